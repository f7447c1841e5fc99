"""Interleaved timing: contenders take turns, so that what else the machine does falls on all of them alike."""

import statistics
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

Contender = Callable[[], object]
"""Does the work once."""


@dataclass(frozen=True)
class Effort:
    """How long to measure."""

    rounds: int = 7
    """Turns of every contender."""
    fewest: int = 3
    """Turns that are taken however long they last."""
    shortest: float = 0.1
    """Seconds of a turn: quick work is repeated until they are over."""
    budget: float = 20.0
    """Seconds after which no turn beyond the fewest is begun."""


QUICK = Effort(rounds=2, fewest=2, shortest=0.005, budget=1.0)


def interleaved(
    contenders: Mapping[str, Contender],
    effort: Effort,
    clock: Callable[[], float] = time.process_time,
) -> dict[str, float]:
    """Median seconds of one call of every contender.

    The clock is the process's own CPU time, which is right for work on one thread: time that the scheduler gives to
    others does not count. A first call warms up and is not counted.
    """
    for work in contenders.values():
        work()
    begun = time.monotonic()
    samples: dict[str, list[float]] = {name: [] for name in contenders}
    for turn in range(effort.rounds):
        if turn >= effort.fewest and time.monotonic() - begun > effort.budget:
            break
        for name, work in contenders.items():
            samples[name].append(_turn(work, effort.shortest, clock))
    return {name: statistics.median(taken) for name, taken in samples.items()}


def _turn(work: Contender, shortest: float, clock: Callable[[], float]) -> float:
    """Seconds of a call; of quick work without the first one, which finds the caches full of another's data."""
    started = clock()
    work()
    if (elapsed := clock() - started) >= shortest:
        return elapsed
    started, count = clock(), 0
    while True:
        work()
        count += 1
        elapsed = clock() - started
        if elapsed >= shortest:
            return elapsed / count
