"""What a network is shown of a model's free runs: signals before and during each, and by what the run deviates."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from bench.diagnose.ceiling.deviation import deviation
from bench.diagnose.logs.subject import Log, LogBatch
from bench.diagnose.settings import CEILING
from bench.diagnose.simulate.free_run import Group, full_states, measured_windows, windows
from bench.diagnose.simulate.roll import roll
from registry.dynamics import PhysicsModel, rotation_matrix


@dataclass(frozen=True)
class Grid:
    """The samples of a free run that a network sees: all of them, unless there are many."""

    steps: int
    """Samples of a horizon."""

    @property
    def ahead(self) -> np.ndarray:
        """(T,) samples after the start, the last one at the end of the horizon."""
        count = min(self.steps, CEILING.points)
        return np.round(np.arange(1, count + 1) * self.steps / count).astype(int)

    @property
    def before(self) -> np.ndarray:
        """(τ,) samples of the history relative to the start, which is the last one."""
        count = len(self.ahead)
        past = min(count, CEILING.history)
        return np.round(np.arange(1 - past, 1) * self.steps / count).astype(int)

    @property
    def short(self) -> int:
        """Samples of the short runs whose deviations the history shows."""
        return max(1, round(CEILING.short * self.steps))


@dataclass(frozen=True, eq=False)
class Examples:
    """Free runs of one model as training examples of a network: its inputs and its targets."""

    signals: Tensor
    """(W, τ + T, c): measured ones up to the start, then those of the free run; NaN where a history is not known."""
    history: Tensor
    """(W, τ, n) deviations of short runs that end at each sample of the history; 0 where there is none."""
    deviations: Tensor
    """(W, T, n) of the free run; what is to be predicted."""
    run: Tensor
    """(W, steps + 1, s) its states."""

    def finite(self) -> "Examples":
        """Those whose free run did not diverge."""
        good = torch.isfinite(self.deviations).all(-1).all(-1)
        return Examples(self.signals[good], self.history[good], self.deviations[good], self.run[good])

    @classmethod
    def of(
        cls, model: PhysicsModel, logs: Sequence[Log], at: Sequence[np.ndarray], grid: Grid, groups: Sequence[Group]
    ) -> "Examples":
        """Of free runs from the samples ``at`` of each log."""
        stack, size = LogBatch.of(logs), len(model.state_channels)
        log = torch.from_numpy(np.repeat(np.arange(len(logs)), [len(k) for k in at]))
        start = torch.from_numpy(np.concatenate(at).astype(int))
        with torch.no_grad():
            full, inputs = full_states(model, stack), windows([x.inputs for x in logs], at, grid.steps)
            run = roll(model, full[log, start], inputs, stack.dt)
            past = start[:, None] + torch.from_numpy(grid.before)
            known, short = _short_runs(model, stack, full, grid.short, groups)
            seen = (past >= 0) & _valid(logs)[log[:, None], past.clamp(min=0)]
            told = (past >= grid.short) & known[log[:, None], past.clamp(min=0)]
            place = log[:, None], past.clamp(min=0)
            measured = _signals(model, full[place], stack.inputs[place])
            signals = torch.cat(
                [
                    torch.where(seen[..., None], measured, torch.nan),
                    _signals(model, run[:, grid.ahead], inputs[:, grid.ahead]),
                ],
                dim=1,
            )
            off = deviation(run[..., :size], measured_windows(logs, at, grid.steps), groups)[:, grid.ahead]
            return cls(signals, torch.where(told[..., None], short[place], 0.0), off, run[..., :size])


def _valid(logs: Sequence[Log]) -> Tensor:
    """(L, N) whether a sample is valid, and no padding."""
    return torch.nn.utils.rnn.pad_sequence([log.valid for log in logs], batch_first=True)


def _short_runs(
    model: PhysicsModel, stack: LogBatch, full: Tensor, steps: int, groups: Sequence[Group]
) -> tuple[Tensor, Tensor]:
    """Of runs of so many steps that end at every sample: whether there is one (L, N), and its deviation (L, N, n)."""
    count, size = full.shape[1] - steps, len(model.state_channels)
    state = full[:, :count]
    for k in range(steps):
        state = model.step(state, stack.inputs[:, k : k + count], stack.inputs[:, k + 1 : k + 1 + count], stack.dt)
    off = deviation(state[..., :size], stack.states[:, steps:], groups)
    good = _valid(stack.logs)
    bad = torch.nn.functional.pad((~good).cumsum(1), (1, 0))
    whole = bad[:, steps + 1 :] == bad[:, :count]
    known = whole & torch.isfinite(off).all(-1)
    return torch.nn.functional.pad(known, (steps, 0)), torch.nn.functional.pad(off, (0, 0, steps, 0))


def _signals(model: PhysicsModel, full: Tensor, inputs: Tensor) -> Tensor:
    """States, the rates that the model gives them, and inputs (…, c) at full states (…, full) and inputs (…, m).

    An attitude is a rotation matrix, without the two signs of a quaternion; its rate is that of the body.
    """
    channels = model.state_channels
    turning = [i for i, c in enumerate(channels) if c.group == "attitude"]
    others = [i for i, c in enumerate(channels) if c.group != "attitude"]
    rates = model.derivative(full[..., : len(channels) + model.internal_size], inputs)
    parts = [full[..., others], rates[..., others], inputs]
    if turning:
        parts.append(rotation_matrix(full[..., turning]).flatten(-2))
    return torch.cat(parts, dim=-1)
