"""A case on disk, as a user would bring it: CSV files and a dataset.toml that says nothing of how they were made."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from bench.score.chain.condition import ChainCase

_COLUMNS = {
    "position": (("x", "y", "z"), "m", ""),
    "attitude": (("qx", "qy", "qz", "qw"), "1", ', convention = "quaternion_xyzw"'),
    "velocity": (("vx", "vy", "vz"), "m/s", ', frame = "world"'),
    "body_rates": (("p", "q", "r"), "rad/s", ""),
    "rotor_speed": (("rotor1", "rotor2", "rotor3", "rotor4"), "rad/s", ""),
    "rotor_command": (("cmd1", "cmd2", "cmd3", "cmd4"), "rad/s", ""),
    "battery": (("vbat",), "V", ""),
    "specific_force": (("ax", "ay", "az"), "m/s^2", ', frame = "body"'),
}


def write(
    path: Path,
    case: "ChainCase",
    constants: dict[str, Any],
    uncertainty: dict[str, float] | None,
    logs: list[dict[str, np.ndarray]],
) -> None:
    """Write the logs as ``path``/flight_*.csv, dataset.toml, and known effects as model.toml.

    Logs that are driven by commands hold no rotor speeds: who has them, has no use for the commands.
    """
    hidden = "rotor_speed" if case.drive == "rotor_command" else ""
    signals = [name for name in _COLUMNS if name in logs[0] and name != hidden]
    header = ",".join(["t", *(c for name in signals for c in _COLUMNS[name][0])])
    for i, log in enumerate(logs):
        table = np.column_stack([log["t"], *(log[name] for name in signals)])
        np.savetxt(path / f"flight_{i + 1}.csv", table, fmt="%.8g", delimiter=",", header=header, comments="")
    lines = [
        f'name = "{case.vehicle}"',
        'system = "quadrotor"',
        f"rate_hz = {case.log_hz}",
        'files = "flight_*.csv"',
        'time = "t"',
        f'input = "{case.drive}"',
        f'input_hold = "{"previous" if hidden else "linear"}"',
        "",
        "[signals]",
    ]
    for name in signals:
        columns, unit, more = _COLUMNS[name]
        lines.append(f'{name} = {{columns = {json.dumps(columns)}, unit = "{unit}"{more}}}')
    lines += ["", *_table("physics", constants)]
    if uncertainty is not None:
        lines += ["", *_table("physics.uncertainty", uncertainty)]
    lines += ["", "[environment]", "gravity = 9.81", "ground_z = 0.0", "air_density = 1.2"]
    (path / "dataset.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    if case.known:
        lines = ['system = "quadrotor"', "", *_table("physics", constants)]
        for effect, values in case.known.items():
            lines += ["", "[[effects]]", f'id = "{effect}"', *(f"{k} = {v!r}" for k, v in values.items())]
        (path / "model.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")


def _table(name: str, values: dict[str, Any]) -> list[str]:
    return [f"[{name}]", *(f"{key} = {json.dumps(value)}" for key, value in values.items())]
