"""One study or configuration on its way: plan, train, mirror, table and figures."""

import os
import shlex
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
from rich.console import Console
from rich.markup import escape

from bench import engine, study
from bench.cli.progress import clock, meter
from bench.config import RunConfig
from bench.record import RunRecord


@dataclass(frozen=True)
class Job:
    """What is asked: runs under one title."""

    title: str
    target: str
    """Name of the study, or the configuration."""
    study: study.Study | None
    configs: list[RunConfig]
    command: list[str]
    """Arguments of `bench` that make it again."""


@dataclass(frozen=True)
class Place:
    """Where results go and who makes them."""

    results: Path
    tracking: str | None
    """MLflow address; None: the database in the results folder."""
    no_track: bool
    workers: int | None
    """Processes; None: one a core, as far as there is work for them."""

    @property
    def runs(self) -> Path:
        """Folder of the records."""
        return self.results / "runs"


def say(out: Console, job: Job, todo: engine.Plan) -> int:
    """One line about what there is to do; returns the number of runs to do."""
    models = sum(len(t.configs) for t in todo.tasks)
    out.print(
        f"[bold]{escape(job.title)}[/]: {len(todo.keys)} runs, {len(todo.done)} already recorded, {models} to do."
    )
    return models


def carry_out(out: Console, job: Job, todo: engine.Plan, place: Place) -> None:
    """Train what is missing, then print the table and write figures."""
    models = say(out, job, todo)
    workers = place.workers or min(os.cpu_count() or 1, max(1, sum(t.updates > 200 for t in todo.tasks)))
    tracker = _tracker(place, job.title, job.target if job.study else None)
    with meter(out, sum(t.cost for t in todo.tasks) or 1.0, models) as progress:

        def finished(record: RunRecord) -> None:
            progress.record()
            tracker([record])

        records = engine.execute(todo, place.runs, workers, progress.tick, finished, lambda t: progress.start(t.name))
    if models:
        out.print(f"{models} runs in {clock(time.monotonic() - progress.started)} with {workers} process(es).")
    tracker([r for r in records if r.key in todo.done])
    _conclude(out, records, job, place.results, tracker)


class _Tracker:
    """Mirrors records in MLflow as they come; a tracking server that fails is said once and does not stop a study."""

    def __init__(self, uri: str | None, experiment: str, name: str | None) -> None:
        self.uri, self.experiment, self.study = uri, experiment, name
        self.experiment_id: str | None = None

    def __call__(self, records: list[RunRecord]) -> None:
        if self.uri and records:
            from bench import track

            self._try(lambda: track.mirror([r.folder for r in records], self.uri or "", self.experiment, self.study))

    def attach(self, files: list[Path]) -> None:
        """Study-level figures and tables."""
        if self.uri:
            from bench import track

            self._try(lambda: track.attach(self.uri or "", self.experiment, self.study or self.experiment, files))

    def _try(self, action: Callable[[], Any]) -> None:
        from bench.track import TrackingError

        try:
            result = action()
            self.experiment_id = getattr(result, "experiment_id", self.experiment_id)
        except TrackingError as error:
            click.echo(f"bench: {error}", err=True)
            self.uri = None


def _tracker(place: Place, experiment: str, name: str | None) -> _Tracker:
    if place.no_track:
        return _Tracker(None, experiment, name)
    from bench import track

    return _Tracker(place.tracking or track.default_uri(place.results), experiment, name)


def _conclude(out: Console, records: list[RunRecord], job: Job, results: Path, tracker: _Tracker) -> None:
    """Table on the terminal; table, figure and all steps in one folder; where to look next."""
    from bench import conclude

    folder = results / "studies" / conclude.slug(job.title)
    command = shlex.join(["bench", *_portable(job.command)])
    files = conclude.conclude(out, records, job.title, job.study, command, folder)
    tracker.attach(files)
    out.print(f"Figure and tables: {escape(str(folder))}")
    if tracker.uri:
        out.print(
            f"Browse all runs: [bold]bench ui --results {escape(str(results))}[/] "
            f"(opens on the chart of “{escape(job.title)}”)"
        )


def _portable(arguments: list[str]) -> list[str]:
    """The command line without what belongs to this machine alone: where results go, how many processes."""
    kept, skip = [], False
    for argument in arguments:
        local = argument.partition("=")[0] in ("--results", "--tracking", "--workers")
        if not skip and not local and argument != "--no-track":
            kept.append(argument)
        skip = local and "=" not in argument
    return kept
