"""How a sweep went, drawn: the error of every trial, learning curves, which options mattered, the Pareto front."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import optuna
from optuna.distributions import CategoricalDistribution, IntDistribution
from optuna.trial import FrozenTrial, TrialState

from bench.records.record import RunRecord
from bench.reporting import report
from bench.reporting.drawing import Look, Panel, Scale, around
from bench.reporting.page import Drawing
from bench.sweep import journal as sweeps
from bench.sweep.finalists import Verdict
from bench.sweep.space import default_params, options

TOLD, PRUNED = Look("#0072B2", (), 2.4), Look("#7f8791", (), 1.2)
BEST, DEFAULT = Look("#D55E00", (), 2.4), Look("#009E73", (), 2.4)
RMSSE = "validation RMSSE [std. dev.]"


@dataclass(frozen=True)
class Content:
    """A sweep that has ended."""

    sweep: sweeps.Sweep
    study: optuna.Study
    verdicts: Sequence[Verdict]
    """Empty where the default is the best."""
    best_records: Sequence[RunRecord]
    default_records: Sequence[RunRecord]

    @cached_property
    def finished(self) -> list[FrozenTrial]:
        """Trials of which the end is known, by number."""
        return sweeps.finished(self.study)

    @cached_property
    def complete(self) -> list[FrozenTrial]:
        """Those that went to their end."""
        return [t for t in self.finished if t.state == TrialState.COMPLETE]

    @cached_property
    def best(self) -> FrozenTrial:
        """The trial with the smallest error."""
        return sweeps.best(self.study)

    @cached_property
    def errors(self) -> Scale:
        """An axis of errors; a trial that ran away leaves it."""
        every = [t.values[0] for t in self.complete] + [e for t in self.finished if math.isfinite(e := _last(t))]
        kept = [v for v in every if v < 5 * float(np.median([t.values[0] for t in self.complete]))]
        return around(kept, log=max(kept) > 4 * min(kept) > 0)

    @cached_property
    def default(self) -> int | None:
        """Number of the trial with the default configuration, unless it is the best."""
        params = default_params(self.sweep.space, self.sweep.configs)
        return next((t.number for t in self.complete if t.params == params and t.number != self.best.number), None)

    @property
    def marks(self) -> list[tuple[Look, str]]:
        """What the colours of dots and curves mean."""
        known = [(TOLD, "trained to the end"), (PRUNED, "stopped early, at its last validation"), (BEST, "best")]
        return known + ([] if self.default is None else [(DEFAULT, "default")])

    def mark(self, drawn: Panel, xs: Sequence[tuple[FrozenTrial, float]]) -> None:
        """A dot a trial at its x: pruned ones hollow at their last validation, the best and the default larger."""
        for t, x in xs:
            if t.state != TrialState.COMPLETE:
                drawn.dots([x], [_last(t)], PRUNED.colour, hollow=True)
        for t, x in xs:
            if t.state == TrialState.COMPLETE and t.number not in (self.best.number, self.default):
                drawn.dots([x], [t.values[0]], TOLD.colour)
        for t, x in xs:
            if t.number in (self.best.number, self.default):
                look = BEST if t.number == self.best.number else DEFAULT
                drawn.dots([x], [t.values[0]], look.colour, radius=5)


@dataclass(frozen=True)
class _History:
    summary: str
    legend: Sequence[tuple[Look, str]]
    drawings: Sequence[Drawing]


@dataclass(frozen=True)
class _Importances:
    complete: int
    """Trials trained to the end."""
    objectives: int
    shares: Sequence[tuple[str, float]]
    colour: str = TOLD.colour


@dataclass(frozen=True)
class _Table:
    heads: Sequence[str]
    rows: Sequence[Sequence[str]]
    name: str = ""


@dataclass(frozen=True)
class _Slices:
    legend: Sequence[tuple[Look, str]]
    drawings: Sequence[Drawing]
    choices: Sequence[_Table]
    """Of options that are no numbers."""


@dataclass(frozen=True)
class _Front:
    drawings: Sequence[Drawing]
    chosen: _Table


def _curve(t: FrozenTrial) -> list[tuple[int, float]]:
    return [(int(u), float(v)) for u, v in t.user_attrs.get("curve", [])]


def _last(t: FrozenTrial) -> float:
    curve = _curve(t)
    return curve[-1][1] if curve else math.nan


def history(c: Content) -> _History:
    """The error of every trial, and the best so far."""
    drawn = Panel(Scale(-0.5, max(1, len(c.finished)) - 0.5, whole=True), c.errors, "trial [number]", RMSSE, 520, 260)
    places = {t.number: i for i, t in enumerate(c.finished)}
    xs: list[float] = []
    ys: list[float] = []
    lowest = math.inf
    for t in c.complete:
        if t.values[0] < lowest:
            xs += [places[t.number], places[t.number]] if xs else [places[t.number]]
            ys += [lowest, t.values[0]] if ys else [t.values[0]]
            lowest = t.values[0]
    drawn.line([*xs, len(c.finished) - 1], [*ys, lowest], Look(BEST.colour, (), 1.4, 0.6))
    c.mark(drawn, [(t, places[t.number]) for t in c.finished])
    cut = sum(t.state == TrialState.PRUNED for t in c.finished)
    lost = len(c.finished) - len(c.complete) - cut
    seconds = sum(t.user_attrs.get("seconds", 0.0) for t in c.finished)
    summary = (
        f"{len(c.finished)} trials: {len(c.complete)} trained to the end, {cut} stopped early, {lost} failed; "
        f"{seconds:.0f} s of training."
    )
    every = Drawing("Error of every trial", "", drawn.svg("Error of every trial"))
    return _History(summary, c.marks, [every, *_curves(c)])


def _curves(c: Content) -> list[Drawing]:
    """Learning curves of all trials."""
    curves = [(t, curve) for t in c.finished if len(curve := _curve(t)) > 1]
    if not curves:
        return []
    drawn = Panel(Scale(0, max(curve[-1][0] for _, curve in curves)), c.errors, "updates [count]", RMSSE, 520, 260)
    thick = {c.default: DEFAULT, c.best.number: BEST}
    for t, curve in sorted(curves, key=lambda pair: pair[0].number in thick):  # those above all others
        thin = Look(TOLD.colour, (), 1.0, 0.45) if t.state == TrialState.COMPLETE else Look(PRUNED.colour, (), 1.0, 0.6)
        drawn.line([u for u, _ in curve], [v for _, v in curve], thick.get(t.number, thin))
    title = "Validation error of all trials while they train"
    return [Drawing("While training", "grey: stopped early", drawn.svg(title))]


def importances(c: Content) -> _Importances | None:
    """Which options mattered; None where there are too few to tell."""
    if len(c.complete) < 2 or len(c.sweep.space) < 2:
        return None
    found = optuna.importance.get_param_importances(c.study)
    return _Importances(len(c.complete), len(c.sweep.objectives), list(found.items()))


def slices(c: Content) -> _Slices:
    """The error against each option."""
    fields = {path: field for path, field, _ in options(c.sweep.default)}
    drawn, choices = [], []
    for path, distribution in c.sweep.space.items():
        have = [t for t in c.finished if path in t.params]
        if isinstance(distribution, CategoricalDistribution):
            choices.append(_choices(path, distribution, have))
            continue
        low, high, log = (getattr(distribution, name) for name in ("low", "high", "log"))
        whole = isinstance(distribution, IntDistribution)
        unit = fields[path].metadata.get("unit") or ("count" if whole else "1")
        scale = replace(around([low, high], log, room=0.04), whole=whole)
        made = Panel(scale, c.errors, f"{path.rpartition('.')[2].replace('_', ' ')} [{unit}]", RMSSE, 340, 215)
        c.mark(made, [(t, t.params[path]) for t in have])
        drawn.append(Drawing(path, fields[path].metadata.get("help", ""), made.svg(f"Error against {path}")))
    return _Slices(c.marks, drawn, choices)


def _choices(path: str, distribution: CategoricalDistribution, trials: Sequence[FrozenTrial]) -> _Table:
    """A row a choice."""
    rows = []
    for choice in distribution.choices:
        of = [t for t in trials if t.params[path] == choice]
        ends = sorted(t.values[0] for t in of if t.state == TrialState.COMPLETE)
        best = report.number(ends[0] if ends else math.nan)
        rows.append(
            [str(choice), str(len(of)), str(len(ends)), best, report.number(float(np.median(ends))) if ends else "–"]
        )
    return _Table([path, "trials", "trained to the end", f"best {RMSSE}", "median"], rows, path)


def front(c: Content) -> _Front | None:
    """What cannot be made smaller in one objective without a loss in another."""
    if len(c.sweep.objectives) == 1:
        return None
    numbers = {t.number for t in c.study.best_trials}
    drawn = []
    for i, name in enumerate(c.sweep.objectives[1:], 1):
        values = [t.values[i] for t in c.complete]
        scale = around(values, log=min(values) > 0 and max(values) > 4 * min(values))
        made = Panel(scale, c.errors, sweeps.OBJECTIVES[name], RMSSE, 520, 260)
        for on_it, colour in ((False, TOLD.colour), (True, BEST.colour)):
            some = [t for t in c.complete if (t.number in numbers) is on_it]
            made.dots([t.values[i] for t in some], [t.values[0] for t in some], colour, radius=4 if on_it else 3)
        drawn.append(Drawing(f"RMSSE against {name}", "", made.svg(f"RMSSE against {name}")))
    chosen = sorted((t for t in c.complete if t.number in numbers), key=lambda t: t.values[0])
    return _Front(drawn, trials(c, chosen))


def trials(c: Content, some: Sequence[FrozenTrial]) -> _Table:
    """A row a trial."""
    heads = ["trial", "state", *c.sweep.objectives, *c.sweep.space, "updates", "time [s]"]
    rows = []
    for t in some:
        values = t.values if t.state == TrialState.COMPLETE else [_last(t), *[math.nan] * (len(c.sweep.objectives) - 1)]
        state = t.user_attrs.get("status", t.state.name.lower())
        cells = [str(t.number), state, *(report.number(v) for v in values)]
        cells += [shown(t.params.get(path, "–")) for path in c.sweep.space]
        cells += [str(t.user_attrs.get("updates", "–")), f"{t.user_attrs.get('seconds', math.nan):.1f}"]
        rows.append(cells)
    return _Table(heads, rows)


def shown(value: Any) -> str:
    """The value of an option."""
    return f"{value:.4g}" if isinstance(value, float) else str(value)
