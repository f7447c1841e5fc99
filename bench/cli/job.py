"""One study or configuration on its way: plan, train, mirror, table and figures."""

import os
import shlex
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import click
from rich.console import Console
from rich.markup import escape

from bench.cli.execution_options import Execution, portable
from bench.cli.progress import clock, meter
from bench.execution import engine, lock
from bench.experiment.config import RunConfig
from bench.experiment.request import Request
from bench.records.record import RunRecord
from bench.tracking.mirroring import Mirroring


@dataclass(frozen=True)
class Job:
    """Runs under one title, and how they were asked for."""

    asked: Request
    command: list[str]
    """Arguments of `bench` that make it again."""

    @property
    def title(self) -> str:
        """Of the study or configuration."""
        return self.asked.title

    @property
    def configs(self) -> list[RunConfig]:
        """Of its runs."""
        return self.asked.configs


def print_plan(out: Console, job: Job, todo: engine.Plan) -> int:
    """One line about what there is to do; returns the number of runs to do."""
    for sentence in todo.damaged:
        click.echo(f"bench: {sentence}", err=True)
    models = sum(len(t.configs) for t in todo.tasks)
    out.print(
        f"[bold]{escape(job.title)}[/]: {len(todo.keys)} runs, {len(todo.done)} already recorded, {models} to do."
    )
    return models


def carry_out(out: Console, job: Job, todo: engine.Plan, execution: Execution, tables: bool = True) -> None:
    """Train what is missing, then print the table and write figures; one driver at a time.

    Args:
        out: where it is said.
        job: what was asked for.
        todo: its plan.
        execution: where results go, and what carries the work out.
        tables: print the table, and where the files are.

    Raises:
        BenchError: another driver is at this study, the results folder cannot be written, or workers die.
    """
    from bench.records.finished import slug
    from bench.reporting import study_outputs

    folder = execution.results / "studies" / slug(job.title)
    with (
        lock.held(folder, job.title),
        mirroring(execution, job.title, job.asked.target if job.asked.study else None) as mirror,
    ):
        todo = engine.unrecorded(todo, execution.runs)
        models = print_plan(out, job, todo)
        workers = execution.workers or min(os.cpu_count() or 1, max(1, sum(t.updates > 200 for t in todo.tasks)))
        started = time.monotonic()
        records = train_missing(out, todo, execution, workers, lambda r: mirror.add([r.folder]) if mirror else None)
        if models:
            by = f"on {execution.cluster}" if execution.cluster else f"with {workers} process(es)"
            out.print(f"{models} runs in {clock(time.monotonic() - started)} {escape(by)}.")
        if mirror:
            mirror.add(execution.runs / key for key in todo.done)
        command = shlex.join(["bench", *portable(job.command)])
        shown = out if tables else Console(quiet=True)
        files = study_outputs.write_outputs(shown, records, job.title, job.asked.study, command, folder)
        shown.print(f"Figure and tables: {escape(str(folder))}")
        if mirror:
            mirror.attach(files)
            browse(shown, mirror.finish(), job.title, execution)


def train_missing(
    out: Console,
    todo: engine.Plan,
    execution: Execution,
    workers: int,
    finished: Callable[[RunRecord], None] = lambda r: None,
) -> list[RunRecord]:
    """Carry out a plan beside a bar; gives the records in its order, and each that is new to ``finished``."""
    with meter(out, sum(t.cost for t in todo.tasks) or 1.0, sum(len(t.configs) for t in todo.tasks)) as progress:

        def recorded(record: RunRecord) -> None:
            progress.record()
            finished(record)

        return engine.execute(
            todo,
            execution.runs,
            workers,
            tick=progress.tick,
            finished=recorded,
            starting=lambda t: progress.start(t.name),
            cluster=execution.cluster,
        )


@contextmanager
def mirroring(execution: Execution, title: str, name: str | None) -> Iterator[Mirroring | None]:
    """MLflow beside a study or sweep, gone with it; None where it is to be left alone."""
    if execution.no_track:
        yield None
        return
    uri = execution.tracking or f"sqlite:///{execution.results.resolve() / 'mlflow.db'}"
    mirror = Mirroring(uri, title, name, lambda s: click.echo(f"bench: {s}", err=True))
    try:
        yield mirror
    finally:
        mirror.stop()


def browse(out: Console, missing: int, title: str, execution: Execution) -> None:
    """Where to look next."""
    tracking = ["--tracking", execution.tracking] if execution.tracking else []
    where = escape(shlex.join(["--results", str(execution.results), *tracking]))
    if missing:
        out.print(f"{missing} runs are not in MLflow yet: [bold]bench sync {where}[/] logs them.")
    else:
        out.print(f"Browse all runs: [bold]bench ui {where}[/] (opens on the chart of “{escape(title)}”)")
