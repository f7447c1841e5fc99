"""The nano-drone benchmark: 21 flights of a Crazyflie 2.1 with measured rotor speeds."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pandas as pd
from pyarrow import ArrowException
from typing_extensions import override

from registry.contracts import Dataset, Finding, Recording, RecordingSet, Split
from registry.core import DATASETS, option
from registry.datasets.locate import locate
from registry.datasets.reading.cleaning import airborne, delay, extent, held, resample, runs, smooth, spikes, widen
from registry.datasets.reading.rotations import euler_from_quaternion, euler_rates_from_body, rotate, unit_quaternion
from registry.datasets.signals import recording
from registry.errors import BenchError

RATE = 100.0
ERPM = 2 * np.pi / (6 * 60)
"""Electrical rpm to rad/s of the shaft, as the authors convert it."""
FASTEST = 2e5
"""Electrical rpm that no rotor reaches: the rest are telegram errors (up to 6e6)."""
JUMP = 0.3
"""Distance from the running median that no flight covers within 3 samples [m]."""
MAX_GAP = 0.06
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
    uncertainty: ClassVar[dict[str, float]] = {"inertia": 0.7, "torque_coefficient": 10.0, "thrust_coefficient": 0.05}
    """The inertia is another vehicle's. The published torque coefficient, .2 mm of the thrust's, is far too small for
    the yaw: that of a Crazyflie is 6 mm (`thrustToTorque` of Bitcraze's firmware)."""

    def __post_init__(self) -> None:
        if self.smoothing and (self.smoothing < 5 or self.smoothing % 2 == 0):
            raise BenchError(
                f"nanodrone.smoothing = {self.smoothing} must be 0 or an odd number of at least 5 samples."
            )

    @override
    def read(self) -> RecordingSet:
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
        return RecordingSet(tuple(recordings), tuple(findings))

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
        """The flight of a file, none where it is short, and what was found; ``common`` as `_training_lag` has it."""
        log = _read(file)
        x, measured = resample(log.t, log.state[log.kept], log.grid, MAX_GAP)
        speed, logged = log.rotor_speed()
        flying = airborne(x[:, 2], GROUND, MARGIN)
        lag, agreement = _lag(x, speed, flying & measured & logged)
        if self.align_lag:
            speed, logged = log.rotor_speed(later=lag if common is None else common)
        # The smoothing mixes what lies inside a gap into its neighbours.
        valid = flying & ~widen(~(measured & logged), self.smoothing // 2)
        part = extent(valid)
        done = "removed" if self.align_lag else "left in"
        if common is not None:
            done = f"{common:+.2f} removed, as of every flight"
        turns = f"the body turns {lag:+.2f} samples after the rotor speeds that turn it (correlation {agreement:.2f})"
        findings = [*_bridged(log, flying), *_masked(log, flying, valid, part)]
        findings.append(Finding(log.name, "lag", lag, f"{turns}, {done}"))
        if part.stop - part.start < RATE:
            findings.append(Finding(log.name, "short", len(log.grid), "less than 1 s of flight: left out"))
            return [], findings
        inputs = {"rotor_speed": speed[part]}
        outputs = {signal: values[part] for signal, values in _outputs(x, self.smoothing).items()}
        return [recording(log.name, RATE, inputs, outputs, valid[part])], findings


@dataclass(frozen=True, eq=False)
class _Log:
    """One file as it was received, a row a packet of the state (N,), and which rows measure something new."""

    name: str
    state: np.ndarray
    """(N, 17) `_STATE`."""
    motors: np.ndarray
    """(N, 4) `_MOTORS`, electrical rpm."""
    clocks: np.ndarray
    """(N, 2) when state and motors were received [s]."""
    jumps: np.ndarray
    """(N,) positions that no flight reaches."""
    kept: np.ndarray
    """(N,) rows whose state is used."""
    wild: np.ndarray
    """(N,) rotor speeds that no rotor has."""
    kept_motors: np.ndarray
    """(N,) rows whose rotor speeds are used."""

    @property
    def t(self) -> np.ndarray:
        """Reception of the states that are used [s]."""
        return self.clocks[self.kept, 0]

    @property
    def grid(self) -> np.ndarray:
        """Times of the recording's samples [s]."""
        return np.arange(self.t[0], self.t[-1], 1 / RATE)

    def rotor_speed(self, later: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """Rotor speeds (K, 4) [rad/s] on the grid, ``later`` [samples] than received; where there are any (K,)."""
        t = self.clocks[self.kept_motors, 1] + later / RATE
        erpm, valid = resample(t, self.motors[self.kept_motors], self.grid, MAX_GAP)
        return erpm * ERPM, valid


def _read(file: Path) -> _Log:
    try:
        table = pd.read_parquet(file, columns=[*_STATE, *_MOTORS, *_CLOCKS])
    except (OSError, ArrowException, ValueError, KeyError) as error:
        raise BenchError(f"{file} is damaged or not the published file ({error}): download it again.") from error
    if table.empty:
        raise BenchError(f"{file} holds a header and no samples: download it again.")
    state, motors, clocks = (table[c].to_numpy(dtype=float) for c in (_STATE, _MOTORS, _CLOCKS))
    fresh, fresh_motors = (np.diff(clock, prepend=-np.inf) > 0 for clock in clocks.T)
    jumps, wild = spikes(state[:, :3], JUMP), (motors > FASTEST).any(axis=1)
    log = _Log(
        name=file.stem,
        state=state,
        motors=motors,
        clocks=clocks,
        jumps=jumps,
        kept=fresh & ~held(state[:, :13]) & ~jumps & np.isfinite(state).all(axis=1),
        wild=wild,
        kept_motors=fresh_motors & ~wild & ~np.isnan(motors).any(axis=1),
    )
    if log.kept.sum() < 3 or log.kept_motors.sum() < 3:
        raise BenchError(f"{file} holds fewer than 3 usable samples: download it again.")
    return log


def _lag(x: np.ndarray, speed: np.ndarray, in_air: np.ndarray) -> tuple[float, float]:
    """By how many samples the body turns after the rotors that turn it, and the correlation then.

    Args:
        x: (K, 17) states on the grid.
        speed: (K, 4) of the rotors [rad/s].
        in_air: (K,) samples that count.
    """
    torque = smooth(speed**2, 9) @ np.column_stack([ARMS[:, 1], -ARMS[:, 0]])
    turning = np.gradient(smooth(x[:, 10:12], 9), axis=0)
    return delay(torque * in_air[:, None], turning * in_air[:, None], widest=6)


def _bridged(log: _Log, flying: np.ndarray) -> list[Finding]:
    """What was not a measurement of its own and is bridged from its neighbours; ``flying`` (K,) on the grid."""
    in_flight = np.interp(log.clocks[:, 0], log.grid, flying) > 0.5
    again = ~log.kept & ~log.jumps & in_flight
    lost = ~log.kept_motors & ~log.wild & in_flight
    counted = (
        ("spike", log.wild.sum(), f"rotor speeds above {FASTEST:.0f} electrical rpm, bridged"),
        ("spike", log.jumps.sum(), f"positions more than {JUMP} m from their neighbours, bridged"),
        ("held", again.sum(), "state samples that only repeat the last packet, bridged"),
        ("dropped", lost.sum(), "rotor-speed packets lost, bridged where short"),
    )
    findings = [Finding(log.name, kind, int(count), detail) for kind, count, detail in counted if count]
    pause = np.diff(log.t)
    if pause.max() > 1:
        at = int(pause.argmax())
        detail = f"the longest of them {pause[at]:.2f} s at {log.t[at] - log.t[0]:.2f} s; the column t shows none"
        count = int((pause > MAX_GAP).sum())
        findings.append(Finding(log.name, "pause", count, f"pauses of the reception clock, {detail}"))
    return findings


def _masked(log: _Log, flying: np.ndarray, valid: np.ndarray, part: slice) -> list[Finding]:
    """Gaps within the part of the grid that is kept, and what is cut off at its ends; ``flying``, ``valid`` (K,)."""
    findings = []
    for start, stop in runs(~valid[part]):
        at, end = part.start + start, part.start + stop
        reason = "packets lost" if flying[at:end].mean() > 0.5 else "on or near the ground"
        detail = f"{(stop - start) / RATE:.2f} s from {at / RATE:.2f} s: {reason}, masked"
        findings.append(Finding(log.name, "gap", stop - start, detail))
    if trimmed := len(log.grid) - (part.stop - part.start):
        detail = "samples of take-off and landing cut off at the ends"
        findings.append(Finding(log.name, "trimmed", trimmed, detail))
    return findings


def _outputs(x: np.ndarray, smoothing: int) -> dict[str, np.ndarray]:
    """Signal → values out of the states (K, 17) on the grid."""
    attitude, rates = unit_quaternion(x[:, 6:10]), smooth(x[:, 10:13], smoothing)
    return {
        "position": x[:, :3],
        "velocity": smooth(x[:, 3:6], smoothing),
        "attitude": attitude,
        "body_rates": rates,
        "euler_rates": euler_rates_from_body(euler_from_quaternion(attitude), rates),
        # Logged along the axes of the world, with the weight: there it is the acceleration (correlation .98).
        "specific_force": rotate(attitude * [-1.0, -1.0, -1.0, 1.0], x[:, 13:16]),
        "battery": x[:, 16:],
    }
