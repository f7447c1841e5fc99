"""Drawings of a fleet: every vehicle's number with its interval, and numbers against dates."""

import math
from collections.abc import Sequence

from markupsafe import Markup

from bench.diagnose.report import phrases
from bench.fleet.result import DAYS, Answer, Drift, Number, Quantity, day
from bench.reporting.drawing import Look, Panel, Scale, around

LABELLED = 9
"""Vehicles that have their name in a drawing, as many as there is room for below one another."""
WIDE, HIGH, ROOM = 480.0, 210.0, 120.0
"""Size of a drawing, and of that the room for names."""
USUAL, UNUSUAL, MEAN = "var(--extended)", "var(--nominal)", Look("var(--ink)", width=1.2)
_SHORT = 16
"""Characters of a name that fit."""


def spread(q: Quantity, kind: str = "vehicle") -> Markup:
    """Every member's value with its 95 % interval, by value; mean, and the band of 1.96 τ about it."""
    unit, factor = phrases.shown(q.unit, q.parameter, [d.value for d in q.vehicles])
    ordered = sorted(q.vehicles, key=lambda d: (d.value, d.vehicle))
    band = [(q.mean + side * 1.96 * q.between) * factor for side in (-1, 1)]
    ends = [v * factor for d in ordered for v in (d.low, d.high)]
    panel = Panel(
        Scale(0, len(ordered) + 1, whole=True),
        around([*ends, *band]),
        f"{kind}s, by value",
        f"{q.parameter} [{unit}]",
        width=WIDE,
        height=HIGH,
        right=ROOM if any(d.differs for d in ordered) else 14.0,
    )
    across = [0.0, len(ordered) + 1.0]
    panel.band(across, [band[0]] * 2, [band[1]] * 2, "var(--ink)")
    panel.line(across, [q.mean * factor] * 2, MEAN)
    named = {d.vehicle for d in sorted((d for d in ordered if d.differs), key=lambda d: d.p)[:LABELLED]}
    points, xs, ys = [], list[float](), list[float]()
    for rank, d in enumerate(ordered, start=1):
        colour = UNUSUAL if d.differs else USUAL
        if d.vehicle in named:
            points.append((float(rank), d.value * factor, d.low * factor, d.high * factor, colour, _short(d.vehicle)))
            continue
        xs += [rank] * 3
        ys += [d.low * factor, d.high * factor, math.nan]  # one path of all, broken between vehicles
        panel.dots([rank], [d.value * factor], colour, radius=2.2)
    panel.line(xs, ys, Look(USUAL, width=1.4, opacity=0.55))
    panel.points(points)
    return panel.svg(f"{q.parameter} of {len(ordered)} {kind}s")


def over_dates(drift: Drift, told: Sequence[tuple[Answer, Number]]) -> Markup:
    """Values with their 95 % intervals against their dates, and the line through them."""
    unit, factor = phrases.shown(drift.unit, drift.parameter, [n.value for _, n in told])
    first = min(day(a.date) for a, _ in told)
    at = [float(day(a.date) - first) for a, _ in told]
    ends = [v * factor for _, n in told for v in (n.low, n.high)]
    panel = Panel(
        around(at), around(ends), f"days from {drift.dates[0]}", f"{drift.parameter} [{unit}]", width=WIDE, height=HIGH
    )
    for x, (_, n) in zip(at, told, strict=True):
        panel.line([x, x], [n.low * factor, n.high * factor], Look(USUAL, width=1.4, opacity=0.55))
    panel.dots(at, [n.value * factor for _, n in told], USUAL)
    middle, ends = sum(at) / len(at), [min(at), max(at)]
    panel.line(ends, [(drift.level + drift.per_year * (x - middle) / DAYS) * factor for x in ends], Look(UNUSUAL))
    return panel.svg(f"{drift.parameter} against the date")


def _short(name: str) -> str:
    return name if len(name) <= _SHORT else name[: _SHORT - 1] + "…"
