"""CrazyPAD: hops of a Crazyflie 2.1 with small weights taped near its motors."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from typing_extensions import override

from registry.contracts import Channel, Dataset, Finding, Recording, RecordingSet, Split
from registry.core import DATASETS, option
from registry.datasets.crazyflie import CONSTANTS, UNCERTAINTY
from registry.datasets.locate import locate
from registry.datasets.logs.formats.usd import read_usd_log
from registry.datasets.reading.cleaning import airborne, extent, resample, runs
from registry.errors import BenchError
from registry.units import to_si

RATE = 100.0
MAX_GAP = 0.03
"""Missing samples are bridged up to this distance between two logged ones [s]."""
GROUND, MARGIN = 0.25, 20
"""Flight is above this height [m], and this many samples away from take-off and landing."""
FULL = 65535.0
"""Largest motor command."""
_MIX = np.array([[-1, 1, 1], [-1, -1, -1], [1, -1, 1], [1, 1, -1]])
"""Signs of roll, pitch and yaw command in motors 1–4 (front-right, rear-right, rear-left, front-left)."""
_POSITION = [f"stateEstimate.{axis}" for axis in "xyz"]
_RATES = [f"controller.r_{axis}" for axis in ("roll", "pitch", "yaw")]
_COMMANDS = [f"controller.cmd_{axis}" for axis in ("roll", "pitch", "yaw")]


@DATASETS.register("crazypad")
@dataclass(frozen=True)
class Crazypad(Dataset):
    """Crazyflie 2.1, two vehicles (E8, E9) with and without taped weights, 100 Hz, 20 logs of two hops each.

    Position [m] is the on-board estimate, body rates [rad/s] the gyroscope, the vertical specific force [m/s²] the
    accelerometer. The motor commands (0–65535) are put together from the logged thrust, roll, pitch and yaw commands
    as the firmware does, before it makes up for the battery's voltage. Neither velocity nor attitude was logged.
    """

    vehicle: str = option("all", "which vehicle", choices=("all", "E8", "E9"))
    weight: str = option(
        "all",
        "which flights",
        choices=("all", "normal", "W1_near_M3", "W3_near_M3", "W1_near_M4", "W1_near_M3_M4"),
    )

    source: ClassVar[str] = (
        "CrazyPAD (Crazyflie Propeller Anomaly Data), https://github.com/AerialRoboticsUUST/CrazyPAD, MIT, "
        "commit 5448265"
    )
    system: ClassVar[str] = "quadrotor"
    inputs: ClassVar[tuple[str, ...]] = ("pwm",)
    targets: ClassVar[tuple[str, ...]] = ("body_rates",)
    physics: ClassVar[dict[str, Any]] = CONSTANTS
    # Neither velocity nor attitude was logged: of all these only torque over inertia shows, for which inertia stands.
    uncertainty: ClassVar[dict[str, float]] = dict.fromkeys(UNCERTAINTY, 0.0) | {
        "gravity": 0.0,
        "inertia": 0.7,
        "torque_coefficient": 0.7,
    }

    @override
    def read(self) -> RecordingSet:
        files = locate(
            "crazypad_mass_prop",
            "controller_data/*/E?_log[0-9][0-9]",
            "https://github.com/AerialRoboticsUUST/CrazyPAD (data/controller_data at 5448265)",
            "normal_flight/E9_log00 has SHA-256 358100a9845755841fa0ab1febc8238e8d0a6515ff387b5b6a2bba0c3aaeb904",
        )
        recordings, findings = [], []
        for file in files:
            weight = file.parent.name.removeprefix("add_weight_").removesuffix("_flight")
            vehicle, _, number = file.name.partition("_log")
            if self.vehicle in ("all", vehicle) and self.weight in ("all", weight):
                flight, found = _flight(file, f"{vehicle}_{weight}_{number}")
                recordings += flight
                findings += found
        if not recordings:
            raise BenchError(f"crazypad holds no flight of vehicle {self.vehicle} with weight {self.weight}.")
        return RecordingSet(tuple(recordings), tuple(findings))

    def split(self, names: Sequence[str]) -> Split:
        """Of each vehicle and weight the last flight tests and the one before validates (our choice)."""
        kinds: dict[str, list[str]] = {}
        for name in sorted(names):
            kinds.setdefault(name.rpartition("_")[0], []).append(name)
        test = tuple(flights[-1] for flights in kinds.values() if len(flights) > 1)
        validation = tuple(flights[-2] for flights in kinds.values() if len(flights) > 2)
        return Split(tuple(n for n in names if n not in test and n not in validation), validation, test)


def _flight(file: Path, name: str) -> tuple[list[Recording], list[Finding]]:
    t, log = read_usd_log(file)
    wanted = [*_POSITION, *_RATES, *_COMMANDS, "controller.actuatorThrust", "controller.accelz"]
    for variable in wanted:
        if variable not in log:
            raise BenchError(f"{file} has no variable {variable}: download it again.")
    table = np.column_stack([log[variable] for variable in wanted])
    good = np.isfinite(table).all(axis=1) & (np.diff(t, prepend=-np.inf) > 0)
    if good.sum() < RATE:
        return [], [Finding(name, "short", len(t), "less than 1 s of usable samples: left out")]
    t = t - t[0]
    grid = np.arange(t[good][0], t[good][-1] + 1e-6, 1 / RATE)
    x, valid = resample(t[good], table[good], grid, MAX_GAP)
    position, rates, commands, thrust = x[:, :3], x[:, 3:6] * (1, -1, 1), x[:, 6:9], x[:, 9]
    pwm = np.clip(thrust[:, None] + (commands * (0.5, 0.5, 1.0)) @ _MIX.T, 0, FULL)
    running = thrust > 0
    flying = airborne(np.where(running, position[:, 2], -np.inf), GROUND, MARGIN)
    valid &= flying
    part = extent(valid)
    findings = [Finding(name, "trimmed", len(grid) - (part.stop - part.start), "samples on the ground cut off")]
    for start, stop in runs(~valid[part]):
        at, end = part.start + start, part.start + stop
        reason = (
            f"motors off for {(~running[at:end]).sum() / RATE:.2f} s of them" if not running[at:end].all() else "low"
        )
        detail = f"{(stop - start) / RATE:.2f} s from {at / RATE:.2f} s between two hops ({reason}), masked"
        findings.append(Finding(name, "gap", stop - start, detail))
    full = int(((pwm >= FULL) | (pwm <= 0))[valid].sum())
    if full:
        findings.append(Finding(name, "saturated", full, "motor commands at 0 or 65535, kept"))
    if part.stop - part.start < RATE:
        return [], [*findings, Finding(name, "short", len(grid), "less than 1 s of flight: left out")]
    outputs = np.column_stack([position, rates, x[:, 10] * to_si("g")[1]])[part]
    channels = (
        *(Channel(f"position.{axis}", "m") for axis in "xyz"),
        *(Channel(f"body_rates.{axis}", "rad/s") for axis in "pqr"),
        Channel("specific_force.z", "m/s^2"),
    )
    motors = tuple(Channel(f"pwm.{i}", "pwm") for i in range(1, 5))
    return [
        Recording(
            name, RATE, pwm[part], outputs=outputs, input_channels=motors, output_channels=channels, valid=valid[part]
        )
    ], findings
