"""`dataset.toml`: how a user's own files are to be read."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from registry.core import PHYSICS, finite
from registry.datasets.folder.sessions import UNTOLD, Mark, mark
from registry.datasets.folder.signals import SignalColumns, known, refuse_unturned, signal_columns
from registry.dynamics import PhysicsModel
from registry.errors import BenchError, near
from registry.model_file import constants_of
from registry.regular_file import read_toml

FILE = "dataset.toml"
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
"""Of the units that a time column may have."""
SLOWEST, FASTEST = 1e-6, 1e6
"""Sample rates [Hz] beyond which nothing is measured: a period overflows, or a grid has no end."""
LARGEST_NOISE = 1e9
"""1σ of any signal, SI: larger ones overflow where they are squared."""
COMMANDS = ("rotor_command", "pwm")
"""Signals that ask for rotor speeds, held until the next one."""
_REQUIRED = ("name", "rate_hz", "files", "time", "signals")
_TABLES = ("physics", "processing", "environment")
_OPTIONAL = (
    "system",
    "input",
    "input_hold",
    "targets",
    "time_unit",
    "clock",
    "skip_s",
    "commands",
    "vehicle",
    "date",
    *_TABLES,
)
_ENVIRONMENT = ("gravity", "ground_z", "air_density")


@dataclass(frozen=True)
class FolderDescription:
    """The checked contents of a `dataset.toml`."""

    name: str
    system: str
    """A registered physics model; empty: there is none."""
    rate: float
    """[Hz]."""
    files: str
    time: str
    tick: float
    """What 1 in the time column stands for [s]."""
    inputs: tuple[str, ...]
    """Signals that drive the system, the physics model's first; empty: it is not driven."""
    input_hold: str
    signals: dict[str, SignalColumns]
    clock: str = "steady"
    """"exact": its times are those of the samples, however irregularly they came."""
    skip: float = 0.0
    """Of every recording the time at its beginning that is left out [s]."""
    commands: str = ""
    """The signal that asked for the measured input, with which it is read; empty: it is read alone."""
    targets: tuple[str, ...] = ()
    """What is predicted where a run names nothing; empty: what the system makes of it."""
    physics: dict[str, Any] = field(default_factory=dict)
    """Nominal constants, SI; "uncertainty" holds relative 1σ."""
    processing: dict[str, Any] = field(default_factory=dict)
    environment: dict[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    """What was taken for granted, in sentences."""
    vehicle: Mark = UNTOLD
    """Whose recordings they are."""
    date: Mark = UNTOLD
    """When they were made."""

    @property
    def input(self) -> str:
        """The signal that drives the physics model; empty: nothing does."""
        return self.inputs[0] if self.inputs else ""


def _system(path: Path, name: str) -> Any:
    """The physics model that a description names."""
    try:
        return PHYSICS.get(name)
    except BenchError as error:
        raise BenchError(f"{path}: {error}") from error


def describe(folder: Path) -> FolderDescription:
    """Read and check ``folder``/dataset.toml.

    Raises:
        BenchError: what is missing, unknown or of the wrong kind.
    """
    path = folder / FILE
    table = _table(folder, path)
    kind = _system(path, table["system"]) if "system" in table else None
    signals = {name: signal_columns(path, name, entry, kind) for name, entry in table["signals"].items()}
    if not signals:
        raise BenchError(
            f"{path} describes no signal yet: under [signals], write for each one a line such as "
            'NAME = {columns = ["a column of the files"], unit = "m/s"}.'
        )
    inputs = _inputs(path, table, kind, signals)
    if timed := [n for n, s in signals.items() if table["time"] in s.names]:
        raise BenchError(f"{path}: {timed[0]} is read from column {table['time']!r}, which is the time: give its own.")
    twice = [c for c in {c for s in signals.values() for c in s.names} if _uses(signals, c) > 1]
    if twice:
        raise BenchError(f"{path}: column {min(twice)!r} is used twice.")
    refuse_unturned(path, signals)
    targets = _listed(path, table, "targets", signals)
    if both := set(targets) & set(inputs):
        raise BenchError(f"{path}: {min(both)} is an input and cannot be one of the targets.")
    physics, notes = _physics(path, table.get("physics", {}), kind)
    return FolderDescription(
        name=table["name"],
        system=table.get("system", ""),
        rate=float(table["rate_hz"]),
        files=table["files"],
        time=table["time"],
        tick=SECONDS[table.get("time_unit", "s")],
        inputs=inputs,
        input_hold=table.get("input_hold", "linear"),
        signals=signals,
        clock=table.get("clock", "steady"),
        skip=float(table.get("skip_s", 0.0)),
        commands=_commands(path, table, inputs, signals),
        targets=targets,
        physics=physics,
        processing=_processing(path, table.get("processing", {}), signals),
        environment=_environment(path, table.get("environment", {})),
        notes=notes,
        vehicle=mark(path, table, "vehicle"),
        date=mark(path, table, "date"),
    )


def _table(folder: Path, path: Path) -> dict[str, Any]:
    """The keys of the file, those without signals or physics checked."""
    table = read_toml(path, f"`bench data init {folder}` drafts it")
    known(table, (*_REQUIRED, *_OPTIONAL), f"{path}")
    for key in _REQUIRED:
        if key not in table:
            raise BenchError(f"{path} has no key {key!r}: add it.")
    for key in ("name", "system", "files", "time"):
        if key in table and (not isinstance(table[key], str) or not table[key]):
            raise BenchError(f"{path}: {key} must be a text, not {table[key]!r}.")
    rate = table["rate_hz"]
    if not finite(rate) or not SLOWEST <= rate <= FASTEST:
        raise BenchError(f"{path}: rate_hz must be a number from {SLOWEST:g} to {FASTEST:g}, not {rate!r:.60}.")
    skip = table.get("skip_s", 0.0)
    if not finite(skip) or skip < 0:
        raise BenchError(f"{path}: skip_s must be a number of seconds, 0 or more, not {skip!r:.60}.")
    chosen = {"input_hold": ("linear", "previous"), "time_unit": tuple(SECONDS), "clock": ("steady", "exact")}
    for key, choices in chosen.items():
        if key in table and table[key] not in choices:
            raise BenchError(f"{path}: {key} = {table[key]!r:.60}: choose {', '.join(choices[:-1])} or {choices[-1]}.")
    for key in ("signals", *_TABLES):
        if not isinstance(table.get(key, {}), dict):
            raise BenchError(f"{path}: {key} must be a table, [{key}].")
    return table


def _inputs(
    path: Path, table: dict[str, Any], kind: type[PhysicsModel] | None, signals: dict[str, SignalColumns]
) -> tuple[str, ...]:
    """What drives the system; a physics model must accept the first of them."""
    named = table.get("input", "")
    inputs = ((named,) if named else ()) if isinstance(named, str) else _listed(path, table, "input", signals)
    accepted = kind.input_signals if kind else ()
    if accepted and not inputs:
        raise BenchError(
            f"{path} has no key 'input': add the signal that drives {table['system']}: {near('', accepted)}"
        )
    for name in inputs:
        if name not in signals:
            raise BenchError(f"{path}: input = {name!r} is none of its signals: {near(name, signals)}")
    if kind and inputs and inputs[0] not in accepted:
        raise BenchError(f"{path}: {table['system']} cannot be driven by {inputs[0]}: {near('', accepted)}")
    return inputs


def _commands(path: Path, table: dict[str, Any], inputs: Sequence[str], signals: dict[str, SignalColumns]) -> str:
    """The signal that asked for the measured input, as told or as rotors have it; empty: none, or none to be used."""
    if "commands" not in table and inputs[:1] == ("rotor_speed",) and table.get("input_hold") != "previous":
        return next((name for name in COMMANDS if name in signals), "")
    name = table.get("commands", "")
    if not name:
        return ""
    if not isinstance(name, str) or name not in signals or name in inputs:
        raise BenchError(
            f"{path}: commands must be the signal, beside the input, that asked for it, not {name!r:.60}: "
            f"{near(str(name), [s for s in signals if s not in inputs])}"
        )
    if not inputs or table.get("input_hold", "linear") == "previous":
        raise BenchError(f'{path}: commands are told of a measured input: give one, with input_hold = "linear".')
    return name


def _listed(path: Path, table: dict[str, Any], key: str, signals: dict[str, SignalColumns]) -> tuple[str, ...]:
    """The names of signals under a key, such as targets = ["ph"]."""
    names = table.get(key, [])
    if not isinstance(names, list) or not all(isinstance(n, str) for n in names) or len(set(names)) < len(names):
        one = "the name of a signal or " if key == "input" else ""
        raise BenchError(f"{path}: {key} must be {one}a list of different signals, not {names!r:.60}.")
    for name in names:
        if name not in signals:
            raise BenchError(f"{path}: {key} names {name!r}, which is none of its signals: {near(name, signals)}")
    return tuple(names)


def _physics(
    path: Path, physics: dict[str, Any], kind: type[PhysicsModel] | None
) -> tuple[dict[str, Any], tuple[str, ...]]:
    """The constants as floats and tuples, and what was taken for granted in them.

    Without a physics model they belong to a class that is named later, which checks them.
    """
    uncertainty = physics.get("uncertainty", {})
    stated = {k: v for k, v in physics.items() if k != "uncertainty"}
    parameters = kind().parameters() if kind else []
    known(uncertainty, [p.name for p in parameters] if kind else uncertainty, f"{path} [physics.uncertainty]")
    for key, value in uncertainty.items():
        if not finite(value) or value < 0:
            raise BenchError(f"{path} [physics.uncertainty]: {key} must be a number from 0, not {value!r}.")
    if kind is None:
        return physics, ()
    given = constants_of(f"{path} [physics]", parameters, stated)
    flat = (k for k, v in given.items() if _flat(physics[k], v))
    return physics | given, tuple(f"{k} were given as [x, y]: z = 0 was taken." for k in flat)


def _processing(path: Path, processing: dict[str, Any], signals: dict[str, SignalColumns]) -> dict[str, Any]:
    known(processing, ("smoothing", "noise"), f"{path} [processing]")
    known(processing.get("noise", {}), signals, f"{path} [processing] noise")
    for key, value in processing.get("noise", {}).items():
        if not finite(value) or not 0 <= value <= LARGEST_NOISE:
            raise BenchError(
                f"{path} [processing] noise: {key} must be a standard deviation, a number from 0, not {value!r:.60}."
            )
    return processing


def _environment(path: Path, environment: dict[str, Any]) -> dict[str, float]:
    known(environment, _ENVIRONMENT, f"{path} [environment]")
    for key, value in environment.items():
        if not finite(value):
            raise BenchError(f"{path} [environment]: {key} must be a number, not {value!r}.")
    return environment


def _flat(given: Any, places: Any) -> bool:
    """Whether places were given without their height."""
    return isinstance(given, list) and isinstance(given[0], list) and len(given[0]) < len(places[0])


def _uses(signals: dict[str, SignalColumns], column: str) -> int:
    return sum(s.names.count(column) for s in signals.values())
