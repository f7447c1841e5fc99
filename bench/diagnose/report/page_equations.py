"""What the diagnosis page shows of every equation by itself."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from markupsafe import Markup

from bench.diagnose.by_equation import EffectSaving
from bench.diagnose.evidence import AFTER, Signal
from bench.diagnose.report import page_figures as figures
from bench.diagnose.report import phrases
from bench.diagnose.report.equation_errors import ShownEquation, shown_equations
from bench.diagnose.result import Diagnosis, NamedEffect
from bench.diagnose.settings import TELLING


@dataclass(frozen=True)
class _Saving:
    """What one effect saves."""

    name: str
    share: str
    bar: Markup
    interval: str


@dataclass(frozen=True)
class _Axes:
    """What a sensor of rates shows, axis by axis, sample by sample."""

    unit: str
    rows: Sequence[tuple[str, str, str]]
    """Axis, error before and after."""


@dataclass(frozen=True)
class _Equation:
    title: str
    fall: str
    said: str
    """What acts in it, and how much of its error can still be predicted."""
    bars: figures.Waterfall
    savings: Sequence[_Saving]
    axes: _Axes | None


def equation_by_equation(d: Diagnosis) -> list[_Equation]:
    """One for every equation that was judged by itself."""
    every = shown_equations(d)
    if not every:
        return []
    sensed = {s.name for f in d.evidence.flights for s in f.signals if s.sensed}
    judged = list(zip(d.by_equation, every, strict=True))
    first = judged[0][0]  # what a sensor feels of it stands beside it
    judged.sort(key=lambda pair: (pair[0] != first, d.by_equation[pair[0]].output not in sensed))
    return [
        _Equation(
            title=a.equation.capitalize(),
            fall=f"{a.output} {phrases.number(a.nominal)} → {phrases.united(phrases.number(a.extended), a.unit)}",
            said=_said(d, name, a),
            bars=_bars(d, name, f"after {a.horizon}"),
            savings=[_saving(e, s) for e in d.effects for s in e.saves if s.equation == name],
            axes=_axes(d, d.by_equation[name].output),
        )
        for name, a in judged
    ]


def _said(d: Diagnosis, name: str, a: ShownEquation) -> str:
    here = [phrases.named(e.name) for e in d.effects if e.acts_on == name or _acts(e, name)]
    acts = f"Named here: {phrases.listed(here)}." if here else "No effect was named here."
    left, best = a.extended**2, a.predictable**2
    if not all(map(math.isfinite, (left, best))) or not left:
        return acts
    more = 1 - best / left
    if more < TELLING.little_left:
        return f"{acts} What is left cannot be predicted from the measured signals."
    return (
        f"{acts} The measured signals would predict another {phrases.percent(more)} of the squared error that is left."
    )


def _acts(effect: NamedEffect, name: str) -> bool:
    return any(s.equation == name and (s.worth or s is effect.main) for s in effect.saves)


def _bars(d: Diagnosis, name: str, note: str) -> figures.Waterfall:
    e = d.by_equation[name]
    bars = [("nominal", "nominal", e.nominal), ("calibrated", "calibrated", e.calibrated)]
    bars += [("extended", "extended", e.extended)] if d.effects else []
    bars += [("best predictor", "floor", e.predictable)]
    return figures.waterfall(e.output, note, bars, e.floor, e.unit)


def _saving(effect: NamedEffect, s: EffectSaving) -> _Saving:
    name = phrases.named(effect.id) + (f", {phrases.named(s.axis)}" if s.axis else "")
    if not s.matters:
        return _Saving(name, phrases.NOTHING, Markup(), "too little to explain")
    bar = figures.interval_bar(s.share, s.low, s.high, s is effect.main)
    return _Saving(name, phrases.percent(s.share), bar, f"{phrases.percent(s.low)} to {phrases.percent(s.high)}")


def _axes(d: Diagnosis, output: str) -> _Axes | None:
    found = [s for f in d.evidence.flights for s in f.signals if s.sensed and s.name == output and f.held_out]
    if not found:
        return None
    unit, factor = phrases.shown(found[0].unit, output)
    rows = []
    for c, trace in enumerate(found[0].traces):
        before, after = (phrases.number(_mean(found, c, model) * factor) for model in ("nominal", AFTER))
        rows.append((trace.channel.rpartition(".")[2], before, after))
    return _Axes(unit, rows)


def _mean(signals: list[Signal], c: int, model: str) -> float:
    """Root mean square over recordings."""
    errors = [s.traces[c].rms.get(model, math.nan) for s in signals]
    return math.sqrt(sum(e * e for e in errors) / len(errors))
