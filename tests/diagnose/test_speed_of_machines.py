"""What is hidden in a machine is found however slow or fast it is: with the time axis its answer is scaled, no more."""

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from torch import Tensor

from bench.diagnose import diagnose
from bench.diagnose.extend import _named
from bench.diagnose.logs.subject import Subject
from bench.diagnose.report import model_file
from bench.diagnose.result import ParameterEstimate
from registry.contracts import Channel
from registry.dynamics import constant, tensor
from registry.effects.actuation import ActuatorLag
from registry.physics.oscillator import Oscillator
from registry.physics.state_space import StateSpace
from registry.units import Signal
from tests.diagnose.machines_of_any_size import Array, cart, delay, lag, recorded

SOME = ("actuator_lag", "input_delay", "joint_elasticity", "dead_zone", "saturation", "coulomb_friction")


@pytest.mark.parametrize(
    ("drive", "time", "id", "value"),
    [
        (delay, 1000.0, "input_delay", 0.09),
        (lag, 1000.0, "actuator_lag", 0.04),
        (delay, 1e-3, "input_delay", 0.09),
        (lag, 1e-3, "actuator_lag", 0.04),
    ],
)
def test_a_slow_or_fast_machine_has_the_same_answer_in_its_own_time(
    drive: Any, time: float, id: str, value: float, tmp_path: Path
) -> None:
    """A dead time of 90 s was taken for a lag: none beyond .2 s was looked for."""
    given = cart(drive, time=time)
    told, extended = diagnose(given, brief=True, catalogue=SOME)
    (effect,) = told.effects
    (number,) = effect.parameters.values()
    assert (effect.id, effect.indistinguishable_from) == (id, ())
    assert number.value == pytest.approx(value * time, rel=0.01)
    model_file.write(tmp_path / "model.toml", extended)
    assert model_file.read(tmp_path / "model.toml").effects[0] == replace(
        extended.effects[0], **{name: float(f"{n.value:.9g}") for name, n in effect.parameters.items()}
    )


@dataclass(frozen=True)
class Block(StateSpace):
    """A heated block that loses heat."""

    capacity: Any = constant(2.0, "C", "J/K", low=0, uncertainty=0.1)
    loss: Any = constant(1.0, "H", "W/K", low=0, uncertainty=0.1)

    state_channels: ClassVar[tuple[Channel, ...]] = (Channel("temperature.block", "K"),)
    input_signals: ClassVar[tuple[str, ...]] = ("power",)
    signals: ClassVar[dict[str, Signal]] = {
        "temperature": Signal("K", ("block",)),
        "power": Signal("W", ("",)),
    }
    alike: ClassVar[tuple[str, ...]] = ()
    equation: ClassVar[str] = "C dT/dt = P − H T"

    def own_rate(self, state: Tensor, inputs: Tensor) -> Tensor:
        c, h = (tensor(v, state).unsqueeze(-1) for v in (self.capacity, self.loss))
        return (inputs[..., :1] - h * state) / c


def walled(seed: int) -> tuple[Array, Array]:
    """Power (N,) [W] and temperature (N, 1) [K] of a block in a wall, of 30 J/K and 3 W/K, that nobody measured."""
    rng, fine, step = np.random.default_rng(seed), 10, 0.1
    u = np.repeat(rng.uniform(0, 20, 50), 30)
    acting = np.interp(np.arange((len(u) - 1) * fine + 1) / fine, np.arange(len(u)), u)
    x, path, h = rng.uniform(2, 12, 2), [], step / fine

    def rate(x: Array, power: float) -> Array:
        through = 3.0 * (x[0] - x[1])
        return np.array([(power - x[0] - through) / 2.0, through / 30.0])

    for before, after in pairwise(acting):
        path.append(x)
        slope = rate(x, before)
        x = x + h / 2 * (slope + rate(x + h * slope, after))
    seen = np.array([*path, x])[::fine, :1]
    return u, seen + rng.normal(size=seen.shape) * 0.01


def block(time: float) -> Subject:
    """Six recordings of it, slower by a factor."""
    runs = [walled(seed) for seed in range(6)]
    return recorded(Block(capacity=2.0 * time), runs, Channel("power", "W"), 10.0 / time)


@pytest.mark.slow
def test_a_hidden_wall_is_found_in_seconds_and_in_days() -> None:
    """Its time constant is 10 s, or 5.6 hours: slower than 1592 s none was looked for."""
    here, there = (diagnose(block(time), brief=True)[1].effects for time in (1.0, 2000.0))
    (one,), (other,) = ([e for e in some if e.learned] for some in (here, there))
    assert one.frequency == pytest.approx(1 / 20 / np.pi, rel=0.03)
    assert 2000.0 * other.frequency == pytest.approx(one.frequency, rel=1e-6)
    assert other.gains == pytest.approx(tuple(np.array(one.gains)), rel=1e-6)


def test_a_lag_much_shorter_than_the_samples_is_told_although_nothing_was_estimated() -> None:
    lag_of_it = ActuatorLag(2.3)
    told = _named(lag_of_it, Oscillator(effects=(lag_of_it,)), [], 0.0, {}, {}, {}, None)
    assert told.parameters["tau"] == ParameterEstimate(2.3, 0.0, math.inf, "s")
