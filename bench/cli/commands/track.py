"""`bench ui` and `bench sync`: the MLflow side."""

from pathlib import Path

import click

from bench.cli import options
from registry.errors import BenchError

LOCK = ".sync.lock"
"""Held while `bench sync` logs: two at once would log one run twice."""


@click.command("ui")
@options.results
@options.tracking
@click.option(
    "--port", type=click.IntRange(1, 65535), default=5000, show_default=True, help="The next free one if taken."
)
@click.option("--study", metavar="EXPERIMENT", help="Experiment to open; default: the latest.")
def ui_command(results: Path, tracking: str | None, port: int, study: str | None) -> None:
    """Browse the results in the MLflow UI, on this machine only (127.0.0.1)."""
    from bench.tracking.ui import serve

    _present(results, tracking)
    serve(results, tracking, port=port, study=study)


@click.command("sync")
@options.results
@options.tracking
def sync_command(results: Path, tracking: str | None) -> None:
    """Log every recorded run, study and sweep in MLflow again; what is already there stays as it is.

    Runs that a killed driver has left half logged are completed.
    """
    from bench.execution import lock

    _present(results)
    with lock.turn(results, LOCK, lambda sentence: click.echo(f"bench: {sentence}", err=True)):
        _sync(results, tracking)


def _sync(results: Path, tracking: str | None) -> None:
    from bench.records import record
    from bench.records.finished import finished_studies
    from bench.sweep import journal as sweep
    from bench.tracking import track

    own = track.default_uri(results)
    uri, logged = tracking or own, 0
    for study in finished_studies(results):
        folders = [results / "runs" / key for key in study.keys]
        present = [f for f in folders if (f / "record.json").is_file()]
        there = track.whole(uri, study.title, study.study)
        track.mirror([f for f in present if f.name not in there], uri, study.title, study.study)
        track.attach(uri, study.title, study.study or study.title, study.files)
        logged += len(present)
        click.echo(f"{study.title}: {len(present)} runs")
    for folder in sweep.sweeps(results):
        kept, keys = sweep.read(folder)
        finished = sweep.finished(sweep.load(folder))
        track.mirror_trials(uri, kept.title, folder.name, kept.configs, finished)
        present = [results / "runs" / key for key in keys if record.exists(results / "runs", key)]
        track.mirror(present, uri, kept.title, folder.name)
        track.attach(uri, kept.title, folder.name, [f for f in (folder / sweep.REPORT,) if f.is_file()])
        logged += len(finished) + len(present)
        click.echo(f"{kept.title}: {len(finished)} trials, {len(present)} runs")
    repaired = track.repair(uri, results / "runs", own=uri == own)
    if repaired:
        click.echo(f"{repaired} runs that were left half logged are repaired.")
    click.echo(f"{logged} runs are in MLflow at {uri}.")


def _present(results: Path, tracking: str | None = None) -> None:
    if tracking is None and not results.is_dir():
        raise BenchError(
            f"There is no folder {results}: name the one that holds your runs with --results, or make a first one with "
            "`bench run washout_vs_mlp`."
        )
