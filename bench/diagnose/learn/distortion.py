"""Whether a line is made of what was measured: a harmonic of a manoeuvre, or a sum or difference of two.

A friction or a stiffness that a model lacks turns a sine into its multiples, which follow a measured signal although
that has no line there. Functions of signals without their own swing at the frequency show them.
"""

from collections.abc import Sequence

import numpy as np

from bench.diagnose.learn.thomson import evidence_at
from bench.diagnose.settings import UNSEEN


def distortion(measured: Sequence[np.ndarray], step: float, frequency: float) -> bool:
    """Whether functions of measured signals show a line of a frequency that the signals have not themselves.

    A signal counts where it moves mostly otherwise: one that only answers the line tells of no other cause.

    Args:
        measured: (J, m) of every stretch, every ``step``.
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
    evidence = evidence_at([_functions(s[:, otherwise]) for s in notched], step, frequency)
    return bool(evidence.max() > np.log(len(evidence) / UNSEEN.confirmed))


def _functions(x: np.ndarray) -> np.ndarray:
    """Even and odd functions (J, n) of signals (J, m), and products of two of them."""
    first, second = np.triu_indices(x.shape[1])
    size, sign = np.abs(x), np.sign(x)
    odd = np.einsum("ji,jk->jik", size, x).reshape(len(x), -1)
    return np.concatenate([sign, size, x[:, first] * x[:, second], odd], axis=1)
