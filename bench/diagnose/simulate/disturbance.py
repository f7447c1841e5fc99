"""What the past of a disturbance tells of its future: the disturbance line.

Gusts, loads and inputs that nobody logged follow no measured signal, and most of them change slowly: a disturbance
observer on board would know them. Here the residual d of every dynamic equation, with everything else as measured
(`teacher_forced`), is predicted over a horizon from its own past through a bank of first-order low-pass filters,

    d̂(t + s) = Σ_i β_i(s) z_i(t),    z_i(t) = ∫ e^{−r/T_i} d(t − r) dr / ∫ e^{−r/T_i} dr   (over the recorded past),

and a free run goes on with it. That is the one-output case of a disturbance observer (Chen, Yang, Guo and Li 2016,
IEEE Trans. Ind. Electron. 63(2)) with poles that are given and gains that are learned. What is left then is what
neither the model nor the measured past of these recordings predicts.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.signal import lfilter
from torch import Tensor

from bench.diagnose.logs.noise import Noise
from bench.diagnose.logs.subject import Log
from bench.diagnose.regression.weak import Stack
from bench.diagnose.settings import OBSERVING
from bench.diagnose.simulate.floor import reach
from bench.diagnose.simulate.teacher_forced import Increments, equations, increments
from registry.dynamics import PhysicsModel


@dataclass(frozen=True, eq=False)
class Observer:
    """A model's disturbance, as its past predicts it."""

    model: PhysicsModel
    noise: Noise
    steps: int
    """Samples of a horizon."""
    channels: tuple[int, ...]
    """Places in the state whose rate it moves."""
    gains: np.ndarray
    """(channels, filters, parts): β."""

    @classmethod
    def learned(cls, model: PhysicsModel, logs: Sequence[Log], noise: Noise, steps: int) -> "Observer | None":
        """Gains by least squares from recordings; None: they are too short, or no equation can be judged by itself.

        Args:
            model: of which the residuals are; all its states were measured.
            logs: to learn from.
            noise: of the measurements.
            steps: samples of a horizon.
        """
        stack, sensed = Stack.of(logs), len(model.state_channels)
        places = [c for e in equations(model, stack.measured) for c in e.group.at if c < sensed]
        left = increments(model, stack, noise)
        if not places or not np.isfinite(left.steps[left.valid]).all():
            return None
        past = _filtered(left, steps, places, reach(noise.smoothing))
        parts = _parts(steps)
        ahead = [_mean_ahead(left, first, last, steps, places) for first, last in parts]
        _, recording, first = left.over(steps, max(1, steps // 4))
        if len(first) < OBSERVING.windows * OBSERVING.filters:
            return None
        x = past[recording, first]  # (W, channels, filters)
        y = np.stack([a[recording, first] for a in ahead], axis=-1)  # (W, channels, parts)
        gains = np.stack([np.linalg.lstsq(x[:, c], y[:, c], rcond=None)[0] for c in range(len(places))])
        return cls(model, noise, steps, tuple(places), gains)

    def drift(self, logs: Sequence[Log], at: Sequence[np.ndarray]) -> Tensor:
        """What is added to the states (W, steps, s) from sample to sample, in windows from the samples ``at``."""
        left = increments(self.model, Stack.of(logs), self.noise)
        past = _filtered(left, self.steps, self.channels, reach(self.noise.smoothing))
        x = np.concatenate([past[i, k] for i, k in enumerate(at)])  # (W, channels, filters)
        y = np.einsum("wcf,cfp->wcp", x, self.gains)
        out = np.zeros((len(x), self.steps, len(self.model.state_channels)))
        for p, (first, last) in enumerate(_parts(self.steps)):
            out[:, first:last, list(self.channels)] = y[:, None, :, p]
        return torch.from_numpy(out)


def _parts(steps: int) -> list[tuple[int, int]]:
    """First and last sample of the stretches of a horizon."""
    ends = np.unique(np.round(np.linspace(0, steps, OBSERVING.parts + 1)).astype(int))
    return list(zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True))


def _filtered(left: Increments, steps: int, places: Sequence[int], late: int) -> np.ndarray:
    """The residual's past (L, N, channels, filters) at every sample: means of which the weight decays into the past.

    Args:
        left: residuals of the changes from sample to sample; what is not valid has no weight.
        steps: samples of the horizon.
        places: channels.
        late: samples by which the filters wait, since the smoothing of a later measurement looks back at them.
    """
    valid = left.valid[..., None].astype(float)
    known = np.concatenate([np.where(valid > 0, left.steps[..., list(places)], 0.0), valid], axis=-1)
    known = np.concatenate([np.zeros_like(known[:, : late + 1]), known], axis=1)[:, : valid.shape[1] + 1]
    spans = OBSERVING.fastest * steps * OBSERVING.ratio ** np.arange(OBSERVING.filters)
    poles = np.exp(-1.0 / np.maximum(1.0, spans))
    sums = np.stack([lfilter([1 - a], [1, -a], known, axis=1) for a in poles], axis=-1)
    total, weight = sums[..., :-1, :], sums[..., -1:, :]
    return np.divide(total, weight, out=np.zeros_like(total), where=weight > 0)


def _mean_ahead(left: Increments, first: int, last: int, steps: int, places: Sequence[int]) -> np.ndarray:
    """Mean residual (L, N − steps, channels) from ``first`` to ``last`` samples after every sample."""
    total = np.cumsum(left.steps[..., list(places)], axis=1)
    total = np.concatenate([np.zeros_like(total[:, :1]), total], axis=1)
    count = total.shape[1] - steps
    return np.asarray((total[:, last : last + count] - total[:, first : first + count]) / (last - first))
