"""The section of the diagnosis page on whole recordings, over time and from above. What comes from data is escaped."""

import math
from collections.abc import Sequence
from html import escape
from itertools import pairwise
from pathlib import Path

import numpy as np

from bench.diagnose.flight import AFTER, RUNS, Flight, Signal, Trace
from bench.diagnose.flight import Path as Track
from bench.diagnose.report import phrases
from bench.diagnose.result import Diagnosis
from bench.reporting.drawing import Look, Panel, Scale, align, around, legend, swatch

WIDE = 1000.0
"""Width of a drawing over time."""
PLAN = 480.0
"""Width of a drawing from above, and the most of its height."""
ROOM = 0.5
"""How far beyond the measured values a frame reaches for the models, as a share of their range."""
HEATS = 5
"""Colours of a flight's path."""
LABEL = 40
"""Characters of a name in a drawing."""


def script() -> str:
    """Zoom and pan, for the end of the page."""
    return Path(__file__).with_name("flights.js").read_text(encoding="utf-8")


def over_time(d: Diagnosis) -> str:
    """Measured and predicted, a recording and a signal at a time; empty where no recording was kept."""
    flights = d.evidence.flights
    if not flights:
        return ""
    names, looks = dict(zip(RUNS, ("measured", "nominal model (before)", _after(d)), strict=True)), _looks(d)
    signals = list(dict.fromkeys(s.name for f in flights for s in f.signals))
    figures = []
    for i, flight in enumerate(flights):
        figures += [_figure(flight, i, s, signals.index(s.name), looks) for s in flight.signals]
        if flight.path is not None:
            figures.append(_from_above(flight, flight.path, i, len(signals), names))
    seen = [*map(phrases.named, signals), *(["seen from above"] if any(f.path for f in flights) else [])]
    recordings = [f"{f.recording}{'' if f.held_out else ' (fitted)'}" for f in flights]
    more = d.evidence.recordings - len(flights)
    rest = f" {more} of {d.evidence.recordings} recordings are left out to keep this page small." if more > 0 else ""
    return (
        f"<p>Each model runs free and begins anew from the measured state every {flights[0].restart_s:g} s: where its "
        "line leaves the measurement, it is wrong. Held-out recordings come first, that with the greatest error before "
        f"the others.{rest}</p>"
        f'<div class="recorded">{_rules(len(flights), len(signals), len(seen) > len(signals))}'
        f"{_choice('recording', recordings)}{_choice('signal', seen, _first(d, signals))}"
        f"{legend([(look, names[n]) for n, look in looks.items()])}{''.join(figures)}</div>"
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


def _choice(what: str, names: Sequence[str], first: int = 0) -> str:
    """Radio buttons, which need no script: one of them stands for what is shown."""
    buttons = "".join(
        f'<label><input type="radio" name="{what}" id="{what}-{i}"{" checked" if i == first else ""}>'
        f"<span>{escape(name)}</span></label>"
        for i, name in enumerate(names)
    )
    return f'<fieldset class="choice"><legend>{what}</legend>{buttons}</fieldset>'


def _rules(recordings: int, signals: int, above: bool) -> str:
    """Which drawing the chosen recording and signal show; a browser that does not know :has shows all."""
    rules = "".join(
        f".recorded:has(#recording-{i}:checked):has(#signal-{j}:checked) .of-{i}-{j}{{display:block}}"
        for i in range(recordings)
        for j in range(signals + above)
    )
    if above:  # it has colours of its own
        rules += f".recorded:has(#signal-{signals}:checked) > .legend{{display:none}}"
    return f"<style>@supports selector(:has(*)){{.recorded figure{{display:none}}{rules}}}</style>"


# ------------------------------------------------------------------------------------------------------ over time


def _figure(flight: Flight, i: int, signal: Signal, j: int, looks: dict[str, Look]) -> str:
    seconds = (flight.samples - 1) * flight.dt
    finite = [v for t in signal.traces for v in _ends(t.lines.get("measured", ()))]
    unit, factor = phrases.shown(signal.unit, signal.name, finite)
    panels = [_panel(flight, t, unit, factor, looks, seconds, last=t is signal.traces[-1]) for t in signal.traces]
    align(panels)
    drawn = ""
    for panel, trace in zip(panels, signal.traces, strict=True):
        for run, look in looks.items():
            pieces = [(x, y * factor) for x, y in trace.lines.get(run, ())]
            panel.trace(pieces, flight.dt, look, run)
        drawn += panel.svg(f"{phrases.named(trace.channel)} of {flight.recording} over time: {panel.y_name}")
    name = f"{phrases.named(signal.name)} of {flight.recording}"
    how = "Each model at the measured states, without the sensor's offset." if signal.sensed else ""
    thin = ""
    if flight.samples < flight.whole:
        thin = f"The first {seconds:.3g} s of {flight.whole * flight.dt:.3g} s."
    note = " ".join(filter(None, (how, thin)))
    return (
        f'<figure class="wide of-{i}-{j}" data-recording="{i}" data-seconds="{seconds:.9g}" '
        f'data-step="{flight.dt:.9g}">'
        f"<figcaption>{escape(name)} <small>{note}</small></figcaption>"
        f'<div class="plots" tabindex="0" role="group" aria-label="{escape(name)} over time. With a script: + and − '
        f'zoom, arrow keys move, 0 shows all.">{drawn}</div></figure>'
    )


def _panel(
    flight: Flight, trace: Trace, unit: str, factor: float, looks: dict[str, Look], seconds: float, last: bool
) -> Panel:
    """The empty frame of one channel; the lowest names the time."""
    alone = trace.channel.rpartition(".")[2].replace("_", " ")
    errors = [trace.rms[n] * factor for n in RUNS if n in trace.rms]
    error = " → ".join("diverged" if math.isnan(e) else phrases.number(e, 2) for e in errors)
    said = f"{_short(alone)}{'' if unit == '1' else f' [{_short(unit)}]'}" + (f", rms error {error}" if errors else "")
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


def _short(text: str) -> str:
    return text if len(text) <= LABEL else text[: LABEL - 1] + "…"


# ----------------------------------------------------------------------------------------------------- from above


def _from_above(flight: Flight, path: Track, i: int, j: int, names: dict[str, str]) -> str:
    """The path as often as there are models, coloured by each one's error, both on one scale of colours."""
    finite = np.concatenate([e[np.isfinite(e)] for e in path.errors.values()])
    unit, factor = phrases.shown(path.unit, path.group, finite)
    steps = _steps(finite * factor)
    x, y = _frame(np.concatenate(path.stretches))
    drawings = []
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
        drawings.append(f"<div><h4>{escape(names[name])}</h4>{panel.svg(said)}</div>")
    title = f"{flight.recording} seen from above"
    what = f"Colour and width: rms error of {phrases.named(path.group)} in each free run of {flight.restart_s:g} s."
    return (
        f'<figure class="wide of-{i}-{j}"><figcaption>{escape(title)} <small>{escape(what)}</small></figcaption>'
        f'{_heat_legend(steps, unit)}<div class="plans">{"".join(drawings)}</div></figure>'
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


def _heat_legend(steps: np.ndarray, unit: str) -> str:
    ends = [phrases.number(s, 2) for s in steps]
    said = [f"below {ends[0]}", *(f"{a} to {b}" for a, b in pairwise(ends)), f"above {ends[-1]}"]
    items = "".join(
        f"<li>{swatch(Look(f'var(--heat-{i})', width=1.6 + 0.7 * i))}{escape(phrases.united(text, unit))}</li>"
        for i, text in enumerate(said)
    )
    return f'<ul class="legend">{items}</ul>'
