"""What a diagnosis costs as recordings become more: processor time and memory of `bench diagnose` on simulated flights.

The flights are made as those of `pelican_twin` (four hidden effects), as many as are asked for, in a
folder of CSV files as a user would bring it. Each diagnosis runs in a process of its own, and copies of it where there
is a second processor.
"""

import json
import os
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from registry.datasets.twin.quadrotor import flights
from registry.datasets.twin.reference import DT
from registry.errors import BenchError
from registry.physics.quadrotor import Quadrotor

ROWS = (6, 28, 100, 1000)
"""Recordings."""
QUICK = (6,)
SECONDS = 30.0
"""Of a recording."""
SEED = 7
"""Of the flights; `pelican_twin` has 0."""
_SIGNALS = {
    "rotor_speed": (("w1", "w2", "w3", "w4"), 'unit = "rad/s"'),
    "position": (("x", "y", "z"), 'unit = "m"'),
    "velocity": (("vx", "vy", "vz"), 'unit = "m/s", frame = "world"'),
    "attitude": (("qx", "qy", "qz", "qw"), 'unit = "1", convention = "quaternion_xyzw"'),
    "body_rates": (("p", "q", "r"), 'unit = "rad/s"'),
}
"""The first columns of `registry.datasets.twin.quadrotor.measure`."""


@dataclass(frozen=True)
class Cost:
    """What one diagnosis took."""

    recordings: int
    samples: int
    wall_s: float
    """From beginning to end."""
    cpu_s: float
    """Of the process and its copies, user and system."""
    peak_mb: float
    """Resident memory of the process at its peak."""
    effects: tuple[str, ...]
    """That were named."""


def seconds(recordings: int) -> float:
    """Roughly how long a diagnosis takes, for progress only."""
    return 30 + 0.15 * recordings


def measure(recordings: int, folder: Path) -> Cost:
    """Diagnose as many recordings, written to the empty ``folder``.

    Raises:
        BenchError: the diagnosis failed.
    """
    write(folder, recordings)
    return cost(folder, recordings, recordings * round(SECONDS / DT))


def cost(folder: Path, recordings: int, samples: int) -> Cost:
    """What the diagnosis of a folder of so many recordings takes.

    Raises:
        BenchError: it failed.
    """
    target, log = folder / "result.json", folder / "log"
    asked = [sys.executable, "-m", "bench", "diagnose", str(folder), "--json", str(target), "--no-track"]
    begun = time.monotonic()
    with log.open("w") as said:
        work = subprocess.Popen(asked, env={**os.environ, "OMP_NUM_THREADS": "1"}, stdout=said, stderr=said)
    try:
        _, status, used = os.wait4(work.pid, 0)  # the peak of this child alone
    except KeyboardInterrupt:
        work.kill()
        work.wait()
        raise
    wall, work.returncode = time.monotonic() - begun, os.waitstatus_to_exitcode(status)
    if work.returncode:
        last = log.read_text(encoding="utf-8", errors="replace").strip().rpartition("\n")[2]
        raise BenchError(f"The diagnosis of {recordings} recordings ended with exit code {work.returncode}: {last}")
    effects = tuple(str(e["id"]) for e in json.loads(target.read_text(encoding="utf-8"))["effects"])
    return Cost(recordings, samples, wall, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024, effects)


def write(folder: Path, recordings: int) -> None:
    """Write simulated flights and their dataset.toml, with the nominal constants."""
    logged, _ = flights(SEED, [round(SECONDS / DT)] * recordings)
    header = ",".join(["t", *(c for columns, _ in _SIGNALS.values() for c in columns)])
    for i, log in enumerate(logged):
        table = np.column_stack([np.arange(len(log)) * DT, log[:, : header.count(",")]])
        np.savetxt(folder / f"flight_{i:04d}.csv", table, fmt="%.9g", delimiter=",", header=header, comments="")
    stated = {p.name: p.value for p in Quadrotor().parameters()}
    lines = [
        'name = "flights"',
        'system = "quadrotor"',
        f"rate_hz = {1 / DT:g}",
        'files = "flight_*.csv"',
        'time = "t"',
    ]
    lines += ['input = "rotor_speed"', "", "[signals]"]
    lines += [f"{name} = {{columns = {json.dumps(columns)}, {how}}}" for name, (columns, how) in _SIGNALS.items()]
    lines += ["", "[physics]", *(f"{name} = {json.dumps(value)}" for name, value in stated.items())]
    (folder / "dataset.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
