"""`bench sweep`: better options for a configuration, or the best configuration of a study, found by trial."""

import os
import shlex
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from bench import engine, lock, study
from bench.cli import options
from bench.cli.datasets import choose
from bench.cli.job import Place, browse, mirroring, portable
from bench.cli.progress import clock, meter
from bench.cli.run import apply, check_target
from bench.conclude import slug
from bench.config import RunConfig
from bench.mirroring import Mirroring
from bench.notation import parse
from bench.record import RunRecord
from bench.study import Study
from registry.contracts import Dataset
from registry.errors import BenchError

LOOKS = 20
"""At the validation part in a trial, where the user sets the updates alone; each is a chance to stop it."""


@click.command("sweep")
@click.argument("target", metavar="STUDY|SPEC")
@options.dataset
@click.option("--trials", type=click.IntRange(1, 100_000), default=30, show_default=True, help="Trials in all.")
@click.option(
    "--search",
    "searches",
    multiple=True,
    metavar="OPTION=LOW:HIGH[:log]",
    help="Search this range of an option, or these values of it (OPTION=A,B,C), in place of its default range or "
    "besides the options searched by default. May be repeated.",
)
@options.assignments
@click.option(
    "--objective",
    "objectives",
    multiple=True,
    type=click.Choice(["rmsse", "weights", "latency"]),
    help="What to make small; rmsse always is. With weights or latency (of one prediction, in ms) besides, the answer "
    "is a Pareto front, and no trial is stopped early.",
)
@click.option("--horizon", "-T", type=click.IntRange(1), help="Prediction length in samples (default: 40).")
@click.option("--outputs", metavar="SIGNALS", help="What to predict, such as body_rates,velocity or body_rates.p.")
@click.option("--preset", type=click.Choice(study.PRESETS), default="laptop", show_default=True, help="Of a STUDY.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Of the proposals.")
@click.option("--workers", type=click.IntRange(1, 512), help="Processes, one thread each; default: one a core.")
@click.option("--name", help="Of the sweep's folder, `<results>/sweeps/NAME`; default: made of what is searched.")
@click.option("--resume", is_flag=True, help="Go on with a sweep that was stopped or killed, or add trials to it.")
@options.results
@options.tracking
@click.option("--no-track", is_flag=True, help="Leave MLflow alone; `bench sync` can log the trials later.")
@click.option("--dry-run", is_flag=True, help="Say what would be searched and how long it would take; train nothing.")
def sweep_command(
    target: str,
    dataset: str | None,
    trials: int,
    searches: tuple[str, ...],
    assignments: tuple[str, ...],
    objectives: tuple[str, ...],
    horizon: int | None,
    outputs: str | None,
    preset: str,
    seed: int,
    workers: int | None,
    name: str | None,
    resume: bool,
    results: Path,
    tracking: str | None,
    no_track: bool,
    dry_run: bool,
) -> None:
    """Search the options of a SPEC, or the configurations of a STUDY, for the smallest error on the validation part.

    \b
    bench sweep "LSTM: 1x50 - MLP: 60x10" --dataset nanodrone --trials 30 --workers 2
    bench sweep "LSTM: 1x50 - MLP: 60x10" --search predictor.hidden=10:200:log --set predictor.layers=1
    bench sweep washout_vs_mlp --trials 20               which of its configurations, with which learning rate
    bench sweep "LSTM: 1x50 - MLP: 60x10" --objective weights
    bench sweep "LSTM: 1x50 - MLP: 60x10" --trials 60 --resume

    Of a SPEC, sizes and learning rate are searched (`--dry-run` lists the ranges); what you name is the first trial.
    Of a STUDY, every configuration that is trained is a choice, on the study's first outputs and horizon (choose
    others with --outputs and -T), and the learning rate is searched along. An option given with --set is not searched.

    Each trial trains on the training part and is judged on the validation part (RMSSE of the outputs, each in units of
    its standard deviation). Optuna's TPE proposes; a trial that is worse than the median of the others at the same
    update is stopped. At the end the best configuration and the default one are trained from three fresh seeds and
    compared on the validation and, for the first time, on the test part.

    Nothing that was told is lost: after Ctrl-C, a crash or a power cut, the same command with --resume goes on.
    """
    from bench.sweep import journal as sweeps
    from bench.sweep.space import default_space, parse_search

    out = options.console()
    place = Place(results, tracking, no_track, workers)
    changes = options.parsed(assignments)
    run_options = {k: v for k, v in changes.items() if not k.startswith("dataset.")}
    if horizon is not None:
        run_options["horizon"] = str(horizon)
    if outputs is not None:
        run_options["outputs"] = outputs
    data_options = {k.removeprefix("dataset."): v for k, v in changes.items() if k.startswith("dataset.")}
    found = study.studies().get(target)
    if found is None:
        check_target(target)
    chosen = choose(dataset or (found.default_dataset if found else "pelican_twin"), data_options)
    configs = _choices(found, preset, chosen, run_options) if found else [RunConfig(*parse(target), chosen)]
    configs = list({c.spec: c for c in apply(configs, _with_looks(run_options))}.values())
    space = default_space(configs, run_options)
    for text in searches:
        path, values = parse_search(text, configs)
        if path in run_options:
            raise BenchError(f"{path} is given with --set and with --search: leave one of them out.")
        space[path] = values
    asked = [f"{k} {v}" for k, v in sorted((run_options | data_options).items()) if k != "path"]
    asked += [f"search {s}" for s in searches]
    wanted = tuple(o for o in sweeps.OBJECTIVES if o == "rmsse" or o in objectives)
    title = f"sweep of {target} on {chosen.label}" + (f" ({preset})" if found else "")
    title += "".join(f", {a}" for a in asked) + "".join(f", and {o}" for o in wanted[1:])
    command = shlex.join(["bench", *portable(sys.argv[1:])])
    sweep = sweeps.Sweep(title, tuple(configs), space, wanted, seed, command)
    sweep.check()
    folder = results / "sweeps" / slug(name or title)
    if dry_run:
        _estimate(out, sweep, trials, place)
        return
    try:
        _carry_out(out, sweep, folder, trials, resume, place)
    except KeyboardInterrupt:
        again = shlex.join(["bench", *(a for a in sys.argv[1:] if a != "--resume"), "--resume"])
        click.echo(f"\nbench: stopped. Every trial that was told is kept; go on with {again}", err=True)
        sys.exit(130)


def _choices(found: Study, preset: str, dataset: Dataset, asked: dict[str, str]) -> list[RunConfig]:
    """One run of every configuration of a study that is trained, of one problem and horizon."""
    runs = [c for c in found.runs(preset, dataset) if c.predictor.training == "gradient"]
    if not runs:
        raise BenchError(f"Nothing in {found.name} is trained: choose a configuration.")
    first = runs[0]
    horizon = int(asked["horizon"]) if asked.get("horizon", "").isdecimal() else first.horizon
    nearest = min((c.horizon for c in runs), key=lambda h: abs(h - horizon))
    alike = [c for c in runs if c.horizon == nearest]
    outputs = alike[0].outputs
    return list({c.spec: replace(c, seed=0, outputs=outputs) for c in reversed(alike)}.values())[::-1]


def _with_looks(asked: dict[str, str]) -> dict[str, str]:
    """With as many looks at the validation part as usual where only the number of updates is changed."""
    updates = asked.get("training.updates", "")
    if updates.isdecimal() and "training.evaluate_every" not in asked:
        return {**asked, "training.evaluate_every": str(max(1, int(updates) // LOOKS))}
    return asked


def _carry_out(out: Console, sweep: Any, folder: Path, trials: int, resume: bool, place: Place) -> None:
    """Search, train the finalists, write the report, say what came out; one driver at a time."""
    from bench.sweep import journal as sweeps
    from bench.sweep.search import search

    workers = place.workers or os.cpu_count() or 1
    with lock.held(folder, sweep.title), mirroring(place, sweep.title, folder.name) as mirror:
        study = sweeps.begin(sweep, folder, resume)
        before = sweeps.told(study)
        out.print(f"[bold]{escape(sweep.title)}[/]: {trials} trials, {len(before)} told, {workers} process(es).")
        out.print(_searched(sweep), highlight=False, markup=False)
        if mirror:
            mirror.trials(sweep.configs, before)
        with meter(out, float(max(1, trials - len(before))), trials) as progress:
            progress.finished = len(before)

            def ended(t: Any) -> None:
                progress.current = _best_so_far(study)
                progress.record()
                if mirror:
                    mirror.trials(sweep.configs, [t])

            search(sweep, study, folder, trials, workers, progress.tick, ended)
            spent = time.monotonic() - progress.started
        if len(before) < trials:
            out.print(f"{trials - len(before)} trials in {clock(spent)}. {_best_so_far(study)}.", highlight=False)
        _conclude(out, sweep, study, folder, place, workers, mirror)


def _conclude(
    out: Console, sweep: Any, study: Any, folder: Path, place: Place, workers: int, mirror: Mirroring | None
) -> None:
    """Train the best and the default configuration from fresh seeds, compare them, write it down."""
    from bench.sweep import finalists
    from bench.sweep import journal as sweeps
    from bench.sweep import page as sweep_page

    best, default = finalists.finalists(sweep, study)
    records = _train(out, [*best, *default], place, workers, mirror)
    sides = records[: len(best)], records[len(best) :]
    verdicts = finalists.judge(*sides) if default else []
    sweep_page.write(folder / sweeps.REPORT, sweep_page.Content(sweep, study, verdicts, *sides))
    finalists.write(folder / sweeps.RESULT, sweep, study, records, verdicts)
    _summary(out, sweep, study, verdicts, folder)
    if mirror:
        mirror.attach([folder / sweeps.REPORT])
        browse(out, mirror.finish(), sweep.title, place)


def _train(
    out: Console, configs: list[RunConfig], place: Place, workers: int, mirror: Mirroring | None
) -> list[RunRecord]:
    """The finalists' records, in the order of their configurations."""
    todo = engine.plan(configs, place.runs)
    models = sum(len(t.configs) for t in todo.tasks)
    out.print(f"The best and the default from {len(configs)} fresh seeds: {models} to train.", highlight=False)
    with meter(out, sum(t.cost for t in todo.tasks) or 1.0, models) as progress:
        records = engine.execute(
            todo, place.runs, workers, progress.tick, lambda r: progress.record(), lambda t: progress.start(t.name)
        )
    if mirror:
        mirror.add([r.folder for r in records])
    return records


def _searched(sweep: Any) -> str:
    from bench.sweep.space import said

    return "Searched: " + "; ".join(said(path, values) for path, values in sweep.space.items()) + "."


def _best_so_far(search: Any) -> str:
    from bench.sweep import journal as sweeps

    try:
        best = sweeps.best(search)
    except BenchError:
        return "no trial has come to its end yet"
    return f"best: trial {best.number}, RMSSE {best.values[0]:.4g}"


def _summary(out: Console, sweep: Any, search: Any, verdicts: Any, folder: Path) -> None:
    """The answer on the terminal."""
    from bench.sweep import journal as sweeps
    from bench.sweep.space import SPEC, options

    best = sweeps.best(search)
    have = {path: value for path, _, value in options(sweep.default)} | {SPEC: sweep.default.spec}
    table = Table(title="what the sweep chose", title_justify="left")
    for heading in ("option", f"best (trial {best.number})", "default"):
        table.add_column(heading)
    for path in sweep.space:
        shown = (f"{v:.4g}" if isinstance(v, float) else str(v) for v in (best.params[path], have[path]))
        table.add_row(escape(path), *map(escape, shown))
    out.print(table)
    if len(sweep.objectives) > 1:
        out.print(
            f"{len(search.best_trials)} trials are on the Pareto front; the one with the smallest error is taken."
        )
    for verdict in verdicts:
        out.print(verdict.sentence, highlight=False, markup=False)
    if not verdicts:
        out.print("No trial was better than the default configuration.")
    out.print(f"Report: {folder / sweeps.REPORT}", highlight=False, markup=False)


def _estimate(out: Console, sweep: Any, trials: int, place: Place) -> None:
    """What the sweep would cost here, were no trial stopped early."""
    from optuna.distributions import CategoricalDistribution

    from bench.estimate import per_update
    from bench.sweep.finalists import SEEDS
    from bench.sweep.space import configured

    out.print(_searched(sweep), highlight=False, markup=False)
    workers = place.workers or os.cpu_count() or 1
    largest = configured(
        sweep.configs,
        {k: d.choices[-1] if isinstance(d, CategoricalDistribution) else d.high for k, d in sweep.space.items()},
    )
    with out.status("timing a few updates"):
        times = [
            per_update((c,)) * c.training.updates if c.predictor.training == "gradient" else 0.0
            for c in (sweep.default, largest)
        ]
    runs = trials + 2 * SEEDS
    low, high = (clock(t * runs / workers) for t in times)
    out.print(
        f"A trial takes {clock(times[0])} with the default options ({escape(sweep.default.spec)}) and "
        f"{clock(times[1])} with the largest values ({escape(largest.spec)}). {trials} trials and {2 * SEEDS} runs "
        f"of the best and the default with {workers} process(es): {low} to {high}, less what is stopped early."
    )
