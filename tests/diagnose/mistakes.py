"""Flights of three vehicles as folders, and the mistakes that people make when they describe such folders."""

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.signal import savgol_filter
from scipy.spatial.transform import Rotation, Slerp

from bench.score.case import Case, fly, nominal
from registry.core import DATASETS
from registry.physics.quadrotor import Quadrotor

Log = dict[str, np.ndarray]
NED = np.array([1.0, -1.0, -1.0])
COLUMNS = {
    "position": (["x", "y", "z"], {"unit": "m"}),
    "velocity": (["vx", "vy", "vz"], {"unit": "m/s", "frame": "world"}),
    "attitude": (["qx", "qy", "qz", "qw"], {"unit": "1", "convention": "quaternion_xyzw"}),
    "body_rates": (["p", "q", "r"], {"unit": "rad/s"}),
    "specific_force": (["ax", "ay", "az"], {"unit": "m/s^2", "frame": "body"}),
    "rotor_speed": (["m1", "m2", "m3", "m4"], {"unit": "rad/s"}),
    "rotor_command": (["m1", "m2", "m3", "m4"], {"unit": "rad/s"}),
}
EULER = (["roll", "pitch", "yaw"], {"unit": "rad", "convention": "euler_zyx"})


@dataclass
class Set:
    """Recordings and how they are described."""

    logs: list[Log]
    drive: str
    physics: dict[str, object]
    rate: float = 100.0
    columns: dict[str, tuple[list[str], dict[str, object]]] = field(default_factory=dict)

    def write(self, folder: Path, mend: tuple[str, ...] = ()) -> Path:
        """The folder; lines of ``mend`` stand for those that they are about."""
        folder.mkdir(parents=True, exist_ok=True)
        for old in folder.glob("*.csv"):
            old.unlink()
        for i, log in enumerate(self.logs):
            names = [n for n in self.columns if n in log]
            table = {"t": log["t"], **{c: v for n in names for c, v in zip(self.columns[n][0], log[n].T, strict=True)}}
            pd.DataFrame(table).to_csv(folder / f"flight_{i}.csv", index=False, float_format="%.7g")
        own = {line.split(" = ", 1)[0]: line for line in mend}
        head = ['name = "set"', 'system = "quadrotor"', f"rate_hz = {self.rate:g}", 'files = "*.csv"', 'time = "t"']
        head.append(own.pop("input", f'input = "{self.drive}"'))
        lines = [
            own.pop(n, self._line(n))
            for n in self.columns
            if n in self.logs[0] and not (n == self.drive and "pwm" in own)
        ]
        lines += [own.pop("pwm")] if "pwm" in own else []
        constants = [own.pop(n, f"{n} = {json.dumps(v)}") for n, v in self.physics.items()]
        text = [*head, "[signals]", *lines, "[physics]", *constants, *own.values()]
        (folder / "dataset.toml").write_text("\n".join(text) + "\n", encoding="utf-8")
        return folder

    def _line(self, name: str) -> str:
        columns, how = self.columns[name]
        return f"{name} = {{columns = {json.dumps(columns)}, " + ", ".join(f'{k} = "{v}"' for k, v in how.items()) + "}"


def flown(vehicle: str, cache: Path, recordings: int = 4, seconds: float = 12.0, seed: int = 0) -> Set:
    """Flights with drag: a Hummingbird and a Crazyflie (with motors that lag) of RotorPy's, or a Pelican twin."""
    if vehicle == "pelican":
        data = DATASETS.get("pelican_twin")().load().recordings
        chosen = [r for r in data if "aggressive" in r.name or "moderate" in r.name] or list(data)
        logs, drive, model = [], "rotor_speed", Quadrotor()
        for r in chosen[seed : seed + recordings]:
            log = {n: r.pick([n])[0] for n in ("position", "velocity", "attitude", "body_rates", drive)}
            logs.append({"t": np.arange(len(r)) / r.rate, **log})
        names = ("mass", "inertia", "thrust_coefficient", "torque_coefficient", "rotor_positions", "rotor_directions")
        physics = {n: getattr(model, n) for n in names}
    else:
        drive = "rotor_command" if vehicle == "crazyflie" else "rotor_speed"
        hidden = {"rotor_drag": {"k_d": 1.19e-4 if vehicle == "hummingbird" else 5.1e-6}}
        hidden |= {"motor_lag": {"tau_up": 0.05, "tau_down": 0.05}} if vehicle == "crazyflie" else {}
        case = Case(
            vehicle,
            vehicle,
            "aggressive",
            hidden,
            drive=drive,
            recordings=recordings,
            seconds=seconds,
            flight_seed=40 + seed,
        )
        logs, physics = (
            [{n: v for n, v in log.items() if n in COLUMNS or n == "t"} for log in fly(case, cache)],
            nominal(case),
        )
        for log in logs:
            log.pop("rotor_speed" if drive == "rotor_command" else "rotor_command")
    for i, log in enumerate(logs):
        log["specific_force"] = accelerometer(log, np.random.default_rng([seed, i]))
    return Set(
        logs, drive, dict(physics), columns={n: (list(c), dict(h)) for n, (c, h) in COLUMNS.items() if n in logs[0]}
    )


def accelerometer(log: Log, rng: np.random.Generator) -> np.ndarray:
    """What the flight is felt like (N, 3) [m/s²], with a sensor's noise."""
    a = savgol_filter(log["velocity"], 7, 2, deriv=1, delta=0.01, axis=0) + np.array([0, 0, 9.81])
    felt: np.ndarray = Rotation.from_quat(log["attitude"]).inv().apply(a) + rng.normal(0, 0.1, a.shape)
    return felt


def each(change: Callable[[Log], object]) -> Callable[[Set], None]:
    """A mistake that is in the logs."""

    def spoil(s: Set) -> None:
        for log in s.logs:
            change(log)

    return spoil


def _put(log: Log, name: str, values: np.ndarray) -> None:
    log[name] = np.ascontiguousarray(values)


def _euler(s: Set, order: str = "ZYX", factor: float = 1.0) -> None:
    s.columns["attitude"] = EULER
    for log in s.logs:
        angles = Rotation.from_quat(log["attitude"]).as_euler(order)
        _put(log, "attitude", factor * (angles[:, ::-1] if order == "ZYX" else angles))


def _flip(log: Log, names: tuple[str, ...]) -> None:
    for name in names:
        _put(log, name, log[name] * (NED if name != "attitude" else np.array([1.0, -1.0, -1.0, 1.0])))


def _body(log: Log) -> None:
    _put(log, "velocity", Rotation.from_quat(log["attitude"]).inv().apply(log["velocity"]))


def _linear(log: Log) -> None:
    weight = Rotation.from_quat(log["attitude"]).inv().apply(np.tile([0, 0, 9.81], (len(log["t"]), 1)))
    _put(log, "specific_force", log["specific_force"] - weight)


def _scaled(name: str, factor: float) -> Callable[[Set], None]:
    return each(lambda log: _put(log, name, log[name] * factor))


def _picked(name: str, order: list[int], signs: tuple[int, ...] = (1, 1, 1, 1)) -> Callable[[Set], None]:
    return each(lambda log: _put(log, name, log[name][:, order] * signs[: len(order)]))


def _ordered(*order: int) -> Callable[[Set], None]:
    """Rotors logged as rotor 1 in the column where ``order`` has 1."""

    def spoil(s: Set) -> None:
        for log in s.logs:
            _put(log, s.drive, log[s.drive][:, [i - 1 for i in order]])

    return spoil


def _late(name: str, by: float) -> Callable[[Set], None]:
    def change(log: Log) -> None:
        t = log["t"]
        when = np.clip(t - by, t[0], t[-1])
        if name == "attitude":
            _put(log, name, Slerp(t, Rotation.from_quat(log[name]))(when).as_quat())
        else:
            _put(log, name, np.stack([np.interp(when, t, v) for v in log[name].T], axis=1))

    return each(change)


def _directions(s: Set) -> None:
    s.physics["rotor_directions"] = [-x for x in s.physics["rotor_directions"]]  # type: ignore[attr-defined]


def _hubs(s: Set) -> None:
    s.physics["rotor_positions"] = [[x, -y, z] for x, y, z in s.physics["rotor_positions"]]  # type: ignore[attr-defined]


def _drive_scaled(factor: float) -> Callable[[Set], None]:
    def spoil(s: Set) -> None:
        for log in s.logs:
            _put(log, s.drive, log[s.drive] * factor)

    return spoil


def _normalised(s: Set) -> None:
    """Commands from 0 to 1 that were taken for rotor speeds."""
    top = 1.2 * max(log[s.drive].max() for log in s.logs)
    _drive_scaled(1 / top)(s)


def _noise(s: Set) -> None:
    """The columns of something else."""
    for i, log in enumerate(s.logs):
        _put(log, s.drive, log[s.drive].mean() * (1 + 0.1 * np.random.default_rng(i).normal(size=log[s.drive].shape)))


def _stated(name: str, factor: float) -> Callable[[Set], object]:
    """A constant as it is in another unit."""

    def spoil(s: Set) -> None:
        s.physics[name] = (factor * np.asarray(s.physics[name], dtype=float)).tolist()

    return spoil


MISTAKES: dict[str, tuple[tuple[Callable[[Set], object], str, str], ...]] = {
    "quaternion order": ((_picked("attitude", [3, 0, 1, 2]), "quaternion order", "attitude"),),
    "angles": (
        (lambda s: _euler(s, factor=180 / np.pi), "unit", "attitude"),
        (lambda s: _euler(s, "XYZ"), "euler convention", "attitude"),
    ),
    "north-east-down": (
        (
            each(lambda log: _flip(log, ("position", "velocity", "attitude", "body_rates", "specific_force"))),
            "frame",
            "position",
        ),
        (each(lambda log: _flip(log, ("position", "velocity"))), "frame", "position"),
        (each(lambda log: _flip(log, ("body_rates",))), "frame", "body_rates"),
        (each(lambda log: _flip(log, ("attitude",))), "frame", "attitude"),
    ),
    "frame of the velocity": ((each(_body), "frame", "velocity"),),
    "unit of the motion": (
        (_scaled("position", 1000.0), "unit", "position"),
        (_scaled("velocity", 100.0), "unit", "velocity"),
        (lambda s: [_scaled(n, 1000.0)(s) for n in ("position", "velocity")], "unit", "position"),
    ),
    "body rates": (
        (_scaled("body_rates", 180 / np.pi), "unit", "body_rates"),
        (_picked("body_rates", [0, 1, 2], (1, -1, 1)), "swapped sign", "body_rates"),
        (_picked("body_rates", [1, 0, 2]), "swapped axes", "body_rates"),
    ),
    "accelerometer": (
        (each(_linear), "gravity", "specific_force"),
        (_scaled("specific_force", 1 / 9.80665), "unit", "specific_force"),
        (_scaled("specific_force", -1.0), "swapped sign", "specific_force"),
    ),
    "rotor order": (
        (_ordered(1, 3, 2, 4), "rotor order", "drive"),
        (_ordered(2, 3, 4, 1), "rotor order", "drive"),
        (_ordered(4, 3, 2, 1), "rotor order", "drive"),
        (_hubs, "rotor positions", "drive"),
    ),
    "rotor directions": ((_directions, "rotor directions", "drive"),),
    "unit of the rotors": (
        (_drive_scaled(30 / np.pi), "unit", "drive"),
        (_normalised, "input scale", "drive"),
    ),
    "unit of a constant": (
        (_stated("mass", 1e3), "unit", "drive"),
        (_stated("rotor_positions", 1e3), "unit", "drive"),
        (_stated("thrust_coefficient", 1e3), "unit", "drive"),
    ),
    "clocks": (
        (_late("attitude", 0.03), "clock offset", "attitude"),
        (_late("specific_force", 0.04), "clock offset", "specific_force"),
        (_late("body_rates", 0.03), "clock offset", "body_rates"),
    ),
    "no effect": ((_noise, "no effect", "drive"),),
}
"""By what it is about: how to make the mistake, and the kind and first signal that must be named."""
VEHICLES = ("hummingbird", "crazyflie", "pelican")
