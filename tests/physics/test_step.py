"""The fast step of a rigid body: that of the physics model, which `test_quadrotor` holds against others."""

import numpy as np
import pytest
import torch
from networks import noise

from registry.kernels.rigid_body import RigidBodyStep
from registry.physics.quadrotor import Quadrotor

F64 = torch.float64
INERTIA, GRAVITY, DT = np.array([0.01, 0.013, 0.02]), 9.81, 0.01


def body() -> RigidBodyStep:
    x, y, z = INERTIA
    return RigidBodyStep(DT, GRAVITY, torch.tensor([(y - z) / x, (z - x) / y, (x - y) / z], dtype=F64))


@pytest.mark.parametrize("hold", ["linear", "previous"])
def test_is_the_step_of_the_quadrotor(hold: str) -> None:
    model = Quadrotor(inertia=tuple(INERTIA), mass=0.7, input_hold=hold)
    state, speed = noise(5, 13, seed=2), 400 + 60 * noise(2, 5, 4, seed=3)
    moments = [speed[0], speed.mean(0), speed[1]] if hold == "linear" else [speed[0]] * 3
    arms, signs = np.array(model.rotor_positions), np.array(model.rotor_directions)

    def load(s: torch.Tensor) -> torch.Tensor:
        thrust, drag = (c * s.numpy() ** 2 for c in (model.thrust_coefficient, model.torque_coefficient))
        torque = np.stack([thrust @ arms[:, 1], -thrust @ arms[:, 0], drag @ signs])
        return torch.from_numpy(np.concatenate([[thrust.sum(1) / model.mass], torque / INERTIA[:, None]]))

    none = torch.zeros(4, 5, dtype=F64)
    got = body()(state.T, none, none, torch.stack([load(s) for s in moments]))
    torch.testing.assert_close(got.T, model.step(state, speed[0], speed[1], DT), rtol=1e-12, atol=1e-12)
    if hold == "linear":  # loads that are straight lines are shared out alike, given or not
        start, end = noise(4, 5, seed=4), noise(4, 5, seed=5)
        given = torch.stack([start, (start + end) / 2, end])
        torch.testing.assert_close(body()(state.T, start, end), body()(state.T, none, none, given))


def test_gradient_is_the_finite_difference() -> None:
    """Over a step of 0.3 s, in which everything moves everything."""
    coupling = body().coupling.requires_grad_()

    def run(state: torch.Tensor, start: torch.Tensor, end: torch.Tensor, given: torch.Tensor, c: torch.Tensor):
        return RigidBodyStep(0.3, GRAVITY, c)(state, start, end, given)

    shapes = ((13, 2), (4, 2), (4, 2), (3, 4, 2))
    assert torch.autograd.gradcheck(
        run, (*(noise(*s, seed=i).requires_grad_() for i, s in enumerate(shapes)), coupling)
    )
