"""Signals of a log, each with its own clock, and what else it says of the vehicle."""

from dataclasses import dataclass, field

import numpy as np

from registry.datasets.folder.constants import Constant


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


@dataclass
class Log:
    """What was read from one file."""

    signals: dict[str, Series] = field(default_factory=dict)
    """By the names of `registry.units.SIGNALS`; z up, x forward, y left."""
    constants: dict[str, Constant] = field(default_factory=dict)
    """Those that the vehicle's own parameters state."""
    torque_over_thrust: float = 0.0
    """Of a rotor [m]; 0: not stated."""
    hints: dict[str, str] = field(default_factory=dict)
    """What the log says of constants that it does not state."""
    landed: Series | None = None
    """(N, 1), 1 on the ground and 0 in the air, each until the next."""
    notes: list[str] = field(default_factory=list)
    """What a user should know of it, in sentences."""


_NO_ATTITUDE = 0.5
"""Length of a quaternion up to which it is none: zero before the estimator has started."""


def series(t: np.ndarray, values: np.ndarray, source: str, signal: str = "") -> Series | None:
    """A series of the finite samples in order of time; None: fewer than three of them."""
    keep = np.isfinite(values).all(axis=1) & np.isfinite(t)
    if signal == "attitude":
        keep &= np.linalg.norm(np.where(keep[:, None], values, 0), axis=1) > _NO_ATTITUDE
    t, values = t[keep], values[keep]
    t, first = np.unique(t, return_index=True)
    return Series(t, values[first], source) if len(t) >= 3 else None


def steps(t: np.ndarray, values: np.ndarray, source: str) -> Series:
    """A series of values that hold until the next; there may be one alone."""
    t, first = np.unique(t, return_index=True)
    return Series(t, values[first], source)


def round_rate(rate: float) -> float:
    """The number of fewest digits within 1 % of a sample rate [Hz]: clocks of vehicles are no better."""
    return next((r for digits in range(1, 6) if abs((r := float(f"{rate:.{digits}g}")) - rate) <= 0.01 * rate), rate)
