"""A first `dataset.toml` guessed from the headers of a folder's files."""

import json
import os
import re
from collections.abc import Collection
from pathlib import Path
from typing import Any

from registry.core import PHYSICS
from registry.datasets.tables import ENDINGS, header
from registry.errors import BenchError
from registry.stated import needed
from registry.units import SIGNALS

_GUESSES: tuple[tuple[str, str, tuple[str, ...]], ...] = (
    ("position", 'unit = "m"', ("x|px|pos_?x", "y|py|pos_?y", "z|pz|pos_?z")),
    ("attitude", 'unit = "1", convention = "quaternion_xyzw"', ("q_?x", "q_?y", "q_?z", "q_?w")),
    ("attitude", 'unit = "rad", convention = "euler_zyx"', ("roll|phi", "pitch|theta", "yaw|psi")),
    ("velocity", 'unit = "m/s", frame = "world"', ("v_?x|vel_?x", "v_?y|vel_?y", "v_?z|vel_?z")),
    ("body_rates", 'unit = "rad/s"', ("p|w_?x|gyro_?x|omega_?x", "q|w_?y|gyro_?y|omega_?y", "r|w_?z|gyro_?z|omega_?z")),
    ("specific_force", 'unit = "m/s^2", frame = "body"', ("a_?x|acc_?x", "a_?y|acc_?y", "a_?z|acc_?z")),
    ("battery", 'unit = "V"', ("v_?bat|battery|battery_voltage",)),
    ("pilot", 'unit = "1"', ("aileron", "elevator", "rudder", "collective")),
)
_NUMBERED = (
    ("rotor_speed", "rad/s", "(?:rotor|omega|rpm|motor_speed)_?"),
    ("rotor_command", "rad/s", "(?:cmd|command|rotor_cmd|rotor_command)_?"),
    ("pwm", "pwm", "(?:pwm|motor|m)_?"),
)
_NAMED: dict[str, str] = {
    "displacement": "q|x|y|pos|position|disp|displacement",
    "speed": "v|speed|vel|velocity|d[qx]|[qx]_?dot",
    "angle": "theta|phi|th|angle",
    "angle_rate": "omega|w|gyro|(?:theta|phi|angle)_?(?:dot|rate)|d(?:theta|phi)",
    "force": "f|u|force|input",
    "voltage": "u|v|volt|voltage|input",
    "level": "h|y|[hy]_?2|level|level_?2|lower|lower_?level",
    "upper_level": "[hy]_?1|level_?1|upper|upper_?level",
}
"""Of systems with one axis, whose names are too short to be guessed where the system is not named."""
_TIME = "t|time|timestamp|time_?s"


def draft(folder: str | Path, system: str = "") -> str:
    """The text of a `dataset.toml` for the files of ``folder``: guesses, and TODO lines for what is left.

    Args:
        folder: of the recordings.
        system: the physics model's registered name; "": a quadrotor or a helicopter, by the columns.

    Raises:
        BenchError: the folder holds no CSV or Parquet file, the first one cannot be read, the system is unknown, or
            none is named and no column looks like a signal of a vehicle.
    """
    folder = Path(folder)
    files = sorted(p for p in folder.glob("*") if p.name.endswith(ENDINGS))
    if not files:
        raise BenchError(f"{folder} holds no CSV, CSV.gz or Parquet file.")
    ending = next(e for e in ENDINGS[::-1] if files[0].name.endswith(e))
    names = header(files[0])
    left = list(names)

    wanted = _signals_of(system) if system else {}

    def take(pattern: str) -> str | None:
        return next((n for n in left if re.fullmatch(pattern, _bare(n), re.IGNORECASE)), None)

    time = take(_TIME)
    if time is not None:
        left.remove(time)
    signals: dict[str, str] = {}
    for signal, about, patterns in _guesses(wanted):
        columns = [take(p) for p in patterns]
        if signal not in signals and all(columns):
            signals[signal] = f"{{columns = {json.dumps(columns, ensure_ascii=False)}, {about}}}"
            left = [n for n in left if n not in columns]
    for signal, unit, prefix in _NUMBERED:
        numbered = sorted((n for n in left if re.fullmatch(prefix + r"\d+", n, re.IGNORECASE)), key=_number)
        if numbered and (not wanted or signal in wanted):
            signals[signal] = f'{{columns = {json.dumps(numbered, ensure_ascii=False)}, unit = "{unit}"}}'
            left = [n for n in left if n not in numbered]
    if not system:
        if not signals:
            raise BenchError(
                f"No column of {files[0].name} ({', '.join(names)}) looks like a signal of a vehicle: name the system "
                f"with --system, one of {', '.join(PHYSICS.names())}; `bench show NAME` lists its signals."
            )
        system = "helicopter" if "pilot" in signals else "quadrotor"
    driver = next((s for s in PHYSICS.get(system).input_signals if s in signals), None)
    missing = [s for s in wanted if s not in signals]
    lines = [
        f"name = {json.dumps(Path(os.path.realpath(folder)).name, ensure_ascii=False)}",
        f'system = "{system}"' + ("" if wanted else "  # TODO: check; `bench list physics` names the others"),
        "rate_hz = 100  # TODO: check",
        f'files = "*{ending}"',
        f"time = {json.dumps(time, ensure_ascii=False)}  # seconds"
        if time
        else 'time = "t"  # TODO: no column looks like time',
        *_driven(system, driver),
        "",
        "[signals]  # TODO: check every unit, and the frame of the velocity",
        *(f"{signal} = {entry}" for signal, entry in signals.items()),
        *(
            f'# TODO: {m} = {{columns = ["…"], unit = "{SIGNALS[m].unit}"}}, {wanted[m]}, if it was measured'
            for m in missing
        ),
        *(f"# TODO: what is column {json.dumps(n, ensure_ascii=False)}?" for n in left),
        "",
        *physics_lines(system, driver or ""),
    ]
    return "\n".join(lines) + "\n"


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


def _guesses(wanted: Collection[str]) -> list[tuple[str, str, tuple[str, ...]]]:
    """Signal, the rest of its entry, and a pattern for each of its columns."""
    if not wanted:
        return list(_GUESSES)
    found = [g for g in _GUESSES if g[0] in wanted]
    for signal in (s for s in wanted if s not in {g[0] for g in _GUESSES}):
        known = SIGNALS[signal]
        patterns = (_NAMED[signal] + f"|{signal}",) if signal in _NAMED else known.axes
        if patterns:
            found.append((signal, f'unit = "{known.unit}"', patterns))
    return found


def _driven(system: str, driver: str | None) -> list[str]:
    if not PHYSICS.get(system).input_signals:
        return []
    named = f'input = "{driver}"' if driver else '# TODO: input = "…", the signal that drives the system'
    return [named, 'input_hold = "linear"  # TODO: "previous" if the input is a command']


def _bare(name: str) -> str:
    """A column's name without a unit in brackets."""
    return re.sub(r"\s*[\[(][^\[(]*[\])]$", "", name.strip())


def _number(name: str) -> int:
    return int(re.search(r"\d+$", name).group())  # type: ignore[union-attr]
