"""A designed manoeuvre as sentences, as a file to fly and as one HTML page that needs no network."""

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from jinja2 import Environment

from bench.diagnose.manoeuvre.design import Design
from bench.diagnose.report.phrases import listed, named, shown
from bench.diagnose.result import write_text
from bench.diagnose.settings import DESIGNING
from bench.reporting import page
from bench.reporting.drawing import Look, Panel, Scale, align, around
from bench.reporting.figures import COLOURS
from bench.reporting.page import Drawing, Section

DESIGNED, STOCK = Look(COLOURS[0], (), 2.0), Look(COLOURS[1], (4, 2), 1.4)


@dataclass(frozen=True)
class Drawn:
    """Drawings, and what their lines mean."""

    legend: Sequence[tuple[Look, str]]
    drawings: Sequence[Drawing]


def write_csv(path: Path, design: Design) -> None:
    """Write what is asked for, one row a sample: time, then inputs or set-points; or the starts of several runs.

    Raises:
        BenchError: the file cannot be written.
    """
    out = io.StringIO()
    rows = csv.writer(out, lineterminator="\n")
    names = [f"{name} [{unit}]" for name, unit in design.columns]
    if design.driven:
        rows.writerow(["t [s]", *names])
        rows.writerows([f"{k * design.dt:.9g}", *map(_cell, row)] for k, row in enumerate(design.table[0]))
    else:
        rows.writerow(["run", *names])
        rows.writerows([i, *map(_cell, run[0])] for i, run in enumerate(design.table, start=1))
    write_text(path, out.getvalue())


def _cell(value: float) -> str:
    return f"{value:.9g}"


def sentences(design: Design) -> list[str]:
    """What the design says beside its headline: row by row, then how to go about it."""
    said = [
        f"{row}: {told}"
        for row, told in zip(design.rows, (_told(design, row) for row in design.plan.told), strict=True)
    ]
    if design.candidates:
        said.append(f"Sure (95 %) after {_seconds(design.plan.needed_s)}.{_beside(design)}")
    if design.without:
        said.append(f"Left out, because it cannot be fitted to these recordings: {listed(map(named, design.without))}.")
    times = [round(s / design.seconds[0]) for s in design.seconds[1:]]
    again = f"; {design.seconds[1]:g} s are {times[0]} of it" if times else ""
    what = "the file is one recording" if design.driven else "the file has where to let go, once for each run"
    said.append(
        f"How: {what}{again}. Log each as a recording of its own, put them beside the others and diagnose again."
    )
    return said


def _told(design: Design, row: np.ndarray) -> str:
    if design.candidates:
        return "told from the others in " + ", ".join(
            f"{100 * c:.0f} % ({s:g} s)" for c, s in zip(row, design.seconds, strict=True)
        )
    return "expected ±" + ", ±".join(f"{w:.3g} ({s:g} s)" for w, s in zip(row, design.seconds, strict=True))


def _beside(design: Design) -> str:
    if design.stock is None:
        return ""
    return f" The stock manoeuvre within the same limits ({design.phrase}): {_seconds(design.stock.needed_s)}."


def _seconds(value: float) -> str:
    return f"{value:g} s" if math.isfinite(value) else "longer than was tried"


def write_page(path: Path, design: Design) -> None:
    """Write the page, whole or not at all.

    Raises:
        BenchError: the file cannot be written.
    """
    write_text(path, render(design))


def render(design: Design) -> str:
    """The page as text; all that comes from data is escaped."""
    made = [Section("What to do", "drawn", _asked(design))] if design.driven else []
    made += [Section("What it would show", "drawn", _answers(design))]
    made += [Section("What it is worth", "drawn", _worth(design))]
    return page.render(
        _templates(),
        "design.html.j2",
        f"A manoeuvre for {design.dataset}",
        made,
        facts=f"to tell {listed(map(named, design.rows), 'and')}" if design.candidates else "to narrow intervals",
        headline=design.headline,
        lines=sentences(design),
    )


@lru_cache(maxsize=1)
def _templates() -> Environment:
    return page.templates(Path(__file__).with_name("templates"))


def _asked(design: Design) -> Drawn:
    """Every channel over time, beside the stock manoeuvre."""
    drawings, panels = [], []
    for i, limit in enumerate(design.drives):
        lines = [(design.plan.asked[0, :, i], DESIGNED)]
        lines += [] if design.stock is None else [(design.stock.asked[0, :, i], STOCK)]
        panels.append(_panel(design, lines, f"{named(limit.name)} [{limit.unit}]"))
        drawings.append((named(limit.name), panels[-1]))
    align(panels)
    legend = [(DESIGNED, "designed"), *([] if design.stock is None else [(STOCK, "stock manoeuvre")])]
    return Drawn(legend, [Drawing(n, "", p.svg(f"{n} over time")) for n, p in drawings])


def _answers(design: Design) -> Drawn:
    """Every state over time, one line a candidate."""
    looks = [Look(COLOURS[i % len(COLOURS)], (), 1.6) for i in range(len(design.states))]
    drawings = []
    for k, (name, unit) in enumerate(design.outputs):
        shown_unit, factor = shown(unit, name.partition(".")[0], [float(np.abs(design.states[..., k]).max())])
        lines = [(run[:, k] * factor, look) for of, look in zip(design.states, looks, strict=True) for run in of]
        made = _panel(design, lines, f"{named(name)} [{shown_unit}]")
        drawings.append(Drawing(named(name), "", made.svg(f"{named(name)} over time, by candidate")))
    names = design.rows if design.candidates else ("the model",)
    return Drawn(
        [(look, f"if it is {named(n)}" if design.candidates else n) for look, n in zip(looks, names, strict=False)],
        drawings,
    )


def _worth(design: Design) -> Drawn:
    """Chances or half widths against the length of flight."""
    plans = [(design.plan, DESIGNED), *([] if design.stock is None else [(design.stock, STOCK)])]
    drawings = []
    for i, row in enumerate(design.rows):
        name = "chance that it is told" if design.candidates else f"±95 % of {row}"
        values = [float(v) for plan, _ in plans for v in plan.told[i]]
        scale = Scale(0.0, 1.05) if design.candidates else around(values, zero=True)
        made = Panel(around([0.0, *design.seconds], room=0.02), scale, "flown [s]", name, 330, 180)
        for plan, look in plans:
            made.line(design.seconds, plan.told[i], look)
            made.dots(design.seconds, plan.told[i], look.colour)
        drawings.append(Drawing(named(row), "", made.svg(f"{named(row)}: {name}, by seconds flown")))
    legend = [(DESIGNED, "designed"), *([] if design.stock is None else [(STOCK, "stock manoeuvre")])]
    return Drawn(legend, drawings)


def _panel(design: Design, lines: Sequence[tuple[np.ndarray, Look]], name: str) -> Panel:
    values = np.concatenate([y[np.isfinite(y)] for y, _ in lines])
    length = max(len(y) for y, _ in lines) * design.dt
    made = Panel(Scale(0.0, length), around(values.tolist()), "time [s]", name, 420, 190)
    for y, look in lines:
        at = np.unique(np.linspace(0, len(y) - 1, min(DESIGNING.drawn, len(y))).round().astype(int))
        made.line(at * design.dt, y[at], look)
    return made
