"""Test functions of the weak form: smooth windows through which both sides of an equation are integrated."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from bench.diagnose.logs.smoothing import Smoothing
from bench.diagnose.logs.subject import Log, LogBatch
from bench.diagnose.settings import SEARCHING


@dataclass(frozen=True, eq=False)
class TestFunctions:
    """Hann windows over the sampling intervals of each log, none of which touches an invalid sample."""

    measured: tuple[sparse.csr_matrix, ...]
    """A log: (J, N − 1), for measured increments."""
    modelled: tuple[tuple[sparse.csr_matrix, ...], ...]
    """A log, a channel: (J, N − 1) with the channel's smoothing, for the model's."""
    centres: tuple[np.ndarray, ...]
    """A log: (J,) middle of each window [samples]."""
    stride: int
    """Samples from one window to the next; a window spans two hops."""

    @classmethod
    def over(cls, logs: Sequence[Log], stride: int, smoothing: Sequence[Smoothing]) -> "TestFunctions":
        """Windows every ``stride`` samples over ``logs``; ``smoothing`` of each channel that is looked at."""
        hann = np.hanning(2 * stride + 1)
        bump = hann[:-1] + hann[1:]
        bump = bump / bump.sum() * stride  # windows half a span apart add up to one
        kernels = [s.kernel() for s in smoothing]
        half_width = max(len(k) // 2 for k in kernels)
        measured, modelled, centres = [], [], []
        for log in logs:
            intervals = len(log) - 1
            starts = np.arange(half_width, intervals - 2 * stride - half_width + 1, stride)
            good = (log.valid[:-1] & log.valid[1:]).numpy()
            bad = np.concatenate([[0], np.cumsum(~good)])
            starts = (
                starts[bad[starts + 2 * stride + half_width] == bad[starts - half_width]] if len(starts) else starts
            )
            measured.append(_rows(bump, starts, intervals))
            by = {k.tobytes(): _rows(np.convolve(bump, k), starts - len(k) // 2, intervals) for k in kernels}
            modelled.append(tuple(by[k.tobytes()] for k in kernels))
            centres.append(starts + stride)
        return cls(tuple(measured), tuple(modelled), tuple(centres), stride)

    def increment(self, log: int, states: np.ndarray) -> np.ndarray:
        """Weighted increments (J, channels) of measured states (N, channels) of the log of that number."""
        out: np.ndarray = self.measured[log] @ np.diff(states, axis=0)
        return out

    def integral(self, log: int, channel: int, rates: np.ndarray, dt: float) -> np.ndarray:
        """Weighted integrals (J, …) of rates (≥ N − 1, …) of one channel over the log of that number."""
        rows = self.modelled[log][channel]
        out: np.ndarray = rows @ rates[: rows.shape[1]] * dt
        return out


def _rows(weights: np.ndarray, starts: np.ndarray, width: int) -> sparse.csr_matrix:
    columns = starts[:, None] + np.arange(len(weights))
    rows = np.repeat(np.arange(len(starts)), len(weights))
    return sparse.csr_matrix((np.tile(weights, len(starts)), (rows, columns.ravel())), shape=(len(starts), width))


def stride_of(stack: LogBatch) -> int:
    """Samples between test functions: short against the motion, long against the sampling."""
    x = np.zeros(tuple(stack.states.shape))
    for i, log in enumerate(stack.logs):
        x[i, : len(log)] = (log.states - log.states.mean(0)).numpy()
    power = (np.abs(np.fft.rfft(x, axis=1)) ** 2).sum(0)
    share = np.cumsum(power, axis=0) / np.maximum(power.sum(0), 1e-300)
    moving = np.flatnonzero(power.sum(0) > 0)
    fastest = max((int(np.searchsorted(share[:, c], 0.95)) for c in moving), default=1) / x.shape[1]  # cycles a sample
    return int(np.clip(round(0.15 / max(fastest, 1e-6)), 2, max(2, round(SEARCHING.stride / stack.dt))))
