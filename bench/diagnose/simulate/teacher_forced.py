"""Each equation of motion by itself: what it predicts while everything else is as measured (teacher forcing).

A free run in which torques are badly known loses the attitude within a fifth of a second, and then judges nothing else.
Here the change of one group of states over a horizon is compared with the integral of its own equation along the
*measured* states: forces with measured attitude and rates, torques with measured rates and velocity,

    e_k = x_{k+h} − x_k − Σ_{j<h} dt (κ ∗ f)(x_{k+j}, u_{k+j}),

where κ is the smoothing that the measured states went through.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from scipy.ndimage import convolve1d

from bench.diagnose.logs.noise import Noise
from bench.diagnose.logs.subject import Log, LogBatch
from bench.diagnose.regression.weak import mean_rates
from bench.diagnose.settings import RUNNING
from bench.diagnose.simulate.floor import measure
from bench.diagnose.simulate.free_run import Group, default_steps, groups
from registry.dynamics import PhysicsModel


@dataclass(frozen=True)
class Equation:
    """One group of states and the name of the equation that moves it."""

    name: str
    """Such as "forces"."""
    group: Group
    sensed: bool = False
    """Whether a sensor shows the rate itself: then its mean over a horizon is judged."""


def equations(model: PhysicsModel, measured: Sequence[int]) -> tuple[Equation, ...]:
    """The dynamic equations of what was measured; kinematic ones hold no physics that could be missing.

    Args:
        model: tells the equations.
        measured: places among its `measured_channels`.
    """
    names, channels = model.equation_names(), model.measured_channels
    sensed = {c.group for c in model.sensed_channels}
    found = groups(channels, [i in measured for i in range(len(channels))])
    return tuple(Equation(names[g.name], g, g.name in sensed) for g in found if g.name in names)


def horizons(logs: Sequence[Log]) -> tuple[int, int]:
    """A short and a long horizon in samples; the long one is that of the free runs."""
    longest = default_steps(logs)
    return max(2, round(RUNNING.short * longest)), longest


@dataclass(frozen=True, eq=False)
class Increments:
    """What an equation leaves of every measured change from sample to sample, recording by recording."""

    steps: np.ndarray
    """(L, N − 1, s or s + f) for every state channel, and the integral of every sensed one."""
    valid: np.ndarray
    """(L, N − 1) whether both samples are, and are no padding."""

    @cached_property
    def totals(self) -> np.ndarray:
        """(L, N, s or s + f): their sums from the first sample to every one."""
        return np.concatenate([np.zeros_like(self.steps[:, :1]), np.cumsum(self.steps, axis=1)], axis=1)

    def over(self, horizon: int, every: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Errors over ``horizon`` intervals, a window every ``every``.

        Returns:
            Errors (W, s), the recording (W,) and the first interval (W,) of each window.
        """
        total = self.totals
        bad = np.concatenate([np.zeros((len(self.valid), 1), int), np.cumsum(~self.valid, axis=1)], axis=1)
        start = np.arange(0, max(total.shape[1] - horizon, 0), every)
        recording, at = np.nonzero(bad[:, start + horizon] == bad[:, start])
        first = start[at]
        return total[recording, first + horizon] - total[recording, first], recording, first


def increments(model: PhysicsModel, stack: LogBatch, noise: Noise) -> Increments:
    """What ``model`` leaves of the measured changes of every state; see the head of this file.

    A sensor of rates has an offset of its own in every recording, which is taken off.
    """
    size = len(model.state_channels)
    with torch.no_grad():
        rates = mean_rates(model, stack, so_far=True).numpy() * stack.dt
    smoothed = rates.copy()
    for c in range(size):
        smoothed[..., c] = convolve1d(rates[..., c], noise.smoothing_of(c).kernel(), axis=1, mode="nearest")
    valid = np.zeros(rates.shape[:2], dtype=bool)
    margin, good = noise.half_width, stack.good.numpy()
    for i, log in enumerate(stack.logs):
        inner = slice(margin, len(log) - 1 - margin)
        valid[i, inner] = good[i, inner]
    steps = np.diff(stack.paths, axis=1) - smoothed
    for left, good in zip(steps, valid, strict=True):
        if good.any():
            left[:, size:] -= left[good, size:].mean(0)
    return Increments(steps, valid)


def noise_increments(model: PhysicsModel, stack: LogBatch, noise: Noise) -> Increments:
    """What noise alone adds to the increments: those of measurements with noise drawn once more, less those without."""
    clean, moved = (increments(model, s, noise) for s in (stack, with_noise(model, stack, noise)))
    return Increments(moved.steps - clean.steps, clean.valid)


def with_noise(model: PhysicsModel, stack: LogBatch, noise: Noise) -> LogBatch:
    """Measurements with noise drawn once more, the same every time."""
    generator, r = np.random.default_rng(0), noise.half_width
    padded = torch.cat([stack.states[:, :1].expand(-1, r, -1), stack.states, stack.states[:, -1:].expand(-1, r, -1)], 1)
    channels = model.state_channels
    silent = replace(noise, raw=tuple(0.0 for _ in noise.raw))
    drawn = measure(padded, noise, channels, stack.dt, generator) - measure(
        padded, silent, channels, stack.dt, generator
    )
    white = generator.normal(size=stack.inputs.shape) * np.array(noise.inputs)
    through = convolve1d(white, noise.input_weights, axis=1)
    states, inputs = stack.states + drawn, stack.inputs + torch.from_numpy(through)
    logs = [
        replace(log, states=x[: len(log)], inputs=u[: len(log)])
        for log, x, u in zip(stack.logs, states, inputs, strict=True)
    ]
    if stack.sensed:
        sigma = np.array(noise.sensed)
        shown = generator.normal(size=(*stack.states.shape[:2], len(sigma))) * sigma
        more = np.cumsum((shown[:, 1:] + shown[:, :-1]) / 2 * stack.dt, axis=1)
        summed = torch.from_numpy(np.concatenate([np.zeros_like(more[:, :1]), more], axis=1))
        logs = [
            replace(log, sensed=log.sensed + s[: len(log)])
            for log, s in zip(logs, summed, strict=True)
            if log.sensed is not None
        ]
    return replace(stack, logs=tuple(logs), states=states, inputs=inputs)
