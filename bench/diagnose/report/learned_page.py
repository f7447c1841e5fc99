"""The section of the diagnosis page on learned terms: each shape with its band over the data."""

import numpy as np
from matplotlib.axes import Axes

from bench.diagnose.learned_shape import LearnedCurve
from bench.diagnose.report import page_figures as figures
from bench.diagnose.report import phrases
from bench.diagnose.result import Diagnosis
from bench.reporting import page

INNER = 0.99
"""Share of the dots that the frame holds."""


def section(d: Diagnosis) -> str:
    """What each term looks like over what it was learned from; empty without any."""
    if not d.evidence.learned:
        return ""
    panels = [
        page.panel(f"{phrases.named(c.y_quantity)} against {phrases.named(c.x_signal)}", "", shape(c))
        for c in d.evidence.learned
    ]
    return (
        "<p>No effect of the catalogue explains these recordings, so terms were learned from them: splines, kept where "
        "recordings left out of the fit confirm them, and replaced by the shortest formula that predicts those no "
        "worse. Line and band: the term as fitted by simulation, with 95 %. Dots: what the measurements show along "
        "that axis without the term, as means over short windows.</p>"
        f"{page.grid(panels)}"
    )


def shape(c: LearnedCurve) -> str:
    """SVG: a learned term against its signal, with its band, over the data."""
    x_unit, x_factor = phrases.shown(c.x_unit, c.x_signal, c.x)
    y_unit, y_factor = phrases.shown(c.y_unit, c.y_quantity, (*c.low, *c.high))

    def draw(axes: Axes) -> None:
        x, dots_x = x_factor * np.array(c.x), x_factor * np.array(c.dots_x)
        y, low, high, dots_y = (y_factor * np.array(v) for v in (c.y, c.low, c.high, c.dots_y))
        axes.axhline(0, color=figures.MUTED, linewidth=0.8)
        # Grey of middle brightness: the dots are pixels, which cannot follow the page's colours.
        axes.scatter(dots_x, dots_y, s=5, color="#8a8f98", alpha=0.35, linewidths=0, rasterized=True)
        colour, dashes, width = figures.LOOK["extended"]
        axes.fill_between(x, low, high, color=colour, alpha=0.25, linewidth=0)
        axes.plot(x, y, color=colour, linestyle=dashes, linewidth=width)
        outer = (1 - INNER) / 2
        least, most = np.quantile(dots_y, [outer, 1 - outer]) if len(dots_y) else (0.0, 0.0)
        bottom, top = min(least, low.min()), max(most, high.max())
        room = 0.06 * ((top - bottom) or 1.0)
        axes.set(
            xlim=(x[0], x[-1]),
            ylim=(bottom - room, top + room),
            xlabel=figures._axis(phrases.named(c.x_signal), x_unit),
            ylabel=figures._axis(phrases.named(c.y_quantity), y_unit),
        )

    return figures._svg(draw, f"{phrases.named(c.y_quantity)} against {phrases.named(c.x_signal)}")
