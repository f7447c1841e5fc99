"""`dataset.toml`: how a user's own files are to be read."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from registry.core import PHYSICS
from registry.errors import BenchError, near
from registry.model_file import constants_of, finite
from registry.regular_file import read_toml
from registry.units import SIGNALS, to_si

FILE = "dataset.toml"
CONVENTIONS = {"euler_zyx": 3, "euler_xyz": 3, "quaternion_xyzw": 4, "quaternion_wxyz": 4}
FRAMES = {
    "position": ("world", "ned"),
    "velocity": ("world", "body", "ned", "frd"),
    "attitude": ("flu", "ned"),
    "body_rates": ("body", "frd"),
    "specific_force": ("body", "frd", "world", "ned"),
}
"""Of each signal: world with z up or north-east-down; body with y left and z up or forward-right-down. An attitude is
from the body (flu) to the world with z up, or from forward-right-down to north-east-down (ned)."""
GRAVITY = ("included", "removed")
SLOWEST, FASTEST = 1e-6, 1e6
"""Sample rates [Hz] beyond which nothing is measured: a period overflows, or a grid has no end."""
LARGEST_NOISE = 1e9
"""1σ of any signal, SI: larger ones overflow where they are squared."""
LONGEST_DELAY = 1.0
"""Of a signal that was logged late [s]."""
_REQUIRED = ("name", "system", "rate_hz", "files", "time", "signals")
_OPTIONAL = ("input", "input_hold", "physics", "processing", "environment")
_ENVIRONMENT = ("gravity", "ground_z", "air_density")


@dataclass(frozen=True)
class SignalColumns:
    """Where a signal is in the files and what it is measured in."""

    columns: tuple[str, ...]
    unit: str
    convention: str = ""
    """Of the attitude: one of `CONVENTIONS`."""
    frame: str = ""
    """One of `FRAMES`; empty: the first of them."""
    gravity: str = ""
    """Of the specific force: "removed" where it is the acceleration alone."""
    delay: float = 0.0
    """By how much it was logged late [s]."""

    @property
    def names(self) -> tuple[str, ...]:
        """The columns as the files call them, without the sign that may stand before."""
        return tuple(c.removeprefix("-") for c in self.columns)


@dataclass(frozen=True)
class FolderDescription:
    """The checked contents of a `dataset.toml`."""

    name: str
    system: str
    rate: float
    """[Hz]."""
    files: str
    time: str
    input: str
    """The signal that drives the system; empty: it is not driven."""
    input_hold: str
    signals: dict[str, SignalColumns]
    physics: dict[str, Any] = field(default_factory=dict)
    """Nominal constants, SI; "uncertainty" holds relative 1σ."""
    processing: dict[str, Any] = field(default_factory=dict)
    environment: dict[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    """What was taken for granted, in sentences."""


def describe(folder: Path) -> FolderDescription:
    """Read and check ``folder``/dataset.toml.

    Raises:
        BenchError: what is missing, unknown or of the wrong kind.
    """
    path = folder / FILE
    table = read_toml(path, f"`bench data init {folder}` drafts it")
    _known(table, (*_REQUIRED, *_OPTIONAL), f"{path}")
    for key in _REQUIRED:
        if key not in table:
            raise BenchError(f"{path} has no key {key!r}: add it.")
    for key in ("name", "system", "files", "time"):
        if not isinstance(table[key], str) or not table[key]:
            raise BenchError(f"{path}: {key} must be a text, not {table[key]!r}.")
    rate = table["rate_hz"]
    if not finite(rate) or not SLOWEST <= rate <= FASTEST:
        raise BenchError(f"{path}: rate_hz must be a number from {SLOWEST:g} to {FASTEST:g}, not {rate!r:.60}.")
    hold = table.get("input_hold", "linear")
    if not isinstance(table.get("input", ""), str):
        raise BenchError(f"{path}: input must be the name of a signal, not {table['input']!r:.60}.")
    if hold not in ("linear", "previous"):
        raise BenchError(f"{path}: input_hold = {hold!r}: choose linear or previous.")
    for key in ("signals", *_OPTIONAL[2:]):
        if not isinstance(table.get(key, {}), dict):
            raise BenchError(f"{path}: {key} must be a table, [{key}].")
    signals = {name: _signal(path, name, entry) for name, entry in table["signals"].items()}
    model = PHYSICS.get(table["system"])
    accepted, drive = model.input_signals, table.get("input", "")
    if accepted and not drive:
        raise BenchError(
            f"{path} has no key 'input': add the signal that drives {table['system']}: {near('', accepted)}"
        )
    if drive and drive not in signals:
        raise BenchError(f"{path}: input = {drive!r} is none of its signals: {near(str(drive), signals)}")
    if drive and drive not in accepted:
        raise BenchError(f"{path}: {table['system']} cannot be driven by {drive}: {near('', accepted)}")
    if timed := [n for n, s in signals.items() if table["time"] in s.names]:
        raise BenchError(f"{path}: {timed[0]} is read from column {table['time']!r}, which is the time: give its own.")
    twice = [c for c in {c for s in signals.values() for c in s.names} if _uses(signals, c) > 1]
    if twice:
        raise BenchError(f"{path}: column {min(twice)!r} is used twice.")
    _turned(path, signals)
    physics, processing = table.get("physics", {}), table.get("processing", {})
    environment = table.get("environment", {})
    parameters = model().parameters()
    given = constants_of(f"{path} [physics]", parameters, {k: v for k, v in physics.items() if k != "uncertainty"})
    _known(physics.get("uncertainty", {}), [p.name for p in parameters], f"{path} [physics.uncertainty]")
    _known(processing, ("smoothing", "noise"), f"{path} [processing]")
    _known(processing.get("noise", {}), signals, f"{path} [processing] noise")
    _known(environment, _ENVIRONMENT, f"{path} [environment]")
    for key, value in physics.get("uncertainty", {}).items():
        if not finite(value) or value < 0:
            raise BenchError(f"{path} [physics.uncertainty]: {key} must be a number from 0, not {value!r}.")
    for key, value in processing.get("noise", {}).items():
        if not finite(value) or not 0 <= value <= LARGEST_NOISE:
            raise BenchError(
                f"{path} [processing] noise: {key} must be a standard deviation, a number from 0, not {value!r:.60}."
            )
    for key, value in environment.items():
        if not finite(value):
            raise BenchError(f"{path} [environment]: {key} must be a number, not {value!r}.")
    return FolderDescription(
        table["name"],
        table["system"],
        float(rate),
        table["files"],
        table["time"],
        drive,
        hold,
        signals,
        physics | given,
        processing,
        environment,
        tuple(f"{k} were given as [x, y]: z = 0 was taken." for k, v in given.items() if _flat(physics[k], v)),
    )


def _flat(given: Any, places: Any) -> bool:
    """Whether places were given without their height."""
    return isinstance(given, list) and isinstance(given[0], list) and len(given[0]) < len(places[0])


def _signal(path: Path, name: str, entry: Any) -> SignalColumns:
    if name not in SIGNALS:
        raise BenchError(f"{path}: unknown signal {name!r}: {near(name, SIGNALS)}")
    if not isinstance(entry, dict) or "columns" not in entry:
        raise BenchError(f'{path}: {name} must be written {{columns = ["…"], unit = "…"}}.')
    _known(entry, ("columns", "unit", "convention", "frame", "gravity", "delay_s"), f"{path}: {name}")
    columns = entry["columns"]
    if not isinstance(columns, list) or not columns or not all(isinstance(c, str) for c in columns):
        raise BenchError(f"{path}: {name}: columns must be a list of column names, not {columns!r}.")
    known, convention, frame = SIGNALS[name], entry.get("convention", ""), entry.get("frame", "")
    if not isinstance(convention, str) or not isinstance(frame, str):
        raise BenchError(f"{path}: {name}: convention and frame must be texts.")
    count = len(known.axes) or len(columns)
    si, unit = known.unit, entry.get("unit")
    if name == "attitude":
        if convention not in CONVENTIONS:
            raise BenchError(f"{path}: attitude: convention = {convention!r}: {near(str(convention), CONVENTIONS)}")
        count, si = CONVENTIONS[convention], "rad" if convention.startswith("euler") else "1"
        unit = entry.get("unit", "1") if si == "1" else unit
    elif convention:
        raise BenchError(f"{path}: {name} has no convention: only the attitude has.")
    if unit is None:
        raise BenchError(f"{path}: {name} has no unit: add one, such as {si!r}.")
    if not isinstance(unit, str):
        raise BenchError(f"{path}: {name}: unit must be a text, not {unit!r}.")
    try:
        found = to_si(unit)[0]
    except BenchError as error:
        raise BenchError(f"{path}: {name}: {error}") from error
    if found != si:
        raise BenchError(f"{path}: {name} is measured in {si}, which {unit!r} is not.")
    if len(columns) != count:
        raise BenchError(f"{path}: {name} needs {count} columns, not {len(columns)}.")
    frames = FRAMES.get(name, ())
    if frame and frame not in frames:
        raise BenchError(f"{path}: {name}: frame = {frame!r}: {near(str(frame), frames)}")
    gravity, delay = entry.get("gravity", ""), entry.get("delay_s", 0.0)
    if gravity and (name != "specific_force" or gravity not in GRAVITY):
        raise BenchError(f"{path}: {name}: gravity = {gravity!r}: only specific_force has it, {near('', GRAVITY)}")
    if not finite(delay) or abs(delay) > LONGEST_DELAY:
        raise BenchError(f"{path}: {name}: delay_s must be a number of at most {LONGEST_DELAY:g} s, not {delay!r}.")
    return SignalColumns(tuple(columns), unit, convention, frame, gravity, float(delay))


def _turned(path: Path, signals: dict[str, SignalColumns]) -> None:
    """Raise `BenchError` where a vector must be turned and the attitude was not measured."""
    if "attitude" in signals:
        return
    if signals.get("velocity", SignalColumns((), "")).frame in ("body", "frd"):
        raise BenchError(f"{path}: velocity in the body frame needs the attitude to be turned into the world.")
    force = signals.get("specific_force", SignalColumns((), ""))
    if force.frame in ("world", "ned") or force.gravity == "removed":
        raise BenchError(f"{path}: specific_force in the world frame, or without gravity, needs the attitude.")


def _known(table: Any, keys: Any, where: str) -> None:
    if not isinstance(table, dict):
        raise BenchError(f"{where} must be a table, not {table!r}.")
    for key in table:
        if key not in keys:
            raise BenchError(f"{where}: unknown key {key!r}: {near(key, keys)}")


def _uses(signals: dict[str, SignalColumns], column: str) -> int:
    return sum(s.names.count(column) for s in signals.values())
