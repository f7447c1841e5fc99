"""The drawings of the diagnosis page: errors, residuals, learned terms and single stretches of a recording."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from bench.diagnose.evidence import Curves, ResidualMap, Window
from bench.diagnose.learned_shape import LearnedCurve
from bench.diagnose.report.phrases import named, number, shown
from bench.reporting.drawing import Look, Panel, Scale, align, around

MODELS = {
    "nominal": (Look("var(--nominal)", (5, 1.6), 1.6), "nominal model (before)"),
    "calibrated": (Look("var(--calibrated)", (6, 1.5, 1.2, 1.5), 1.5), "calibrated constants"),
    "extended": (Look("var(--extended)", (), 2.0), "extended model (after)"),
    "disturbance": (Look("var(--disturbance)", (4, 1.2, 1, 1.2), 1.5), "with a disturbance observer"),
    "network": (Look("var(--network)", (2.5, 1.2), 1.7), "with a network"),
    "floor": (Look("var(--floor)", (1, 1.3), 1.5), "noise floor"),
    # Broad and pale, so that a model that lies on it is still seen.
    "measured": (Look("var(--ink)", (), 4.5, 0.28), "measured"),
}
"""How the line of a model is drawn, and what a legend calls it."""
WIDE, HIGH = 480.0, 250.0
"""Size of a drawing."""
ZERO = Look("var(--muted)", width=0.8)
DOTS = 1500
"""Samples shown in a scatter; more only make the page heavier."""
LABEL = 40
"""Characters of a name in a drawing."""
INNER = 0.99
"""Share of the dots that the frame of a learned term holds."""


def legend(names: Iterable[str]) -> list[tuple[Look, str]]:
    """What the lines of these models mean."""
    return [MODELS[name] for name in names]


def axis(quantity: str, unit: str) -> str:
    """The name of an axis with its unit, short enough for a drawing."""
    return _short(quantity) if unit == "1" else f"{_short(quantity)} [{_short(unit)}]"


def error_curves(group: str, curves: Curves) -> Markup:
    """Error against the horizon, one line a model, its band the 95 % interval over recordings."""
    unit, factor = shown(curves.unit, group, [v for line in curves.lines.values() for v in line.rmse])
    drawn = {n: [factor * np.array(v) for v in (e.rmse, e.low, e.high)] for n, e in curves.lines.items()}
    every = [float(v) for values in drawn.values() for line in values for v in line]
    panel = Panel(
        Scale(0.0, max(curves.horizon_s)), around(every, zero=True), "horizon [s]", axis("RMSE", unit), WIDE, HIGH
    )
    for name in (n for n in MODELS if n in drawn):
        rmse, low, high = drawn[name]
        if len(low) and len(high):
            panel.band(curves.horizon_s, low, high, MODELS[name][0].colour)
        panel.line(curves.horizon_s, rmse, MODELS[name][0])
    return panel.svg(f"Error of {named(group)} against the horizon")


@dataclass(frozen=True)
class Bar:
    """The error that remains after a stage."""

    label: str
    model: str
    """One of `MODELS`, whose colour it has."""
    error: str
    width: str
    """Of the longest."""
    before: str
    """The width of the bar above, of which this stage took the rest away."""


@dataclass(frozen=True)
class Waterfall:
    """The errors of one output after each stage, as bars below one another."""

    title: str
    note: str
    bars: Sequence[Bar]
    floor: str
    """Where the line stands that noise alone leaves; empty: unknown."""


def waterfall(group: str, note: str, stages: Sequence[tuple[str, str, float]], floor: float, si_unit: str) -> Waterfall:
    """The error that remains after each stage.

    Args:
        group: output group.
        note: beside its name.
        stages: label, one of `MODELS` and error [SI] of each, in order.
        floor: error [SI] that noise alone gives; NaN: unknown.
        si_unit: of the group.
    """
    errors = [e for _, _, e in stages]
    unit, factor = shown(si_unit, group, errors)
    top = max((e for e in (*errors, floor) if math.isfinite(e)), default=1.0) or 1.0

    def width(error: float) -> str:
        return f"{100 * min(error, top) / top if not math.isnan(error) else 0:.1f}%"

    bars = [
        Bar(label, model, "diverged" if math.isinf(e) else number(e * factor), width(e), width(max(e, before)))
        for (label, model, e), before in zip(stages, [math.nan, *errors], strict=False)
    ]
    said = ", ".join(filter(None, (note, axis("RMSE", unit))))
    return Waterfall(named(group), said, bars, width(floor) if math.isfinite(floor) else "")


def residual_map(m: ResidualMap) -> Markup:
    """A residual against a signal, samples as dots, means in bins before and after as lines."""
    x_unit, x_factor = shown(m.x_unit, m.x_signal, m.centres)
    y_unit, y_factor = shown(m.y_unit, m.y_quantity, m.y)
    every = max(1, len(m.x) // DOTS)
    x, y = ([v * f for v in values[::every]] for values, f in ((m.x, x_factor), (m.y, y_factor)))
    spread = sorted(abs(v) for v in y) or [1.0]
    means = [abs(v) * y_factor for v in (*m.before, *m.after) if math.isfinite(v)]
    bound = 1.1 * max([spread[int(0.985 * (len(spread) - 1))], *means]) or 1.0
    names = axis(named(m.x_signal), x_unit), axis(named(m.y_quantity), y_unit)
    panel = Panel(around(x), Scale(-bound, bound), *names, WIDE, HIGH)
    panel.cloud(x, y)
    panel.line([panel.x.low, panel.x.high], [0.0, 0.0], ZERO)
    for values, key in ((m.before, "calibrated"), (m.after, "extended")):
        if values:
            at, mean = [c * x_factor for c in m.centres], [v * y_factor for v in values]
            panel.line(at, mean, MODELS[key][0])
            panel.dots(at, mean, MODELS[key][0].colour, radius=2.6)
    return panel.svg(f"{named(m.y_quantity)} against {named(m.x_signal)}")


def learned_shape(c: LearnedCurve) -> Markup:
    """A learned term against its signal, with its band, over the data."""
    x_unit, x_factor = shown(c.x_unit, c.x_signal, c.x)
    y_unit, y_factor = shown(c.y_unit, c.y_quantity, (*c.low, *c.high))
    x, dots_x = x_factor * np.array(c.x), x_factor * np.array(c.dots_x)
    y, low, high, dots_y = (y_factor * np.array(v) for v in (c.y, c.low, c.high, c.dots_y))
    outer = (1 - INNER) / 2
    least, most = np.quantile(dots_y, [outer, 1 - outer]) if len(dots_y) else (0.0, 0.0)
    names = axis(named(c.x_signal), x_unit), axis(named(c.y_quantity), y_unit)
    frame = around([float(v) for v in (least, most, *low, *high)])
    panel = Panel(Scale(float(x[0]), float(x[-1])), frame, *names, WIDE, HIGH)
    panel.cloud(dots_x, dots_y)
    panel.line([panel.x.low, panel.x.high], [0.0, 0.0], ZERO)
    panel.band(x, low, high, MODELS["extended"][0].colour)
    panel.line(x, y, MODELS["extended"][0])
    return panel.svg(f"{named(c.y_quantity)} against {named(c.x_signal)}")


def window(w: Window) -> Markup:
    """Measurement and free runs of one stretch of a recording, a drawing a channel below one another."""
    lines = {n: v for n, v in (("measured", w.measured), ("nominal", w.nominal), ("extended", w.extended)) if v}
    unit, factor = shown(w.unit, w.group, [v for rows in lines.values() for row in rows for v in row])
    panels = []
    for i, channel in enumerate(w.channels):
        values = {name: [v * factor for v in rows[i]] for name, rows in lines.items()}
        scale = around([v for of in values.values() for v in of], room=0.12)
        last, name = i == len(w.channels) - 1, axis(channel.rpartition(".")[2], unit)
        panels.append(
            Panel(Scale(w.t[0], w.t[-1]), scale, "time [s]" if last else "", name, WIDE, 134 if last else 118)
        )
        for model, of in values.items():
            panels[-1].line(w.t, of, MODELS[model][0])
    align(panels)
    said = f"{named(w.group)} measured and predicted"
    return Markup().join(p.svg(f"{said}: {p.y_name}") for p in panels)


def interval_bar(value: float, low: float, high: float, taken: bool) -> Markup:
    """SVG: a share from 0 to 1 as a dot with its 95 % interval, for a table row."""

    def at(share: float) -> float:
        return 4 + 152 * min(1.0, max(0.0, share))

    colour = "extended" if taken else "muted"
    marks = '<line x1="4" x2="156" y1="8" y2="8" stroke="var(--grid)"/>'
    if math.isfinite(low) and math.isfinite(high):
        span = f'x1="{at(low):.1f}" x2="{at(high):.1f}" y1="8" y2="8"'
        marks += f'<line {span} stroke="var(--{colour})" stroke-width="3" stroke-linecap="round" opacity=".45"/>'
    if math.isfinite(value):
        marks += f'<circle cx="{at(value):.1f}" cy="8" r="4" fill="var(--{colour})"/>'
    return Markup(f'<svg class="interval" viewBox="0 0 160 16" aria-hidden="true">{marks}</svg>')


def _short(text: str) -> str:
    return text if len(text) <= LABEL else text[: LABEL - 1] + "…"
