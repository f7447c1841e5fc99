"""What a model leaves along every axis, as evenly spaced series, beside functions of all that was measured."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from bench.diagnose.learn.candidates import dynamic_axes, paths, with_axes
from bench.diagnose.logs.noise import Noise
from bench.diagnose.logs.subject import Log, LogBatch, Subject
from bench.diagnose.regression.generic import Dictionary, dictionary
from bench.diagnose.regression.linearise import Linearization, directions
from bench.diagnose.regression.test_functions import TestFunctions
from bench.diagnose.regression.weak import mean_rates
from bench.diagnose.settings import UNSEEN
from registry.dynamics import PhysicsModel
from registry.terms import signals as known


@dataclass(frozen=True, eq=False)
class Stretch:
    """A part of a recording without a gap."""

    recording: str
    t: np.ndarray
    """(J,) [s] from the recording's first sample, evenly spaced."""
    left: np.ndarray
    """(J,) mean along the axis, over a short window about each time, of what the model leaves."""
    beside: np.ndarray
    """(J, p): what a unit of each of the model's numbers, and each function of a measured signal, adds."""
    driven: np.ndarray
    """(J,): what the inputs' departure from their mean adds, as the model says."""
    measured: np.ndarray
    """(J, m): every signal that a term can follow, mean over the same windows."""

    def coarser(self, count: int) -> "Stretch":
        """Means over ``count`` windows each; what is over at the end is left out."""
        whole = len(self.t) // count * count
        arrays = self.t, self.left, self.beside, self.driven, self.measured
        return Stretch(self.recording, *(x[:whole].reshape(-1, count, *x.shape[1:]).mean(1) for x in arrays))


@dataclass(frozen=True, eq=False)
class AxisSeries:
    """All recordings along one axis."""

    axis: str
    unit: str
    stretches: tuple[Stretch, ...]
    step: float
    """From one window to the next [s]."""
    weights: np.ndarray
    """(w,) of a window over the sampling intervals, the filter of the measurements included; they sum to 1."""
    own: int
    """How many columns of ``beside`` are of the model's numbers; the others are functions of signals."""
    dt: float
    """Sampling period [s]."""

    def gain(self, frequency: float) -> float:
        """What a window leaves of the amplitude of a sine of ``frequency`` [Hz]."""
        phase = 2j * np.pi * frequency * self.dt * np.arange(len(self.weights))
        return float(abs((self.weights * np.exp(phase)).sum()))

    def of(self, names: Sequence[str]) -> "AxisSeries":
        """The recordings of these names only."""
        return replace(self, stretches=tuple(s for s in self.stretches if s.recording in names))

    def coarser(self, count: int) -> "AxisSeries":
        """Means over ``count`` windows each, without stretches that are shorter than two of them."""
        if count == 1:
            return self
        box = np.zeros((count - 1) * round(self.step / self.dt) + 1)
        box[:: round(self.step / self.dt)] = 1 / count
        long = [s for s in self.stretches if len(s.t) >= 2 * count]
        return replace(
            self,
            stretches=tuple(s.coarser(count) for s in long),
            step=self.step * count,
            weights=np.convolve(self.weights, box),
        )


def axis_series(subject: Subject, model: PhysicsModel, noise: Noise) -> list[AxisSeries]:
    """What ``model`` leaves of every recording along every axis that was measured.

    Args:
        subject: measurements; the beginning of each recording, where they are more than can be looked at.
        model: with the effects it has, its constants calibrated.
        noise: of the measurements.
    """
    share = min(1.0, UNSEEN.longest / sum(map(len, subject.logs)))
    stack = LogBatch.of([_beginning(log, share) for log in subject.logs])
    stride = max(2, round(UNSEEN.window * stack.logs[0].pace))
    base = len(model.effects)
    with torch.no_grad():
        linear = directions(with_axes(model), subject.model, subject.uncertainty, stack, settled=True)
        kept = [k for k, c in enumerate(linear.channels) if c < stack.states.shape[-1]]
        words = dictionary(model, stack, tuple(linear.channels[k] for k in kept))
        means = torch.stack([log.inputs.mean(0, keepdim=True) for log in stack.logs])
        still = replace(stack, inputs=means.expand_as(stack.inputs))
        driven = linear.rates - mean_rates(model, still).numpy()[..., list(linear.channels)]
    tests = TestFunctions.over(stack.logs, stride, [noise.smoothing_of(linear.channels[k]) for k in kept])
    order, places = dynamic_axes(model), {}
    for j, e in enumerate(linear.own):
        if e.owner >= base:
            places[order[e.owner - base]] = j
    own = [j for j, e in enumerate(linear.own) if e.owner < base]
    signals = np.stack(list(paths(model, stack).values()), axis=-1)
    windows = _Windows(stack, tests, linear, driven=driven, signals=signals, kept=kept, words=words, own=own)
    units = known.axes_of(type(model))
    found = [windows.along(axis, units[axis], j) for axis, j in places.items()]
    return [series for series in found if series is not None and series.stretches]


def _beginning(log: Log, share: float) -> Log:
    """The first ``share`` of a log."""
    count = max(2, int(len(log) * share))
    return log if share == 1 else replace(log.part(slice(count), log.name), sensed=None)


@dataclass(frozen=True, eq=False)
class _Windows:
    """Means over short windows of what a linearised model leaves."""

    stack: LogBatch
    tests: TestFunctions
    linear: Linearization
    driven: np.ndarray
    """(L, N − 1, channels)."""
    signals: np.ndarray
    """(L, N − 1, m)."""
    kept: Sequence[int]
    """Of its channels, those of measured states."""
    words: Dictionary
    own: Sequence[int]
    """Columns of the model's numbers."""

    def along(self, axis: str, unit: str, column: int) -> AxisSeries | None:
        """Along the axis of which ``column`` is a unit; None: it moves no state that was measured."""
        direction = self.linear.columns[column][..., self.kept]
        moved = [k for k in range(len(self.kept)) if np.abs(direction[..., k]).max() > 0]
        if not moved:
            return None
        stretches: list[Stretch] = []
        for i in range(len(self.stack.logs)):
            if len(self.tests.centres[i]) > 1:
                stretches += self._of_log(i, direction[i], moved)
        weights = self.tests.modelled[0][moved[0]]
        row = weights[0].toarray().ravel() if weights.shape[0] else np.ones(1)
        row = row[np.flatnonzero(row)[0] : np.flatnonzero(row)[-1] + 1]
        step = self.tests.stride * self.stack.dt
        return AxisSeries(
            axis=axis,
            unit=unit,
            stretches=tuple(stretches),
            step=step,
            weights=row / row.sum(),
            own=len(self.own),
            dt=self.stack.dt,
        )

    def _of_log(self, i: int, direction: np.ndarray, moved: Sequence[int]) -> list[Stretch]:
        log, dt = self.stack.logs[i], self.stack.dt

        def rows(k: int, rates: np.ndarray) -> np.ndarray:
            return self.tests.integral(i, k, rates, dt)

        states = [self.linear.channels[self.kept[k]] for k in moved]
        measured = self.tests.increment(i, log.states.numpy()[:, states])
        units = np.stack([rows(k, direction[:, k]) for k in moved], axis=-1)
        left = np.stack(
            [measured[:, m] - rows(k, self.linear.rates[i, :, self.kept[k]]) for m, k in enumerate(moved)], axis=-1
        )
        own = np.stack([rows(k, self.linear.columns.on(self.kept[k], i, self.own)) for k in moved], axis=-1)
        power = (units**2).sum(-1)
        good = power > 0
        scale = np.where(good, power, 1.0)
        driven = np.stack([rows(k, self.driven[i, :, self.kept[k]]) for k in moved], axis=-1)
        functions, signals = (
            rows(moved[0], x) / (self.tests.stride * dt) for x in (self.words.values[:, i].T, self.signals[i])
        )
        beside = np.concatenate([np.einsum("jpc,jc->jp", own, units) / scale[:, None], functions], axis=1)
        amount, driving = ((x * units).sum(-1) / scale for x in (left, driven))
        centre = self.tests.centres[i]
        name = log.name
        return [
            Stretch(name, centre[part] * dt, amount[part], beside[part], driving[part], signals[part])
            for part in np.split(np.arange(len(centre)), np.flatnonzero(np.diff(centre) != self.tests.stride) + 1)
            if good[part].all()
        ]
