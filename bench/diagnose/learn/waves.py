"""The lines that a model leaves, each along the one axis that shows it best."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bench.diagnose.learn.axis_series import AxisSeries, axis_series
from bench.diagnose.learn.spectral_line import Line, line_at, lines
from bench.diagnose.learned_shape import LearnedCurve
from bench.diagnose.logs.noise import Noise
from bench.diagnose.logs.subject import Subject
from bench.diagnose.settings import SKETCHING
from bench.diagnose.simulate.unmeasured import hidden
from bench.execution.parallel import side_by_side
from registry.dynamics import PhysicsModel
from registry.effects.waves.periodic_term import PeriodicTerm
from registry.terms import signals as known


def waves(subject: Subject, model: PhysicsModel, noise: Noise) -> tuple[Line, ...]:
    """What swings in what ``model`` leaves and follows no measured signal, the largest part first.

    Args:
        subject: measurements; nothing is sought where some state was not measured.
        model: with the effects it has, its constants calibrated.
        noise: of the measurements.
    """
    if hidden(subject.logs):
        return ()
    series = axis_series(subject, model, noise)
    told = side_by_side(lambda one: lines(one, subject.training, len(series)), series)
    found = [line for of_one in told for line in of_one]
    longest = max((s.t[-1] for one in series for s in one.stretches), default=1.0)
    return tuple(_distinct(found, 2 / longest))


def told(subject: Subject, model: PhysicsModel, noise: Noise, place: int) -> Line | None:
    """What every recording says of the wave in ``model.effects[place]``; None: none is long enough."""
    return _heard(subject, model, noise, place)[1]


def folded(subject: Subject, model: PhysicsModel, noise: Noise, place: int) -> LearnedCurve | None:
    """A period of the wave in ``model.effects[place]`` over what is left without it, all periods laid upon each other.

    None: no recording is long enough.
    """
    series, line = _heard(subject, model, noise, place)
    if series is None or line is None:
        return None
    period = 1 / line.frequency
    several = max(1, round(period / SKETCHING.parts / series.step))
    xs, ys = [], []
    for s in series.stretches:
        if s.recording in line.swings:
            count = len(s.t) // several * several
            t, left = (x[:count].reshape(-1, several).mean(1) for x in (s.t, s.left))
            xs.append((t + line.swings[s.recording].phase / (2 * np.pi) * period) % period)
            ys.append(left - left.mean())
    x, y = np.concatenate(xs), np.concatenate(ys)
    thin = slice(None, None, max(1, len(x) // SKETCHING.dots))
    grid = np.linspace(0.0, period, SKETCHING.points)
    swings = line.swings.values()
    shown = np.cos(2 * np.pi * grid / period) * float(np.mean([w.amplitude for w in swings]))
    half = abs(shown) * float(np.mean([(w.high - w.low) / 2 / max(w.amplitude, 1e-300) for w in swings]))
    return LearnedCurve(
        x_signal="time in a period",
        x_unit="s",
        y_quantity=known.quantity_of(type(model), line.axis),
        y_unit=line.unit,
        x=tuple(grid.tolist()),
        y=tuple(shown.tolist()),
        low=tuple((shown - half).tolist()),
        high=tuple((shown + half).tolist()),
        dots_x=tuple(x[thin].tolist()),
        dots_y=tuple(y[thin].tolist()),
    )


def _heard(subject: Subject, model: PhysicsModel, noise: Noise, place: int) -> tuple[AxisSeries | None, Line | None]:
    """What is left without any wave along the axis of the one in ``model.effects[place]``, and that as a line."""
    wave = model.effects[place]
    assert isinstance(wave, PeriodicTerm)
    beside = [e for e in model.effects if isinstance(e, PeriodicTerm) and e is not wave and e.axis == wave.axis]
    rest = replace(model, effects=tuple(e for e in model.effects if not isinstance(e, PeriodicTerm)))
    series = next((s for s in axis_series(subject, rest, noise) if s.axis == wave.axis), None)
    if series is None:
        return None, None
    return series, line_at([*(e.frequency for e in beside), wave.frequency], series, subject.training)


def _distinct(found: Sequence[Line], apart: float) -> list[Line]:
    """The lines without those that only show another one along another frame's axis.

    Args:
        found: along all axes.
        apart: frequencies nearer than this are the same [Hz].
    """
    kept: list[Line] = []
    for line in sorted(found, key=lambda one: -(one.evidence + one.gain)):
        same = [k for k in kept if abs(k.frequency - line.frequency) < max(apart, line.high - line.low)]
        if not any(_frame(k.axis) != _frame(line.axis) and _forces(k.axis, line.axis) for k in same):
            kept.append(line)
    return kept


def _frame(axis: str) -> str:
    return "world" if axis in known.WORLD_FORCES else "body"


def _forces(*axes: str) -> bool:
    return all(a in known.FORCES or a in known.WORLD_FORCES for a in axes)
