"""NanoBench: tracking flights of a Crazyflie 2.1 under motion capture."""

import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pandas as pd
from typing_extensions import override

from registry.contracts import Dataset, Finding, Recording, RecordingSet, Split
from registry.core import DATASETS, option
from registry.datasets.crazyflie import CONSTANTS, UNCERTAINTY
from registry.datasets.locate import locate
from registry.datasets.reading.cleaning import airborne, delay, extent, held, resample, runs, spikes
from registry.datasets.reading.rotations import euler_from_quaternion, euler_rates_from_body, unit_quaternion
from registry.datasets.signals import recording
from registry.errors import BenchError
from registry.units import to_si

RATE = 100.0
MAX_GAP = 0.06
"""Missing samples are bridged up to this distance between two measured ones [s]."""
CLIMB, MARGIN = 0.15, 50
"""Flight is this far above the lowest point [m], and this many samples away from take-off and landing."""
GLITCH = {"position": 0.1, "velocity": 0.5, "body_rates": 2.0, "specific_force": 10.0}
"""Distance from the running median that only a glitch has (m, m/s, rad/s, m/s²)."""
WIDEST = 15
"""Samples that the clocks of the vehicle and of the motion capture may be apart."""
ON_BOARD = ("gyroscope", "specific_force", "pwm", "battery")
"""What the vehicle measured, on its own clock."""
_GYROSCOPE = {"gyroscope": ["imu_gyro_x", "imu_gyro_y", "imu_gyro_z"]}
_COLUMNS = {
    "position": ["px", "py", "pz"],
    "velocity": ["vx", "vy", "vz"],
    "attitude": ["qx", "qy", "qz", "qw"],
    "body_rates": ["wx_vicon", "wy_vicon", "wz_vicon"],
    "specific_force": ["imu_acc_x", "imu_acc_y", "imu_acc_z"],
    "pwm": [f"motor_motor_m{i}" for i in range(1, 5)],
    "battery": ["pwr_pm_vbat"],
}


@DATASETS.register("nanobench")
@dataclass(frozen=True)
class Nanobench(Dataset):
    """Crazyflie 2.1 tracking flights, 100 Hz, with the PWM commands (0–65535) of the motors; 37 flights.

    Motion-capture position [m], velocity [m/s], attitude xyzw and body rates [rad/s], all on one clock; what the
    vehicle measured is mostly within a sample of it and up to twelve off, differently in every flight. Specific force
    [m/s²] is the on-board accelerometer, with that delay. Ground parts are cut off.
    """

    gyroscope: bool = option(
        False,
        "body rates are the on-board gyroscope's, and all that the vehicle measured is shifted by the whole samples "
        "with which that agrees best with the motion capture, whose rates are differences of poses: noise from 6 Hz on",
    )

    source: ClassVar[str] = (
        "NanoBench (IROS 2026), https://github.com/syediu/nanobench-iros2026, BSD-3-Clause, commit 0ae7d68"
    )
    system: ClassVar[str] = "quadrotor"
    inputs: ClassVar[tuple[str, ...]] = ("pwm", "battery")
    targets: ClassVar[tuple[str, ...]] = ("body_rates",)
    chain: ClassVar[tuple[str, ...]] = ("velocity", "body_rates")
    input_hold: ClassVar[str] = "previous"
    physics: ClassVar[dict[str, Any]] = CONSTANTS
    uncertainty: ClassVar[dict[str, float]] = UNCERTAINTY

    @property
    @override
    def finer_signals(self) -> dict[str, str]:
        return {} if self.gyroscope else {"body_rates": "gyroscope=true"}

    @override
    def read(self) -> RecordingSet:
        files = locate(
            "nanobench",
            "*.csv*",
            "https://github.com/syediu/nanobench-iros2026 (datasets/dataset at 0ae7d68)",
            "B2_circle_fast_rep1.csv has SHA-256 221e337203c009491d27e4feef7baef246f971e3219ffa305d1b71641e64afd7",
        )
        recordings, findings = [], []
        for file in files:
            flight, found = _flight(file, self.gyroscope)
            recordings += flight
            findings += found
        return RecordingSet(tuple(recordings), tuple(findings))

    def split(self, names: Sequence[str]) -> Split:
        """Of every trajectory with two or more flights the last tests; of those, every third one's first validates
        (our choice: none is published)."""
        kinds: dict[str, list[str]] = {}
        for name in sorted(names):
            kinds.setdefault(name.rpartition("_rep")[0], []).append(name)
        repeated = [flights for flights in kinds.values() if len(flights) > 1]
        test = tuple(flights[-1] for flights in repeated)
        validation = tuple(flights[0] for flights in repeated[::3])
        return Split(tuple(n for n in names if n not in test and n not in validation), validation, test)


def _flight(file: Path, gyroscope: bool) -> tuple[list[Recording], list[Finding]]:
    name = file.name.partition(".")[0]
    groups = {**_COLUMNS, **(_GYROSCOPE if gyroscope else {})}
    columns = [c for group in groups.values() for c in group]
    try:
        table = pd.read_csv(file, usecols=["t", *columns], dtype=float, engine="c")
    except (OSError, ValueError, EOFError, zlib.error) as error:
        raise BenchError(f"{file} is damaged or not the published file ({error}): download it again.") from error
    if table.empty:
        raise BenchError(f"{file} holds a header and no samples: download it again.")
    t, x = table["t"].to_numpy(), {group: table[c].to_numpy() for group, c in groups.items()}
    findings: list[Finding] = []

    def note(kind: str, count: float, detail: str) -> None:
        if count:
            findings.append(Finding(name, kind, count, detail))

    x["specific_force"] = x["specific_force"] * to_si("g")[1]
    note("held", int(held(x["pwm"]).sum()), "PWM commands equal to the one before, kept: commands are held")
    good = (np.diff(t, prepend=-np.inf) > 0) & np.isfinite(np.column_stack([t, *x.values()])).all(axis=1)
    up = x["position"][:, 2] > np.nanmin(x["position"][:, 2]) + CLIMB
    for group, limit in GLITCH.items():
        wild = spikes(x[group], limit)
        # The motion capture is one measurement: a glitch in any part of it makes the sample doubtful.
        good &= ~wild
        note("spike", int((wild & up).sum()), f"{group} more than {limit} from its neighbours, bridged")
    if good.sum() < RATE:
        note("short", len(t), "less than 1 s of usable samples: left out")
        return [], findings
    t = t - t[0]
    grid = np.arange(t[good][0], t[good][-1] + 1e-6, 1 / RATE)
    stacked = np.column_stack(list(x.values()))
    values, valid = resample(t[good], stacked[good], grid, MAX_GAP)
    bounds = np.cumsum([v.shape[1] for v in x.values()])[:-1]
    x = dict(zip(x, np.split(values, bounds, axis=1), strict=True))
    note("dropped", int((np.diff(t) > 1.5 / RATE).sum()), "pauses of the clock, bridged where short")
    height = x["position"][:, 2]
    flying = airborne(height, height.min() + CLIMB, MARGIN)
    valid = flying & (_on_one_clock(x, valid & flying, note) if gyroscope else valid)
    part = extent(valid)
    for start, stop in runs(~valid[part]):
        note("gap", stop - start, f"{(stop - start) / RATE:.2f} s from {(part.start + start) / RATE:.2f} s, masked")
    note("trimmed", len(grid) - (part.stop - part.start), "samples on the ground cut off at the ends")
    if part.stop - part.start < RATE:
        note("short", len(grid), f"less than 1 s of flight more than {CLIMB} m above the lowest point: left out")
        return [], findings
    x = {group: v[part] for group, v in x.items()}
    attitude = unit_quaternion(x["attitude"])
    outputs = {
        "position": x["position"],
        "velocity": x["velocity"],
        "attitude": attitude,
        "body_rates": x["body_rates"],
        "euler_rates": euler_rates_from_body(euler_from_quaternion(attitude), x["body_rates"]),
        "specific_force": x["specific_force"],
    }
    inputs = {"pwm": x["pwm"], "battery": x["battery"]}
    return [recording(name, RATE, inputs, outputs, valid[part])], findings


def _on_one_clock(x: dict[str, np.ndarray], valid: np.ndarray, note: Callable[[str, float, str], None]) -> np.ndarray:
    """Shift in ``x`` what the vehicle measured so that its gyroscope turns with the motion capture, and take its rates.

    Returns:
        Which samples are valid (N,).
    """
    counted = valid[:, None]
    lag, agreement = delay(x["body_rates"] * counted, x["gyroscope"] * counted, widest=WIDEST)
    note("lag", lag, f"the vehicle is {lag:+.2f} samples late (correlation {agreement:.2f}), whole ones removed")
    late, there = round(lag), np.arange(len(valid))
    for group in ON_BOARD:
        x[group] = np.roll(x[group], -late, axis=0)
    x["body_rates"] = x["gyroscope"]
    return valid & np.roll(valid, -late) & (there + late >= 0) & (there + late < len(valid))
