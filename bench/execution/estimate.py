"""What runs will cost: a few updates of every kind of model are timed on this machine, nothing is kept."""

import time
from collections.abc import Iterable
from dataclasses import replace

from bench.execution.engine import Task
from bench.experiment.config import RunConfig
from bench.experiment.run_key import shape_key
from bench.training.data import prepare
from bench.training.train import train

TIMED_SECONDS = 0.5
"""Seconds of updates that are timed of one kind of model, if it is not slower than that."""
MAX_TIMED_UPDATES = 20
"""Updates that are timed at most."""


def seconds(tasks: Iterable[Task]) -> list[float]:
    """Seconds of training of every task on one thread, were all updates of the budget used.

    Early stopping may end a run sooner; reading data and the tests come on top.
    """
    known: dict[tuple[str, int], float] = {}
    estimated = []
    for task in tasks:
        kind = shape_key(task.configs[0]), len(task.configs)
        if kind not in known:
            known[kind] = per_update(task.configs) if task.updates > 1 else 0.0
        estimated.append(known[kind] * task.updates)
    return estimated


def per_update(configs: tuple[RunConfig, ...]) -> float:
    """Seconds of one update of models that are trained side by side."""
    data = [prepare(c) for c in configs]

    def timed(updates: int) -> float:
        budget = {"updates": updates, "evaluate_every": updates, "validation_windows": 1}
        started = time.perf_counter()
        train([replace(c, training=replace(c.training, **budget)) for c in configs], data)
        return time.perf_counter() - started

    once = timed(1)  # with everything that is done once
    if once > TIMED_SECONDS:  # perhaps because it was the first in this process, which loads data and kernels
        once = timed(1)
    more = min(MAX_TIMED_UPDATES, int(TIMED_SECONDS / once))
    if not more:
        return once
    many = timed(1 + more)
    return (many - once) / more if many > once else many / (1 + more)
