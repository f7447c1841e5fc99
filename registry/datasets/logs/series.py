"""Signals of a log, each with its own clock."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Series:
    """A signal with its own clock."""

    t: np.ndarray
    """(N,) [s], strictly increasing."""
    values: np.ndarray
    """(N, c), SI."""
    source: str
    """Topic that it came from."""

    @property
    def rate(self) -> float:
        """Median sample rate [Hz]."""
        return float(1 / np.median(np.diff(self.t)))


Log = dict[str, Series]


def series(t: np.ndarray, values: np.ndarray, source: str) -> Series | None:
    """A series of the finite samples in order of time; None: fewer than three of them."""
    keep = np.isfinite(values).all(axis=1) & np.isfinite(t)
    t, values = t[keep], values[keep]
    t, first = np.unique(t, return_index=True)
    return Series(t, values[first], source) if len(t) >= 3 else None
