"""A joint that a controller moves slowly sticks for a while at every turn: friction, or a dead zone of the drive."""

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import pytest
import torch
from torch import Tensor

from bench.diagnose import diagnose, discover
from bench.diagnose.checks.machines import standstills
from bench.diagnose.logs.subject import Subject, log_of
from bench.diagnose.select.simulated.forecasting import forecasting
from registry.contracts import Channel, Recording
from registry.dynamics import constant, resting, tensor
from registry.effects.mechanics.friction import CoulombFriction
from registry.physics.state_space import Mechanical
from registry.units import Signal

RATE, SAMPLES, FINE = 100.0, 2000, 50
INERTIA, DAMPING, LIMIT, STATIC, OVER = 0.03, 0.277, 0.333, 0.6, 0.05
"""[kg m²], [N m s/rad], [N m] of what is hidden and of static friction, and the speed [rad/s] over which that ends."""
FEW = [
    "coulomb_friction",
    "stribeck_friction",
    "viscous_friction",
    "dead_zone",
    "curved_drive",
    "quadratic_drag",
    "cogging",
]
NOISE = np.array([1e-3, 1e-2])


@dataclass(frozen=True)
class Joint(Mechanical):
    """A joint, its motor's torque against what goes with the rate."""

    mass: Any = constant(0.033, "J", "kg m^2", low=1e-6, uncertainty=0.3)
    damping: Any = constant(0.3, "b", "N m s/rad", low=0, uncertainty=0.5)
    state_channels: ClassVar[tuple[Channel, ...]] = (Channel("angle.q", "rad"), Channel("angle_rate.q", "rad/s"))
    input_signals: ClassVar[tuple[str, ...]] = ("torque",)
    signals: ClassVar[dict[str, Signal]] = {"torque": Signal("N m", ("",))}
    equation: ClassVar[str] = "J dω/dt = u − b ω"

    def own_force(self, state: Tensor, inputs: Tensor) -> Tensor:
        """Torque less what goes with the rate (…, 1) [N m]."""
        return inputs[..., :1] - tensor(self.damping, state).unsqueeze(-1) * state[..., 1:]


def recording(seed: int, hidden: str) -> Recording:
    """A path of slow sines under proportional and differential control, which holds its torque between samples."""
    rng = np.random.default_rng(seed)
    frequency, size, phase = rng.uniform(0.3, 2.5, 3), rng.uniform(0.1, 0.4, 3), rng.uniform(0, 6.28, 3)
    gains, out = np.array([rng.uniform(6, 12), rng.uniform(0.1, 0.3)]), np.empty((SAMPLES, 3))
    dt = 1 / (RATE * FINE)
    q, w = float((size * np.sin(phase)).sum()), 0.0
    for i in range(SAMPLES):
        angle = frequency * i / RATE + phase
        off = np.array([(size * np.sin(angle)).sum() - q, (size * frequency * np.cos(angle)).sum() - w])
        u = float(gains @ off)
        out[i] = q, w, u
        drive = np.sign(u) * max(abs(u) - LIMIT, 0.0) if hidden == "dead_zone" else u
        static = {"dead_zone": 0.0, "coulomb_friction": LIMIT, "stribeck_friction": STATIC}[hidden]
        dry = LIMIT if hidden != "dead_zone" else 0.0
        for _ in range(FINE):
            if w == 0.0 and abs(drive) <= static:
                break
            limit = dry + (static - dry) * np.exp(-((w / OVER) ** 2))
            after = w + dt / INERTIA * (drive - DAMPING * w - limit * np.sign(w or drive))
            w = 0.0 if after * w < 0 and hidden != "dead_zone" else after
            q += dt * w
    states, valid = out[:, :2] + rng.normal(size=(SAMPLES, 2)) * NOISE, np.ones(SAMPLES, bool)
    model = Joint()
    return Recording(f"run_{seed}", RATE, out[:, 2:], states, (Channel("torque", "N m"),), model.state_channels, valid)


def subject(hidden: str) -> Subject:
    made, model = [recording(seed, hidden) for seed in range(6)], Joint(input_hold="previous")
    logs, names = tuple(log_of(r, model, "torque") for r in made), tuple(r.name for r in made)
    return Subject("joint", model, logs, names[:4], names[4:], None, {}, {}, ("angle", "angle_rate", "torque"))


@pytest.mark.parametrize("catalogue", [FEW, pytest.param(None, marks=pytest.mark.slow)], ids=["few", "all"])
@pytest.mark.parametrize("hidden", ["coulomb_friction", "dead_zone", "stribeck_friction"])
def test_friction_that_holds_a_joint_and_a_dead_zone_of_its_drive_are_told_apart(
    hidden: str, catalogue: list[str] | None
) -> None:
    """All of them take the same off the torque while the joint moves, and at rest nothing of it moves anything."""
    answer = discover(subject(hidden), catalogue)
    assert [f.id for f in answer.found] == [hidden]
    number = answer.found[0].estimates[0]
    assert number.value == pytest.approx(LIMIT, rel=0.03)
    inertia = next(x for x in answer.constants if x.entry.name == "mass")
    if hidden != "stribeck_friction":  # beside which few moments tell the inertia
        assert inertia.value == pytest.approx(INERTIA, rel=0.05)
    assert inertia.low < INERTIA < inertia.high


def test_what_noise_hides_of_a_motion_is_told_by_all_else() -> None:
    """Held where friction can hold it, started where it cannot, and measured where it only turns round."""
    friction = CoulombFriction(f_c=0.4, v_0=1e-3)
    model = Joint(damping=0.0, effects=(replace(friction, hidden=(0.03,)),))
    speeds, torques = np.array([0.01, -0.01, 0.005, 0.3, 0.01]), np.array([0.2, -0.3, -0.404, 0.2, -4.0])
    state, inputs = torch.tensor(np.stack([0 * speeds, speeds], -1)), torch.tensor(torques[:, None])
    left = resting(model, state, inputs).derivative(state, inputs)[:, 1].numpy() * float(model.mass)
    np.testing.assert_allclose(left, [0.0, 0.0, -0.012, -0.2, -4.4], atol=2e-3)
    known = resting(replace(model, effects=(friction,)), state, inputs).derivative(state, inputs)
    np.testing.assert_allclose(known[:, 1].numpy() * float(model.mass), [-0.2, 0.1, -0.804, -0.2, -4.4], atol=2e-3)


def test_a_machine_that_is_held_while_its_drive_goes_on_is_mentioned() -> None:
    """By a sensor with counts, which repeats its values at rest; noise never does."""
    given = subject("coulomb_friction")
    counts = torch.tensor([0.02, 0.2])
    logs = tuple(replace(log, states=torch.round(log.states / counts) * counts) for log in given.logs)
    (remark,) = standstills(replace(given, logs=logs))
    assert remark.kind == "standstill" and "stands still in" in remark.detail and "N m, which" in remark.detail
    assert standstills(given) == []
    still = tuple(replace(log, inputs=torch.full_like(log.inputs, 0.1)) for log in logs)
    assert standstills(replace(given, logs=still)) == []  # nothing says that it is held


def test_recordings_of_which_little_is_valid_are_no_crash() -> None:
    """Forecasts and what differs from one recording to another were asked of stretches too short for a free run."""
    given = subject("coulomb_friction")
    kept = torch.arange(SAMPLES) % 24 < 12
    logs = [replace(log, valid=log.valid & kept) if 0 < i < 4 else log for i, log in enumerate(given.logs)]
    short = replace(given, logs=tuple(logs))
    said, _ = diagnose(short, brief=True)
    assert [e.id for e in said.effects] == ["coulomb_friction"]
    assert forecasting(short, short.model, ["coulomb_friction"]) == (short.model, ())
    assert forecasting(given, given.model, ["coulomb_friction"])[1]
