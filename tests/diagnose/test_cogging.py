"""Magnets along the way: of a motor that turns many times, and of a carriage that travels over many of them."""

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest
from torch import Tensor

from bench.diagnose import discover
from bench.diagnose.confirm import idle_effects
from bench.diagnose.logs.subject import Subject, log_of
from bench.diagnose.result import ParameterEstimate
from registry.contracts import Channel, Recording
from registry.core import EFFECTS
from registry.dynamics import constant, tensor
from registry.physics.mass_on_rail import MassOnRail
from registry.physics.state_space import Mechanical
from registry.units import Signal

STEP, SAMPLES, PERIODS = 0.005, 1600, 14
INERTIA, VISCOUS, MAGNETS = 2e-4, 1e-3, 4e-3
"""[kg m²], [N m s/rad], [N m]"""


@dataclass(frozen=True)
class Shaft(Mechanical):
    """A shaft with a bearing, driven by a torque."""

    mass: Any = constant(INERTIA, "J", "kg m^2", low=1e-9, uncertainty=0.1)
    friction: Any = constant(VISCOUS, "B", "N m s/rad", low=0, uncertainty=0.1)

    state_channels: ClassVar[tuple[Channel, ...]] = (Channel("angle.q", "rad"), Channel("angle_rate.q", "rad/s"))
    input_signals: ClassVar[tuple[str, ...]] = ("torque",)
    signals: ClassVar[dict[str, Signal]] = {"torque": Signal("N m", ("",))}
    equation: ClassVar[str] = "J dω/dt = u − B ω"

    def own_force(self, state: Tensor, inputs: Tensor) -> Tensor:
        """Torque less that of the bearing (…, 1) [N m]."""
        return inputs[..., :1] - tensor(self.friction, state).unsqueeze(-1) * state[..., 1:]


def recording(seed: int) -> Recording:
    """Some eight turns, now faster, now slower, the torque held over each sample."""
    rng, fine = np.random.default_rng(seed), 20
    u = np.repeat(rng.uniform(4e-3, 1.3e-2, SAMPLES // 100), 100)
    q, w, out = 0.0, 6.0, np.empty((SAMPLES, 2))
    for i in range(SAMPLES):
        out[i] = q, w
        for _ in range(fine):
            w += STEP / fine * (u[i] - VISCOUS * w + MAGNETS * np.sin(PERIODS * q + 1.0)) / INERTIA
            q += STEP / fine * w
    out += rng.normal(size=out.shape) * np.array([1e-3, 2e-2])
    channels, valid = (Channel("torque", "N m"),), np.ones(SAMPLES, bool)
    return Recording(f"run_{seed}", 1 / STEP, u[:, None], out, channels, Shaft.state_channels, valid)


def test_cogging_is_found_over_many_turns() -> None:
    made, model = [recording(seed) for seed in range(6)], Shaft(input_hold="previous")
    assert min(float(np.ptp(r.outputs[:, 0])) for r in made) > 6 * 2 * np.pi
    logs, names = tuple(log_of(r, model, "torque") for r in made), tuple(r.name for r in made)
    signals = ("angle", "angle_rate", "torque")
    answer = discover(Subject("shaft", model, logs, names[:-2], names[-2:], None, {}, {}, signals))
    (cogging,) = answer.found
    assert cogging.id == "cogging"
    a, b, pitch = (x.value for x in cogging.estimates)
    assert pitch == pytest.approx(2 * np.pi / PERIODS, rel=1e-4)
    assert np.hypot(a, b) == pytest.approx(MAGNETS, rel=0.03)


MASS, PITCH, PULL = 12.0, 0.03, 6.5
"""[kg], [m], [N]"""


def carriage(seed: int) -> Recording:
    """Sent from place to place by a controller, over some fifteen magnets."""
    rng, fine = np.random.default_rng(seed), 10
    target = np.repeat(rng.uniform(-0.22, 0.22, SAMPLES // 200), 200)
    q, w, asked, out, force = 0.0, 0.0, 0.0, np.empty((SAMPLES, 2)), np.empty((SAMPLES, 1))
    for i in range(SAMPLES):
        asked += STEP / 0.15 * (target[i] - asked)
        out[i], force[i] = (q, w), 900.0 * (asked - q) - 170.0 * w
        for _ in range(fine):
            w += STEP / fine * (force[i, 0] + PULL * np.sin(2 * np.pi * q / PITCH + 1.0)) / MASS
            q += STEP / fine * w
    out += rng.normal(size=out.shape) * np.array([1e-5, 1e-3])
    channels, valid = (Channel("voltage", "V"),), np.ones(SAMPLES, bool)
    return Recording(f"run_{seed}", 1 / STEP, force, out, channels, MassOnRail.state_channels, valid)


def test_magnets_are_found_along_a_rail_that_is_many_of_them_long() -> None:
    """The pitches that were tried lay so far apart that none kept the magnets' phase from end to end."""
    made, model = [carriage(seed) for seed in range(6)], MassOnRail(mass=11.5, force_gain=1.0, input_hold="previous")
    logs, names = tuple(log_of(r, model, "voltage") for r in made), tuple(r.name for r in made)
    signals = ("displacement", "speed", "voltage")
    answer = discover(Subject("rail", model, logs, names[:-2], names[-2:], None, {}, {"mass": 0.05}, signals))
    (cogging,) = answer.found
    assert cogging.id == "cogging"
    a, b, pitch = (x.value for x in cogging.estimates)
    assert pitch == pytest.approx(PITCH, rel=1e-3)
    assert np.hypot(a, b) == pytest.approx(PULL, rel=0.05)


@pytest.mark.parametrize(("sine", "idle"), [((-0.4, 0.6), {"cogging"}), ((0.1, 0.6), set())])
def test_magnets_without_a_force_are_none_whatever_their_pitch(sine: tuple[float, float], idle: set[str]) -> None:
    logs = (log_of(carriage(0), model := MassOnRail(force_gain=1.0, input_hold="previous"), "voltage"),)
    subject = Subject("rail", model, logs, ("run_0",), (), None, {}, {}, ("displacement", "speed", "voltage"))
    told = {"a": (0.1, *sine), "b": (0.2, -0.1, 0.5), "pitch": (0.03, 0.029, 0.031)}
    named = SimpleNamespace(
        id="cogging", learned=False, parameters={n: ParameterEstimate(*of, unit="") for n, of in told.items()}
    )
    whole = replace(model, effects=(EFFECTS.get("cogging")(a=0.1, b=0.2, pitch=0.03),))
    assert idle_effects(subject, SimpleNamespace(model=whole, effects=[named])) == idle  # type: ignore[arg-type]
