"""Recordings out of named signals."""

from collections.abc import Mapping

import numpy as np

from registry.contracts import Channel, Recording
from registry.units import SIGNALS


def channels(signal: str, count: int) -> tuple[Channel, ...]:
    """The channels of a signal with ``count`` columns: its axes, or 1, 2, … where it has none."""
    known = SIGNALS[signal]
    axes = known.axes or tuple(str(i + 1) for i in range(count))
    return tuple(Channel(f"{signal}.{axis}", known.unit) for axis in axes)


def recording(
    name: str, rate: float, inputs: Mapping[str, np.ndarray], outputs: Mapping[str, np.ndarray], valid: np.ndarray
) -> Recording:
    """A recording from its signals (N, c), SI, by name.

    Args:
        name: of the recording.
        rate: [Hz].
        inputs: what drives the system.
        outputs: everything else.
        valid: (N,).
    """

    def side(signals: Mapping[str, np.ndarray]) -> tuple[np.ndarray, tuple[Channel, ...]]:
        named = tuple(c for signal, x in signals.items() for c in channels(signal, x.shape[1]))
        return np.concatenate([np.empty((len(valid), 0)), *signals.values()], axis=1), named

    (u, u_channels), (y, y_channels) = side(inputs), side(outputs)
    return Recording(name, rate, u, y, u_channels, y_channels, valid)
