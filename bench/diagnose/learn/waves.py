"""The lines that a model leaves, each along the one axis that shows it best."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch

from bench.diagnose.learn.axis_series import AxisSeries, axis_series
from bench.diagnose.learn.learn import refitted
from bench.diagnose.learn.spectral_line import Line, line_at, lines
from bench.diagnose.learned_shape import LearnedCurve
from bench.diagnose.logs.noise import Noise
from bench.diagnose.logs.subject import Subject
from bench.diagnose.select.search import Search, View
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
    return tuple(_distinct(found, 2 / longest, _Frames(subject, model, noise)))


def periodic(line: Line) -> PeriodicTerm:
    """A line as an effect, its frequency with seven digits."""
    return PeriodicTerm(line.axis, float(f"{line.frequency:.7g}"))


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


@dataclass(frozen=True, eq=False)
class _Frames:
    """Which frame's axes a force swings along: what each explains along its own axis does not compare."""

    subject: Subject
    model: PhysicsModel
    noise: Noise

    @cached_property
    def search(self) -> Search:
        """Of the training recordings."""
        return Search(self.subject, (), lambda what: None, self.noise)

    @cached_property
    def view(self) -> View:
        """The model without any of it."""
        return self.search.views(self.search.own(self.model, settled=True))[0]

    def cost(self, some: Sequence[Line]) -> float:
        """Squares that the model leaves with such waves, and what their numbers must save (Schwarz)."""
        grown = replace(self.model, effects=(*self.model.effects, *map(periodic, some)))
        with torch.no_grad():
            left = self.search.loss(self.view, refitted(self.search, grown))
        return left + self.view.subsets.penalty * 2 * len(self.subject.training) * len(some)


def _distinct(found: Sequence[Line], apart: float, frames: _Frames) -> list[Line]:
    """The lines without those that only show a force along another frame's axes, the largest part first.

    Args:
        found: along all axes.
        apart: frequencies nearer than this are the same [Hz].
        frames: say in which frame a force swings that shows in both.
    """
    kept, rest = list[Line](), sorted(found, key=lambda one: -(one.evidence + one.gain))
    while rest:
        first = rest[0]
        same = [one for one in rest if abs(one.frequency - first.frequency) < max(apart, one.high - one.low)]
        same = [one for one in same if (one.axis in known.TORQUES) == (first.axis in known.TORQUES)]
        of_world = [one for one in same if one.axis in known.WORLD_FORCES]
        of_body = [one for one in same if one.axis not in known.WORLD_FORCES]
        either = [some for some in (of_world, of_body) if some]
        chosen = min(either, key=frames.cost) if len(either) > 1 else same
        kept += chosen
        rest = [one for one in rest if one not in same]
    return sorted(kept, key=lambda one: -(one.evidence + one.gain))
