"""The drawings of a study's page, small multiples with common axes."""

from collections.abc import Sequence

import numpy as np
from markupsafe import Markup

from bench.analysis import tables
from bench.records.record import RunRecord
from bench.reporting import figures
from bench.reporting.drawing import CHARACTER, Look, Panel, Scale, around
from bench.reporting.page import Drawing
from bench.reporting.study_page_content import QUANTILES, Content

BOXES = 20
"""Boxes of a drawing, evenly over the horizon."""
TIME = "time after k0 [s]"


def curves(c: Content, quantity: str, horizon: int) -> Drawing:
    """Mean error of every step, a line a configuration; its band runs from the best to the worst seed."""
    found = {s: curve for s in c.specs if (curve := c.curve(s, quantity, horizon))}
    if not found:
        return Drawing(figures.title(quantity), "no finished run", Markup())
    top = c.ceiling({s: float(curve.mean.max()) for s, curve in found.items()})
    end = max(curve.time[-1] for curve in found.values())
    drawn = Panel(Scale(0, end), Scale(0, top), TIME, f"mean |error| [{c.unit(quantity)}]", 340, 215)
    for spec, curve in found.items():
        if curve.seeds > 1:
            drawn.band(curve.time, curve.low, curve.high, c.looks[spec].colour)
    for spec, curve in found.items():
        drawn.line(curve.time, curve.mean, c.looks[spec])
    above = [s for s, curve in found.items() if curve.mean.max() > top]
    note = f"{', '.join(above)} {'leaves' if len(above) == 1 else 'leave'} the axis" if above else ""
    return Drawing(figures.title(quantity), note, drawn.svg(f"Mean error of {figures.title(quantity)} of every step"))


def boxes(c: Content, quantity: str, horizon: int) -> list[Drawing]:
    """Distribution of the error at every step, a drawing a configuration, all on one axis."""
    found = {s: q for s in c.specs if (q := c.quantiles(s, quantity, horizon))}
    top = c.ceiling({s: float(q["q95"].max()) for s, q in found.items()})
    made = []
    for spec, quantiles in found.items():
        curve = c.curve(spec, quantity, horizon)
        assert curve is not None  # it has quantiles
        every = -(-horizon // BOXES)
        picks = range(every - 1, horizon, every)
        pitch = curve.time[0] * every
        drawn = Panel(Scale(0, curve.time[-1] + 0.5 * pitch), Scale(0, top), TIME, f"|error| [{c.unit(quantity)}]")
        for i in picks:
            low, box_low, median, box_high, high = (float(quantiles[q][i]) for q in QUANTILES)
            drawn.box(float(curve.time[i]), 0.62 * pitch, (low, high), (box_low, box_high), median)
        note = "leaves the axis" if quantiles["q95"].max() > top else ""
        made.append(Drawing(spec, note, drawn.svg(f"Distribution of the error of {figures.title(quantity)}, {spec}")))
    return made


def within(c: Content, a: str, b: str, horizon: int) -> list[Drawing]:
    """Mean error of two quantities of one network, a drawing a configuration, all on one axis."""
    found = {}
    for spec in c.specs:
        pair = (c.curve(spec, a, horizon), c.curve(spec, b, horizon))
        if pair[0] and pair[1]:
            found[spec] = pair
    every = [v for pair in found.values() for curve in pair if curve for v in curve.mean]
    positive = [v for v in every if v > 0]
    log = bool(positive) and max(positive) > 8 * min(positive)
    made = []
    for spec, pair in found.items():
        drawn = None
        for curve, look in zip(pair, WITHIN, strict=True):
            assert curve is not None
            drawn = drawn or Panel(
                Scale(0, curve.time[-1]), around(every, log, zero=not log), TIME, f"mean |error| [{c.unit(a)}]"
            )
            if curve.seeds > 1:
                drawn.band(curve.time, curve.low, curve.high, look.colour)
            drawn.line(curve.time, curve.mean, look)
        assert drawn is not None
        made.append(Drawing(spec, "", drawn.svg(f"{figures.title(a)} and {figures.title(b)}, {spec}")))
    return made


WITHIN = (Look("#0072B2", (), 2.0), Look("#D55E00", (5, 1.6), 2.0))
"""First and second quantity of a contrast."""
MEASURED, PREDICTED = Look("var(--ink)", (), 4.5, 0.25), Look("#D55E00", (), 1.7)


def size(c: Content, quantity: str, horizon: int) -> Drawing:
    """RMSSE against the number of weights, a labelled point a network."""
    t = c.table
    t = t[(t.horizon == horizon) & (t.output == quantity) & t.rmsse.notna()]
    rows = [r for r in t.itertuples() if not tables.is_baseline(r.spec)]
    low = [r.rmsse_low if r.rmsse_low > 0 else r.rmsse for r in rows]
    high = [r.rmsse_high if r.rmsse_high > 0 else r.rmsse for r in rows]
    values = [r.rmsse for r in rows]
    log = max(values) > 8 * min(values)
    drawn = Panel(
        around([r.weights for r in rows], log=True),
        around([*low, *high, *values] if not log else values, log, zero=not log),
        "weights [count]",
        f"RMSSE [{c.unit(quantity)}]",
        490,
        max(230, 15 * len(rows) + 70),
        right=20 + CHARACTER * max(len(r.spec) for r in rows),
    )
    drawn.points([(r.weights, r.rmsse, r.rmsse_low, r.rmsse_high, c.looks[r.spec].colour, r.spec) for r in rows])
    return Drawing(figures.title(quantity), "", drawn.svg(f"RMSSE of {figures.title(quantity)} against weights"))


def worst(c: Content, quantity: str, horizon: int) -> list[Drawing]:
    """The worst example window of every configuration beside the measurement, each on an axis of its own."""
    found = {s: w for s in c.specs if (w := c.worst_window(s, quantity, horizon))}
    made = []
    for spec, window in found.items():
        drawn = Panel(
            Scale(0, float(window.time[-1])),
            around([*window.measured, *window.predicted]),
            TIME,
            f"{figures.title(window.channel)} [{c.unit(quantity)}]",
        )
        drawn.line(window.time, window.measured, MEASURED)
        drawn.line(window.time, window.predicted, PREDICTED)
        made.append(Drawing(spec, f"{window.recording}, seed {window.seed}", drawn.svg(f"Worst window of {spec}")))
    return made


def learning(c: Content, name: str, runs: Sequence[RunRecord]) -> Drawing | None:
    """Validation cost of every run against updates."""
    found = [(r, r.curve) for r in runs if len(r.curve) > 1]
    costs = [v for _, t in found for v in t["validation_loss"] if np.isfinite(v) and v > 0]
    if not costs:
        return None
    last = max(int(t["update"].max()) for _, t in found)
    # A cost that has run away would press all others flat against the axis.
    drawn = Panel(
        Scale(0, last),
        around([v for v in costs if v < 1e3 * float(np.median(costs))], log=True),
        "updates [count]",
        "validation cost [scaled units]",
        340,
        200,
    )
    for run, t in found:
        look = c.looks[run.summary["spec"]]
        drawn.line(t["update"].tolist(), t["validation_loss"].tolist(), Look(look.colour, look.dashes, 1.3))
    return Drawing(name, "", drawn.svg(f"Learning curves, {name}"))
