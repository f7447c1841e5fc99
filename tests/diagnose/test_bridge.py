"""A motor on a bridge that is off between pulses: its brake acts while the bridge is on, as voltage times speed.

By plain numpy; friction falls as the motor warms, and only the speed was logged.
"""

from pathlib import Path

import numpy as np
import pytest
from test_steps import written

from bench.diagnose import diagnose
from bench.diagnose.logs.load import load

MOTOR = """
from dataclasses import dataclass
from typing import Any

from registry.contracts import Channel
from registry.dynamics import constant, tensor
from registry.physics.state_space import Mechanical
from registry.units import Signal


@dataclass(frozen=True)
class Motor(Mechanical):
    mass: Any = constant(1e-6, "J", "kg m^2", low=1e-9)
    resistance: Any = constant(10, "R", "ohm", low=1e-3)
    torque_constant: Any = constant(0.004, "K", "N m/A", low=1e-4)
    friction: Any = constant(1e-6, "B", "N m s/rad", low=0)
    state_channels = (Channel("angle.shaft", "rad"), Channel("angle_rate.shaft", "rad/s"))
    input_signals = ("voltage",)
    signals = {"voltage": Signal("V", ("",))}
    equation = "J dω/dt = K (u − K ω) / R − B ω"

    def own_force(self, state, inputs):
        numbers = (self.resistance, self.torque_constant, self.friction)
        r, k, b = (tensor(n, state).unsqueeze(-1) for n in numbers)
        return k * (inputs[..., :1] - k * state[..., 1:]) / r - b * state[..., 1:]
"""
CONSTANTS = """mass = 1e-6
resistance = 10
torque_constant = 0.004
friction = 1e-6
[physics.uncertainty]
mass = 0.5
resistance = 0.5
torque_constant = 0.5
friction = 0.5
"""
SUPPLY, PULL, BRAKE, DRY, VISCOUS, WARMTH = 5.0, 4000.0, 2.1, 7700.0, 0.2, 2.0
"""[V], then by volt of the mean [rad/s² per V, 1/s per V], of friction [rad/s², 1/s] and what it loses [rad/s³]."""


def bridged(folder: Path, air: float = 0.0) -> Path:
    """One run of 96 s at 50 Hz, another duty every .2 s or more.

    ``air`` [1/rad] brakes with the speed's square, and cools: friction falls without it only.
    """
    rng, parts = np.random.default_rng(3), []
    while sum(map(len, parts)) < 4800:
        parts.append(np.full(10 * rng.integers(1, 4), rng.uniform(2.9, 4.65)))
    volts, speed, w, fine = np.concatenate(parts)[:4800], np.zeros(4800), 900.0, 50
    for k, u in enumerate(volts):
        speed[k] = w
        for _ in range(fine):
            dry = DRY - (0.0 if air else WARMTH * k / 50)
            w += (PULL * u - BRAKE * u * w - dry - VISCOUS * w - air * w * w) / 50 / fine
    speed = speed + rng.normal(0, 5, len(speed))
    words = {"signal": "angle_rate", "unit": "rad/s", "drive": "voltage", "of_drive": "V", "constant": CONSTANTS}
    return written(folder, MOTOR, 50, [np.column_stack([volts, speed])], **words)


@pytest.mark.parametrize(("air", "told"), [(0.0, "time"), (0.002, "angle_rate.shaft")])
def test_what_goes_with_the_speed_is_told_of_the_speed_and_not_of_the_time(
    tmp_path: Path, air: float, told: str
) -> None:
    """What the speed becomes holds what is to be explained, whatever the cause; voltage times time had been told.

    A fan's brake on the same shaft is learned as a function of the speed, and without it how friction falls: what is
    sought can be found.
    """
    folder = bridged(tmp_path / "bridged", air)
    found, _ = diagnose(load(folder, f"{folder}/mine.py:Motor"), brief=True, catalogue=["actuator_lag"])
    (learned,) = found.effects
    assert learned.name == f"angle_rate.shaft ~ {told}"
    assert air or learned.parameters["k"].low < WARMTH < learned.parameters["k"].high
