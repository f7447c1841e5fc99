"""The nano-drone benchmark: 21 flights of a Crazyflie 2.1 with measured rotor speeds."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pandas as pd
from pyarrow import ArrowException

from registry.contracts import Dataset, Finding, Loaded, Recording, Split
from registry.core import DATASETS, option
from registry.datasets.cleaning import airborne, delay, extent, held, resample, runs, smooth, spikes, widen
from registry.datasets.locate import locate
from registry.datasets.rotations import euler_from_quaternion, euler_rates_from_body, rotate, unit_quaternion
from registry.datasets.signals import recording
from registry.errors import BenchError

RATE = 100.0
ERPM = 2 * np.pi / (6 * 60)
"""Electrical rpm to rad/s of the shaft, as the authors convert it."""
FASTEST = 2e5
"""Electrical rpm that no rotor reaches: the rest are telegram errors (up to 6e6)."""
JUMP = 0.3
"""Distance from the running median that no flight covers within 3 samples [m]."""
LONGEST = 0.06
"""Lost packets are bridged up to this distance between two received ones [s]."""
GROUND, MARGIN = 0.3, 150
"""Flight is above this height [m], and this many samples away from take-off and landing."""
ARMS = np.array([[1, -1], [-1, -1], [-1, 1], [1, 1]])
"""Where the rotors are (forward, left): front-right, rear-right, rear-left, front-left."""
_STATE = ["x", "y", "z", "vx", "vy", "vz", "qx", "qy", "qz", "qw", "wx", "wy", "wz", "ax", "ay", "az", "Vbat"]
_MOTORS = [f"m{i}_erpm" for i in range(1, 5)]
_ARM = 0.0353
"""Of the hubs, along x and y [m]."""
_CLOCKS = ["ros_timestamp_x", "ros_timestamp_y"]


@DATASETS.register("nanodrone")
@dataclass(frozen=True)
class Nanodrone(Dataset):
    """Crazyflie 2.1 brushless, 21 flights at 100 Hz with measured rotor speeds [rad/s]; 20 minutes.

    Position [m] and velocity [m/s] in the world, attitude xyzw, body and Euler rates [rad/s], specific force [m/s²],
    battery [V]. Packets are put back on the clock of their reception; lost ones are bridged, long losses are masked.
    Published split: `melon` is only for testing.
    """

    align_lag: bool = option(
        True, "shift rotor speeds by each flight's own delay, so that they act when the body moves"
    )
    common_lag: bool = option(
        False,
        "shift every flight by the median delay of the training flights instead of its own: test flights tell nothing "
        "about theirs",
    )
    smoothing: int = option(
        7,
        "window of the local quadratic through velocity and body rates, odd, looking (window - 1) / 2 ahead; 0: none. "
        "7 samples come near the published constant row at one step too, which unsmoothed data do not",
        unit="samples",
        low=0,
        high=31,
    )

    source: ClassVar[str] = (
        "R. Busetto, E. Cereda, M. Forgione, G. Maroni, D. Piga, D. Palossi, Nonlinear System Identification "
        "Nano-drone Benchmark, arXiv:2512.14450; https://github.com/idsia-robotics/nanodrone-sysid-benchmark, "
        "no licence stated"
    )
    system: ClassVar[str] = "quadrotor"
    inputs: ClassVar[tuple[str, ...]] = ("rotor_speed",)
    targets: ClassVar[tuple[str, ...]] = ("body_rates",)
    chain: ClassVar[tuple[str, ...]] = ("velocity", "body_rates")
    physics: ClassVar[dict[str, Any]] = {
        "mass": 0.045,
        "inertia": (1.43e-5, 1.43e-5, 2.89e-5),  # of another Crazyflie: not published for this one
        "thrust_coefficient": 3.72e-8,
        "torque_coefficient": 7.74e-12,
        "rotor_positions": ((_ARM, -_ARM, 0.0), (-_ARM, -_ARM, 0.0), (-_ARM, _ARM, 0.0), (_ARM, _ARM, 0.0)),
        "rotor_directions": (-1.0, 1.0, -1.0, 1.0),
        "rotor_radius": 0.0275,
    }
    uncertainty: ClassVar[dict[str, float]] = {"inertia": 0.7, "torque_coefficient": 2.0, "thrust_coefficient": 0.05}
    """The inertia is another vehicle's, and the published torque coefficient is far too small for the yaw."""

    def __post_init__(self) -> None:
        if self.smoothing and (self.smoothing < 5 or self.smoothing % 2 == 0):
            raise BenchError(
                f"nanodrone.smoothing = {self.smoothing} must be 0 or an odd number of at least 5 samples."
            )

    def read(self) -> Loaded:
        """See `Dataset.read`."""
        files = locate(
            "nanodrone_idsia/raw_parquet",
            "*.parquet",
            "https://github.com/idsia-robotics/nanodrone-sysid-benchmark (data/real/raw/parquets at f17f6b3)",
            "melon_20251017_run1.parquet has SHA-256 7231f4feba572efe38ed604bb1c5031427efa633842fb17251ce8e4e487b77b4",
        )
        recordings, findings = [], []
        common = self._training_lag(files) if self.align_lag and self.common_lag else None
        for file in files:
            flight, found = self._flight(file, common)
            recordings += flight
            findings += found
        return Loaded(tuple(recordings), tuple(findings))

    def split(self, names: Sequence[str]) -> Split:
        """Melon tests, as published; of the other kinds the last flight of each validates (our choice)."""
        test = tuple(n for n in names if n.startswith("melon"))
        kinds: dict[str, list[str]] = {}
        for name in sorted(set(names) - set(test)):
            kinds.setdefault(name.partition("_")[0], []).append(name)
        validation = tuple(flights[-1] for flights in kinds.values())
        return Split(tuple(n for n in names if n not in test and n not in validation), validation, test)

    def _training_lag(self, files: Sequence[Path]) -> float:
        """Median delay [samples] of the flights that do not test."""
        test = self.split([file.stem for file in files]).test
        found = [f for file in files if file.stem not in test for f in self._flight(file)[1]]
        return float(np.median([f.count for f in found if f.kind == "lag"]))

    def _flight(self, file: Path, common: float | None = None) -> tuple[list[Recording], list[Finding]]:
        name = file.stem
        try:
            table = pd.read_parquet(file, columns=[*_STATE, *_MOTORS, *_CLOCKS])
        except (OSError, ArrowException, ValueError, KeyError) as error:
            raise BenchError(f"{file} is damaged or not the published file ({error}): download it again.") from error
        if table.empty:
            raise BenchError(f"{file} holds a header and no samples: download it again.")
        state, motors, clocks = (table[c].to_numpy(dtype=float) for c in (_STATE, _MOTORS, _CLOCKS))
        findings: list[Finding] = []

        def note(kind: str, count: float, detail: str) -> None:
            if count:
                findings.append(Finding(name, kind, count, detail))

        jumps = spikes(state[:, :3], JUMP)
        fresh = np.diff(clocks[:, 0], prepend=-np.inf) > 0
        kept = fresh & ~held(state[:, :13]) & ~jumps & np.isfinite(state).all(axis=1)
        wild = (motors > FASTEST).any(axis=1)
        missing = np.isnan(motors).any(axis=1)
        kept_motors = (np.diff(clocks[:, 1], prepend=-np.inf) > 0) & ~wild & ~missing
        t, t_motors = clocks[kept, 0], clocks[kept_motors, 1]
        if len(t) < 3 or len(t_motors) < 3:
            raise BenchError(f"{file} holds fewer than 3 usable samples: download it again.")
        grid = np.arange(t[0], t[-1], 1 / RATE)
        x, valid = resample(t, state[kept], grid, LONGEST)
        erpm, motors_valid = resample(t_motors, motors[kept_motors], grid, LONGEST)
        attitude = unit_quaternion(x[:, 6:10])
        flying = airborne(x[:, 2], GROUND, MARGIN)
        in_air = flying & valid & motors_valid

        torque = smooth((erpm * ERPM) ** 2, 9) @ np.column_stack([ARMS[:, 1], -ARMS[:, 0]])
        turning = np.gradient(smooth(x[:, 10:12], 9), axis=0)
        lag, agreement = delay(torque * in_air[:, None], turning * in_air[:, None], widest=6)
        if self.align_lag:
            shift = lag if common is None else common
            erpm, motors_valid = resample(t_motors + shift / RATE, motors[kept_motors], grid, LONGEST)
        # The smoothing mixes what lies inside a gap into its neighbours.
        valid = flying & ~widen(~(valid & motors_valid), self.smoothing // 2)
        part = extent(valid)

        on_clock = np.interp(clocks[:, 0], grid, flying) > 0.5
        note("spike", int(wild.sum()), f"rotor speeds above {FASTEST:.0f} electrical rpm, bridged")
        note("spike", int(jumps.sum()), f"positions more than {JUMP} m from their neighbours, bridged")
        note("held", int((~kept & ~jumps & on_clock).sum()), "state samples that only repeat the last packet, bridged")
        note("dropped", int((~kept_motors & ~wild & on_clock).sum()), "rotor-speed packets lost, bridged where short")
        pause = np.diff(t)
        if pause.max() > 1:
            at = int(pause.argmax())
            detail = f"the longest of them {pause[at]:.2f} s at {t[at] - t[0]:.2f} s; the column t shows none"
            note("pause", int((pause > LONGEST).sum()), f"pauses of the reception clock, {detail}")
        for start, stop in runs(~valid[part]):
            at, end = part.start + start, part.start + stop
            reason = "packets lost" if flying[at:end].mean() > 0.5 else "on or near the ground"
            note("gap", stop - start, f"{(stop - start) / RATE:.2f} s from {at / RATE:.2f} s: {reason}, masked")
        note("trimmed", len(grid) - (part.stop - part.start), "samples of take-off and landing cut off at the ends")
        done = "removed" if self.align_lag else "left in"
        if common is not None:
            done = f"{common:+.2f} removed, as of every flight"
        findings.append(
            Finding(
                name,
                "lag",
                lag,
                f"the body turns {lag:+.2f} samples after the rotor speeds that turn it (correlation {agreement:.2f}), "
                + done,
            )
        )
        if part.stop - part.start < RATE:
            note("short", len(grid), "less than 1 s of flight: left out")
            return [], findings
        rates = smooth(x[:, 10:13], self.smoothing)
        outputs = {
            "position": x[:, :3],
            "velocity": smooth(x[:, 3:6], self.smoothing),
            "attitude": attitude,
            "body_rates": rates,
            "euler_rates": euler_rates_from_body(euler_from_quaternion(attitude), rates),
            # Logged along the axes of the world, with the weight: there it is the acceleration (correlation .98).
            "specific_force": rotate(attitude * [-1.0, -1.0, -1.0, 1.0], x[:, 13:16]),
            "battery": x[:, 16:],
        }
        return [
            recording(
                name,
                RATE,
                {"rotor_speed": erpm[part] * ERPM},
                {signal: values[part] for signal, values in outputs.items()},
                valid[part],
            )
        ], findings
