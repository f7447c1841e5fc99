"""Parametrised signals: a staircase of levels and a multisine with Schroeder's phases, within limits and rates.

Schroeder, "Synthesis of low-peak-factor signals and binary sequences with low autocorrelation" (1970).
"""

from collections.abc import Sequence

import numpy as np

from bench.diagnose.manoeuvre.limits import Limit
from bench.diagnose.settings import COMPOSING

PARAMETERS = COMPOSING.levels + 4
"""Of a channel, each from 0 to 1: levels, share of the multisine, both ends of its band, tempo."""


def signals(z: np.ndarray, limits: Sequence[Limit], samples: int, dt: float, band: tuple[float, float]) -> np.ndarray:
    """Signals (W, N, c) of parameters (W, c · PARAMETERS) in 0..1; they leave from `Limit.start`.

    Args:
        z: parameters of W signals.
        limits: of the c channels.
        samples: N.
        dt: [s].
        band: lowest and highest frequency of a multisine [Hz].
    """
    grid = _Grid(samples, dt, band, len(limits))
    out = [
        _channel(part, limit, i, len(limits), grid)
        for i, (limit, part) in enumerate(zip(limits, np.split(z, len(limits), axis=1), strict=True))
    ]
    return np.stack(out, axis=-1)


class _Grid:
    """Times, and frequencies that fit them: one for each of ``channels`` at least."""

    def __init__(self, samples: int, dt: float, band: tuple[float, float], channels: int) -> None:
        self.samples, self.dt, self.t = samples, dt, np.arange(samples) * dt
        length = samples * dt
        self.low, self.high = max(band[0], 1 / length), max(band[1], 2 / length)
        self.harmonics = np.arange(1, max(2, channels, int(self.high * length)) + 1)
        self.frequencies = self.harmonics / length


def _channel(z: np.ndarray, limit: Limit, place: int, of: int, grid: _Grid) -> np.ndarray:
    """(W, N) of one channel; the harmonics of several channels take turns, so that they can be told apart."""
    count, tempi = COMPOSING.levels, np.array(COMPOSING.tempi)
    levels, (share, one, other, tempo) = z[:, :count], z[:, count:].T
    often = tempi[np.minimum((tempo * len(tempi)).astype(int), len(tempi) - 1)]
    step = (np.arange(grid.samples)[None] * often[:, None] * count // grid.samples) % count
    stairs = limit.low + limit.span * np.take_along_axis(levels, step, axis=1)
    ratio = grid.high / grid.low
    first, last = grid.low * ratio ** np.minimum(one, other), grid.low * ratio ** np.maximum(one, other)
    waves = multisine(grid, first, last, place, of)
    wanted = np.clip(stairs + share[:, None] * limit.span / 2 * waves, limit.low, limit.high)
    return slewed(wanted, limit, grid.dt)


def multisine(grid: _Grid, first: np.ndarray, last: np.ndarray, place: int, of: int) -> np.ndarray:
    """(W, N) sums of cosines between ``first`` and ``last`` (W,) [Hz], of peak 1."""
    mine = grid.harmonics % of == place % of
    frequency = grid.frequencies[mine]
    inside = (frequency >= first[:, None] - 1e-12) & (frequency <= last[:, None] + 1e-12)
    nearest = np.abs(frequency - first[:, None]).argmin(1)
    inside[np.arange(len(first)), nearest] = True
    number = np.cumsum(inside, axis=1)
    phase = -np.pi * number * (number - 1) / inside.sum(1, keepdims=True)
    angle = 2 * np.pi * frequency[:, None] * grid.t
    # cos(a + φ) as two products: (W, h) · (h, N)
    wave = (inside * np.cos(phase)) @ np.cos(angle) - (inside * np.sin(phase)) @ np.sin(angle)
    return np.asarray(wave / np.abs(wave).max(1, keepdims=True))


def slewed(wanted: np.ndarray, limit: Limit, dt: float) -> np.ndarray:
    """(W, N) that follow ``wanted`` (W, N) from `Limit.start` no faster than `Limit.rate`."""
    most, now = limit.rate * dt, np.full(len(wanted), limit.start)
    if not np.isfinite(most):
        return wanted
    out = np.empty_like(wanted)
    for k in range(wanted.shape[1]):
        out[:, k] = now
        now = now + np.clip(wanted[:, k] - now, -most, most)
    return out
