"""A first `dataset.toml` guessed from the headers of a folder's files."""

import json
import re
from pathlib import Path

from registry.datasets.tables import ENDINGS, header
from registry.errors import BenchError

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
_TIME = "t|time|timestamp|time_?s"


def draft(folder: str | Path) -> str:
    """The text of a `dataset.toml` for the files of ``folder``: guesses, and TODO lines for what is left.

    Raises:
        BenchError: the folder holds no CSV or Parquet file, or the first one cannot be read.
    """
    folder = Path(folder)
    files = sorted(p for p in folder.glob("*") if p.name.endswith(ENDINGS))
    if not files:
        raise BenchError(f"{folder} holds no CSV, CSV.gz or Parquet file.")
    ending = next(e for e in ENDINGS[::-1] if files[0].name.endswith(e))
    names = header(files[0])
    left = list(names)

    def take(pattern: str) -> str | None:
        return next((n for n in left if re.fullmatch(pattern, n, re.IGNORECASE)), None)

    time = take(_TIME)
    if time is not None:
        left.remove(time)
    signals: dict[str, str] = {}
    for signal, about, patterns in _GUESSES:
        columns = [take(p) for p in patterns]
        if signal not in signals and all(columns):
            signals[signal] = f"{{columns = {json.dumps(columns, ensure_ascii=False)}, {about}}}"
            left = [n for n in left if n not in columns]
    for signal, unit, prefix in _NUMBERED:
        numbered = sorted((n for n in left if re.fullmatch(prefix + r"\d+", n, re.IGNORECASE)), key=_number)
        if numbered:
            signals[signal] = f'{{columns = {json.dumps(numbered, ensure_ascii=False)}, unit = "{unit}"}}'
            left = [n for n in left if n not in numbered]
    system = "helicopter" if "pilot" in signals else "quadrotor"
    driver = next((s for s in ("rotor_speed", "rotor_command", "pilot", "pwm") if s in signals), None)
    lines = [
        f"name = {json.dumps(folder.resolve().name, ensure_ascii=False)}",
        f'system = "{system}"  # TODO: check; `bench list physics` names the others',
        "rate_hz = 100  # TODO: check",
        f'files = "*{ending}"',
        f"time = {json.dumps(time, ensure_ascii=False)}  # seconds"
        if time
        else 'time = "t"  # TODO: no column looks like time',
        f'input = "{driver}"' if driver else '# TODO: input = "…", the signal that drives the system',
        'input_hold = "linear"  # TODO: "previous" if the input is a command',
        "",
        "[signals]  # TODO: check every unit, and the frame of the velocity",
        *(f"{signal} = {entry}" for signal, entry in signals.items()),
        *(f"# TODO: what is column {json.dumps(n, ensure_ascii=False)}?" for n in left),
        "",
        "# [physics]  # TODO: nominal constants, SI",
    ]
    return "\n".join(lines) + "\n"


def _number(name: str) -> int:
    return int(re.search(r"\d+$", name).group())  # type: ignore[union-attr]
