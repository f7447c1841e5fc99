"""Many verdicts at once: at which confidence each must stand, so that few of those that are given are wrong."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

from bench.analysis import spending
from bench.claims.estimate import ALPHA, NOT_RUN, SETTLED, Estimate, Judgement, decide, settle


class Question(NamedTuple):
    """What a claim asks of evidence, at every look at it."""

    found: Sequence[Estimate]
    """The numbers of the claim, by all evidence."""
    accept: tuple[float, float]
    """Its band."""
    relative: bool
    """Whether they are ratios."""
    seeds: int = 0
    """Of a configuration; 0: the only look, at seeds that nobody added to."""
    earlier: tuple[tuple[int, Sequence[Estimate]], ...] = ()
    """Seeds and the same numbers at the looks before, from the first."""

    @property
    def first(self) -> int:
        """Seeds at the first look."""
        return self.earlier[0][0] if self.earlier else self.seeds

    def looks(self, alpha: float) -> list[tuple[int, Sequence[Estimate], float]]:
        """Seeds, numbers and level of every look, the last one first."""
        looks = [*self.earlier, (self.seeds, self.found)]
        return [(n, found, spending.level(alpha, self.first, n)) for n, found in reversed(looks)]


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
        if verdict(question, rate * k / count)[0] in SETTLED:
            high = k
        else:
            low = k + 1
    return low


def verdict(question: Question, alpha: float) -> tuple[str, int]:
    """The verdict of the latest look that gives one, and the seeds it had; what the latest look says if none does."""
    said = [(decide(found, question.accept, at, question.relative)[0], n) for n, found, at in question.looks(alpha)]
    return next((v for v in said if v[0] in SETTLED), said[0])


def judged(question: Question, alpha: float, count: int) -> Judgement:
    """The verdict at the family's α, with the numbers of all evidence.

    Where it would be another one for the claim alone, or rests on an earlier look, the basis says so.
    """
    now, seeds = verdict(question, alpha)
    at = spending.level(alpha, question.first, question.seeds)
    among = settle(question.found, question.accept, at, question.relative)
    if seeds < question.seeds:
        said = f"settled with {seeds} of {question.seeds} seeds, and not contradicted since. {among.basis}"
        return replace(among, verdict=now, basis=said)
    alone = settle(question.found, question.accept, ALPHA, question.relative)
    if among.verdict == alone.verdict or among.verdict == NOT_RUN:
        return among
    said = [f"as one of {count}"] if count > 1 else []
    said += ["after earlier looks"] if question.earlier else []
    return replace(among, basis=f"{alone.verdict} if it stood alone, but not {' and '.join(said)}. {among.basis}")
