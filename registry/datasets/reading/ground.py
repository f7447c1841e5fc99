"""Where a vehicle stands on the ground with its rotors off or idle."""

from collections.abc import Mapping

import numpy as np

from registry.datasets.reading.cleaning import runs

Array = np.ndarray

IDLE = 0.6
"""Share of the usual input of flight below which no vehicle hovers: 36 % of the thrust where it goes with ω²."""
STILL = {"velocity": 0.08, "body_rates": 0.15}
"""Above which a vehicle moves (m/s, rad/s): more than an estimator wanders, less than free fall reaches in 10 ms."""
SHORTEST = 0.3
"""Of a standstill [s]; free fall moves long before."""
MARGIN = 0.5
"""Beside it, where the vehicle lifts off or bounces [s]."""


def resting(x: Mapping[str, Array], driving: Array, rate: float) -> Array:
    """Samples (N,) at which neither the vehicle nor its rotors do what they do in flight.

    Args:
        x: (N, c) signals by name, SI.
        driving: (N, m) rotor speeds or commands.
        rate: [Hz].
    """
    level = np.sqrt(np.mean(driving**2, axis=1))
    still = level < IDLE * np.quantile(level, 0.8)
    known = [n for n in STILL if n in x]
    if not known or not still.any():
        return np.zeros(len(level), dtype=bool)
    for name in known:
        still &= np.linalg.norm(x[name], axis=1) < STILL[name]
    out = np.zeros(len(level), dtype=bool)
    gap = round(SHORTEST * rate)
    for first, end in runs(still):
        if end - first >= gap:
            out[first:end] = True
    return out
