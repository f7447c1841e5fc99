"""Recordings out of named signals."""

from collections.abc import Mapping

import numpy as np

from registry.contracts import Channel, Recording
from registry.errors import BenchError, near
from registry.units import SIGNALS, Signal, channel_names


def channels(signal: str, count: int, known: Signal | None = None) -> tuple[Channel, ...]:
    """The channels of a signal with ``count`` columns: its axes, or 1, 2, … where it has none.

    Args:
        signal: its name.
        count: of columns.
        known: its unit and axes; None: as in `SIGNALS`.

    Raises:
        BenchError: nobody says what the signal is, or it has another number of axes.
    """
    if known is None and signal not in SIGNALS:
        raise BenchError(f"The signal {signal!r} comes without its unit: give a Signal, or {near(signal, SIGNALS)}")
    known = known or SIGNALS[signal]
    axes = known.axes or tuple(str(i + 1) for i in range(count))
    if len(axes) != count:
        raise BenchError(f"The signal {signal!r} has {count} columns and {len(axes)} axes: {', '.join(axes)}.")
    return tuple(Channel(name, known.unit) for name in channel_names(signal, axes))


def recording(
    name: str,
    rate: float,
    inputs: Mapping[str, np.ndarray],
    outputs: Mapping[str, np.ndarray],
    valid: np.ndarray,
    signals: Mapping[str, Signal] | None = None,
) -> Recording:
    """A recording from its signals (N, c) by name, in the units of ``signals`` and else in SI.

    Args:
        name: of the recording.
        rate: [Hz].
        inputs: what drives the system.
        outputs: everything else.
        valid: (N,).
        signals: units and axes of those that are the data's own, or called otherwise in them.
    """
    own = signals or {}

    def side(signals: Mapping[str, np.ndarray]) -> tuple[np.ndarray, tuple[Channel, ...]]:
        named = tuple(c for signal, x in signals.items() for c in channels(signal, x.shape[1], own.get(signal)))
        return np.concatenate([np.empty((len(valid), 0)), *signals.values()], axis=1), named

    (u, u_channels), (y, y_channels) = side(inputs), side(outputs)
    return Recording(name, rate, u, outputs=y, input_channels=u_channels, output_channels=y_channels, valid=valid)
