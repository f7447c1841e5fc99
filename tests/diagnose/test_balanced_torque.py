"""A joint turned at constant speeds: its torque balances friction and weight, and hardly accelerates anything."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import pytest
from torch import Tensor

from bench.diagnose import discover
from bench.diagnose.logs.subject import Subject, log_of
from registry.contracts import Channel, Recording
from registry.dynamics import constant, tensor
from registry.physics.state_space import Mechanical
from registry.units import Signal

STEP, SAMPLES = 0.01, 1000
INERTIA, WEIGHT, DRY, TEETH = 0.0013, 0.084, 0.06, 0.01
"""[kg m²], and torques [N m]: of the weight, of dry friction, from tooth to tooth."""
RIPPLE = 0.015
"""Of the torque that is measured, 1σ; the joint does not feel it [N m]."""
SPEEDS = (0.5, -0.5, 1.0, -1.0, 8.0, -8.0, 4.0, -4.0, 2.0, -2.0)
"""[rad/s]"""


@dataclass(frozen=True)
class Joint(Mechanical):
    """A link in a vertical plane, driven by a measured torque."""

    mass: Any = constant(0.0015, "J", "kg m^2", low=1e-7, uncertainty=0.5)
    weight: Any = constant(0.08, "G", "N m", uncertainty=0.2)

    state_channels: ClassVar[tuple[Channel, ...]] = (Channel("angle.q", "rad"), Channel("angle_rate.q", "rad/s"))
    input_signals: ClassVar[tuple[str, ...]] = ("torque",)
    signals: ClassVar[dict[str, Signal]] = {"torque": Signal("N m", ("",))}
    equation: ClassVar[str] = "J d²q/dt² = u − G cos q"

    def own_force(self, state: Tensor, inputs: Tensor) -> Tensor:
        """Torque less that of the weight (…, 1) [N m]."""
        return inputs[..., :1] - tensor(self.weight, state).unsqueeze(-1) * state[..., :1].cos()


def recording(seed: int, speed: float) -> Recording:
    """Some turns at a constant speed under proportional and integral control, slower ones logged at a lower rate."""
    rng, step = np.random.default_rng(seed), 0.008 / abs(speed)
    q, w, held, out = rng.uniform(-1, 1), speed, 0.0, np.empty((SAMPLES, 3))
    teeth = rng.uniform(0, 6.28)
    parts = max(4, round(step / 0.0005))
    for i in range(SAMPLES):
        u = held + 0.05 * (speed - w)
        out[i] = q, w + 0.01 * rng.normal(), u + RIPPLE * rng.normal()
        for _ in range(parts):
            held += 0.5 * step / parts * (speed - w)
            lost = DRY * np.tanh(w / 0.02) + WEIGHT * np.cos(q) + TEETH * np.sin(12 * q + teeth)
            w += step / parts * (held + 0.05 * (speed - w) - lost) / INERTIA
            q += step / parts * w
    times = np.arange(SAMPLES) * step
    out = np.stack([np.interp(np.arange(0, times[-1], STEP), times, column) for column in out.T], 1)
    inputs, valid = (Channel("torque", "N m"),), np.ones(len(out), bool)
    return Recording(f"run_{seed}", 1 / STEP, out[:, 2:], out[:, :2], inputs, Joint.state_channels, valid)


@pytest.mark.slow
def test_friction_is_named_though_forecasts_are_best_where_no_torque_does_anything() -> None:
    made = [recording(seed, speed) for seed, speed in enumerate(SPEEDS)]
    logs, names = tuple(log_of(r, Joint(), "torque") for r in made), tuple(r.name for r in made)
    signals = ("angle", "angle_rate", "torque")
    answer = discover(Subject("joint", Joint(), logs, names[:-2], names[-2:], None, {}, {}, signals))
    (friction,) = answer.found  # before, nothing, and an inertia of 250 times what was stated
    assert friction.id == "coulomb_friction"
    assert [x.value for x in friction.estimates] == pytest.approx([DRY], rel=0.03)
