"""A fleet as one HTML file that needs no network: which vehicles lack what, which differ, which drift."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.diagnose.report import phrases
from bench.fleet import page_figures as figures
from bench.fleet.result import FAILED, Answer, Drift, FleetDiagnosis, Number, Quantity
from bench.reporting import page
from bench.reporting.page import Drawing, Section

VERDICTS = {
    "named": "named",
    "tie": "tie",
    "nothing": "nothing missing",
    "unknown_effect": "unknown effect",
    "data_problem": "data problem",
    FAILED: "failed",
}
"""As they are shown."""
DRAWN = 12
"""Drifts that are drawn, the surest; all are in the table."""


@dataclass(frozen=True)
class _Cell:
    """A number with its interval; both empty: there is none."""

    value: str = ""
    interval: str = ""
    off: bool = False
    """Whether it differs from the other vehicles'."""


@dataclass(frozen=True)
class _Row:
    cells: Sequence[Any]
    page: str = ""
    """That its first cell leads to."""


@dataclass(frozen=True)
class _Table:
    heads: Sequence[str]
    rows: Sequence[_Row]
    drawings: Sequence[Drawing] = ()
    numbers: Sequence[int] = ()
    """Columns that are right-aligned."""


def _lacking(f: FleetDiagnosis) -> _Table | None:
    """Every effect with the mean and the spread of its numbers."""
    if not f.lacking:
        return None
    heads = ("effect", f"{f.kind}s", "parameter", "mean", f"spread between {f.kind}s τ", "p of no spread")
    rows, of = [], {q.effect: [r for r in f.quantities if r.effect == q.effect] for q in f.quantities}
    for effect, count in f.lacking.items():
        for q in of.get(effect, [None]):
            name, share = phrases.named(effect), f"{count} of {len(f.vehicles)}"
            rows.append(_Row((name, share, *(_summary(q) if q else ("", _Cell(), "", "")))))
    drawings = [
        Drawing(f"{phrases.named(q.effect)}, {q.parameter}", f"{len(q.vehicles)} {f.kind}s", figures.spread(q, f.kind))
        for q in f.quantities
        if len(q.vehicles) > 1
    ]
    return _Table(heads, rows, drawings)


def _summary(q: Quantity) -> tuple[str, _Cell, str, str]:
    unit, factor = phrases.shown(q.unit, q.parameter, [d.value for d in q.vehicles])
    if len(q.vehicles) < 2:
        d = q.vehicles[0]
        return q.parameter, _shown(d.value, d.low, d.high, unit, factor), "", ""
    spread = f"{phrases.united(phrases.number(q.between * factor, 2), unit)} ({_share(q.between, q.mean)})"
    sure = _p(q.heterogeneity)
    return q.parameter, _shown(q.mean, q.low, q.high, unit, factor), spread if q.between else "none seen", sure


def _differing(f: FleetDiagnosis) -> _Table | None:
    pages = {a.vehicle: a.page for a in f.answers}
    rows = []
    for q, d in f.differing:
        unit, factor = phrases.shown(q.unit, q.parameter, [e.value for e in q.vehicles])
        others = phrases.united(phrases.number(d.others * factor), unit)
        what = f"{phrases.named(q.effect)}, {q.parameter}"
        cells = (d.vehicle, what, _shown(d.value, d.low, d.high, unit, factor), others)
        rows.append(_Row((*cells, _share(d.value - d.others, d.others, signed=True), _p(d.adjusted)), pages[d.vehicle]))
    return _Table((f.kind, "number", "value", "others", "off by", "p, adjusted"), rows) if rows else None


def _drifting(f: FleetDiagnosis) -> _Table | None:
    if not f.drifts:
        return None
    pages = {a.vehicle: a.page for a in f.answers}
    told = f.drifting
    rows = [_Row(_slope(d), pages.get(d.vehicle, "")) for d in told]
    drawings = [
        Drawing(_who(d), f"{phrases.named(d.effect)}", figures.over_dates(d, f.behind(d))) for d in told[:DRAWN]
    ]
    return _Table(("vehicle", "number", "change a year", "at the mean date", "dates", "p, adjusted"), rows, drawings)


def _who(d: Drift) -> str:
    return d.vehicle or "from vehicle to vehicle"


def _slope(d: Drift) -> tuple[Any, ...]:
    unit, factor = phrases.shown(d.unit, d.parameter, [d.level])
    slope = _shown(d.per_year, d.low, d.high, "" if unit == "1" else unit, factor)
    level = phrases.united(phrases.number(d.level * factor), unit)
    what = f"{phrases.named(d.effect)}, {d.parameter}"
    return _who(d), what, slope, level, f"{len(d.dates)}, {d.dates[0]} to {d.dates[-1]}", _p(d.adjusted)


def _without(f: FleetDiagnosis) -> _Table | None:
    rows = [_Row((a.title, VERDICTS[a.verdict], a.sentence), a.page) for a in f.of(FAILED, "data_problem")]
    return _Table((f.kind, "", "what is wrong"), rows) if rows else None


def _matrix(f: FleetDiagnosis) -> _Table:
    """Vehicle by effect: values with intervals, and what the effects do to the error."""
    quantities = list(dict.fromkeys(n.quantity for a in f.answers for n in a.numbers if not n.learned))
    by: dict[tuple[str, str, str], list[float]] = {q: [] for q in quantities}
    for n in (n for a in f.answers for n in a.numbers if not n.learned):
        by[n.quantity].append(n.value)
    units = {q: phrases.shown(q[2], q[1], values) for q, values in by.items()}
    learned = any(n.learned for a in f.answers for n in a.numbers)
    groups = list(dict.fromkeys((e.group, e.unit, e.horizon_s) for a in f.answers for e in a.errors))
    scales = {
        g: phrases.shown(g[1], g[0], [e.extended for a in f.answers for e in a.errors if e.group == g[0]])
        for g in groups
    }
    off = {(d.vehicle, q.effect, q.parameter, q.unit) for q, d in f.differing}
    dated = any(a.date for a in f.answers)
    heads = [f.kind, *(["date"] if dated else []), "verdict"]
    heads += [
        f"{phrases.named(q[0])} {phrases.united(q[1], f'[{units[q][0]}]' if units[q][0] != '1' else '1')}"
        for q in quantities
    ]
    heads += ["learned"] * learned
    heads += [f"{phrases.named(g[0])} after {g[2]:g} s [{scales[g][0]}]" for g in groups]
    rows = []
    for a in f.answers:
        held = {n.quantity: n for n in a.numbers}
        cells: list[Any] = [a.vehicle, *([a.date] if dated else []), VERDICTS[a.verdict]]
        cells += [_number(held.get(q), units[q][1], (a.vehicle, *q) in off) for q in quantities]
        cells += [phrases.listed(dict.fromkeys(n.effect for n in a.numbers if n.learned))] * learned
        cells += [_fall(a, g, scales[g][1]) for g in groups]
        rows.append(_Row(cells, a.page))
    return _Table(heads, rows)


def _number(n: Number | None, factor: float, off: bool) -> _Cell:
    if n is None:
        return _Cell()
    shown = _shown(n.value, n.low, n.high, "1", factor)
    rivals = f" or {phrases.listed(map(phrases.named, n.rivals), 'or')}" if n.rivals else ""
    return _Cell(shown.value, shown.interval + rivals, off)


def _fall(a: Answer, group: tuple[str, str, float], factor: float) -> str:
    for e in a.errors:
        if (e.group, e.unit, e.horizon_s) == group:
            return f"{phrases.number(e.nominal * factor)} → {phrases.number(e.extended * factor)}"
    return ""


def _shown(value: float, low: float, high: float, unit: str, factor: float) -> _Cell:
    digits = phrases.digits_of(value * factor, low * factor, high * factor)
    text, *ends = (phrases.number(v * factor, digits) for v in (value, low, high))
    return _Cell(phrases.united(text, unit or "1"), f"{ends[0]} to {ends[1]}" if math.isfinite(low) else "")


def _share(part: float, whole: float, signed: bool = False) -> str:
    """Of the mean, in per cent."""
    if not whole:
        return phrases.NOTHING
    sign = "+" if signed and part * whole > 0 else ""
    return sign + phrases.percent(part / abs(whole))


def _p(p: float) -> str:
    if not math.isfinite(p):
        return phrases.NOTHING
    return "< 0.001" if p < 0.001 else f"{p:.2g}"


def _method(f: FleetDiagnosis) -> FleetDiagnosis:
    return f


SECTIONS = (
    ("What they lack", "lacking", _lacking),
    ("Those that differ", "differing", _differing),
    ("Drift over dates", "drifting", _drifting),
    ("Without an answer", "without", _without),
    ("One by one", "matrix", _matrix),
    ("How it was done", "method", _method),
)
"""Title, macro of ``fleet_sections.html.j2``, and what that is given."""


def render(found: FleetDiagnosis, command: str) -> str:
    """The page as text; ``command``: what to type to repeat it."""
    verdicts = {a.verdict for a in found.answers}
    tone = next((v for v in ("named", "tie", "unknown_effect", "nothing") if v in verdicts), "data_problem")
    return page.render(
        page.templates(Path(__file__).with_name("templates")),
        "fleet.html.j2",
        f"Fleet {found.name}",
        [Section(title, part, content(found)) for title, part, content in SECTIONS],
        fleet=found,
        tone=tone,
        facts=_facts(found),
        command=command,
    )


def _facts(f: FleetDiagnosis) -> list[str]:
    systems = [phrases.named(s) for s in dict.fromkeys(a.system for a in f.answers if a.system)]
    count = len(f.vehicles)
    sessions = [f"{len(f.answers)} diagnoses"] if len(f.answers) != count else []
    return [*systems, f"{count} {f.kind}s", *sessions]
