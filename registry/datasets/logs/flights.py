"""Flights as autopilots and robots log them, every signal with a clock of its own, on one clock as a folder.

In SI units, world z up, body x forward, y left, z up.
"""

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from registry.datasets.folder.constants import Constant, physics_lines
from registry.datasets.folder.description import FILE
from registry.datasets.logs.series import Log, Series
from registry.datasets.reading.cleaning import resample, runs
from registry.datasets.reading.rotations import unit_quaternion
from registry.errors import BenchError

FASTEST = 100.0
"""Sample rate that is chosen where the signals have it [Hz]."""
MAX_GAP = 5.0
"""Periods of a signal without a sample that are bridged; a longer gap cuts the recording in two."""
SHORTEST = 2.0
"""Recordings shorter than this are left out [s]."""
COMMANDS = ("rotor_command", "pwm")
"""Signals that are held until the next one."""
DRIVERS = ("rotor_speed", "rotor_command", "pwm")
"""What can drive a quadrotor, best first."""
PACE = ("position", "attitude", "body_rates", *DRIVERS)
"""Signals whose rates limit the common one."""
_COLUMNS: dict[str, tuple[tuple[str, ...], str]] = {
    "position": (("x", "y", "z"), 'unit = "m"'),
    "attitude": (("qx", "qy", "qz", "qw"), 'unit = "1", convention = "quaternion_xyzw"'),
    "velocity": (("vx", "vy", "vz"), 'unit = "m/s", frame = "world"'),
    "body_rates": (("p", "q", "r"), 'unit = "rad/s"'),
    "specific_force": (("ax", "ay", "az"), 'unit = "m/s^2", frame = "body"'),
    "rotor_speed": (("rotor",), 'unit = "rad/s"'),
    "rotor_command": (("cmd",), 'unit = "rad/s"'),
    "pwm": (("pwm",), 'unit = "pwm"'),
    "battery": (("vbat",), 'unit = "V"'),
}
"""Columns of each signal (a prefix where the count is open), and how the description has it."""


def write(logs: Mapping[str, Log], folder: Path, rate: float | None, known: Mapping[str, Constant]) -> list[str]:
    """The logs as CSV files with a drafted dataset.toml; what was done, in sentences.

    Args:
        logs: by the name that a recording gets.
        folder: made where it does not exist.
        rate: common sample rate [Hz]; None: that of the slowest of `PACE`, 100 Hz at most.
        known: constants of the vehicle that the logs do not state.

    Raises:
        BenchError: a log lacks the motion or its cause, or the folder cannot be written.
    """
    common = set.intersection(*(set(log.signals) for log in logs.values()))
    driver = next((d for d in DRIVERS if d in common), None)
    for name, log in logs.items():
        if "attitude" not in log.signals:
            raise BenchError(f"{name} holds no attitude: log vehicle_attitude (PX4) or nav_msgs/Odometry (ROS).")
    if driver is None:
        raise BenchError(
            "The files hold no motor signal that all of them have: log esc_status, actuator_motors or "
            "actuator_outputs (PX4), or an Actuators or RCOut message (ROS)."
        )
    signals = [s for s in _COLUMNS if s in common]
    counts = {s: min(log.signals[s].values.shape[1] for log in logs.values()) for s in signals}
    if rate is None:
        slowest = min(log.signals[s].rate for log in logs.values() for s in signals if s in PACE)
        rate = float(min(FASTEST, np.floor(slowest + 0.5) if slowest >= 1 else slowest))
    said: list[str] = []
    tables: dict[str, np.ndarray] = {}
    for name, log in logs.items():
        parts = _gridded({s: log.signals[s] for s in signals}, rate)
        for i, (t, values) in enumerate(parts, start=1):
            label = name if len(parts) == 1 else f"{name}_part{i}"
            tables[label] = np.column_stack([t - t[0], *(values[s][:, : counts[s]] for s in signals)])
        seconds = sum(len(t) for t, _ in parts) / rate
        sources = ", ".join(f"{s} from {log.signals[s].source} ({log.signals[s].rate:.0f} Hz)" for s in signals)
        said.append(f"{name}: {seconds:.1f} s in {len(parts)} recording(s) at {rate:g} Hz: {sources}.")
        slow = [s for s in signals if log.signals[s].rate < 0.7 * rate and s != "battery"]
        if slow:
            said.append(f"{name}: {', '.join(slow)} came slower than {rate:g} Hz: values between samples are made up.")
    if not tables:
        raise BenchError(f"No file holds {SHORTEST:g} s in which all signals were logged at once.")
    left = sorted({s for log in logs.values() for s in log.signals} - common)
    if left:
        said.append(f"Left out, because not every file has it: {', '.join(left)}.")
    _write(folder, tables, signals, counts, rate, driver, known)
    return said


def _gridded(log: Mapping[str, Series], rate: float) -> list[tuple[np.ndarray, Mapping[str, np.ndarray]]]:
    """Stretches in which all signals are there: times (N,) and values by signal (N, c)."""
    first, last = max(s.t[0] for s in log.values()), min(s.t[-1] for s in log.values())
    if last - first < SHORTEST:
        return []
    grid = first + np.arange(int((last - first) * rate + 1e-6) + 1) / rate
    whole, values = np.ones(len(grid), dtype=bool), {}
    for name, s in log.items():
        x = unit_quaternion(s.values) if name == "attitude" else s.values
        moved, valid = resample(s.t, x, grid, MAX_GAP / min(s.rate, rate))
        if name in COMMANDS:
            moved = x[np.clip(np.searchsorted(s.t, grid + 1e-9, side="right") - 1, 0, len(x) - 1)]
        values[name] = unit_quaternion(moved) if name == "attitude" else moved
        whole &= valid
    stretches = [(a, b) for a, b in runs(whole) if (b - a) / rate >= SHORTEST]
    return [(grid[a:b], {s: x[a:b] for s, x in values.items()}) for a, b in stretches]


def _write(
    folder: Path,
    tables: Mapping[str, np.ndarray],
    signals: Sequence[str],
    counts: Mapping[str, int],
    rate: float,
    driver: str,
    known: Mapping[str, Constant],
) -> None:
    names = {s: _names(s, counts[s]) for s in signals}
    header = ",".join(["t", *(c for s in signals for c in names[s])])
    lines = [
        f"name = {json.dumps(Path(os.path.realpath(folder)).name, ensure_ascii=False)}",
        'system = "quadrotor"  # TODO: check; `bench list physics` names the others',
        f"rate_hz = {rate:g}",
        'files = "*.csv"',
        'time = "t"',
        f'input = "{driver}"',
        f'input_hold = "{"previous" if driver in COMMANDS else "linear"}"',
        "",
        "[signals]  # SI; world z up, body x forward, y left, z up",
        *(f"{s} = {{columns = {json.dumps(names[s])}, {_COLUMNS[s][1]}}}" for s in signals),
        "",
        "# rotor_positions and rotor_directions go in the order of the motor columns; x forward, y left",
        *physics_lines("quadrotor", driver, known),
    ]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, table in tables.items():
            np.savetxt(folder / f"{name}.csv", table, fmt="%.9g", delimiter=",", header=header, comments="")
        (folder / FILE).write_text("\n".join(lines) + "\n", encoding="utf-8")
    except OSError as error:
        raise BenchError(f"{folder} cannot be written: {error.strerror or error}.") from error


def _names(signal: str, count: int) -> list[str]:
    columns = _COLUMNS[signal][0]
    return list(columns) if len(columns) > 1 or signal == "battery" else [f"{columns[0]}{i + 1}" for i in range(count)]
