"""Several processes at once, each training its own model on one thread."""

import multiprocessing
import statistics
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from multiprocessing.connection import Connection

from bench.execution.executor import interrupts_withheld
from bench.speed.rows import Row
from bench.speed.timing import Effort

SECONDS = 0.5
"""Of a turn at least."""


def side_by_side(row: Row, kernel: str, effort: Effort) -> tuple[float, float]:
    """Wall seconds of a step of one process alone, and in which every one of ``row.processes`` does a step."""
    with _workers(row, kernel) as workers:
        steps = max(1, round(min(SECONDS, 5 * effort.shortest) / _turn(workers[:1], 3)))
        alone, together = [], []
        for _ in range(effort.rounds):
            alone.append(_turn(workers[:1], steps))
            together.append(_turn(workers, steps))
    return statistics.median(alone), statistics.median(together)


def _turn(workers: list[Connection], steps: int) -> float:
    """Seconds a step, until the last of the workers is done."""
    started = time.perf_counter()
    for worker in workers:
        worker.send(steps)
    for worker in workers:
        worker.recv()
    return (time.perf_counter() - started) / steps


@contextmanager
def _workers(row: Row, kernel: str) -> Iterator[list[Connection]]:
    context = multiprocessing.get_context("spawn")
    pipes = [context.Pipe() for _ in range(row.processes)]
    processes = [context.Process(target=_work, args=(row, kernel, far), daemon=True) for _, far in pipes]
    try:
        with interrupts_withheld():
            for process in processes:
                process.start()
        for near, _ in pipes:
            near.recv()
        yield [near for near, _ in pipes]
    finally:
        for process in processes:
            process.terminate()


def _work(row: Row, kernel: str, asked: Connection) -> None:
    import torch

    from bench.speed import networks

    torch.set_num_threads(1)
    with networks.using(kernel):
        step = networks.ours(replace(row, processes=1))
        step()
        asked.send(0)
        while True:
            for _ in range(asked.recv()):
                step()
            asked.send(0)
