"""A case as a user would bring it: a folder of CSV files and a dataset.toml."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from bench.score.case import UNCERTAINTY, Case, Columns, fly, nominal
from bench.score.multirotor.flights import RATE
from bench.score.multirotor.measure import LEVELS, SMOOTHINGS

_COLUMNS = {
    "position": (("x", "y", "z"), "m"),
    "attitude": (("qx", "qy", "qz", "qw"), "1"),
    "velocity": (("vx", "vy", "vz"), "m/s"),
    "body_rates": (("p", "q", "r"), "rad/s"),
    "rotor_speed": (("rotor1", "rotor2", "rotor3", "rotor4"), "rad/s"),
    "rotor_command": (("cmd1", "cmd2", "cmd3", "cmd4"), "rad/s"),
    "battery": (("vbat",), "V"),
}
_EXTRA = {"attitude": ', convention = "quaternion_xyzw"', "velocity": ', frame = "world"'}


def write_folder(case: Case, path: Path, cache: Path, processing: bool = True) -> None:
    """Write the logs of ``case`` as ``path``/flight_*.csv, and dataset.toml; effects it knows go to model.toml.

    Args:
        case: what is flown.
        path: the folder; made where it does not exist.
        cache: of the flights.
        processing: whether dataset.toml states smoothing and noise.
    """
    write_logs(case, fly(case, cache), Path(path), processing)


def write_logs(case: Case, logs: list[Columns], path: Path, processing: bool = True) -> None:
    """Write logs as `write_folder` does."""
    path.mkdir(parents=True, exist_ok=True)
    signals = [name for name in _COLUMNS if name in logs[0]]
    header = ",".join(["t", *(c for name in signals for c in _COLUMNS[name][0])])
    for i, log in enumerate(logs):
        table = np.column_stack([log["t"], *(log[name] for name in signals)])
        np.savetxt(path / f"flight_{i:02d}.csv", table, fmt="%.9g", delimiter=",", header=header, comments="")
    (path / "dataset.toml").write_text(_description(case, signals, processing), encoding="utf-8")
    if case.known:
        lines = ['system = "quadrotor"', "", *_table("physics", nominal(case))]
        for name, values in case.known.items():
            lines += ["", "[[effects]]", f'id = "{name}"', *(f"{k} = {v!r}" for k, v in values.items())]
        (path / "model.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")


def _table(name: str, values: dict[str, Any]) -> list[str]:
    return [f"[{name}]", *(f"{key} = {json.dumps(value)}" for key, value in values.items())]


def _description(case: Case, signals: list[str], processing: bool) -> str:
    lines = [
        f'name = "{case.vehicle}"',
        'system = "quadrotor"',
        f"rate_hz = {RATE:g}",
        'files = "flight_*.csv"',
        'time = "t"',
        f'input = "{case.drive}"',
        f'input_hold = "{"previous" if case.drive == "rotor_command" else "linear"}"',
        "",
        "[signals]",
    ]
    for name in signals:
        columns, unit = _COLUMNS[name]
        lines.append(f'{name} = {{columns = {json.dumps(columns)}, unit = "{unit}"{_EXTRA.get(name, "")}}}')
    lines += ["", *_table("physics", nominal(case)), "", *_table("physics.uncertainty", dict(UNCERTAINTY))]
    if processing:
        how, noise = SMOOTHINGS[case.smoothing], LEVELS[case.noise]
        size = f", window = {how.window}" if how.kind != "none" else ""
        order = f", order = {how.order}" if how.kind == "savgol" else ""
        own = {"velocity": noise.velocity, "body_rates": noise.rates} if how.kind == "none" else {}
        sigma = {"position": noise.position, "attitude": float(noise.attitude), **own}
        listed = ", ".join(f"{k} = {v:.6g}" for k, v in sigma.items())
        lines += ["", "[processing]", f'smoothing = {{kind = "{how.kind}"{size}{order}}}', f"noise = {{{listed}}}"]
    lines += ["", "[environment]", "gravity = 9.81", "ground_z = 0.0", "air_density = 1.2"]
    return "\n".join(lines) + "\n"
