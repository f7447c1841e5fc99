"""What the diagnosis page shows of whole recordings, over time and from above."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from markupsafe import Markup

from bench.diagnose.evidence import AFTER, RUNS, Flight, Signal, Trace
from bench.diagnose.evidence import Path as Track
from bench.diagnose.report import phrases
from bench.diagnose.report.page_figures import axis
from bench.diagnose.result import Diagnosis
from bench.reporting.drawing import Look, Panel, Scale, align, around

WIDE = 1000.0
"""Width of a drawing over time."""
PLAN = 480.0
"""Width of a drawing from above, and the most of its height."""
ROOM = 0.5
"""How far beyond the measured values a frame reaches for the models, as a share of their range."""
HEATS = 5
"""Colours of a flight's path."""


def script() -> str:
    """Zoom and pan, for the end of the page."""
    return Path(__file__).with_name("flights.js").read_text(encoding="utf-8")


@dataclass(frozen=True)
class _Series:
    """One signal of a recording over time."""

    recording: int
    signal: int
    name: str
    note: str
    seconds: str
    step: str
    """Sampling period [s]."""
    panels: Markup


@dataclass(frozen=True)
class _Plan:
    """A recording from above, as often as there are models."""

    recording: int
    signal: int
    name: str
    note: str
    legend: Sequence[tuple[Look, str]]
    plans: Sequence[tuple[str, Markup]]


@dataclass(frozen=True)
class _OverTime:
    restart: str
    """Time between two beginnings of a free run [s]."""
    every: int
    """Recordings of the data, of which ``left_out`` are not shown."""
    left_out: int
    recordings: Sequence[str]
    signals: Sequence[str]
    first: int
    """Which signal is shown first."""
    from_above: int | None
    """Which of the ``signals`` is the view from above, which has colours of its own."""
    legend: Sequence[tuple[Look, str]]
    figures: Sequence[_Series | _Plan]


def over_time(d: Diagnosis) -> _OverTime | None:
    """Measured and predicted, a recording and a signal at a time; None where no recording was kept."""
    flights = d.evidence.flights
    if not flights:
        return None
    names, looks = dict(zip(RUNS, ("measured", "nominal model (before)", _after(d)), strict=True)), _looks(d)
    signals = list(dict.fromkeys(s.name for f in flights for s in f.signals))
    figures: list[_Series | _Plan] = []
    for i, flight in enumerate(flights):
        figures += [_series(flight, i, s, signals.index(s.name), looks) for s in flight.signals]
        if flight.path is not None:
            figures.append(_plan(flight, flight.path, i, len(signals), names))
    above = any(f.path for f in flights)
    return _OverTime(
        restart=f"{flights[0].restart_s:g}",
        every=d.evidence.recordings,
        left_out=max(0, d.evidence.recordings - len(flights)),
        recordings=[f"{f.recording}{'' if f.held_out else ' (fitted)'}" for f in flights],
        signals=[*map(phrases.named, signals), *(["seen from above"] if above else [])],
        first=_first(d, signals),
        from_above=len(signals) if above else None,
        legend=[(look, names[n]) for n, look in looks.items()],
        figures=figures,
    )


def _first(d: Diagnosis, signals: Sequence[str]) -> int:
    """Which signal is shown first: what a sensor of rates shows, else what an equation moves and was mended most."""
    moved, worst = {e.output for e in d.by_equation.values()}, d.evidence.flights[0]
    fall = {s.name: (not s.sensed, _fallen(s)) for s in worst.signals if s.sensed or s.name in moved}
    return signals.index(min(fall, key=fall.__getitem__)) if fall else 0


def _fallen(signal: Signal) -> float:
    """Squared error after over before, pooled over axes; infinite where it cannot be said."""
    before, after = (sum(t.rms.get(n, math.nan) ** 2 for t in signal.traces) for n in ("nominal", AFTER))
    return after / before if before > 0 and math.isfinite(after) else math.inf


def _after(d: Diagnosis) -> str:
    return "extended model (after)" if d.effects else "calibrated constants (after)"


def _looks(d: Diagnosis) -> dict[str, Look]:
    colour = "var(--extended)" if d.effects else "var(--calibrated)"
    drawn = (Look("var(--ink)", width=4, opacity=0.26), Look("var(--nominal)", (4, 1.5), 1.3), Look(colour, width=1.6))
    return dict(zip(RUNS, drawn, strict=True))


# ------------------------------------------------------------------------------------------------------ over time


def _series(flight: Flight, i: int, signal: Signal, j: int, looks: dict[str, Look]) -> _Series:
    seconds = (flight.samples - 1) * flight.dt
    finite = [v for t in signal.traces for v in _ends(t.lines.get("measured", ()))]
    unit, factor = phrases.shown(signal.unit, signal.name, finite)
    panels = [_panel(flight, t, unit, factor, looks, seconds, last=t is signal.traces[-1]) for t in signal.traces]
    align(panels)
    drawn = Markup()
    for panel, trace in zip(panels, signal.traces, strict=True):
        for run, look in looks.items():
            pieces = [(x, y * factor) for x, y in trace.lines.get(run, ())]
            panel.trace(pieces, flight.dt, look, run)
        drawn += panel.svg(f"{phrases.named(trace.channel)} of {flight.recording} over time: {panel.y_name}")
    how = "Each model at the measured states, without the sensor's offset." if signal.sensed else ""
    cut = flight.samples < flight.whole
    thin = f"The first {seconds:.3g} s of {flight.whole * flight.dt:.3g} s." if cut else ""
    return _Series(
        recording=i,
        signal=j,
        name=f"{phrases.named(signal.name)} of {flight.recording}",
        note=" ".join(filter(None, (how, thin))),
        seconds=f"{seconds:.9g}",
        step=f"{flight.dt:.9g}",
        panels=drawn,
    )


def _panel(
    flight: Flight, trace: Trace, unit: str, factor: float, looks: dict[str, Look], seconds: float, last: bool
) -> Panel:
    """The empty frame of one channel; the lowest names the time."""
    alone = trace.channel.rpartition(".")[2].replace("_", " ")
    errors = [trace.rms[n] * factor for n in RUNS if n in trace.rms]
    error = " → ".join("diverged" if math.isnan(e) else phrases.number(e, 2) for e in errors)
    said = axis(alone, unit) + (f", rms error {error}" if errors else "")
    time = Scale(0.0, seconds or 1.0)
    return Panel(time, _scale(trace, factor), "time [s]" if last else "", said, WIDE, 176 if last else 160)


def _scale(trace: Trace, factor: float) -> Scale:
    """What was measured, and the models as far as they stay near it."""
    ends = {n: _ends(pieces) for n, pieces in trace.lines.items()}
    low, high = ends.pop("measured", (0.0, 1.0))
    reach = ROOM * (high - low)
    lows, highs = [low], [high]
    for a, b in ends.values():
        lows.append(max(a, low - reach))
        highs.append(min(b, high + reach))
    return around([factor * min(lows), factor * max(highs)])


def _ends(pieces: Sequence[tuple[np.ndarray, np.ndarray]]) -> tuple[float, float]:
    """The least and the greatest finite value; 0 and 1 where there is none."""
    values = np.concatenate([*(y[np.isfinite(y)] for _, y in pieces), np.empty(0)])
    return (float(values.min()), float(values.max())) if len(values) else (0.0, 1.0)


# ----------------------------------------------------------------------------------------------------- from above


def _plan(flight: Flight, path: Track, i: int, j: int, names: dict[str, str]) -> _Plan:
    """The path as often as there are models, coloured by each one's error, both on one scale of colours."""
    finite = np.concatenate([e[np.isfinite(e)] for e in path.errors.values()])
    unit, factor = phrases.shown(path.unit, path.group, finite)
    steps = _steps(finite * factor)
    x, y = _frame(np.concatenate(path.stretches))
    plans = []
    for name, errors in path.errors.items():
        high = 54 + (PLAN - 60) * (y.high - y.low) / (x.high - x.low)
        panel = Panel(x, y, "x [m]", "y [m]", PLAN, high)
        heats = np.searchsorted(steps, np.nan_to_num(errors * factor, nan=math.inf), side="right")
        for heat in range(HEATS):
            look = Look(f"var(--heat-{heat})", width=1.6 + 0.7 * heat)
            own = [stretch for stretch, h in zip(path.stretches, heats, strict=True) if h == heat]
            broken = np.concatenate([np.vstack([s, [[math.nan] * 2]]) for s in own] or [np.empty((0, 2))])
            panel.line(broken[:, 0], broken[:, 1], look)
        said = f"{flight.recording} from above, coloured by the {phrases.named(path.group)} error: {names[name]}"
        plans.append((names[name], panel.svg(said)))
    return _Plan(
        recording=i,
        signal=j,
        name=f"{flight.recording} seen from above",
        note=f"Colour and width: rms error of {phrases.named(path.group)} in each free run of {flight.restart_s:g} s.",
        legend=_heats(steps, unit),
        plans=plans,
    )


def _steps(errors: np.ndarray) -> np.ndarray:
    """Four round numbers that part the errors of both models."""
    if not len(errors) or not errors.max() > 0:
        return np.arange(1.0, HEATS)
    top = float(np.quantile(errors, 0.98))
    return np.array([float(f"{top * share:.2g}") for share in (0.1, 0.25, 0.5, 0.8)])


def _frame(points: np.ndarray) -> tuple[Scale, Scale]:
    """Scales on which a metre is as long in x as in y, no taller than wide."""
    centre, half = (points.max(0) + points.min(0)) / 2, np.ptp(points, axis=0) / 2
    room = 1.08 * max(float(half.max()), 1e-3)
    tall = max(0.35 * room, min(room, 1.08 * float(half[1]))) if half[0] >= half[1] else room
    wide = room
    return (
        Scale(float(centre[0]) - wide, float(centre[0]) + wide),
        Scale(float(centre[1]) - tall, float(centre[1]) + tall),
    )


def _heats(steps: np.ndarray, unit: str) -> list[tuple[Look, str]]:
    """What the colours of a path mean."""
    ends = [phrases.number(s, 2) for s in steps]
    said = [f"below {ends[0]}", *(f"{a} to {b}" for a, b in pairwise(ends)), f"above {ends[-1]}"]
    return [(Look(f"var(--heat-{i})", width=1.6 + 0.7 * i), phrases.united(text, unit)) for i, text in enumerate(said)]
