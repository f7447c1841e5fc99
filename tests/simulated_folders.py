"""What simulators of others are driven by, and how their flights become folders as a user would bring them."""

from pathlib import Path
from typing import Any

import numpy as np

Array = np.ndarray
GRAVITY = 9.81


def tracking(turned: Array, off: Array, pace: Array, bend: Array, heading: float, rates: Array, mass: float,
             inertia: Array) -> tuple[float, Array]:  # fmt: skip
    """Thrust [N] and torques (3,) [N m] of a geometric tracking controller (Lee, Leok and McClamroch, 2010).

    Args:
        turned: (3, 3) attitude, body to world.
        off: (3,) by how much the path is elsewhere [m].
        pace: (3,) by how much it is faster [m/s].
        bend: (3,) its acceleration [m/s²].
        heading: [rad].
        rates: (3,) about the body's axes [rad/s].
        mass: [kg].
        inertia: (3,) [kg m²].
    """
    push = mass * (np.add(bend, (0, 0, GRAVITY)) + 6 * off + 3.5 * pace)
    up = push / np.linalg.norm(push)
    side = np.cross(up, (np.cos(heading), np.sin(heading), 0))
    side /= np.linalg.norm(side)
    wanted = np.column_stack([np.cross(side, up), side, up])
    miss = (wanted.T @ turned - turned.T @ wanted) / 2
    torque = inertia * (-120 * np.array([miss[2, 1], miss[0, 2], miss[1, 0]]) - 18 * rates)
    return max(float(push @ turned[:, 2]), 0.2 * mass * GRAVITY), torque


def save(folder: Path, run: int, table: np.ndarray, header: str) -> None:
    """Write one recording."""
    folder.mkdir(parents=True, exist_ok=True)
    np.savetxt(folder / f"run_{run}.csv", table, "%.9g", ",", header=header, comments="")


QUADROTOR = "t,x,y,z,vx,vy,vz,qw,qx,qy,qz,p,q,r,w1,w2,w3,w4"
"""Columns of a flight."""


def describe_quadrotor(folder: Path, rate: int, hold: str, **physics: Any) -> None:
    """Write dataset.toml of flights with the columns `QUADROTOR`."""
    signals = {
        "position": ('"x", "y", "z"', "m", ', frame = "world"'),
        "velocity": ('"vx", "vy", "vz"', "m/s", ', frame = "world"'),
        "attitude": ('"qw", "qx", "qy", "qz"', "1", ', convention = "quaternion_wxyz"'),
        "body_rates": ('"p", "q", "r"', "rad/s", ""),
        "rotor_speed": ('"w1", "w2", "w3", "w4"', "rad/s", ""),
    }
    physics["rotor_positions"] = [list(map(float, h)) for h in physics["rotor_positions"]]
    describe(folder, "quadrotor", rate, drive="rotor_speed", hold=hold, signals=signals, physics=physics)


def describe(folder: Path, system: str, rate: int, *, drive: str, hold: str, signals: Any, physics: Any) -> None:
    """Write dataset.toml."""
    lines = [
        f'name = "{folder.name}"',
        f'system = "{system}"',
        f"rate_hz = {rate}",
        'files = "run_*.csv"',
        'time = "t"',
    ]
    lines += [f'input = "{drive}"', f'input_hold = "{hold}"', "[signals]"]
    lines += [f'{n} = {{columns = [{c}], unit = "{u}"{more}}}' for n, (c, u, more) in signals.items()]
    lines += ["[physics]", *(f"{n} = {v}" for n, v in physics.items())]
    (folder / "dataset.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
