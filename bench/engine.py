"""Run many configurations: skip what is recorded, group what has one shape, use one or several processes.

One path over `concurrent.futures.Executor`. Workers get configurations and return outcomes; the driver alone
writes records, so a kill loses at most the groups in hand, and those go on from their last checkpoint.
"""

import ctypes
import hashlib
import multiprocessing
import os
import queue
import signal
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED as FIRST
from concurrent.futures import Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch

from bench import record
from bench.config import RunConfig, from_json, run_key, shape_key, to_json
from bench.data import choose_split, digest, prepare
from bench.record import RunRecord
from bench.run import Outcome, run_group
from bench.train import independent
from registry.errors import BenchError

GROUP = 9
"""Models trained side by side at most: beyond that a batch no longer fits the cache and nothing is gained."""


@dataclass(frozen=True)
class Task:
    """A group of runs of one shape, trained side by side."""

    configs: tuple[RunConfig, ...]
    keys: tuple[str, ...]

    @property
    def cost(self) -> float:
        """Rough size of the work: model updates times steps of a window times layers (for progress only)."""
        c = self.configs[0]
        return len(self.configs) * self.updates * (c.tau + c.horizon) * getattr(c.predictor, "layers", 1)

    @property
    def updates(self) -> int:
        """Updates of one run, 1 for what is not trained by gradient."""
        c = self.configs[0]
        return c.training.updates if c.predictor.training == "gradient" else 1

    @property
    def name(self) -> str:
        """What is trained, for progress lines."""
        c = self.configs[0]
        more = f" ({len(self.configs)} side by side)" if len(self.configs) > 1 else ""
        return f"{c.spec}, T = {c.horizon}{more}"

    @property
    def checkpoint(self) -> str:
        """File name of its checkpoint: a function of the runs in it."""
        return hashlib.sha256("".join(self.keys).encode()).hexdigest()[:24] + ".safetensors"


@dataclass
class Plan:
    """What there is to do: keys in the order asked, and the tasks that are not recorded yet."""

    keys: list[str]
    tasks: list[Task]
    done: list[str] = field(default_factory=list)


def plan(configs: Iterable[RunConfig], runs: Path) -> Plan:
    """Check every configuration against its data, and group what is missing. Nothing is trained.

    Raises:
        BenchError: data that are absent, or a configuration that does not fit them.
    """
    torch.set_num_threads(1)  # the run key names the thread count
    result = Plan([], [])
    groups: dict[Any, list[tuple[RunConfig, str]]] = {}
    for config in configs:
        config = config.resolved()
        key = run_key(config, digest(config.dataset), choose_split(config))
        if key in result.keys:
            continue
        result.keys.append(key)
        if record.exists(runs, key):
            result.done.append(key)
            continue
        data = prepare(config)
        side_by_side = (
            config.predictor.training == "gradient" and independent(config) and len(data.train) >= config.training.batch
        )
        shape = (shape_key(config), len(data.output_channels), "" if side_by_side else key)
        groups.setdefault(shape, []).append((config, key))
    for members in groups.values():
        for i in range(0, len(members), GROUP):
            part = members[i : i + GROUP]
            result.tasks.append(Task(tuple(c for c, _ in part), tuple(k for _, k in part)))
    result.tasks.sort(key=lambda t: -t.cost)  # the longest first, so that no core waits at the end
    return result


class _Inline(Executor):
    """Runs a task when it is submitted, in this process."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


_ticks: Any = None


def _start_worker(ticks: Any) -> None:
    global _ticks
    _ticks = ticks
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the driver's to handle
    if sys.platform == "linux":  # a driver that is killed takes its workers along
        ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG


def _work(plain: Sequence[dict[str, Any]], checkpoint: Path, weight: float) -> list[Outcome]:
    """In a worker: train a group, telling the driver about progress."""
    return run_group([from_json(p) for p in plain], lambda n: _ticks.put(n * weight), checkpoint)


@contextmanager
def _executor(workers: int, tick: Callable[[float], None]) -> Iterator[tuple[Executor, Any]]:
    """An executor and the queue through which its tasks report progress."""
    global _ticks
    if workers <= 1:
        _ticks = _Direct(tick)
        yield _Inline(), None
        return
    context = multiprocessing.get_context("spawn")
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    ticks = context.Queue()
    pool = ProcessPoolExecutor(workers, context, _start_worker, (ticks,))
    try:
        yield pool, ticks
    finally:
        for process in list((pool._processes or {}).values()):
            process.terminate()
        pool.shutdown(wait=False, cancel_futures=True)


class _Direct:
    """Stands in for the queue when tasks run in this process."""

    def __init__(self, tick: Callable[[float], None]) -> None:
        self.put = tick


def execute(
    todo: Plan,
    runs: Path,
    workers: int = 1,
    tick: Callable[[float], None] = lambda cost: None,
    finished: Callable[[RunRecord], None] = lambda record: None,
    starting: Callable[[Task], None] = lambda task: None,
) -> list[RunRecord]:
    """Run the tasks and write a record a run.

    Args:
        todo: from `plan`.
        runs: folder of the records.
        workers: processes; 1 stays in this one.
        tick: called with a part of `Task.cost` as it is done.
        finished: called in this process with every new record.
        starting: called when a task is handed out.

    Returns:
        All records of the plan, in the order asked.
    """
    try:
        runs.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BenchError(f"The results folder {runs} cannot be written: {error.strerror or error}.") from error
    if not os.access(runs, os.W_OK):
        raise BenchError(f"The results folder {runs} cannot be written: choose another with --results.")
    waiting = list(todo.tasks)
    with _executor(min(workers, len(waiting)), tick) as (executor, ticks):
        pending: dict[Future[list[Outcome]], Task] = {}
        while waiting or pending:
            while waiting and len(pending) < max(1, workers):
                task = waiting.pop(0)
                starting(task)
                weight = task.cost / (task.updates * len(task.configs))
                plain = [to_json(c) for c in task.configs]
                pending[executor.submit(_work, plain, runs / ".partial" / task.checkpoint, weight)] = task
            done, _ = wait(pending, timeout=0.5, return_when=FIRST)
            _drain(ticks, tick)
            failed = [f for f in done if f.exception()]
            for future in sorted(done, key=failed.__contains__):  # what is good is kept before anything is raised
                task = pending.pop(future)
                try:
                    outcomes = future.result()
                except BrokenProcessPool:
                    raise BenchError(
                        f"A worker process died while training {task.name} (out of memory?): what was finished is "
                        "kept, start again, with fewer --workers if it happens twice."
                    ) from None
                for outcome in outcomes:
                    finished(write(outcome, runs))
                (runs / ".partial" / task.checkpoint).unlink(missing_ok=True)
    with suppress(OSError):
        (runs / ".partial").rmdir()  # stays while another driver's checkpoints are in it
    return [RunRecord(runs / key) for key in todo.keys]


def _drain(ticks: Any, tick: Callable[[float], None]) -> None:
    while ticks is not None:
        try:
            tick(ticks.get_nowait())
        except queue.Empty:
            return


def write(outcome: Outcome, runs: Path) -> RunRecord:
    """File an outcome as a record."""
    return record.write(runs, outcome.summary, outcome.config, outcome.tables, outcome.weights, outcome.provenance)
