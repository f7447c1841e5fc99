"""A user's own recordings: a folder with a `dataset.toml`."""

import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from typing_extensions import override

from registry.contracts import Channel, Dataset, Finding, Recording, RecordingSet, Split
from registry.core import DATASETS, PHYSICS, option
from registry.datasets.folder.clock import Clock, clock, clock_findings, gridded, joined, without_drift
from registry.datasets.folder.conversion import attitude, in_frames, own_units, turns_counted
from registry.datasets.folder.description import FILE, FolderDescription, describe
from registry.datasets.folder.draft import draft
from registry.datasets.folder.sessions import refuse_mixed
from registry.datasets.folder.signals import SignalColumns
from registry.datasets.reading.cleaning import runs, widen
from registry.datasets.reading.ground import MARGIN, resting
from registry.datasets.reading.rotations import euler_from_quaternion, euler_rates_from_body, unit_quaternion
from registry.datasets.reading.tables import ENDINGS, first_row, numbers
from registry.datasets.signals import channels, recording
from registry.errors import BenchError, near
from registry.physics.rigid_body import RigidBody
from registry.regular_file import regular
from registry.units import to_si

__all__ = ["Folder", "FolderDescription", "check", "draft"]

PARTS = 5
"""That a single recording is cut into, one to validate and one to test."""
SHORTEST = 100
"""Samples of such a part."""


@DATASETS.register("folder")
@dataclass(frozen=True)
class Folder(Dataset):
    """Recordings of your own: a folder with CSV or Parquet files and a dataset.toml that says what is in them.

    Units become SI, attitude a quaternion xyzw, velocity that of the world frame; Euler rates are computed where
    attitude and body rates are given. Samples are put on a uniform grid of the stated rate.
    """

    path: str = option(".", "the folder")
    only: tuple[str, ...] = option((), "names of the files to read; none: all that the description means")

    source: ClassVar[str] = "the user's own files"

    @property
    def label(self) -> str:
        """The name in the description."""
        return self.description.name

    @property
    def description(self) -> FolderDescription:
        """The checked dataset.toml, with its [physics], [processing] and [environment]."""
        return describe(Path(self.path))

    @property
    def files(self) -> list[Path]:
        """What is read, in order.

        Raises:
            BenchError: there is none, one that is asked for does not exist, or one leaves the folder.
        """
        found = _files(Path(self.path), self.description.files)
        if absent := set(self.only) - {f.name for f in found}:
            raise BenchError(f"{self.path}: its description means no file {min(absent)!r}.")
        return [f for f in found if not self.only or f.name in self.only]

    @property
    def names(self) -> list[str]:
        """Of the recordings, one a file."""
        return [_name(f) for f in self.files]

    def without(self, names: Collection[str]) -> "Folder":
        """This folder but for the files of these recordings.

        Raises:
            BenchError: no recording has such a name, or all have.
        """
        known = {_name(f): f.name for f in self.files}
        refuse_unknown(names, known)
        left = tuple(file for name, file in known.items() if name not in names)
        if not left:
            raise BenchError(f"--exclude {', '.join(names)} leaves no recording of {self.path}.")
        return replace(self, only=left)

    @property
    def system(self) -> str:  # type: ignore[override]
        """The registered physics model of the recorded system."""
        return self.description.system

    @property
    def inputs(self) -> tuple[str, ...]:  # type: ignore[override]
        """The signals that drive the system; none where nothing does."""
        return self.description.inputs

    @property
    def targets(self) -> tuple[str, ...]:  # type: ignore[override]
        """As the description says; else the body rates of a vehicle, and of other systems their measured states."""
        stated, signals = self.description.targets, self.description.signals
        if stated or "body_rates" in signals or not self.system:
            return stated or tuple(s for s in ("body_rates",) if s in signals)
        states = dict.fromkeys(c.group for c in PHYSICS.get(self.system).state_channels)
        return tuple(s for s in states if s in signals)

    @property
    def chain(self) -> tuple[str, ...]:  # type: ignore[override]
        """Velocity and body rates of a vehicle, unless the description names targets."""
        pair = ("velocity", "body_rates")
        return pair if set(pair) <= set(self.description.signals) and not self.description.targets else ()

    @property
    def input_hold(self) -> str:  # type: ignore[override]
        """Inputs between samples."""
        return self.description.input_hold

    @property
    def physics(self) -> dict[str, Any]:  # type: ignore[override]
        """[physics] but for its uncertainty, and [environment]."""
        stated = {k: v for k, v in self.description.physics.items() if k != "uncertainty"}
        return {**stated, **self.description.environment}

    @property
    def described(self) -> str:  # type: ignore[override]
        """The dataset.toml."""
        return str(Path(self.path) / FILE)

    @property
    def uncertainty(self) -> dict[str, float]:  # type: ignore[override]
        """[physics.uncertainty]."""
        return {k: float(v) for k, v in self.description.physics.get("uncertainty", {}).items()}

    @property
    def processing(self) -> dict[str, Any]:  # type: ignore[override]
        """[processing]."""
        return self.description.processing

    @property
    def recorded(self) -> tuple[Channel, ...]:  # type: ignore[override]
        """What the description says is in the files, inputs first, and the Euler rates that follow from it."""
        drive, signals = self.inputs, self.description.signals
        columns = {n: 4 if n == "attitude" else len(s.columns) for n, s in signals.items()}
        if _turns(signals):
            columns["euler_rates"] = 3
        ordered = [*drive, *(n for n in columns if n not in drive)]
        known = {n: s.signal for n, s in signals.items()}
        return tuple(c for n in ordered for c in channels(n, columns[n], known.get(n)))

    @override
    def read(self) -> RecordingSet:
        description = self.description
        read = [_recording(f, description) for f in self.files]
        findings = tuple(f for _, found in read for f in found)
        return in_parts(RecordingSet(tuple(r for r, _ in read), findings), SHORTEST)

    def split(self, names: Sequence[str]) -> Split:
        """The last fifth of the recordings by name (at least one) tests, as many before it validate.

        Of two the first trains and the second tests, and the end of the first validates.

        Raises:
            BenchError: there is one recording, too short to be cut.
        """
        if len(names) < 2:
            raise BenchError(
                f"{self.path} holds one recording of fewer than {PARTS * SHORTEST} samples, too short to be cut in "
                "parts: add recordings, for what is learnt from one must be tested on another."
            )
        ordered, n = sorted(names), max(1, round(len(names) / 5))
        if len(names) == 2:
            return Split((ordered[0],), (), (ordered[1],))
        return Split(tuple(ordered[: -2 * n]), tuple(ordered[-2 * n : -n]), tuple(ordered[-n:]))


def refuse_unknown(names: Collection[str], known: Collection[str]) -> None:
    """Raise `BenchError` where one of the ``names`` to exclude is no recording's."""
    for name in names:
        if name not in known:
            raise BenchError(f"--exclude {name}: no recording has this name: {near(name, known)}")


def check(folder: str | Path) -> RecordingSet:
    """Read every file of a folder.

    Raises:
        BenchError: the first thing that is wrong: file, column, row.
    """
    return Folder(path=str(folder)).load()


def _turns(signals: Mapping[str, SignalColumns]) -> bool:
    """Whether Euler rates follow from what was measured: attitude, and rates about the three axes of the body."""
    rates = signals.get("body_rates")
    return "attitude" in signals and rates is not None and rates.signal is None and "euler_rates" not in signals


def _files(folder: Path, pattern: str) -> list[Path]:
    home = Path(os.path.realpath(folder))
    if Path(pattern).is_absolute() or ".." in Path(pattern).parts:
        raise BenchError(f"{folder}: files = {pattern!r} leaves the folder: data must lie inside it.")
    try:
        found = sorted(p for p in folder.glob(pattern) if p.name.endswith(ENDINGS))
    except (ValueError, IndexError, NotImplementedError, OSError) as error:
        raise BenchError(f"{folder}: files = {pattern!r} is not a file pattern: {error}.") from error
    if not found:
        raise BenchError(
            f"{folder}: no CSV, CSV.gz or Parquet file matches files = {pattern!r} in dataset.toml: correct the "
            "pattern, or put the recordings there."
        )
    names: dict[str, Path] = {}
    for file in found:
        if not Path(os.path.realpath(file)).is_relative_to(home):
            raise BenchError(f"{file} is a link that leaves the folder: data must lie inside it.")
        regular(file)
        if names.setdefault(_name(file), file) is not file:
            raise BenchError(f"{file} and {names[_name(file)]} would give two recordings of one name: rename one.")
    return found


def _name(file: Path) -> str:
    return file.name.removesuffix(next(e for e in ENDINGS[::-1] if file.name.endswith(e)))


def read_columns(file: Path, description: FolderDescription) -> tuple[Clock, dict[str, np.ndarray]]:
    """The clock of a file and its columns (N,) as they are written there, NaN where a value is missing.

    Raises:
        BenchError: a column is missing or holds no numbers, or the clock does not run forward or drifts.
    """
    names = list(dict.fromkeys(c for s in description.signals.values() for c in s.names))
    table = numbers(file, [description.time, *names], names, time=description.time, tick=description.tick)
    table, twice = joined(table)
    if len(table) < 2:
        raise BenchError(f"{file} holds one sample: a recording has two or more; remove the file.")
    of = replace(clock(file, description.time, table[:, 0], description.rate), twice=twice)
    columns = dict(zip(names, table[:, 1:].T, strict=True))
    commands = description.inputs if description.input_hold == "previous" else ()  # may be logged at any time
    measured = [s for n, s in description.signals.items() if n not in commands]
    if description.clock != "exact":
        of = without_drift(file, description.time, of, [_whole([columns[c] for c in s.names]) for s in measured])
    return of, columns


def _recording(file: Path, description: FolderDescription) -> tuple[Recording, list[Finding]]:
    refuse_mixed(file, description.vehicle, description.date)
    of, columns = read_columns(file, description)
    signals, name = description.signals, _name(file)
    logged = {n: _whole([columns[c] for c in s.names]) for n, s in signals.items()}
    x, close, turned = {}, {}, list[Finding]()
    for n, s in signals.items():
        values = own_units({c: columns[c][logged[n]] for c in s.names}, s)
        if not len(values):
            raise BenchError(f"{file}: {n} has no row in which all of {', '.join(s.names)} hold a number.")
        if n == "attitude":
            values = _attitude(file, values, s, np.flatnonzero(logged[n]))
        elif n not in description.inputs and (s.kept or to_si(s.unit)[0]) == "rad":
            values, times, span = turns_counted(values)
            if times:
                within = "one turn" if span == 2 * np.pi else f"{span:.6g} rad"
                detail = f"{n} is filed within {within} and went past its end {times} times: its turns are counted"
                turned.append(Finding(name, "turns", times, detail))
        held = n in description.inputs and description.input_hold == "previous"
        x[n], close[n] = gridded(of, values, logged[n], s.delay, held)
    valid = np.logical_and.reduce([of.steady, *close.values()])
    findings = [*clock_findings(name, of, logged, close), *turned]
    if "attitude" in x:
        x["attitude"] = unit_quaternion(x["attitude"])
    x = in_frames(x, signals)
    if _turns(signals):
        x["euler_rates"] = euler_rates_from_body(euler_from_quaternion(x["attitude"]), x["body_rates"])
    if description.input and description.system and issubclass(PHYSICS.get(description.system), RigidBody):
        rests = resting(x, x[description.input], description.rate)
        valid &= ~widen(rests, round(MARGIN * description.rate))
        findings += [Finding(name, "ground", b - a, _rest(a, b, len(rests), description.rate)) for a, b in runs(rests)]
    if skipped := round(description.skip * description.rate):
        if skipped >= len(valid):
            raise BenchError(
                f"{file} is no longer than the {description.skip:g} s that skip_s leaves out: make it shorter."
            )
        valid[:skipped] = False
        findings.append(Finding(name, "trimmed", skipped, f"the first {description.skip:g} s, which skip_s leaves out"))
    inputs = {n: x.pop(n) for n in description.inputs}
    own = {n: s.signal for n, s in signals.items() if s.signal}
    return recording(name, description.rate, inputs, x, valid, own), findings


def _whole(columns: Sequence[np.ndarray]) -> np.ndarray:
    """Rows (N,) that hold a number in all columns (N,)."""
    return np.asarray(np.isfinite(columns).all(axis=0))


def in_parts(measured: RecordingSet, shortest: int) -> RecordingSet:
    """The only recording cut in parts, where each has as many samples as the shortest may; others as they are."""
    if len(measured.recordings) != 1 or len(measured.recordings[0]) < PARTS * shortest:
        return measured
    (recording,) = measured.recordings
    ends = np.linspace(0, len(recording), PARTS + 1).round().astype(int)
    parts = (
        recording.part(slice(a, b), f"{recording.name}_{i}of{PARTS}")
        for i, (a, b) in enumerate(pairwise(ends.tolist()), start=1)
    )
    detail = f"the only recording, cut into {PARTS} parts: the last but one validates, the last tests"
    return RecordingSet(tuple(parts), (*measured.findings, Finding(recording.name, "cut", PARTS, detail)))


def _rest(first: int, end: int, samples: int, rate: float) -> str:
    """What is said of samples without flight."""
    where = "before take-off" if first == 0 else "after landing" if end == samples else "on the ground"
    return (
        f"samples {first} to {end - 1} ({(end - first) / rate:.1f} s) are {where}: left out, with {MARGIN:g} s beside"
    )


def _attitude(file: Path, values: np.ndarray, signal: SignalColumns, rows: np.ndarray) -> np.ndarray:
    if signal.convention.startswith("quaternion"):
        length = np.linalg.norm(values, axis=1)
        if (np.abs(length - 1) > 0.1).any():
            i = int((np.abs(length - 1) > 0.1).argmax())
            raise BenchError(
                f"{file}, column {signal.names[0]!r}, row {first_row(file) + rows[i]}: "
                f"a quaternion of length {length[i]:.3g} is no attitude."
            )
    return attitude(values, signal)
