"""What steps drive and of which one state is logged: a shaft's speed by plain numpy, a temperature by SciPy's exact
discrete system."""

from pathlib import Path

import numpy as np
import pytest
from scipy.signal import cont2discrete
from test_worth import OVEN

from bench.diagnose import diagnose
from bench.diagnose.logs.load import load
from bench.diagnose.logs.noise import noise_of

SHAFT = """
from dataclasses import dataclass
from typing import Any

from registry.contracts import Channel
from registry.dynamics import constant, tensor
from registry.physics.state_space import Mechanical
from registry.units import Signal


@dataclass(frozen=True)
class Motor(Mechanical):
    mass: Any = constant(2e-4, "J", "kg m^2", low=1e-9)
    state_channels = (Channel("angle.shaft", "rad"), Channel("angle_rate.shaft", "rad/s"))
    input_signals = ("voltage",)
    signals = {"voltage": Signal("V", ("",))}
    equation = "J dω/dt = .05 (u − .05 ω) / 1.2"

    def own_force(self, state, inputs):
        return 0.05 * (inputs[..., :1] - 0.05 * state[..., 1:]) / 1.2
"""
DESCRIBED = """
name = "stepped"
rate_hz = {rate}
files = "*.csv"
time = "t"
input = "{drive}"
input_hold = "previous"
[signals]
{signal} = {{columns = ["y"], unit = "{unit}"}}
{drive} = {{columns = ["u"], unit = "{of_drive}"}}
[physics]
{constant}
"""
INERTIA, DAMPING, GAIN, FRICTION, NOISE = 2e-4, 0.05**2 / 1.2, 0.05 / 1.2, 4e-3, 0.2


def written(folder: Path, system: str, rate: float, recordings: list[np.ndarray], **words: str) -> Path:
    """A folder of recordings (N, 2) of what drives and what is measured."""
    folder.mkdir()
    (folder / "mine.py").write_text(system)
    (folder / "dataset.toml").write_text(DESCRIBED.format(rate=rate, **words))
    for i, table in enumerate(recordings):
        timed = np.column_stack([np.arange(len(table)) / rate, table])
        np.savetxt(folder / f"run_{i}.csv", timed, delimiter=",", header="t,u,y", comments="", fmt="%.6f")
    return folder


def shafts(folder: Path, friction: float) -> Path:
    """Six runs of 20 s at 100 Hz, another voltage every quarter of a second; friction may hold the shaft."""
    rng, made, fine = np.random.default_rng(4), [], 50
    for _ in range(6):
        volts, speed, w = np.repeat(rng.uniform(-12, 12, 80), 25), np.zeros(2000), 0.0
        for k, u in enumerate(volts):
            speed[k] = w
            for _ in range(fine):
                free = w + (GAIN * u - DAMPING * w) / INERTIA / 100 / fine
                w = np.sign(free) * max(abs(free) - friction / INERTIA / 100 / fine, 0.0)
        made.append(np.column_stack([volts, speed + rng.normal(0, NOISE, len(speed))]))
    words = {"signal": "angle_rate", "unit": "rad/s", "drive": "voltage", "of_drive": "V", "constant": "mass = 2e-4"}
    return written(folder, SHAFT, 100, made, **words)


def ovens(folder: Path, lag: float, rate: float = 1.0) -> Path:
    """Six runs of 800 samples, a time constant of 50 s behind a heater with another one; noise of .02 K."""
    rng, made = np.random.default_rng(5), []
    a = np.array([[-1 / 50, 1 / 100], [0, -1 / lag]])
    ad, bd, *_ = cont2discrete((a, np.array([[0], [1 / lag]]), np.eye(2), np.zeros((2, 1))), 1 / rate)
    for _ in range(6):
        power, warm = np.repeat(rng.uniform(20, 180, 20), 40), np.zeros(800)
        x = np.array([30.0, power[0]])  # the heater is as long on as a lag that nobody saw begin is taken to be
        for k, u in enumerate(power):
            warm[k] = 290 + x[0]
            x = ad @ x + bd[:, 0] * u
        made.append(np.column_stack([power, warm + rng.normal(0, 0.02, len(warm))]))
    words = {"signal": "temperature", "unit": "K", "drive": "power", "of_drive": "W", "constant": "capacity = 100.0"}
    return written(folder, OVEN, rate, made, **words)


@pytest.mark.parametrize("friction", [0.0, FRICTION])
def test_corners_that_steps_leave_in_a_speed_are_no_noise(tmp_path: Path, friction: float) -> None:
    """They had made a noise of 24 rad/s of .2, and a filter over 25 samples, the length of the steps."""
    folder = shafts(tmp_path / "shafts", friction)
    noise = noise_of(load(folder, f"{folder}/mine.py:Motor"))
    assert noise.raw[1] == pytest.approx(NOISE, rel=0.03)
    assert noise.smoothing.kind == "none"


def test_of_a_shaft_whose_speed_alone_was_logged_friction_is_named_and_nothing_else(tmp_path: Path) -> None:
    """A joint that bends had been named, and forecasts erred 21 times as much as without."""
    folder = shafts(tmp_path / "shafts", FRICTION)
    found, _ = diagnose(load(folder, f"{folder}/mine.py:Motor"))
    (effect,) = found.effects
    assert effect.id == "coulomb_friction"
    assert effect.parameters["f_c"].value == pytest.approx(FRICTION, rel=0.05)
    assert effect.error_after["angle_rate"].rmse < 1.25 * found.noise_floor["angle_rate"].rmse


def test_nothing_is_named_where_a_shaft_lacks_nothing(tmp_path: Path) -> None:
    folder = shafts(tmp_path / "shafts", 0.0)
    found, _ = diagnose(load(folder, f"{folder}/mine.py:Motor"))
    assert found.verdict == "nothing"


@pytest.mark.parametrize("lag", [4.0, 15.0])
def test_a_lag_of_seconds_is_found_in_what_has_neither_place_nor_speed(tmp_path: Path, lag: float) -> None:
    """It was sought of what moves alone, on a scale that comes of place over speed."""
    folder = ovens(tmp_path / "ovens", lag)
    found, _ = diagnose(load(folder, f"{folder}/mine.py:Oven"))
    assert [e.id for e in found.effects] == ["actuator_lag"]
    tau = found.effects[0].parameters["tau"]
    assert tau.low <= lag <= tau.high and tau.value == pytest.approx(lag, rel=0.03 + 0.5 / lag)
