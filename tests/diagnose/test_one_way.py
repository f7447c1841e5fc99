"""A shaft that turns one way in every recording: friction stands still there, and so does what varies slowly."""

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import pytest
from torch import Tensor

from bench.diagnose import diagnose, discover
from bench.diagnose.fit import fit_parameters
from bench.diagnose.logs.sample import shortened
from bench.diagnose.logs.subject import Subject, log_of
from registry.contracts import Channel, Recording
from registry.dynamics import constant, tensor
from registry.physics.state_space import Mechanical
from registry.units import Signal

RATE, INERTIA, DAMPING = 500.0, 1.2e-4, 7e-5
FRICTION, NOISE = 0.03, 0.02
"""Torques [N m]: of the bearings, and of the measurement of the torque."""


@dataclass(frozen=True)
class Shaft(Mechanical):
    """A shaft in bearings, driven by a measured torque."""

    mass: Any = constant(INERTIA, "J", "kg m^2", low=1e-9)
    damping: Any = constant(DAMPING, "B", "N m s/rad", low=0)

    state_channels: ClassVar[tuple[Channel, ...]] = (
        Channel("angle.shaft", "rad"),
        Channel("angle_rate.shaft", "rad/s"),
    )
    input_signals: ClassVar[tuple[str, ...]] = ("torque",)
    signals: ClassVar[dict[str, Signal]] = {"torque": Signal("N m", ("",))}
    equation: ClassVar[str] = "J dω/dt = u − B ω"

    def own_force(self, state: Tensor, inputs: Tensor) -> Tensor:
        """Torque less the damping (…, 1) [N m]."""
        return inputs[..., :1] - tensor(self.damping, state).unsqueeze(-1) * state[..., 1:]


def run(
    name: str,
    torques: tuple[float, float],
    rng: np.random.Generator,
    samples: int = 3000,
    constant: float = 0.0,
    noise: tuple[float, float] = (NOISE, 0.2),
) -> Recording:
    """Two steps of torque from rest; friction that wanders, noise of the torque sensor [N m] and the rate [rad/s]."""
    level, wander, rate, angle = FRICTION * (1 + 0.05 * rng.normal()), 0.0, 0.0, 0.0
    out = np.empty((samples, 3))
    for i in range(samples):
        torque = torques[2 * i // samples]
        wander += (-wander + 0.0015 * np.sqrt(2 * RATE) * rng.normal()) / RATE
        friction = (level + wander) * np.sign(torque)
        out[i] = angle, rate, torque + noise[0] * rng.normal()
        rate += (torque + constant - DAMPING * rate - friction) / INERTIA / RATE
        angle += rate / RATE
    states = out[:, :2] + rng.normal(size=(samples, 2)) * (2e-4, noise[1])
    return Recording(
        name, RATE, out[:, 2:], states, (Channel("torque", "N m"),), Shaft.state_channels, np.ones(samples, dtype=bool)
    )


def test_friction_that_never_changes_its_sign_is_found() -> None:
    """Whitened, what stands still in a recording counts as slow noise, and the noise of the torque hides the rest.

    Eight recordings agree on it nevertheless, as ordinary least squares sees.
    """
    rng, model = np.random.default_rng(3), Shaft()
    steps = [(0.05, 0.06), (-0.045, -0.055)] * 4
    logs = tuple(log_of(run(f"run_{i}", s, rng), model, "torque") for i, s in enumerate(steps))
    names = tuple(log.name for log in logs)
    subject = Subject("shaft", model, logs, names[:6], names[6:], signals=("torque", "angle", "angle_rate"))
    found = discover(subject)
    friction = next(f for f in found.found if f.id in ("coulomb_friction", "stribeck_friction"))
    estimate = friction.estimates[0]
    assert (estimate.value, estimate.entry.unit) == (pytest.approx(FRICTION, rel=0.1), "N m")
    slowest = found.equations[-1]
    assert slowest.models["extended"] < 0.2 * slowest.models["calibrated"]
    # Numbers are fitted as they were found; whitened rows would have another friction.
    again = [fit_parameters(replace(subject, memory=m), found.model, through_simulator=False) for m in (0, None)]
    as_found, whitened = (next(x for x in numbers if x.entry.label == "f_c") for _, numbers in again)
    assert as_found.value == pytest.approx(estimate.value, rel=0.01)
    assert abs(whitened.value - FRICTION) > 5 * abs(as_found.value - FRICTION)
    told, _ = diagnose(subject, brief=True)
    number = next(e for e in told.effects if e.id == friction.id).parameters["f_c"]
    assert number.high - number.low < 0.2 * FRICTION


def test_what_stands_still_beside_a_named_friction_is_found() -> None:
    """A constant torque that whitening hides beside friction that it does not; functions of the signals tell of it."""
    rng, model, constant = np.random.default_rng(5), Shaft(), -0.003
    steps = [(0.057, 0.067), (-0.035, -0.042)] * 4
    logs = tuple(
        log_of(run(f"run_{i}", s, rng, constant=constant, noise=(0.005, 0.05)), model, "torque")
        for i, s in enumerate(steps)
    )
    names = tuple(log.name for log in logs)
    found = discover(Subject("shaft", model, logs, names[:5], names[5:], signals=("torque", "angle", "angle_rate")))
    (estimate,) = next(f for f in found.found if f.id == "offset_force").estimates
    assert estimate.low <= constant <= estimate.high
    assert not any(e.lost for e in found.equations)


@pytest.mark.parametrize(("held", "stride"), [(False, 4), (False, 5), (True, 4), (True, 5)])
def test_inputs_of_samples_left_out_are_averaged(held: bool, stride: int) -> None:
    """From a kept sample on where inputs hold; else so that a line between two has the mean, to fourth order."""
    (log,) = (log_of(run("run", (0.05, 0.06), np.random.default_rng(1), 200), Shaft(), "torque"),)
    (some,) = shortened([log], 10_000, stride, [0] if held else [])
    u = log.inputs[:, 0].numpy()

    def mean(k: int) -> float:
        if held:
            return float(u[k : k + stride].mean())
        about = u[k - stride // 2 : k + stride // 2 + 1]
        return float(about @ (np.ones(stride) if stride % 2 else [0.5, *np.ones(stride - 1), 0.5]) / stride)

    at = np.arange(2 * stride, 200 - 2 * stride, stride)
    curved = [0.0 if held else (mean(k + stride) - 2 * mean(k) + mean(k - stride)) / 8 for k in at]
    expected = np.array([mean(k) for k in at]) - curved
    assert some.inputs[2 : len(at) + 2, 0].numpy() == pytest.approx(expected, rel=1e-12)
    assert (some.states == log.states[::stride]).all()
