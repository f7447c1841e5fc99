"""Recordings as their files have them, and how a dataset.toml reads them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from bench.diagnose.settings import SAMPLING
from registry.contracts import Recording
from registry.core import PHYSICS
from registry.datasets.folder.clock import nearest
from registry.datasets.folder.conversion import attitude, own_units, vector
from registry.datasets.folder.dataset import Folder, read_columns
from registry.datasets.folder.signals import SignalColumns
from registry.datasets.reading.cleaning import extent
from registry.datasets.reading.ground import resting
from registry.datasets.reading.rotations import unit_quaternion
from registry.units import SIGNALS, is_listed

if TYPE_CHECKING:
    from bench.diagnose.logs.subject import Subject

Array = np.ndarray
T = TypeVar("T")


@dataclass(frozen=True)
class Reading:
    """How files are read, and where the rotors are: what a mistake is in."""

    signals: Mapping[str, SignalColumns]
    drive: str = ""
    """The signal that drives the vehicle."""
    positions: tuple[tuple[float, ...], ...] = ()
    """Of the rotors [m], as many as the drive has columns; empty: nobody stated them."""
    directions: tuple[float, ...] = ()
    """Signs of their reaction torques; empty: nobody stated them."""

    def with_signal(self, name: str, **changes: Any) -> "Reading":
        """This reading with changes in one signal."""
        return replace(self, signals={**self.signals, name: replace(self.signals[name], **changes)})


class Flight:
    """The columns of one recording. What they are converted to is kept, for most edits change one signal only."""

    def __init__(self, name: str, rate: float, columns: Mapping[str, Array], valid: Array | None = None) -> None:
        self.name, self.rate = name, rate
        self.columns = columns
        count = len(next(iter(columns.values())))
        self.valid = np.ones(count, dtype=bool) if valid is None else valid
        self._kept: dict[tuple[str, SignalColumns], Array] = {}

    def __len__(self) -> int:
        return len(self.valid)

    def signals(self, reading: Reading, names: Sequence[str]) -> dict[str, Array]:
        """Signals (N, c) by name, SI, in the frames of this project, as far as they were measured."""
        out: dict[str, Array] = {}
        q = self._own("attitude", reading) if "attitude" in reading.signals else None
        for name in names:
            if name not in reading.signals:
                continue
            values = self._own(name, reading)
            turned = name not in ("attitude", reading.drive)
            out[name] = vector(name, values, reading.signals[name], q) if turned else values
        return out

    def _own(self, name: str, reading: Reading) -> Array:
        signal = reading.signals[name]
        if (name, signal) not in self._kept:
            values = own_units(self.columns, signal)
            values = unit_quaternion(attitude(values, signal)) if name == "attitude" else values
            self._kept[name, signal] = _earlier(values, signal.delay * self.rate) if signal.delay else values
        return self._kept[name, signal]

    def part(self, seconds: float, fewest: int = 0) -> "Flight":
        """At most ``seconds``, or ``fewest`` samples where those take longer, from the middle of what is valid."""
        inside, most = extent(self.valid), max(round(seconds * self.rate), fewest)
        first = inside.start + max(0, (inside.stop - inside.start - most) // 2)
        part = slice(first, min(inside.stop, first + most))
        return Flight(self.name, self.rate, {n: v[part] for n, v in self.columns.items()}, self.valid[part])

    def forget(self) -> None:
        """Drop what was converted."""
        self._kept.clear()


def _earlier(values: Array, samples: float) -> Array:
    """What was logged late (N, c), put back by a number of samples; the ends repeat."""
    at = np.arange(len(values))
    return np.stack([np.interp(at + samples, at, v) for v in values.T], axis=1)


def joined(flights: Sequence[Flight]) -> Flight:
    """Flights one after the other as one; nothing that spans two of them is valid."""
    columns = {n: np.concatenate([f.columns[n] for f in flights]) for n in flights[0].columns}
    valid = np.concatenate([f.valid for f in flights])
    ends = np.cumsum([len(f) for f in flights])
    valid[ends - 1] = False
    valid[ends[:-1]] = False
    return Flight(flights[0].name, flights[0].rate, columns, valid)


@dataclass(frozen=True, eq=False)
class Recorded:
    """Recordings of one vehicle, and the constants that were stated of it."""

    flights: tuple[Flight, ...]
    reading: Reading
    rate: float
    """[Hz]."""
    stated: Mapping[str, Any] = field(default_factory=dict)
    """Constants of the model that somebody stated, SI."""
    hold: str = "linear"


def of_folder(source: Folder) -> Recorded:
    """The recordings of a folder with a dataset.toml.

    Raises:
        BenchError: the folder cannot be read.
    """
    description = source.description
    physics = {k: v for k, v in description.physics.items() if k != "uncertainty"}
    reading = _reading(description.signals, description.input, physics)
    flights = []
    for file in _spread(source.files):
        of, columns = read_columns(file, description)
        near = {n: nearest(of, v) for n, v in columns.items()}
        valid = np.logical_and.reduce([of.steady, *(found for _, found in near.values())])
        flight = Flight(file.name.split(".")[0], description.rate, {n: v for n, (v, _) in near.items()}, valid)
        if description.input:
            x = flight.signals(reading, ("attitude", "velocity", "body_rates", description.input))
            flight.valid &= ~resting(x, x[description.input], description.rate)
        flights.append(flight.part(SAMPLING.longest, SAMPLING.fewest))
    stated = {**physics, **description.environment}
    return Recorded(tuple(flights), reading, description.rate, stated, description.input_hold)


def of_subject(subject: "Subject") -> Recorded:
    """Recordings that are in memory, in SI and the frames of this project."""
    if subject.folder is not None:
        return of_folder(subject.folder)
    recordings = [log.recording for log in subject.logs]
    known = type(subject.model)
    drive = recordings[0].input_channels[0].group if known.input_signals else ""
    constants = {
        p: getattr(subject.model, p)
        for p in ("mass", "thrust_coefficient", "rotor_positions", "rotor_directions", "pwm_gain", "pwm_offset")
        if hasattr(subject.model, p)
    }
    reading = _reading(_as_read(recordings), drive, constants)
    flights = tuple(_flight(r).part(SAMPLING.longest, SAMPLING.fewest) for r in _spread(recordings))
    return Recorded(flights, reading, recordings[0].rate, constants, subject.model.input_hold)


def _as_read(recordings: Sequence[Recording]) -> dict[str, SignalColumns]:
    """What a dataset.toml would say of recordings in memory: signals that all of them have, with all their axes."""
    out = {}
    for name in dict.fromkeys(c.group for c in recordings[0].channels):
        channels = [c for c in recordings[0].channels if c.group == name]
        common = all({c.name for c in channels} <= {c.name for c in r.channels} for r in recordings)
        if common and name in SIGNALS and len(channels) >= len(SIGNALS[name].axes):
            convention = "quaternion_xyzw" if name == "attitude" else ""
            kept = "" if is_listed(channels[0].unit) else channels[0].unit
            out[name] = SignalColumns(tuple(c.name for c in channels), channels[0].unit, convention, kept=kept)
    return out


def _flight(recording: Recording) -> Flight:
    values = np.concatenate([recording.inputs, recording.outputs], axis=1).astype(float)
    columns = {c.name: v for c, v in zip(recording.channels, values.T, strict=True)}
    finite = np.isfinite(values).all(axis=1)
    columns = {n: np.where(finite, v, 1.0 if n == "attitude.qw" else 0.0) for n, v in columns.items()}
    return Flight(recording.name, recording.rate, columns, recording.valid & finite)


def _reading(signals: Mapping[str, SignalColumns], drive: str, stated: Mapping[str, Any]) -> Reading:
    positions = tuple(tuple(float(x) for x in r) for r in stated.get("rotor_positions", ()))
    directions = tuple(float(x) for x in stated.get("rotor_directions", ()))
    rotors = len(signals[drive].columns) if drive in signals else 0
    return Reading(
        dict(signals),
        drive,
        positions if len(positions) == rotors else (),
        directions if len(directions) == rotors else (),
    )


def _spread(of: Sequence[T]) -> list[T]:
    count = min(len(of), SAMPLING.recordings)
    return [of[round((i + 0.5) * len(of) / count - 0.5)] for i in range(count)]


def flying(system: str) -> bool:
    """Whether a system is pushed along its own z axis by rotors, as a quadrotor is."""
    return system in PHYSICS.names() and hasattr(PHYSICS.get(system), "rotor_thrust")
