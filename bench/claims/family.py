"""Many verdicts at once: at which confidence each must stand, so that few of those that are given are wrong, and what
would settle those that are open: more seeds, more recordings, or nothing that can be had.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

from bench.analysis import spending
from bench.claims.estimate import ALPHA, NOT_RUN, SETTLED, Estimate, Judgement, decide, settle
from bench.experiment.seeds import MOST_SEEDS

MOST_RECORDINGS = 100
"""Of one data set: beyond them, and `MOST_SEEDS`, nothing settles a claim at its present size."""


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


def outlook(question: Question, alpha: float) -> tuple[str, int]:
    """What would settle the question, as a sentence, and the seeds a configuration that it takes (0: seeds do not).

    Every number is taken to stay where it is and its variances as they were estimated: a forecast, right about as often
    as it is wrong by a seed or two. More seeds are a later look, which takes a narrower interval; new recordings are
    looked at for the first time.

    Args:
        question: that is open at ``alpha``.
        alpha: of the family.
    """
    found = question.found
    seeds, recordings = (min((n for e in found if (n := getattr(e, of))), default=0) for of in ("seeds", "recordings"))
    if not seeds:
        return "", 0
    if seeds == 1 or 1 in [e.recordings for e in found]:
        return f"at least a second {'seed' if seeds == 1 else 'test recording'}: one says nothing about the next", 2
    for more in range(seeds + 1, MOST_SEEDS + 1):
        looked = max(more, question.seeds) if question.first else question.seeds
        if _settled(question._replace(seeds=looked), alpha, more / seeds, 1.0):
            return f"about {_count(more - seeds, 'more seed')} a configuration, {more} in all", more
    for flights in _upwards(recordings, MOST_RECORDINGS):
        if _settled(question, alpha, 1.0, flights / recordings):
            return f"no number of seeds, but about {_count(flights - recordings, 'more test recording')}", 0
    for flights in _upwards(recordings, MOST_RECORDINGS):
        if _settled(question, alpha, MOST_SEEDS / seeds, flights / recordings):
            for more in range(seeds + 1, MOST_SEEDS + 1):
                if _settled(question, alpha, more / seeds, flights / recordings):
                    many = _count(flights - recordings, "more test recording")
                    return f"about {many} and {_count(more - seeds, 'more seed')} a configuration", 0
    what = f"{MOST_SEEDS} seeds" + (f" and {MOST_RECORDINGS} test recordings" if recordings else "")
    return f"nothing at this size: too near the limit of a verdict even with {what}", 0


def _settled(question: Question, alpha: float, seeds: float, recordings: float) -> bool:
    found: Sequence[Estimate] = [e.grown(seeds, recordings) for e in question.found]
    if recordings == 1.0:
        alpha = question.level(alpha)
    return decide(found, question.accept, alpha, question.relative)[0] in SETTLED


def _upwards(start: int, most: int) -> Iterator[int]:
    """Whole numbers above ``start``, an eighth apart where they are many; none where there is no start."""
    at = start
    while start and at < most:
        at = min(most, max(at + 1, at * 9 // 8))
        yield at


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"
