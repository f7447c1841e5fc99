"""Run many configurations: skip what is recorded, group what has one shape, hand it to workers.

Workers get configurations and return outcomes; the driver alone writes records, so a kill loses at most the groups in
hand, and those go on from their last checkpoint.
"""

import hashlib
import os
import platform
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import load, save

from bench.execution.executor import run_jobs, send_progress
from bench.experiment.config import RunConfig, from_json, to_json
from bench.experiment.run_key import environment, run_key, shape_key
from bench.records import record
from bench.records.record import RunRecord
from bench.training.data import prepare
from bench.training.run import Outcome, run_group
from bench.training.split import choose_split, digest
from bench.training.train import batchable
from registry.atomic_io import remove, writing
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
        """File name of its checkpoint: the run that is recorded first, and a function of all of them."""
        return f"{self.keys[0]}-{hashlib.sha256(''.join(self.keys).encode()).hexdigest()[:24]}.safetensors"


@dataclass
class Plan:
    """What there is to do: keys in the order asked, and the tasks that are not recorded yet."""

    keys: list[str]
    tasks: list[Task]
    done: list[str] = field(default_factory=list)
    damaged: list[str] = field(default_factory=list)
    """Sentences about records that were altered since they were written, and are made again."""


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
        key = key_of(config)
        if key in result.keys:
            continue
        result.keys.append(key)
        if record.exists(runs, key):
            altered = record.verify(record.RunRecord(runs / key))
            if not altered:
                result.done.append(key)
                continue
            result.damaged.append(f"Run {key[:12]} is made again: {altered[0]} is damaged.")
        data = prepare(config)
        shape = (shape_key(config), len(data.output_channels), "" if batchable(config, data) else key)
        groups.setdefault(shape, []).append((config, key))
    for members in groups.values():
        for i in range(0, len(members), GROUP):
            part = members[i : i + GROUP]
            result.tasks.append(Task(tuple(c for c, _ in part), tuple(k for _, k in part)))
    result.tasks.sort(key=lambda t: -t.cost)  # the longest first, so that no core waits at the end
    return result


def unrecorded(todo: Plan, runs: Path) -> Plan:
    """The plan without what has been recorded since it was made."""
    left = Plan(todo.keys, [], list(todo.done), list(todo.damaged))
    for task in todo.tasks:
        rest = [(c, k) for c, k in zip(task.configs, task.keys, strict=True) if not record.whole(runs, k)]
        left.done += [k for k in task.keys if k not in [r for _, r in rest]]
        if rest:
            left.tasks.append(Task(tuple(c for c, _ in rest), tuple(k for _, k in rest)))
    return left


def key_of(config: RunConfig) -> str:
    """The key under which this machine would record a run."""
    return run_key(config, digest(config.dataset), choose_split(config))


def refuse_others(configs: Sequence[RunConfig], keys: Sequence[str]) -> None:
    """In a worker: raise `BenchError` where this machine would make other numbers than the driver's."""
    if [key_of(c) for c in configs] != list(keys):
        processor = environment(configs[0])["cpu"]
        raise BenchError(
            f"The worker on {platform.node()} would give other results: its torch, processor ({processor}), "
            "data or this package differ from the driver's; run the driver on a machine like it."
        )


def shared(checkpoint: str) -> Path | None:
    """In a worker: the driver's path of a checkpoint; None where there is no such folder, and what dies starts over."""
    return Path(checkpoint) if Path(checkpoint).parent.is_dir() else None


def _work(plain: Sequence[dict[str, Any]], keys: Sequence[str], checkpoint: str, weight: float) -> list[Outcome]:
    """In a worker: train a group, telling the driver about progress.

    Weights go as bytes: tensors would be shared between processes through a socket in a temporary folder, which a
    worker that is stopped leaves behind.
    """
    torch.set_num_threads(1)
    configs = [from_json(p) for p in plain]
    refuse_others(configs, keys)
    made = run_group(configs, lambda n: send_progress(n * weight), shared(checkpoint))
    return [replace(o, weights=save(o.weights)) for o in made]


def execute(
    todo: Plan,
    runs: Path,
    workers: int = 1,
    tick: Callable[[float], None] = lambda cost: None,
    finished: Callable[[RunRecord], None] = lambda record: None,
    starting: Callable[[Task], None] = lambda task: None,
    cluster: str | None = None,
) -> list[RunRecord]:
    """Run the tasks and write a record a run.

    Args:
        todo: from `plan`.
        runs: folder of the records.
        workers: processes; 1 stays in this one.
        tick: called with a part of `Task.cost` as it is done.
        finished: called in this process with every new record.
        starting: called when a task is handed out.
        cluster: address of a Dask scheduler whose workers do it instead.

    Returns:
        All records of the plan, in the order asked.

    Raises:
        BenchError: a folder that cannot be written, or workers that die again and again.
    """
    partial = runs / ".partial"
    with writing(f"The results folder {runs}"):
        partial.mkdir(parents=True, exist_ok=True)
    if not os.access(runs, os.W_OK):
        raise BenchError(f"The results folder {runs} cannot be written: choose another with --results.")

    def jobs() -> Iterator[tuple[Task, Callable[..., list[Outcome]], tuple[Any, ...]]]:
        for task in todo.tasks:
            starting(task)
            weight = task.cost / (task.updates * len(task.configs))
            plain, checkpoint = [to_json(c) for c in task.configs], str((partial / task.checkpoint).resolve())
            yield task, _work, (plain, list(task.keys), checkpoint, weight)

    with closing(run_jobs(jobs(), min(workers, len(todo.tasks)), tick, lambda t: t.name, cluster)) as done:
        for _, outcomes in done:
            for outcome in outcomes:
                finished(write(outcome, runs))
            _forget(partial, runs)
    _forget(partial, runs)
    with suppress(OSError):
        partial.rmdir()  # stays while another driver's checkpoints are in it
    return [RunRecord(runs / key) for key in todo.keys]


def _forget(partial: Path, runs: Path) -> None:
    """Remove the checkpoints, and drafts of them, whose runs are recorded: by this driver or by one that was killed."""
    for left in partial.glob("*"):
        if record.whole(runs, left.name.lstrip(".").split("-")[0]):
            remove(left)


def write(outcome: Outcome, runs: Path) -> RunRecord:
    """File an outcome as a record."""
    weights = load(outcome.weights) if isinstance(outcome.weights, bytes) else outcome.weights
    return record.write(runs, outcome.summary, outcome.config, outcome.tables, weights, outcome.provenance)
