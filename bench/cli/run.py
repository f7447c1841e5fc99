"""`bench run`: a study or one configuration, from data to table, figure and MLflow page."""

import os
import shlex
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
from rich.markup import escape

from bench import engine, study
from bench.cli import options
from bench.cli.datasets import choose
from bench.cli.progress import clock, meter
from bench.config import RunConfig, changed
from bench.notation import parse
from bench.record import RunRecord
from registry.contracts import Dataset
from registry.core import PREDICTORS
from registry.errors import BenchError, near

BASELINES = ("constant", "linear")


@click.command("run")
@click.argument("target", metavar="STUDY|SPEC")
@options.dataset
@click.option(
    "--preset", type=click.Choice(study.PRESETS), default="laptop", show_default=True, help="Size of a study."
)
@click.option("--seeds", type=click.IntRange(1, 100), help="How many seeds (SPEC only; default 1).")
@click.option("--horizon", "-T", type=click.IntRange(1), help="Prediction length in samples (default: 40).")
@click.option("--outputs", metavar="SIGNALS", help="What to predict, such as body_rates,velocity or body_rates.p.")
@options.assignments
@click.option("--workers", type=click.IntRange(1, 512), help="Processes, one thread each; default: one a core.")
@options.results
@options.tracking
@click.option("--no-track", is_flag=True, help="Leave MLflow alone; `bench sync` can log the records later.")
@click.option("--dry-run", is_flag=True, help="Say what would be run, train nothing.")
def run_command(
    target: str,
    dataset: str | None,
    preset: str,
    seeds: int | None,
    horizon: int | None,
    outputs: str | None,
    assignments: tuple[str, ...],
    workers: int | None,
    results: Path,
    tracking: str | None,
    no_track: bool,
    dry_run: bool,
) -> None:
    """Run a STUDY of the paper (`bench list studies`) or one configuration SPEC.

    SPEC is the paper's notation: predictor: layers x size - initializer: [size x] history.

    \b
    bench run washout_vs_mlp
    bench run washout_vs_mlp --dataset nanodrone
    bench run "LSTM: 2x50 - MLP: 100x10" --dataset nanodrone --seeds 3 -T 190
    bench run "MLFC: 1x50 - Washout: 10" --set training.updates=3000

    Runs that are already recorded are not trained again: after Ctrl-C, a crash or a power cut, the same command
    goes on where it stopped.
    """
    out = options.console()
    changes = options.parsed(assignments)
    data_options = {k.removeprefix("dataset."): v for k, v in changes.items() if k.startswith("dataset.")}
    run_options = {k: v for k, v in changes.items() if not k.startswith("dataset.")}
    if horizon is not None:
        run_options["horizon"] = str(horizon)
    if outputs is not None:
        run_options["outputs"] = outputs
    found = study.studies().get(target)
    if found is not None and seeds is not None:
        raise BenchError("--seeds belongs to a single configuration; a study's presets set their own.")
    if found is None:
        _check_target(target)
    chosen = choose(dataset or (found.default_dataset if found else "pelican_twin"), data_options)
    configs = _apply(found.runs(preset, chosen) if found else _one(target, chosen, seeds or 1), run_options)
    if found is None:
        configs += _apply(_baselines(configs[0]), run_options, strict=False)
    asked = ", ".join(f"{k} {v}" for k, v in sorted({**run_options, **data_options}.items()) if k != "path")
    title = f"{target} on {chosen.label}" + (f" ({preset})" if found else "") + (f", {asked}" if asked else "")
    runs = results / "runs"
    todo = engine.plan(configs, runs)
    models = sum(len(t.configs) for t in todo.tasks)
    workers = workers or min(os.cpu_count() or 1, max(1, sum(t.updates > 200 for t in todo.tasks)))
    out.print(f"[bold]{escape(title)}[/]: {len(todo.keys)} runs, {len(todo.done)} already recorded, {models} to do.")
    if dry_run:
        for task in todo.tasks:
            out.print(f"  {task.name}, {task.updates} updates")
        return
    tracker = _tracker(no_track, tracking, results, title, target if found else None)
    with meter(out, sum(t.cost for t in todo.tasks) or 1.0, models) as progress:

        def finished(record: RunRecord) -> None:
            progress.record()
            tracker([record])

        records = engine.execute(todo, runs, workers, progress.tick, finished, lambda t: progress.start(t.name))
    if models:
        out.print(f"{models} runs in {clock(time.monotonic() - progress.started)} with {workers} process(es).")
    tracker([r for r in records if r.key in todo.done])
    _conclude(out, records, found, title, results, tracker)


def _portable(arguments: list[str]) -> list[str]:
    """The command line without what belongs to this machine alone: where results go, how many processes."""
    kept, skip = [], False
    for argument in arguments:
        local = argument.partition("=")[0] in ("--results", "--tracking", "--workers")
        if not skip and not local and argument != "--no-track":
            kept.append(argument)
        skip = local and "=" not in argument
    return kept


def _check_target(target: str) -> None:
    """A single word that is neither a study nor a predictor gets the near names of both."""
    if ":" not in target and " " not in target.strip() and target not in PREDICTORS.names():
        raise BenchError(
            f"There is no study or predictor {target!r}: {near(target, [*study.studies(), *PREDICTORS.names()])}"
        )


def _one(spec: str, dataset: Dataset, seeds: int) -> list[RunConfig]:
    """One configuration, as many times as there are seeds."""
    predictor, initializer = parse(spec)
    count = seeds if predictor.training == "gradient" else 1
    return [replace(RunConfig(predictor, initializer, dataset), seed=s) for s in range(count)]


def _baselines(beside: RunConfig) -> list[RunConfig]:
    """The honest baselines, with the history of the run that they are judged beside."""
    b = beside.resolved()
    made = [
        RunConfig(parse(name)[0], None, b.dataset, b.inputs, b.outputs, b.context, history=b.tau) for name in BASELINES
    ]
    return [b for b in made if type(b.predictor) is not type(beside.predictor)]


def _apply(configs: list[RunConfig], assignments: dict[str, str], strict: bool = True) -> list[RunConfig]:
    """Set options on every run that has them; if ``strict``, one that no run has is an error."""
    for name, value in assignments.items():
        applied, problem, any_fits = [], None, False
        for config in configs:
            try:
                applied.append(changed(config, {name: value}))
                any_fits = True
            except BenchError as error:
                if not str(error).startswith("There is no option"):
                    raise
                applied.append(config)
                problem = problem or error
        if strict and not any_fits and problem:
            raise problem
        configs = applied
    return configs


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


def _tracker(off: bool, uri: str | None, results: Path, experiment: str, name: str | None) -> _Tracker:
    if off:
        return _Tracker(None, experiment, name)
    from bench import track

    return _Tracker(uri or track.default_uri(results), experiment, name)


def _conclude(
    out: Any, records: list[RunRecord], found: study.Study | None, title: str, results: Path, tracker: _Tracker
) -> None:
    """Table on the terminal; table, figure and all steps in one folder; where to look next."""
    from bench import conclude

    folder = results / "studies" / conclude.slug(title)
    command = shlex.join(["bench", *_portable(sys.argv[1:])])
    files = conclude.conclude(out, records, title, found, command, folder)
    tracker.attach(files)
    out.print(f"Figure and tables: {escape(str(folder))}")
    if tracker.uri:
        out.print(
            f"Browse all runs: [bold]bench ui --results {escape(str(results))}[/] "
            f"(opens on the chart of “{escape(title)}”)"
        )
