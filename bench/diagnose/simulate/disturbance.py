"""What the past of a disturbance tells of its future: the disturbance line.

Gusts, loads and inputs that nobody logged follow no measured signal, and most of them change slowly: a disturbance
observer on board would know them. Here the residual d of every dynamic equation, with everything else as measured
(`teacher_forced`), is forecast from its own past through a bank of first-order low-pass filters,

    z_i(t) = ∫ e^{−r/T_i} d(t − r) dr / ∫ e^{−r/T_i} dr   (over the recorded past),
    d̂(t + s) = γ Σ_i β_i(s) z_i(t),

and a free run goes on with it. That is a disturbance observer (Chen, Yang, Guo and Li 2016, IEEE Trans. Ind. Electron.
63(2)) with given poles. Its gains β are learned from training recordings, equation by equation. Where equations answer
each other, as drag that slows what a torque has turned, a free run wants less of a disturbance than its own equation
says: γ, one an equation, from 0 to 1, is that with which free runs of training recordings err least. None of the gains
is negative: a disturbance fades, and what turns round is motion that the model should have.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from bench.diagnose.logs.filters import lagged
from bench.diagnose.logs.noise import Noise
from bench.diagnose.logs.subject import Log, LogBatch
from bench.diagnose.regression.least_squares import bounded, equilibrium
from bench.diagnose.settings import OBSERVING
from bench.diagnose.simulate.free_run import free_run, measured_windows, starts
from bench.diagnose.simulate.teacher_forced import Increments, equations, increments
from registry.dynamics import PhysicsModel


@dataclass(frozen=True, eq=False)
class Observer:
    """A model's disturbance, as its past predicts it."""

    model: PhysicsModel
    noise: Noise
    steps: int
    """Samples of a horizon."""
    equations: tuple[tuple[int, ...], ...]
    """Of each equation, places in the state whose rate it moves."""
    gains: np.ndarray
    """β (channels, filters, parts of a horizon)."""
    trust: np.ndarray
    """γ (equations,)."""

    @classmethod
    def learned(cls, model: PhysicsModel, logs: Sequence[Log], noise: Noise, steps: int) -> "Observer | None":
        """Gains from recordings; None: they are too short or too few, or no equation can be judged by itself.

        Args:
            model: of which the residuals are; all its states were measured.
            logs: to learn from.
            noise: of the measurements.
            steps: samples of a horizon.
        """
        stack, own = LogBatch.of(logs), len(model.state_channels)
        places = tuple(e.group.at for e in equations(model, stack.measured) if max(e.group.at) < own)
        left = increments(model, stack, noise)
        _, recording, first = left.over(steps, max(1, steps // 4))
        if not places or len(np.unique(recording)) < 2 or not np.isfinite(left.steps[left.valid]).all():
            return None
        parts, channels = _parts(steps), [c for e in places for c in e]
        made = cls(model, noise, steps, places, np.zeros((len(channels), OBSERVING.filters, len(parts))), np.ones(0))
        past = made._past(left)[recording, first]  # (W, channels, filters)
        for p, (begin, end) in enumerate(parts):
            ahead = (left.totals[recording, first + end] - left.totals[recording, first + begin]) / (end - begin)
            for c, channel in enumerate(channels):
                made.gains[c, :, p] = _regressed(past[:, c], ahead[:, channel], recording)
        return made._trusted(logs, left)

    def drift(self, logs: Sequence[Log], at: Sequence[np.ndarray]) -> Tensor:
        """What is added to the states (W, steps, s) from sample to sample, in windows from the samples ``at``."""
        return torch.tensordot(
            torch.from_numpy(self.trust), self._single(increments(self.model, LogBatch.of(logs), self.noise), at), 1
        )

    def _trusted(self, logs: Sequence[Log], left: Increments) -> "Observer | None":
        """With γ: a step of Gauss and Newton, halved until free runs of these recordings err no more."""
        every = max(1, sum(map(len, logs)) // OBSERVING.windows)
        at = [starts(log, self.steps, every) for log in logs]
        if sum(map(bool, map(len, at))) < 2:
            return None
        single, measured = self._single(left, at), measured_windows(logs, at, self.steps)
        base = free_run(self.model, logs, at, self.steps)
        moved = free_run(self.model, logs, at, self.steps, OBSERVING.nudge * single)
        good = torch.isfinite(torch.cat([base[None], moved])).all(-1).all(-1).all(0)
        size = (base - measured)[good].square().mean(0).sqrt()  # by what errors are divided, sample by sample
        ends = np.linspace(0, self.steps, OBSERVING.points + 1).round()[1:]
        seen = (size > 0) & torch.isin(torch.arange(self.steps + 1), torch.from_numpy(ends))[:, None]
        if not good.any() or not seen.any():
            return None

        def scaled(x: Tensor) -> np.ndarray:
            return np.asarray((x[..., good, :, :] / size)[..., seen].flatten(-2).numpy())

        error = scaled(measured - base)
        recording = np.repeat(np.arange(len(at)), [len(k) for k in at])[good.numpy()].repeat(int(seen.sum()))
        step = _regressed(scaled((moved - base) / OBSERVING.nudge).T, error, recording, most=1.0)
        losses = {0.0: float(error @ error)}
        for share in 0.5 ** np.arange(OBSERVING.halvings):
            drift = torch.tensordot(torch.from_numpy(share * step), single, 1)
            rest = scaled(measured - free_run(self.model, logs, at, self.steps, drift))
            with np.errstate(over="ignore"):  # a run that is lost
                losses[share] = float(np.nan_to_num(rest @ rest, nan=np.inf))
        return replace(self, trust=min(losses, key=lambda share: losses[share]) * step)

    def _single(self, left: Increments, at: Sequence[np.ndarray]) -> Tensor:
        """`drift` (equations, W, steps, s) of each equation for a γ of one, from the residuals of the same logs."""
        past = self._past(left)
        z = np.concatenate([past[i, k] for i, k in enumerate(at)])  # (W, channels, filters)
        forecast = np.einsum("wcf,cfp->wcp", z, self.gains)
        out = np.zeros((len(self.equations), len(z), self.steps, len(self.model.state_channels)))
        channel = 0
        for e, places in enumerate(self.equations):
            for c in places:
                for p, (first, last) in enumerate(_parts(self.steps)):
                    out[e, :, first:last, c] = forecast[:, channel, p, None]
                channel += 1
        return torch.from_numpy(out)

    def _past(self, left: Increments) -> np.ndarray:
        """z (L, N, channels, filters) at every sample; see `pasts`."""
        channels = [c for e in self.equations for c in e]
        return pasts(left, channels, self.steps, self.noise.half_width)


def pasts(left: Increments, channels: Sequence[int], steps: int, late: int) -> np.ndarray:
    """z (L, N, channels, filters) at every sample; residuals that are not valid have no weight.

    Args:
        left: what a model leaves.
        channels: of the states.
        steps: samples of the horizon whose disturbance is to be told.
        late: samples that the filters wait for: as long as the smoothing of a later measurement looks back.
    """
    spans = OBSERVING.fastest * steps * OBSERVING.ratio ** np.arange(OBSERVING.filters)
    valid = left.valid[..., None].astype(float)
    known = np.concatenate([np.where(valid > 0, left.steps[..., list(channels)], 0.0), valid], axis=-1)
    known = np.concatenate([np.zeros_like(known[:, : late + 1]), known], axis=1)[:, : valid.shape[1] + 1]
    in_time = known.swapaxes(0, 1)
    sums = [lagged(in_time, a) for a in np.exp(-1.0 / np.maximum(1.0, spans))]
    total = np.stack(sums, axis=-1).swapaxes(0, 1)
    weight = total[..., -1:, :]
    return np.divide(total[..., :-1, :], weight, out=np.zeros_like(total[..., :-1, :]), where=weight > 0)


def _parts(steps: int) -> list[tuple[int, int]]:
    """First and last sample of the stretches of a horizon."""
    ends = np.unique(np.round(np.linspace(0, steps, OBSERVING.parts + 1)).astype(int))
    return list(zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True))


def _regressed(x: np.ndarray, y: np.ndarray, fold: np.ndarray, most: float = np.inf) -> np.ndarray:
    """Coefficients (P,), from 0 to ``most``, of ``y`` (R,) on ``x`` (R, P); none where folds left out confirm none."""
    rows = np.column_stack([x, y])
    grams = [rows[fold == f].T @ rows[fold == f] for f in np.unique(fold)]
    whole = np.asarray(sum(grams))

    def fitted(gram: np.ndarray) -> np.ndarray:
        size = equilibrium(np.diag(gram)[:-1])
        inner = gram[:-1, :-1] * np.outer(size, size) + 1e-9 * np.eye(len(size))
        return bounded(inner, gram[:-1, -1] * size, np.zeros(len(size)), most / size) * size

    vectors = (np.append(-fitted(whole - gram), 1.0) for gram in grams)
    loss = sum(float(v @ gram @ v) for v, gram in zip(vectors, grams, strict=True))
    return fitted(whole) if loss < whole[-1, -1] else np.zeros(x.shape[1])
