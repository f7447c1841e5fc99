"""Whether a line is made of what was measured: a harmonic of a manoeuvre, or a sum or difference of two.

A friction or a stiffness that a model lacks turns a sine into its multiples, which follow a measured signal although
that has no line there. Functions of signals without their own swing at the frequency show them, in step with the line
in every recording. A lively manoeuvre has many lines, and what swings by itself may meet one of them, but not in step.
"""

from collections.abc import Sequence

import numpy as np

from bench.diagnose.learn.thomson import lines_at
from bench.diagnose.settings import UNSEEN


def distortion(measured: Sequence[np.ndarray], line: np.ndarray, step: float, frequency: float) -> bool:
    """Whether a function of measured signals shows the line in step, and the signals themselves do not.

    A signal counts where it moves mostly otherwise: one that only answers the line tells of no other cause.

    Args:
        measured: (J, m) of every stretch, every ``step``.
        line: (stretches, k) its complex amplitudes in each, told in one or several ways.
        step: [s].
        frequency: of the line [Hz].
    """
    notched, own, rest = [], 0.0, 0.0
    for signals in measured:
        phase = 2 * np.pi * frequency * step * np.arange(len(signals))
        still = signals - signals.mean(0)
        swing = np.stack([np.cos(phase), np.sin(phase), np.ones_like(phase)], axis=-1)
        without = still - swing @ np.linalg.lstsq(swing, still, rcond=None)[0]
        notched.append(without)
        own, rest = own + ((still - without) ** 2).sum(0), rest + (without**2).sum(0)
    otherwise = np.flatnonzero((rest > own) & (rest > 1e-12))
    if not len(otherwise):
        return False
    evidence, seen = lines_at([_functions(s[:, otherwise]) for s in notched], step, frequency)
    shown = evidence > np.log(len(evidence) / UNSEEN.confirmed)
    long = np.sqrt([[len(s)] for s in measured])
    return bool((shown & in_step(long * seen, long * line)).any())


def in_step(seen: np.ndarray, line: np.ndarray) -> np.ndarray:
    """Whether each of some lines (n,) is in step with another: their phases differ alike in all recordings, up to π.

    Of a harmonic the size, and with it the sign, depends on how large a motion is, the phase does not.

    Args:
        seen: (r, n) their complex amplitudes in r recordings or stretches.
        line: (r, k) of the other one, told in k ways, of which one suffices.
    """
    both = seen[:, :, None] * line.conj()[:, None, :]
    size = np.maximum(np.abs(both), 1e-300)
    together: np.ndarray = np.abs((both**2 / size).sum(0)) >= UNSEEN.in_step * size.sum(0)
    return np.asarray(together.any(-1))


def _functions(x: np.ndarray) -> np.ndarray:
    """Even and odd functions (J, n) of signals (J, m), and products of two of them."""
    first, second = np.triu_indices(x.shape[1])
    size, sign = np.abs(x), np.sign(x)
    odd = np.einsum("ji,jk->jik", size, x).reshape(len(x), -1)
    return np.concatenate([sign, size, x[:, first] * x[:, second], odd], axis=1)
