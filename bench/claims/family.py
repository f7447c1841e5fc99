"""Many verdicts at once: at which confidence each must stand, so that few of those that are given are wrong."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

from bench.analysis import spending
from bench.claims.estimate import ALPHA, NOT_RUN, SETTLED, Estimate, Judgement, decide, settle


class Question(NamedTuple):
    """What a claim asks of evidence."""

    found: Sequence[Estimate]
    """The numbers of the claim."""
    accept: tuple[float, float]
    """Its band."""
    relative: bool
    """Whether they are ratios."""
    first: int = 0
    """Seeds a configuration at the first look at this evidence."""
    seeds: int = 0
    """Seeds now, of that of its configurations which has most."""

    def level(self, alpha: float) -> float:
        """The α of this look, where all looks together have ``alpha``."""
        return spending.level(alpha, self.first, self.seeds)


def level(asked: Sequence[Question], rate: float = ALPHA) -> float:
    """The α at which verdicts stand such that at most ``rate`` of those given are expected to be wrong.

    Benjamini and Hochberg's step-up procedure (1995), on verdicts in place of p-values: the largest k such that k
    questions are settled at k ``rate`` / m, of m that there is evidence on. A question's p-value is the smallest α that
    settles it; limits are nested, so that it stays settled at every larger one.
    """
    asked = [q for q in asked if q.found]
    ranks = sorted(_rank(q, rate, len(asked)) for q in asked)
    passed = [k for k, rank in enumerate(ranks, start=1) if rank <= k]
    return rate * max(passed, default=1) / max(len(asked), 1)


def _rank(question: Question, rate: float, count: int) -> int:
    """The smallest k of 1 .. count with which the question is settled at k ``rate`` / count; count + 1 for none."""
    low, high = 1, count + 1
    while low < high:
        k = (low + high) // 2
        at = question.level(rate * k / count)
        if decide(question.found, question.accept, at, question.relative)[0] in SETTLED:
            high = k
        else:
            low = k + 1
    return low


def judged(question: Question, alpha: float, count: int) -> Judgement:
    """The verdict at the family's α; where it would be another one for the claim alone, the basis says so."""
    found, accept, relative = question[:3]
    among = settle(found, accept, question.level(alpha), relative)
    alone = settle(found, accept, ALPHA, relative)
    if among.verdict == alone.verdict or among.verdict == NOT_RUN:
        return among
    said = [f"as one of {count}"] if count > 1 else []
    said += ["after earlier looks"] if question.seeds > question.first else []
    return replace(among, basis=f"{alone.verdict} if it stood alone, but not {' and '.join(said)}. {among.basis}")
