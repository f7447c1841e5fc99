"""A first `dataset.toml` guessed from the headers and the clock of a folder's files."""

import json
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from registry.core import PHYSICS
from registry.datasets.folder.clock import pace
from registry.datasets.folder.columns import Found, bare, drives, of_own, own_signal, recognised, time_column
from registry.datasets.folder.constants import Constant, physics_lines
from registry.datasets.folder.description import COMMANDS, SECONDS
from registry.datasets.reading.tables import ENDINGS, MissingValue, dated, header, numbers, units
from registry.dynamics import PhysicsModel
from registry.errors import BenchError
from registry.units import SIGNALS, Signal

MOTION = ("position", "attitude", "velocity", "body_rates", "specific_force")
"""Signals that only a vehicle has."""
NO_PHYSICS = "No physics model: networks only."

_BY_SIZE = {"attitude": ('unit = "rad"', 'unit = "deg"'), "specific_force": ('unit = "g"', 'unit = "m/s^2"')}
"""Signal → its units where values are small, and where they are large."""
_FEW, _WIDTH = 8, 100
"""Columns that have a line each, and characters of a line of more."""
_ONE_G = 3.1
"""What an accelerometer shows in flight is less than this in g, and more in m/s²: the geometric mean of both."""

_ROTORS = (
    "# TODO: pwm is what a driver is told, whole numbers such as 1000 to 2000 or 0 to 65535; where these columns are\n"
    '# speeds of the rotors (in rad/s or rpm), write input = "rotor_speed" above and in the place of the line before:\n'
    "# rotor_speed = {}"
)


@dataclass(frozen=True)
class Known:
    """What an importer knows of the files that it wrote, beside the names of their columns."""

    rate: float
    """[Hz]."""
    constants: Mapping[str, Constant] = field(default_factory=dict)
    """Of the system."""
    sure: bool = False
    """Whether the format of the log says units and frames, so that none need be checked."""


def draft(
    folder: str | Path, system: str = "", known: Known | None = None, own: type[PhysicsModel] | None = None
) -> str:
    """The text of a `dataset.toml` for the files of ``folder``: guesses, and TODO lines for what is left.

    Args:
        folder: of the recordings.
        system: the physics model's registered name; "": a quadrotor or a helicopter where the columns hold the motion
            of a vehicle, and else none.
        known: of files that an importer wrote; None: they are a user's own.
        own: a class of one's own in the place of a registered system.

    Raises:
        BenchError: the folder holds no CSV or Parquet file, the first one cannot be read, the system is unknown, or
            there is no column beside the time.
    """
    folder = Path(folder)
    files = sorted(p for p in folder.glob("*") if p.name.endswith(ENDINGS))
    if not files:
        raise BenchError(
            f"{folder} holds no CSV, CSV.gz or Parquet file: give the folder that holds your recordings, or convert "
            "logs with `bench data import`."
        )
    names = header(files[0])
    stated = units(files[0])
    time = time_column(names) or next((n for n in names if stated.get(n) in SECONDS), None)
    columns = [n for n in names if n != time]
    if not columns:
        raise BenchError(f"{files[0]} has no column beside the time: log what drives the system and what it does.")
    sure = known is not None and known.sure
    wanted = _signals_of(system) if system else {}
    found = recognised(columns, wanted, stated)
    for signal in set(found.signals) & set(_BY_SIZE) if not sure else ():
        found.signals[signal] = _by_size(signal, found.signals[signal], files[0], found.columns[signal])
    if own is None and not system and set(found.signals) & {*MOTION, "pilot"}:
        system = "helicopter" if "pilot" in found.signals else "quadrotor"
        if sure and not set(found.signals) & set(PHYSICS.get(system).input_signals):
            system = ""  # nothing drives it, and nobody can add what the log lacks
    check = "" if sure else "  # TODO: check; `bench list physics` names the others"
    ending = next(e for e in ENDINGS[::-1] if files[0].name.endswith(e))
    lines = [
        f"name = {json.dumps(Path(os.path.realpath(folder)).name, ensure_ascii=False)}",
        *([f'system = "{system}"' + ("" if wanted else check)] * bool(system)),
        *([f"rate_hz = {known.rate:g}"] if known else _clock(files[0], time, stated)),
        f'files = "*{ending}"',
        f"time = {json.dumps(time, ensure_ascii=False)}" if time else 'time = "t"  # TODO: no column looks like time',
    ]
    if own is not None:
        return "\n".join([*lines, *_of_own(own, columns, stated)]) + "\n"
    if system:
        return "\n".join([*lines, *_of_system(system, wanted, found, known)]) + "\n"
    return "\n".join([*lines, *_of_networks(files[0], found, stated)]) + "\n"


def _by_size(signal: str, entry: str, file: Path, columns: Sequence[str]) -> str:
    """The entry in the unit that the size of the values tells: angles beyond π, gravity in g or in m/s²."""
    small, large = _BY_SIZE[signal]
    try:
        values = np.abs(numbers(file, columns))
    except BenchError:
        return entry  # `bench data check` says what is wrong with it
    if signal == "attitude":
        return entry.replace(small, large) if "euler" in entry and values[:, :2].max() > np.pi else entry
    weighs = float(np.median(np.linalg.norm(values, axis=-1)))
    return entry.replace(small, large) if weighs > _ONE_G else entry.replace(large, small)


def _of_system(system: str, wanted: dict[str, str], found: Found, known: Known | None) -> list[str]:
    """What follows the clock where a physics model is known."""
    sure = known is not None and known.sure
    driver = next((s for s in PHYSICS.get(system).input_signals if s in found.signals), None)
    missing = [s for s in wanted if s not in found.signals]
    return [
        *_driven(system, driver, sure),
        "",
        "[signals]" + ("" if sure else "  # TODO: check every unit, and the frame of the velocity"),
        *(f"{signal} = {entry}" for signal, entry in found.signals.items()),
        *(
            _ROTORS.format(e.replace('"pwm"', '"rad/s"'))
            for s, e in found.signals.items()
            if s == driver == "pwm" and not sure
        ),
        *(
            f'# TODO: {m} = {{columns = ["…"], unit = "{SIGNALS[m].unit}"}}, {wanted[m]}, if it was measured'
            for m in missing
            if not sure
        ),
        *_left_over(found.left, sure),
        "",
        *physics_lines(system, driver or "", known.constants if known else {}),
    ]


def _left_over(columns: Sequence[str], sure: bool) -> list[str]:
    """Comments on the columns that no signal has; of many, as an autopilot logs them, several a line."""
    quoted = [json.dumps(n, ensure_ascii=False) for n in columns]
    if len(quoted) <= _FEW:
        return [f"# not used: column {n}" if sure else f"# TODO: what is column {n}?" for n in quoted]
    rows = ["# not used:" if sure else "# TODO: are any of these columns signals of it? They are not read:"]
    for n in quoted:
        if len(rows) > 1 and len(rows[-1]) + len(n) < _WIDTH:
            rows[-1] += f" {n}"
        else:
            rows.append(f"#   {n}")
    return rows


def _of_own(kind: type[PhysicsModel], columns: Sequence[str], stated: Mapping[str, str]) -> list[str]:
    """What follows the clock for a class of one's own: its signals by their names, its constants as it has them."""
    groups = dict.fromkeys(c.group for c in kind.state_channels)
    wanted = {
        g: Signal(next(c.unit for c in own), tuple(c.axis for c in own))
        for g in groups
        if (own := [c for c in kind.state_channels if c.group == g])
    }
    known, inputs = {**SIGNALS, **kind.signals}, kind.input_signals
    beside = (*inputs, *kind.disturbances)
    found = of_own(columns, wanted | {name: known[name] for name in beside}, stated, inputs)
    driver = next((s for s in inputs if s in found.signals), inputs[0] if len(inputs) == 1 else None)
    asked = (*wanted, *([driver] if driver else inputs[:1]), *kind.disturbances)
    missing, constants = [s for s in asked if s not in found.signals], kind().parameters()
    named = f'input = "{driver}"' if driver else "# TODO: input, the signal that drives the system"
    return [
        *[named] * bool(inputs),
        'input_hold = "linear"  # TODO: "previous" if the input is a command',
        "",
        "[signals]  # TODO: check every unit",
        *(f"{signal} = {entry}" for signal, entry in found.signals.items()),
        *(
            f'# TODO: {m} = {{columns = ["…"], unit = "{(wanted | known)[m].unit}"}}, if it was measured'
            for m in missing
        ),
        *_left_over(found.left, sure=False),
        "",
        f"[physics]  # TODO: what this system has, SI; here as {kind.__name__} has them",
        *(f"{p.name} = {json.dumps(p.value)}  # {p.unit}; {p.about}" for p in constants),
        "",
        "[physics.uncertainty]  # TODO: how well each is known, relative 1σ; below 0.2 calibration goes to 3σ at most",
        *(f"{p.name} = {p.uncertainty:g}" for p in constants),
    ]


def _of_networks(file: Path, found: Found, stated: Mapping[str, str]) -> list[str]:
    """What follows the clock where there is no physics model: every column that holds numbers is a signal."""
    signals, inputs, other = dict(found.signals), [], []
    for column in found.left:
        if not _numeric(file, column):
            other.append(column)
            continue
        name, entry = own_signal(column, signals, stated.get(column, ""))
        signals[name] = entry
        if drives(column):
            inputs.append(name)
    inputs += [n for n in found.signals if n in ("pwm", "rotor_speed", "rotor_command")]
    named = f"input = {json.dumps(inputs, ensure_ascii=False)}  # TODO: check what drives the system"
    return [
        named
        if 0 < len(inputs) < len(signals)
        else '# TODO: input = ["…"], the signals that drive the system, if any do',
        'input_hold = "linear"  # TODO: "previous" if the input is a command',
        '# targets = ["…"]  what is predicted; left out, '
        + ("body_rates" if "body_rates" in signals else "all signals beside the input"),
        "",
        f"# {NO_PHYSICS} With one, `bench data init FOLDER --system NAME` drafts its constants too.",
        "[signals]" + ("" if set(found.left) <= {*stated, *other} else "  # TODO: check every unit"),
        *(f"{signal} = {entry}" for signal, entry in signals.items()),
        *(f"# column {json.dumps(n, ensure_ascii=False)} holds no numbers" for n in other),
    ]


def _clock(file: Path, time: str | None, stated: Mapping[str, str]) -> list[str]:
    """The rate, as the time column of a file has it, and the unit of that column where it is not seconds."""
    t = _times(file, time) if time else np.empty(0)
    steps = np.diff(t)
    if len(steps) < 2 or not (period := float(np.median(steps))) > 0:
        return ["rate_hz = 100  # TODO: check"]
    said = stated.get(time or "")
    unit = "s" if dated(file, time or "") else said if said in SECONDS else time_unit(time or "", period)
    rate = 1 / (period * SECONDS[unit])
    uneven = float(np.mean(np.abs(steps - period) > 0.1 * period))
    mean = pace(t).period  # stamps may be rounded
    rate = 1 / (mean * SECONDS[unit]) if abs(mean - period) < 0.1 * period else rate
    rate = round(rate) if round(rate) and abs(rate - round(rate)) < 2e-3 * rate else float(f"{rate:.6g}")
    jitter = f"  # {uneven:.0%} of the steps of {file.name} are others: put on this rate" if uneven > 0.01 else ""
    lines = [f"rate_hz = {rate:g}{jitter or f'  # as {file.name} has it'}"]
    return lines if unit == "s" else [*lines, f'time_unit = "{unit}"']


def _times(file: Path, time: str) -> np.ndarray:
    try:
        return numbers(file, [time], time=time)[:, 0]
    except BenchError:
        return np.empty(0)  # `bench data check` says what is wrong with it


def time_unit(name: str, period: float) -> str:
    """The unit of a time column by its name, or where that is a stamp by the size of its steps."""
    name = bare(name)
    ending = re.search(r"_?(ms|us|ns)$", name, re.IGNORECASE)
    if ending:
        return ending[1].lower()
    if not re.search("stamp|tick|^%", name, re.IGNORECASE):
        return "s"
    return next((unit for least, unit in ((1e5, "ns"), (500.0, "us"), (1.5, "ms")) if period >= least), "s")


def _numeric(file: Path, column: str) -> bool:
    try:
        numbers(file, [column])
    except MissingValue:
        return True
    except BenchError:
        return False
    return True


def _signals_of(system: str) -> dict[str, str]:
    """Name → what it is to the system: what can be measured of its states, and what drives it."""
    model = PHYSICS.get(system)
    states = {c.group: "a state" for c in model.state_channels if c.group in SIGNALS}
    more = ("specific_force", "battery") if "attitude" in states else ()
    return states | {s: "what drives it" for s in model.input_signals} | {s: "which tells more" for s in more}


def _driven(system: str, driver: str | None, sure: bool) -> list[str]:
    """What drives the system; ``sure``: whether the format of the log says if it is a command."""
    if not PHYSICS.get(system).input_signals:
        return []
    named = f'input = "{driver}"' if driver else '# TODO: input = "…", the signal that drives the system'
    if driver in COMMANDS:
        return [named, 'input_hold = "previous"' + ("" if sure else '  # TODO: "linear" if the input was measured')]
    return [named, 'input_hold = "linear"' + ("" if sure else '  # TODO: "previous" if the input is a command')]
