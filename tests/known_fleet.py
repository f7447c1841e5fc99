"""A fleet whose diagnosis is a matter of reading: each vehicle's one number stands in its data."""

import os
from pathlib import Path

import numpy as np

from bench.diagnose.result import (
    DataProblem,
    Diagnosis,
    Errors,
    GroupError,
    NamedEffect,
    ParameterEstimate,
    Unexplained,
)
from bench.fleet.members import Member
from bench.fleet.options import Options
from registry.dynamics import PhysicsModel
from registry.errors import BenchError
from registry.physics.falling_body import FallingBody

LOG = "KNOWN_FLEET_LOG"
"""Environment variable with the file to which every diagnosis appends the id of its vehicle."""
HALF = 0.01
"""Half of the 95 % interval of every number."""
DESCRIPTION = """name = "ball"
system = "falling_body"
rate_hz = 10
files = "*.csv"
time = "t"
"""
SIGNALS = '[signals]\ndisplacement = {columns = ["h"], unit = "m"}\n[physics]\nmass = 0.2\ngravity = 9.81\n'


def folder(path: Path, number: float, more: str = "") -> Path:
    """A vehicle in a folder of its own; 0: it lacks nothing, below 0: its data have a problem, NaN: none are there."""
    path.mkdir(parents=True)
    (path / "dataset.toml").write_text(DESCRIPTION + more + SIGNALS)
    write(path / "ball_0.csv", number)
    write(path / "ball_1.csv", number)
    return path


def write(path: Path, number: float, vehicle: str = "", date: str = "") -> None:
    own = [["tail", vehicle], ["day", date]] if vehicle else []
    head = ",".join(["t", "h", *(name for name, _ in own)])
    rows = [",".join([f"{t / 10:g}", f"{number:.6g}", *(value for _, value in own)]) for t in range(3)]
    path.write_text("\n".join([head, *rows]) + "\n")


def read(member: Member, options: Options) -> tuple[Diagnosis, PhysicsModel]:
    """In place of a diagnosis."""
    if LOG in os.environ:
        with Path(os.environ[LOG]).open("a") as log:
            log.write(f"{member.id}\n")
    (number,) = np.unique([np.loadtxt(f, delimiter=",", skiprows=1, usecols=1)[0] for f in member.folder.files])
    number = float(number)
    if np.isnan(number):
        raise BenchError(f"{member.path} holds no number.")
    if number == 13:
        raise ZeroDivisionError("a mistake of ours")
    errors = {"speed": GroupError(0.5, 0.2, "m/s")}
    estimate = ParameterEstimate(number, number - HALF, number + HALF, "kg/m")
    effect = NamedEffect("quadratic_drag", {"c": estimate}, 0.9, errors, errors)
    problem = DataProblem("ball_0", "displacement", "frozen", (0, 2), "frozen for 0.3 s")
    return Diagnosis(
        dataset=member.id,
        system="falling_body",
        verdict="named" if number > 0 else "nothing" if number == 0 else "data_problem",
        noise_floor=errors,
        error=Errors(errors, errors, {"speed": GroupError(0.5, 0.1, "m/s")}),
        effects=(effect,) if number > 0 else (),
        unexplained=Unexplained(0.0),
        where=(),
        data_problems=(problem,) if number < 0 else (),
    ), FallingBody(mass=0.2)


def interrupted(member: Member, options: Options) -> tuple[Diagnosis, PhysicsModel]:
    """Ctrl-C at the third vehicle."""
    if len(Path(os.environ[LOG]).read_text().splitlines()) == 2:
        raise KeyboardInterrupt
    return read(member, options)
