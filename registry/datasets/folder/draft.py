"""A first `dataset.toml` guessed from the headers and the clock of a folder's files."""

import json
import os
import re
from pathlib import Path
from typing import Any

import numpy as np

from registry.core import PHYSICS
from registry.datasets.folder.columns import Found, bare, drives, own_signal, recognised, time_column
from registry.datasets.folder.description import SECONDS
from registry.datasets.reading.tables import ENDINGS, MissingValue, header, numbers
from registry.errors import BenchError
from registry.stated import needed
from registry.units import SIGNALS

MOTION = ("position", "attitude", "velocity", "body_rates", "specific_force")
"""Signals that only a vehicle has."""
NO_PHYSICS = "No physics model: networks only."


def draft(folder: str | Path, system: str = "") -> str:
    """The text of a `dataset.toml` for the files of ``folder``: guesses, and TODO lines for what is left.

    Args:
        folder: of the recordings.
        system: the physics model's registered name; "": a quadrotor or a helicopter where the columns hold the motion
            of a vehicle, and else none.

    Raises:
        BenchError: the folder holds no CSV or Parquet file, the first one cannot be read, the system is unknown, or
            there is no column beside the time.
    """
    folder = Path(folder)
    files = sorted(p for p in folder.glob("*") if p.name.endswith(ENDINGS))
    if not files:
        raise BenchError(f"{folder} holds no CSV, CSV.gz or Parquet file.")
    names = header(files[0])
    time = time_column(names)
    columns = [n for n in names if n != time]
    if not columns:
        raise BenchError(f"{files[0]} has no column beside the time: log what drives the system and what it does.")
    wanted = _signals_of(system) if system else {}
    found = recognised(columns, wanted)
    if not system and set(found.signals) & {*MOTION, "pilot"}:
        system = "helicopter" if "pilot" in found.signals else "quadrotor"
    ending = next(e for e in ENDINGS[::-1] if files[0].name.endswith(e))
    lines = [
        f"name = {json.dumps(Path(os.path.realpath(folder)).name, ensure_ascii=False)}",
        *(
            [f'system = "{system}"' + ("" if wanted else "  # TODO: check; `bench list physics` names the others")]
            * bool(system)
        ),
        *_clock(files[0], time),
        f'files = "*{ending}"',
        f"time = {json.dumps(time, ensure_ascii=False)}" if time else 'time = "t"  # TODO: no column looks like time',
    ]
    if system:
        return "\n".join([*lines, *_of_system(system, wanted, found)]) + "\n"
    return "\n".join([*lines, *_of_networks(files[0], found)]) + "\n"


def _of_system(system: str, wanted: dict[str, str], found: Found) -> list[str]:
    """What follows the clock where a physics model is known."""
    driver = next((s for s in PHYSICS.get(system).input_signals if s in found.signals), None)
    missing = [s for s in wanted if s not in found.signals]
    return [
        *_driven(system, driver),
        "",
        "[signals]  # TODO: check every unit, and the frame of the velocity",
        *(f"{signal} = {entry}" for signal, entry in found.signals.items()),
        *(
            f'# TODO: {m} = {{columns = ["…"], unit = "{SIGNALS[m].unit}"}}, {wanted[m]}, if it was measured'
            for m in missing
        ),
        *(f"# TODO: what is column {json.dumps(n, ensure_ascii=False)}?" for n in found.left),
        "",
        *physics_lines(system, driver or ""),
    ]


def _of_networks(file: Path, found: Found) -> list[str]:
    """What follows the clock where there is no physics model: every column that holds numbers is a signal."""
    signals, inputs, other = dict(found.signals), [], []
    for column in found.left:
        if not _numeric(file, column):
            other.append(column)
            continue
        name, entry = own_signal(column, signals)
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
        '# targets = ["…"]  what is predicted; left out, all signals beside the input',
        "",
        f"# {NO_PHYSICS} With one, `bench data init FOLDER --system NAME` drafts its constants too.",
        "[signals]  # TODO: check every unit",
        *(f"{signal} = {entry}" for signal, entry in signals.items()),
        *(f"# column {json.dumps(n, ensure_ascii=False)} holds no numbers" for n in other),
    ]


def _clock(file: Path, time: str | None) -> list[str]:
    """The rate, as the time column of a file has it, and the unit of that column where it is not seconds."""
    t = _times(file, time) if time else np.empty(0)
    steps = np.diff(t)
    if len(steps) < 2 or not (period := float(np.median(steps))) > 0:
        return ["rate_hz = 100  # TODO: check"]
    unit = _time_unit(bare(time or ""), period)
    rate = 1 / (period * SECONDS[unit])
    uneven = float(np.mean(np.abs(steps - period) > 0.1 * period))
    overall = (len(t) - 1) / (t[-1] - t[0]) / SECONDS[unit]  # stamps may be rounded
    rate = overall if abs(overall - rate) < 0.1 * rate else rate
    rate = round(rate) if round(rate) and abs(rate - round(rate)) < 2e-3 * rate else float(f"{rate:.6g}")
    said = f"  # {uneven:.0%} of the steps of {file.name} are others: put on this rate" if uneven > 0.01 else ""
    lines = [f"rate_hz = {rate:g}{said or f'  # as {file.name} has it'}"]
    return lines if unit == "s" else [*lines, f'time_unit = "{unit}"']


def _times(file: Path, time: str) -> np.ndarray:
    try:
        return numbers(file, [time])[:, 0]
    except BenchError:
        return np.empty(0)  # `bench data check` says what is wrong with it


def _time_unit(name: str, period: float) -> str:
    """By the name of the time column, or where that is a stamp by the size of its steps."""
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


def physics_lines(system: str, drive: str) -> list[str]:
    """Of a drafted dataset.toml: the constants that it must state, without a value, and those that it may."""
    kind: Any = PHYSICS.get(system)
    own = [p.name for p in needed(kind, drive)]
    lines = {p.name: (json.dumps(p.value), f"# {p.unit}; {p.about}") for p in kind().parameters()}
    return [
        "# [physics]  # TODO: what this system has, SI; physics models need all of these, networks none",
        *(f"# {name} = …  {lines[name][1]}" for name in own),
        "# These may be left out, and are then as here:",
        *(f"# {name} = {value}  {about}" for name, (value, about) in lines.items() if name not in own),
    ]


def _signals_of(system: str) -> dict[str, str]:
    """Name → what it is to the system: what can be measured of its states, and what drives it."""
    model = PHYSICS.get(system)
    states = {c.group: "a state" for c in model.state_channels if c.group in SIGNALS}
    more = ("specific_force", "battery") if "attitude" in states else ()
    return states | {s: "what drives it" for s in model.input_signals} | {s: "which tells more" for s in more}


def _driven(system: str, driver: str | None) -> list[str]:
    if not PHYSICS.get(system).input_signals:
        return []
    named = f'input = "{driver}"' if driver else '# TODO: input = "…", the signal that drives the system'
    return [named, 'input_hold = "linear"  # TODO: "previous" if the input is a command']
