"""Many verdicts at once: at which confidence each must stand, so that few of those that are given are wrong."""

from collections.abc import Sequence
from dataclasses import replace

from bench.claims.estimate import ALPHA, NOT_RUN, SETTLED, Estimate, Judgement, decide, settle

Question = tuple[Sequence[Estimate], tuple[float, float], bool]
"""The numbers of a claim, its band, and whether they are ratios: what `settle` takes beside α."""


def level(asked: Sequence[Question], rate: float = ALPHA) -> float:
    """The α at which verdicts stand such that at most ``rate`` of those given are expected to be wrong.

    Benjamini and Hochberg's step-up procedure (1995), on verdicts in place of p-values: the largest k such that k
    questions are settled at k ``rate`` / m, of m that there is evidence on. A question's p-value is the smallest α that
    settles it; limits are nested, so that it stays settled at every larger one.
    """
    asked = [q for q in asked if q[0]]
    ranks = sorted(_rank(q, rate, len(asked)) for q in asked)
    passed = [k for k, rank in enumerate(ranks, start=1) if rank <= k]
    return rate * max(passed, default=1) / max(len(asked), 1)


def _rank(question: Question, rate: float, count: int) -> int:
    """The smallest k of 1 .. count with which the question is settled at k ``rate`` / count; count + 1 for none."""
    low, high = 1, count + 1
    while low < high:
        k = (low + high) // 2
        if decide(*question[:2], rate * k / count, question[2])[0] in SETTLED:
            high = k
        else:
            low = k + 1
    return low


def judged(question: Question, alpha: float, count: int) -> Judgement:
    """The verdict at the family's α; where it would be another one for the claim alone, the basis says so."""
    found, accept, relative = question
    among, alone = settle(found, accept, alpha, relative), settle(found, accept, ALPHA, relative)
    if among.verdict == alone.verdict or among.verdict == NOT_RUN:
        return among
    said = f"{alone.verdict} if it were the only claim, but not as one of {count}. {among.basis}"
    return replace(among, basis=said)
