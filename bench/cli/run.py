"""`bench run`: a study or one configuration, from data to table, figure and MLflow page."""

import sys
from dataclasses import replace
from pathlib import Path

import click
from rich.markup import escape

from bench.cli import options
from bench.cli.cost import estimate
from bench.cli.datasets import choose
from bench.cli.job import Job, Place, carry_out
from bench.execution import engine
from bench.experiment import study
from bench.experiment.config import RunConfig, changed
from bench.experiment.notation import parse
from bench.training.data import held_back
from registry.contracts import Dataset
from registry.core import PREDICTORS
from registry.errors import BenchError, near
from registry.predictors.physics import digest

BASELINES = ("constant", "linear")
ALL = "all"


@click.command("run")
@click.argument("target", metavar="STUDY|SPEC|all")
@options.dataset
@click.option(
    "--preset",
    type=click.Choice(study.PRESETS),
    default="laptop",
    show_default=True,
    help="Size of a study. Simulated data are as many as the paper's, for smoke a small part of them.",
)
@click.option("--seeds", type=click.IntRange(1, 100), help="How many seeds (SPEC only; default 1).")
@options.horizon
@options.outputs
@click.option(
    "--physics",
    type=click.Path(exists=True, dir_okay=False, resolve_path=True),
    metavar="MODEL.TOML",
    help="The physics of `physics` and `Hybrid`, as `bench diagnose` and `bench extend` write it; default: nominal.",
)
@options.assignments
@options.workers
@options.cluster
@options.results
@options.tracking
@options.no_track
@click.option("--dry-run", is_flag=True, help="Say what would be run and how long it would take; train nothing.")
@click.pass_context
def run_command(
    ctx: click.Context,
    target: str,
    dataset: str | None,
    preset: str,
    seeds: int | None,
    horizon: int | None,
    outputs: str | None,
    physics: str | None,
    assignments: tuple[str, ...],
    workers: int | None,
    cluster: str | None,
    results: Path,
    tracking: str | None,
    no_track: bool,
    dry_run: bool,
) -> None:
    """Run a STUDY of the paper (`bench list studies`), one configuration SPEC, or all studies.

    SPEC is the paper's notation: predictor: layers x size - initializer: [size x] history.

    \b
    bench run washout_vs_mlp
    bench run washout_vs_mlp --dataset nanodrone
    bench run "LSTM: 2x50 - MLP: 100x10" --dataset nanodrone --seeds 3 -T 190
    bench run "MLFC: 1x50 - Washout: 10" --set training.updates=3000
    bench run quadrotor_hybrid --dataset my_flights --physics my_flights/diagnosis/model.toml
    bench run all --dry-run                              what the lot would cost
    bench run all --cluster tcp://127.0.0.1:8786         workers of a Dask cluster

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
    if physics is not None:
        run_options["predictor.model"] = physics
    known = study.studies()
    if seeds is not None and (target in known or target == ALL):
        raise BenchError("--seeds belongs to a single configuration; a study's presets set their own.")
    said = {**run_options, **data_options}
    if file := said.get("predictor.model"):  # its name alone would make one study of two models
        said["predictor.model"] = f"{Path(file).name} {digest(file)[:8]}"
    asked = ", ".join(f"{k} {v}" for k, v in sorted(said.items()) if k != "path")

    def job(name: str) -> Job:
        """The runs of one study or configuration."""
        found = known.get(name)
        source = dataset or (found.default_dataset if found else "pelican_twin")
        chosen = choose(source, data_options, full=found is not None and preset != "smoke")
        configs = found.runs(preset, chosen) if found else _one(name, chosen, seeds or 1)
        if physics and not any(hasattr(c.predictor, "model") for c in configs):
            raise BenchError(f"{name} has no physics: --physics belongs to `physics` and to hybrids.")
        configs = apply(configs, run_options)
        if found is None:
            configs += apply(_baselines(configs[0]), run_options, strict=False)
        title = f"{name} on {chosen.label}" + (f" ({preset})" if found else "") + (f", {asked}" if asked else "")
        return Job(title, name, found, configs, [name if a == ALL else a for a in sys.argv[1:]])

    if target not in known and target != ALL:
        check_target(target)
        options.preset_belongs_to_a_study(ctx)
    place = Place(results, tracking, no_track, workers, cluster)
    planned = []
    for name in known if target == ALL else [target]:
        try:
            made = job(name)
            if sentence := held_back(made.configs[0]):
                out.print(escape(sentence))
            planned.append((made, engine.plan(made.configs, place.runs)))
        except BenchError as error:
            if target != ALL:
                raise
            out.print(f"{escape(name)} is left out: {escape(str(error))}")
    if dry_run:
        estimate(out, planned, place)
        return
    for made, todo in planned:
        carry_out(out, made, todo, place)


def check_target(target: str) -> None:
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


def apply(configs: list[RunConfig], assignments: dict[str, str], strict: bool = True) -> list[RunConfig]:
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
