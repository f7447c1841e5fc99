"""The panels of the diagnosis page: small SVG drawings whose text and colours belong to the page."""

import io
import math
import re
import warnings
from collections.abc import Callable, Sequence
from typing import Any

import matplotlib
import numpy as np
from markupsafe import Markup, escape
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from bench.diagnose.evidence import Curves, Line, ResidualMap, Window
from bench.diagnose.learned_shape import LearnedCurve
from bench.diagnose.report.phrases import named, number, shown
from bench.reporting.white_grid import WHITE_GRID

# A stand-in for each colour of the page, put in its place so that a panel follows the page into the dark.
_VARIABLES = {
    "#0a0101": "ink",
    "#0a0202": "muted",
    "#0a0303": "grid",
    "#0a0404": "nominal",
    "#0a0505": "calibrated",
    "#0a0606": "extended",
    "#0a0707": "floor",
    "#0a0808": "paper",
    "#0a0909": "disturbance",
    "#0a0a0a": "network",
}
INK, MUTED, GRID, NOMINAL, CALIBRATED, EXTENDED, FLOOR, PAPER, DISTURBANCE, NETWORK = _VARIABLES
LOOK: dict[str, tuple[str, Any, float]] = {
    "nominal": (NOMINAL, (0, (5, 1.6)), 1.6),
    "calibrated": (CALIBRATED, (0, (6, 1.5, 1.2, 1.5)), 1.5),
    "extended": (EXTENDED, "solid", 2.0),
    "disturbance": (DISTURBANCE, (0, (4, 1.2, 1, 1.2)), 1.5),
    "network": (NETWORK, (0, (2.5, 1.2)), 1.7),
    "floor": (FLOOR, (0, (1, 1.3)), 1.5),
}
"""Colour, dashes and width of a line."""
DOTS = 1500
"""Samples shown in a scatter; more only make the page heavier."""
LABEL = 28
"""Characters of a label."""
INNER = 0.99
"""Share of the dots that the frame of a learned term holds."""
_STYLE: Any = {
    **WHITE_GRID,
    "axes.edgecolor": GRID,
    "axes.facecolor": "none",
    "axes.labelcolor": MUTED,
    "axes.labelsize": 9,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "figure.facecolor": "none",
    "font.size": 9,
    "grid.color": GRID,
    "grid.linewidth": 0.7,
    "savefig.facecolor": "none",
    "svg.fonttype": "none",  # text stays text: the page's font, selectable
    "svg.hashsalt": "multistep-bench",  # the same diagnosis gives the same file
    "text.color": INK,
    "text.parse_math": False,
    "xtick.color": MUTED,
    "xtick.labelsize": 8.5,
    "ytick.color": MUTED,
    "ytick.labelsize": 8.5,
}


def error_curves(group: str, curves: Curves) -> Markup:
    """SVG: error against the horizon, one line a model, its band the 95 % interval over recordings."""
    values = [v for line in curves.lines.values() for v in line.rmse]
    unit, factor = shown(curves.unit, group, values)

    def draw(axes: Axes) -> None:
        for name in (n for n in LOOK if n in curves.lines):
            _line(axes, curves.horizon_s, curves.lines[name], name, factor)
        axes.set(xlabel="horizon [s]", ylabel=_axis("RMSE", unit))
        axes.set(xlim=(0, max(curves.horizon_s)), ylim=(0, None))

    return _svg(draw, f"Error of {named(group)} against the horizon")


def waterfall(group: str, stages: Sequence[tuple[str, str, float]], floor: float, si_unit: str) -> Markup:
    """SVG: the error that remains after each stage; the pale part of a bar is what the stage took away.

    Args:
        group: output group.
        stages: label, colour key of `LOOK` and error [SI] of each, in order.
        floor: error [SI] that noise alone gives; NaN: unknown.
        si_unit: of the group.
    """
    unit, factor = shown(si_unit, group, [e for _, _, e in stages])
    errors = [e * factor for _, _, e in stages]
    finite = [e for e in errors if math.isfinite(e)]

    def draw(axes: Axes) -> None:
        top = max(finite, default=1.0)
        for i, ((_, key, _), error) in enumerate(zip(stages, errors, strict=True)):
            before = errors[i - 1] if i else error
            axes.barh(i, error, height=0.62, color=LOOK[key][0], linewidth=0)
            if before > error:
                axes.barh(i, before - error, left=error, height=0.62, color=LOOK[key][0], alpha=0.18, linewidth=0)
            text = "diverged" if math.isinf(error) else number(error)
            end = max((e for e in (before, error) if math.isfinite(e)), default=0.0)
            axes.text(end + 0.02 * top, i, text, va="center", ha="left", fontsize=9)
        if math.isfinite(floor):
            colour, dashes, width = LOOK["floor"]
            axes.axvline(floor * factor, color=colour, linestyle=dashes, linewidth=width)
        axes.set_yticks(range(len(stages)), [_short(label) for label, _, _ in stages])
        axes.tick_params(axis="y", labelcolor=INK, length=0)
        axes.locator_params(axis="x", nbins=6)
        axes.set(xlim=(0, 1.18 * top), ylim=(len(stages) - 0.4, -0.6), xlabel=_axis("RMSE", unit))
        axes.grid(axis="y", visible=False)

    return _svg(draw, f"Error of {named(group)} after each stage", height=0.75 + 0.36 * len(stages))


def residual_map(m: ResidualMap) -> Markup:
    """SVG: a residual against a signal, samples as dots, means in bins before and after as lines."""
    x_unit, x_factor = shown(m.x_unit, m.x_signal, m.centres)
    y_unit, y_factor = shown(m.y_unit, m.y_quantity, m.y)
    every = max(1, len(m.x) // DOTS)

    def draw(axes: Axes) -> None:
        x, y = ([v * f for v in values[::every]] for values, f in ((m.x, x_factor), (m.y, y_factor)))
        axes.axhline(0, color=MUTED, linewidth=0.8)
        # Grey of middle brightness: the dots are pixels, which cannot follow the page's colours.
        axes.scatter(x, y, s=5, color="#8a8f98", alpha=0.35, linewidths=0, rasterized=True)
        for values, key in ((m.before, "calibrated"), (m.after, "extended")):
            if values:
                at, mean = [c * x_factor for c in m.centres], [v * y_factor for v in values]
                marker: Any = {"marker": "o", "markersize": 4, "markeredgecolor": PAPER, "markeredgewidth": 0.6}
                axes.plot(at, mean, color=LOOK[key][0], linestyle=LOOK[key][1], linewidth=1.8, **marker)
        spread = sorted(abs(v) for v in y) or [1.0]
        means = [abs(v) * y_factor for v in (*m.before, *m.after) if math.isfinite(v)]
        bound = 1.1 * max([spread[int(0.985 * (len(spread) - 1))], *means])
        axes.set(xlabel=_axis(named(m.x_signal), x_unit), ylabel=_axis(named(m.y_quantity), y_unit))
        axes.set_ylim(-bound or -1, bound or 1)

    return _svg(draw, f"{named(m.y_quantity)} against {named(m.x_signal)}")


def learned_shape(c: LearnedCurve) -> Markup:
    """SVG: a learned term against its signal, with its band, over the data."""
    x_unit, x_factor = shown(c.x_unit, c.x_signal, c.x)
    y_unit, y_factor = shown(c.y_unit, c.y_quantity, (*c.low, *c.high))

    def draw(axes: Axes) -> None:
        x, dots_x = x_factor * np.array(c.x), x_factor * np.array(c.dots_x)
        y, low, high, dots_y = (y_factor * np.array(v) for v in (c.y, c.low, c.high, c.dots_y))
        axes.axhline(0, color=MUTED, linewidth=0.8)
        # Grey of middle brightness: the dots are pixels, which cannot follow the page's colours.
        axes.scatter(dots_x, dots_y, s=5, color="#8a8f98", alpha=0.35, linewidths=0, rasterized=True)
        colour, dashes, width = LOOK["extended"]
        axes.fill_between(x, low, high, color=colour, alpha=0.25, linewidth=0)
        axes.plot(x, y, color=colour, linestyle=dashes, linewidth=width)
        outer = (1 - INNER) / 2
        least, most = np.quantile(dots_y, [outer, 1 - outer]) if len(dots_y) else (0.0, 0.0)
        bottom, top = min(least, low.min()), max(most, high.max())
        room = 0.06 * ((top - bottom) or 1.0)
        axes.set(
            xlim=(x[0], x[-1]),
            ylim=(bottom - room, top + room),
            xlabel=_axis(named(c.x_signal), x_unit),
            ylabel=_axis(named(c.y_quantity), y_unit),
        )

    return _svg(draw, f"{named(c.y_quantity)} against {named(c.x_signal)}")


def window(w: Window) -> Markup:
    """SVG: measurement and free runs of one stretch of a recording, one row a channel."""
    every = [v for rows in (w.measured, w.nominal, w.extended) for row in rows for v in row]
    unit, factor = shown(w.unit, w.group, every)

    def draw(*grid: Axes) -> None:
        for i, axes in enumerate(grid):
            # The measurement is broad and pale, so that a model that lies on it is still seen.
            axes.plot(w.t, [v * factor for v in w.measured[i]], color=INK, alpha=0.28, linewidth=4.5)
            for key, rows in (("nominal", w.nominal), ("extended", w.extended)):
                if rows:
                    colour, dashes, width = LOOK[key]
                    axes.plot(w.t, [v * factor for v in rows[i]], color=colour, linestyle=dashes, linewidth=0.8 * width)
            axes.set(xlim=(w.t[0], w.t[-1]), ylabel=_axis(w.channels[i].rpartition(".")[2], unit))
            axes.margins(y=0.12)
            axes.locator_params(axis="y", nbins=4)
        grid[-1].set_xlabel("time [s]")

    return _svg(draw, f"{named(w.group)} measured and predicted", rows=len(w.channels), height=0.6 + len(w.channels))


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


def _line(axes: Axes, horizon: Sequence[float], line: Line, name: str, factor: float) -> None:
    colour, dashes, width = LOOK[name]
    axes.plot(horizon, [v * factor for v in line.rmse], color=colour, linestyle=dashes, linewidth=width)
    if line.low and line.high:
        low, high = ([v * factor for v in band] for band in (line.low, line.high))
        axes.fill_between(horizon, low, high, color=colour, alpha=0.14, linewidth=0)


def _axis(quantity: str, unit: str) -> str:
    return _short(quantity) if unit == "1" else f"{_short(quantity)} [{_short(unit)}]"


def _short(text: str) -> str:
    """What fits beside a panel."""
    return text if len(text) <= LABEL else text[: LABEL - 1] + "…"


def _svg(draw: Callable[..., None], title: str, height: float = 2.7, rows: int = 1) -> Markup:
    """One panel as an inline SVG element of the page."""
    with matplotlib.rc_context(_STYLE), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing")  # the reader's browser has more fonts
        figure = Figure(figsize=(4.4, height), layout="constrained", dpi=72)
        grid = figure.subplots(rows, 1, sharex=True, squeeze=False)[:, 0]
        for axes in grid:
            axes.tick_params(length=0)
        draw(*grid)
        figure.align_ylabels(list(grid))
        drawing, canvas = io.StringIO(), FigureCanvasSVG(figure)
        layout: Any = figure.get_layout_engine()
        layout.execute(figure)  # savefig would draw everything for the sake of it, then once more
        figure.set_layout_engine("none")
        figure.set_dpi(160)  # of dots
        canvas.print_svg(drawing, metadata={"Date": None})
    svg = drawing.getvalue()
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    svg = re.sub(r'<g id="[^"]*"', "<g", svg)  # not unique within the page
    svg = re.sub(r'(<svg[^>]*?) width="[^"]*"| height="[^"]*pt"', r"\1", svg, count=2)
    for stand_in, variable in _VARIABLES.items():
        svg = svg.replace(stand_in, f"var(--{variable})")
    return Markup(svg.replace("<svg", f'<svg class="panel" role="img" aria-label="{escape(title)}"', 1).strip())
