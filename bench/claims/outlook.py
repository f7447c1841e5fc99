"""What would settle a claim that is open: more seeds, more recordings, or nothing that can be had."""

from collections.abc import Iterator, Sequence

from bench.claims.estimate import SETTLED, Estimate, decide
from bench.claims.family import Question
from bench.experiment.seeds import MOST_SEEDS

MOST_RECORDINGS = 100
"""Of one data set: beyond them, and `MOST_SEEDS`, nothing settles a claim at its present size."""


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
