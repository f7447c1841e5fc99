"""An arm whose light link a controller holds on its path: fast motion is mostly its answer to what nobody measured."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor

from bench.diagnose import discover
from bench.diagnose.logs.subject import Subject, log_of
from registry.contracts import Channel, Recording
from registry.dynamics import constant, tensor
from registry.physics.state_space import StateSpace
from registry.units import Signal

STEP, SAMPLES = 0.003, 1600
DRY, VISCOUS = np.array([0.15, 0.027]), np.array([0.014, 0.0055])
"""Friction of both joints [N m], [N m s/rad]."""
INERTIA, COUPLING, WEIGHT = np.array([0.0265, 0.0012]), 0.0025, np.array([0.9, 0.083])
UNMEASURED = np.array([0.09, 0.01])
"""Torques [N m] of what shakes the joints: as large as this at random, and twice as large from tooth to tooth."""


@dataclass(frozen=True)
class ParallelArm(StateSpace):
    """Two links in a vertical plane, both driven from the base: angles from the horizontal."""

    upper: Any = constant(0.02, "J_1", "kg m^2", low=1e-6, uncertainty=0.3)
    lower: Any = constant(0.0015, "J_2", "kg m^2", low=1e-6, uncertainty=0.5)
    coupling: Any = constant(0.002, "h", "kg m^2", low=0, uncertainty=0.3)
    weight_1: Any = constant(0.85, "G_1", "N m", low=0, uncertainty=0.2)
    weight_2: Any = constant(0.08, "G_2", "N m", low=0, uncertainty=0.2)

    state_channels: ClassVar[tuple[Channel, ...]] = (
        Channel("angle.one", "rad"),
        Channel("angle.two", "rad"),
        Channel("angle_rate.one", "rad/s"),
        Channel("angle_rate.two", "rad/s"),
    )
    input_signals: ClassVar[tuple[str, ...]] = ("torque",)
    signals: ClassVar[dict[str, Signal]] = {"torque": Signal("N m", ("one", "two"))}
    alike: ClassVar[tuple[str, ...]] = ()
    equation: ClassVar[str] = "M(q) d²q/dt² = u − c(q, dq/dt) − G cos q"

    def own_rate(self, state: Tensor, inputs: Tensor) -> Tensor:
        """The state's rate (…, 4)."""
        constants = (self.upper, self.lower, self.coupling, self.weight_1, self.weight_2)
        j_1, j_2, h, g_1, g_2 = (tensor(v, state) for v in constants)
        q_1, q_2, w_1, w_2 = state.unbind(-1)
        c, s = h * torch.cos(q_2 - q_1), h * torch.sin(q_2 - q_1)
        first = inputs[..., 0] - g_1 * torch.cos(q_1) + s * w_2**2
        second = inputs[..., 1] - g_2 * torch.cos(q_2) - s * w_1**2
        whole = j_1 * j_2 - c**2
        return torch.stack([w_1, w_2, (j_2 * first - c * second) / whole, (j_1 * second - c * first) / whole], -1)


def acceleration(q: np.ndarray, w: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """That (2,) of both links, from the torques that are left to them."""
    c, s = COUPLING * np.cos(q[1] - q[0]), COUPLING * np.sin(q[1] - q[0])
    first, second = torque - WEIGHT * np.cos(q) + s * np.array([w[1] ** 2, -(w[0] ** 2)])
    whole = INERTIA.prod() - c**2
    return np.array([INERTIA[1] * first - c * second, INERTIA[0] * second - c * first]) / whole


def recording(seed: int) -> Recording:
    """Some seconds on a path of sines under proportional and differential control."""
    rng, model = np.random.default_rng(seed), ParallelArm()
    phase, frequency = rng.uniform(0, 6.28, (2, 3)), 2 * np.pi * rng.uniform(0.5, 1.5, (2, 3))
    size, teeth = np.array([[0.6, 0.4, 0.2], [0.9, 0.6, 0.4]]), rng.uniform(0, 6.28, 2)
    q, w, shake, out = np.array([0.0, -1.0]), np.zeros(2), np.zeros(2), np.empty((SAMPLES, 6))
    for i in range(SAMPLES):
        angle = frequency * i * STEP + phase
        off = (size * np.sin(angle)).sum(1) - np.array([0.0, 0.5]) - q, (size * frequency * np.cos(angle)).sum(1) - w
        u = np.array([12.0, 1.2]) * off[0] + np.array([0.5, 0.04]) * off[1]
        out[i] = *q, *w, *u
        shake += -shake * STEP / 0.05 + UNMEASURED * np.sqrt(2 * STEP / 0.05) * rng.normal(size=2)
        for _ in range(6):
            lost = DRY * np.tanh(w / 0.05) + VISCOUS * w + shake + 2 * UNMEASURED * np.sin(12 * q + teeth)
            w = w + STEP / 6 * acceleration(q, w, u - lost)
            q = q + STEP / 6 * w
    out += rng.normal(size=out.shape) * np.array([2e-4, 2e-4, 3e-3, 3e-3, 4e-3, 5e-4])
    inputs = tuple(Channel(f"torque.{axis}", "N m") for axis in ("one", "two"))
    states, valid = model.state_channels, np.ones(SAMPLES, bool)
    return Recording(f"run_{seed}", 1 / STEP, out[:, 4:], out[:, :4], inputs, states, valid)


def test_friction_is_named_though_a_controller_answers_what_shakes_the_joints() -> None:
    made = [recording(seed) for seed in range(6)]
    logs, names = tuple(log_of(r, ParallelArm(), "torque") for r in made), tuple(r.name for r in made)
    signals = ("angle", "angle_rate", "torque")
    subject = Subject("arm", ParallelArm(), logs, names[:-2], names[-2:], None, {}, {}, signals)
    answer = discover(subject)
    found = {f.id: np.array([x.value for x in f.estimates]) for f in answer.found}
    assert set(found) == {"joint_friction", "joint_damping"}
    np.testing.assert_allclose(found["joint_friction"], DRY, rtol=0.1)
    np.testing.assert_allclose(found["joint_damping"], VISCOUS, rtol=0.15)
    inertia = next(x.value for x in answer.constants if x.entry.name == "lower")
    assert 0.0010 < inertia < 0.0016  # 0.0026 where rows were whitened
