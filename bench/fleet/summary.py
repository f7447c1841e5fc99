"""A fleet in a few lines on the terminal."""

from collections.abc import Iterator
from typing import Any

from bench.diagnose.report import phrases
from bench.diagnose.result import ParameterEstimate
from bench.fleet.page import VERDICTS
from bench.fleet.result import FAILED, FleetDiagnosis, Quantity

LINES = 6
"""Vehicles that are listed of those that differ, drift or failed; all are on the page."""
FEW = 24
"""Vehicles up to which each has a row: as many as fit a terminal."""


def print_summary(found: FleetDiagnosis, console: Any) -> None:
    """Print what the vehicles lack, and those that differ, drift or have no answer.

    Args:
        found: the fleet.
        console: a rich console.
    """
    from rich.text import Text

    console.print(Text(found.headline, style="bold"))
    if len(found.answers) <= FEW:
        console.print(_table((found.kind, "verdict", "what it lacks"), _vehicles(found)))
    if found.quantities:
        console.print(
            _table(("effect", f"{found.kind}s", f"mean over {found.kind}s", "spread between them"), _effects(found))
        )
    for title, lines in (
        ("differs", list(_differing(found))),
        ("drifts", list(_drifting(found))),
        ("no answer", [f"{a.title}: {a.sentence}" for a in found.of(FAILED, "data_problem")]),
    ):
        for line in lines[:LINES]:
            console.print(Text(f"{title}: {line}"), highlight=False)
        if len(lines) > LINES:
            console.print(f"{title}: and {len(lines) - LINES} more on the page", highlight=False)


def _table(heads: tuple[str, ...], rows: Iterator[tuple[str, ...]]) -> Any:
    from rich.table import Table
    from rich.text import Text

    made = Table(box=None, header_style="bold", padding=(0, 2, 0, 0), pad_edge=False)
    for head in heads:
        made.add_column(head, overflow="fold")
    for row in rows:
        made.add_row(*map(Text, row))
    return made


def _vehicles(found: FleetDiagnosis) -> Iterator[tuple[str, ...]]:
    for a in found.answers:
        numbers = (f"{phrases.named(n.effect)} {n.parameter} = {_estimate(n)}" for n in a.numbers if not n.learned)
        learned = dict.fromkeys(f"{n.effect} (learned)" for n in a.numbers if n.learned)
        yield a.title, VERDICTS[a.verdict], "; ".join((*numbers, *learned))


def _estimate(n: Any) -> str:
    return phrases.estimate(n.parameter, ParameterEstimate(n.value, n.low, n.high, n.unit))


def _effects(found: FleetDiagnosis) -> Iterator[tuple[str, ...]]:
    for q in sorted(found.quantities, key=lambda q: -len(q.vehicles)):
        name = f"{phrases.named(q.effect)} {q.parameter}"
        mean = phrases.estimate(q.parameter, ParameterEstimate(q.mean, q.low, q.high, q.unit))
        yield name, f"{len(q.vehicles)} of {len(found.vehicles)}", mean, _spread(q)


def _spread(q: Quantity) -> str:
    if len(q.vehicles) < 2:
        return phrases.NOTHING
    return f"τ = {phrases.percent(q.between / abs(q.mean))} of the mean" if q.between and q.mean else "none seen"


def _differing(found: FleetDiagnosis) -> Iterator[str]:
    for q, d in found.differing:
        value = phrases.estimate(q.parameter, ParameterEstimate(d.value, d.low, d.high, q.unit))
        unit, factor = phrases.shown(q.unit, q.parameter, [d.value, d.others])
        others = phrases.united(phrases.number(d.others * factor), unit)
        yield f"{d.vehicle}, {phrases.named(q.effect)} {q.parameter} = {value}, the others' mean is {others}"


def _drifting(found: FleetDiagnosis) -> Iterator[str]:
    for d in found.drifting:
        unit, factor = phrases.shown(d.unit, d.parameter, [d.level])
        slope = [phrases.number(v * factor) for v in (d.per_year, d.low, d.high)]
        a_year = f"{phrases.united(slope[0], unit)} a year ({slope[1]} to {slope[2]})"
        yield f"{d.vehicle or 'from vehicle to vehicle'}, {phrases.named(d.effect)} {d.parameter}: {a_year}"
