"""Recordings with the signals of a physics model as it means them: axes in its names, values in its units."""

from dataclasses import replace

import numpy as np

from registry.contracts import Channel, Recording
from registry.dynamics import PhysicsModel
from registry.errors import BenchError
from registry.units import channel_names, conversion


def as_meant(recording: Recording, kind: type[PhysicsModel]) -> Recording:
    """A recording whose states and inputs are those of a model of ``kind``; the same one where they are already.

    Raises:
        BenchError: a signal has another number of axes, or a unit that does not measure what the model means.
    """
    inputs, input_channels = _side(recording, recording.inputs, recording.input_channels, kind)
    outputs, output_channels = _side(recording, recording.outputs, recording.output_channels, kind)
    if (input_channels, output_channels) == (recording.input_channels, recording.output_channels):
        return recording
    return replace(
        recording, inputs=inputs, outputs=outputs, input_channels=input_channels, output_channels=output_channels
    )


def _side(
    recording: Recording, values: np.ndarray, channels: tuple[Channel, ...], kind: type[PhysicsModel]
) -> tuple[np.ndarray, tuple[Channel, ...]]:
    """Inputs or outputs (N, c) and their channels, signal by signal."""
    columns, named = list(values.T), list(channels)
    for group in dict.fromkeys(c.group for c in channels):
        known, at = kind.signal(group), [i for i, c in enumerate(channels) if c.group == group]
        if known is None:
            continue
        names = [channels[i].name for i in at]
        # A part of the signal has its own names; all of it may be called anything, in order.
        if known.axes and len(known.axes) != len(at) and not set(names) <= set(channel_names(group, known.axes)):
            raise BenchError(
                f"Recording {recording.name}: {group} has {len(at)} column(s), and {kind.system_name()} means "
                f"{len(known.axes)}: {', '.join(known.axes)}. Of fewer, say which by axes = […] in dataset.toml."
            )
        whole = known.axes and len(known.axes) == len(at)
        for i, name in zip(at, channel_names(group, known.axes) if whole else names, strict=True):
            try:
                factor, offset = conversion(channels[i].unit, known.unit)
            except BenchError as error:
                raise BenchError(f"Recording {recording.name}: {group}: {error}") from error
            columns[i] = columns[i] * factor + offset if (factor, offset) != (1.0, 0.0) else columns[i]
            named[i] = Channel(channels[i].name if channels[i].name in _names(kind, group) else name, known.unit)
    return np.stack(columns, axis=1) if columns else values, tuple(named)


def _names(kind: type[PhysicsModel], group: str) -> tuple[str, ...]:
    known = kind.signal(group)
    return channel_names(group, known.axes) if known else ()
