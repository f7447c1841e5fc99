"""A sweep on its way: search, train the best and the default, report; progress and answer on the terminal."""

import math
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import optuna
from optuna.distributions import BaseDistribution, CategoricalDistribution, FloatDistribution, IntDistribution
from optuna.trial import FrozenTrial
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from bench.cli.execution_options import Execution
from bench.cli.job import browse, mirroring, train_missing
from bench.cli.progress import clock, meter
from bench.execution import engine, lock
from bench.execution.estimate import per_update
from bench.experiment.config import RunConfig
from bench.records.record import RunRecord
from bench.sweep import finalists
from bench.sweep import journal as sweeps
from bench.sweep.journal import Sweep
from bench.sweep.search import search, trials_at_once
from bench.sweep.space import SPEC, configured, described, options
from bench.sweep.sweep import train_finalists
from bench.tracking.mirroring import Mirroring
from registry.errors import BenchError


def carry_out(out: Console, sweep: Sweep, folder: Path, trials: int, resume: bool, execution: Execution) -> None:
    """Search, train the finalists, write the report, say what came out; one driver at a time.

    Raises:
        BenchError: no scheduler answers, another driver is at this sweep, its folder cannot be written, or workers die.
    """
    if execution.cluster:
        from bench.execution.cluster import connected

        with connected(execution.cluster):  # or nothing is written
            pass
    with lock.held(folder, sweep.title), mirroring(execution, sweep.title, folder.name) as mirror:
        study = sweeps.begin(sweep, folder, resume)
        before = sweeps.finished(study)
        where = escape(_where(execution))
        out.print(f"[bold]{escape(sweep.title)}[/]: {trials} trials, {len(before)} finished, {where}.")
        out.print(_searched(sweep), highlight=False, markup=False)
        if mirror:
            mirror.trials(sweep.configs, before)
        with meter(out, float(max(1, trials - len(before))), trials, "trials") as progress:
            progress.finished, progress.current = len(before), _best_so_far(study)

            def ended(t: FrozenTrial) -> None:
                progress.current = _best_so_far(study)
                progress.record()
                if mirror:
                    mirror.trials(sweep.configs, [t])

            search(
                sweep,
                study,
                folder,
                trials=trials,
                workers=execution.processes,
                tick=progress.tick,
                ended=ended,
                cluster=execution.cluster,
            )
            spent = time.monotonic() - progress.started
        if len(before) < trials:
            out.print(f"{trials - len(before)} trials in {clock(spent)}; {_best_so_far(study)}.", highlight=False)
        _conclude(out, sweep, study, folder, execution, mirror)


def _where(execution: Execution) -> str:
    return f"on {execution.cluster}" if execution.cluster else f"{execution.processes} process(es)"


def _conclude(
    out: Console, sweep: Sweep, study: optuna.Study, folder: Path, execution: Execution, mirror: Mirroring | None
) -> None:
    """Train the best and the default configuration from fresh seeds, compare them, write it down."""

    def train(configs: list[RunConfig]) -> list[RunRecord]:
        several = len({c.seed for c in configs}) < len(configs)
        who = "The best and the default" if several else "The best, which is the default,"
        return _train(out, who, configs, execution, mirror)

    done = train_finalists(sweep, study, folder, train)
    _summary(out, sweep, study, done.verdicts, folder)
    if mirror:
        mirror.attach([folder / sweeps.REPORT])
        browse(out, mirror.finish(), sweep.title, execution)


def _train(
    out: Console, who: str, configs: list[RunConfig], execution: Execution, mirror: Mirroring | None
) -> list[RunRecord]:
    """The finalists' records, in the order of their configurations."""
    todo = engine.plan(configs, execution.runs)
    models = sum(len(t.configs) for t in todo.tasks)
    out.print(f"{who} from {len({c.seed for c in configs})} fresh seeds: {models} to train.", highlight=False)
    records = train_missing(out, todo, execution, execution.processes)
    if mirror:
        mirror.add([r.folder for r in records])
    return records


def _searched(sweep: Sweep) -> str:
    return "Searched: " + "; ".join(described(path, values) for path, values in sweep.space.items()) + "."


def _best_so_far(study: optuna.Study) -> str:
    try:
        best = sweeps.best(study)
    except BenchError:
        return "no trial has come to its end yet"
    return f"best: trial {best.number}, RMSSE {best.values[0]:.4g}"


def _summary(
    out: Console, sweep: Sweep, study: optuna.Study, verdicts: Sequence[finalists.Verdict], folder: Path
) -> None:
    """The answer on the terminal."""
    best = sweeps.best(study)
    have = {path: value for path, _, value in options(sweep.default)} | {SPEC: sweep.default.spec}
    table = Table(title="what the sweep chose", title_justify="left")
    for heading in ("option", f"best (trial {best.number})", "default"):
        table.add_column(heading)
    for path in sweep.space:
        shown = (f"{v:.4g}" if isinstance(v, float) else str(v) for v in (best.params[path], have[path]))
        table.add_row(escape(path), *map(escape, shown))
    out.print(table)
    if len(sweep.objectives) > 1:
        out.print(f"{len(study.best_trials)} trials are on the Pareto front; the one with the smallest error is taken.")
    for verdict in verdicts:
        out.print(verdict.sentence, highlight=False, markup=False)
    if not verdicts:
        out.print("No trial was better than the default configuration.")
    out.print(f"Report: {folder / sweeps.REPORT}", highlight=False, markup=False)


def estimate(out: Console, sweep: Sweep, trials: int, execution: Execution) -> None:
    """What the sweep would cost here, were no trial stopped early."""
    out.print(_searched(sweep), highlight=False, markup=False)
    workers = execution.processes
    together = 1 if execution.cluster else min(trials_at_once(sweep), math.ceil(trials / workers))
    largest = configured(sweep.configs, {path: _last(values) for path, values in sweep.space.items()})
    with out.status("timing a few updates"):
        times = [
            per_update((c,) * together) / together * c.training.updates if c.predictor.training == "gradient" else 0.0
            for c in (sweep.default, largest)
        ]
    finals = 2 * finalists.SEEDS
    low, high = (clock(t * (trials + finals) / workers) for t in times)
    out.print(
        f"A trial takes {clock(times[0])} with the default options ({escape(sweep.default.spec)}) and "
        f"{clock(times[1])} with the largest values ({escape(largest.spec)}). {trials} trials and {finals} runs of the "
        f"best and the default with {workers} process(es): {low} to {high}, less what is stopped early."
    )


def _last(values: BaseDistribution) -> Any:
    if isinstance(values, CategoricalDistribution):
        return values.choices[-1]
    assert isinstance(values, IntDistribution | FloatDistribution)
    return values.high
