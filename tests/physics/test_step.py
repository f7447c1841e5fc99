"""The fast step of a rigid body: against an independent integration, conservation laws and the physics model."""

import numpy as np
import pytest
import torch
from networks import noise
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from registry.kernels.rigid_body import RigidBodyStep
from registry.physics.quadrotor import Quadrotor

F64 = torch.float64
INERTIA, GRAVITY, DT = np.array([0.01, 0.013, 0.02]), 9.81, 0.01


def body(dt: float = DT, gravity: float = GRAVITY) -> RigidBodyStep:
    x, y, z = INERTIA
    return RigidBodyStep(dt, gravity, torch.tensor([(y - z) / x, (z - x) / y, (x - y) / z], dtype=F64))


def test_agrees_with_an_independent_integration_over_the_long_horizon() -> None:
    """Thrust and torques that are straight lines over each sample; attitude as a matrix, not a quaternion."""
    rng = np.random.default_rng(0)
    knots = np.array([9.5, 0.0, 0.0, 0.0]) + rng.normal(0, [2.0, 4.0, 4.0, 1.0], (191, 4)).cumsum(0) * 0.1

    def rate(t: float, x: np.ndarray, k: int) -> np.ndarray:
        thrust, *turn = knots[k] + (knots[k + 1] - knots[k]) * (t / DT - k)
        matrix, w = x[6:15].reshape(3, 3), x[15:]
        skew = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
        spin = np.array(turn) - np.cross(w, INERTIA * w) / INERTIA
        return np.concatenate([x[3:6], matrix[:, 2] * thrust - [0, 0, GRAVITY], (matrix @ skew).ravel(), spin])

    start = Rotation.from_euler("ZYX", [0.4, -0.2, 0.3])
    v, w = [1.0, -0.5, 0.2], [0.8, -0.6, 0.4]
    exact = np.concatenate([[0, 0, 1], v, start.as_matrix().ravel(), w])
    state = torch.tensor([0, 0, 1, *v, *start.as_quat(), *w], dtype=F64).unsqueeze(1)
    step, drive = body(), torch.from_numpy(knots).unsqueeze(-1)
    for k in range(190):
        exact = solve_ivp(rate, (k * DT, (k + 1) * DT), exact, "DOP853", rtol=1e-12, atol=1e-12, args=(k,)).y[:, -1]
        state = step(state, drive[k], drive[k + 1])
    end = state[:, 0].numpy()
    assert np.abs(end[:6] - exact[:6]).max() < 1e-6 and np.abs(end[10:] - exact[15:]).max() < 1e-6
    assert np.abs(Rotation.from_quat(end[6:10]).as_matrix() - exact[6:15].reshape(3, 3)).max() < 1e-6
    assert np.linalg.norm(exact[15:]) > 1, "the case must turn"


def test_a_free_body_keeps_energy_momentum_and_angular_momentum() -> None:
    state, none, step = noise(13, 3, seed=1), torch.zeros(4, 3, dtype=F64), body(0.004, gravity=0.0)
    state[6:10] /= state[6:10].norm(dim=0)
    ends = [state]
    for _ in range(500):
        ends.append(step(ends[-1], none, none))
    first, last = (e.numpy() for e in (ends[0], ends[-1]))

    def energy(s: np.ndarray) -> np.ndarray:
        return 0.5 * (INERTIA[:, None] * s[10:] ** 2).sum(0)

    def spin(s: np.ndarray) -> np.ndarray:
        return Rotation.from_quat(s[6:10].T).apply((INERTIA[:, None] * s[10:]).T)

    np.testing.assert_allclose(energy(last), energy(first), rtol=1e-9)
    np.testing.assert_allclose(spin(last), spin(first), rtol=0, atol=1e-9)
    np.testing.assert_array_equal(last[3:6], first[3:6])
    np.testing.assert_allclose(last[:3], first[:3] + 2.0 * first[3:6], rtol=1e-12)
    assert np.abs(last[10:] - first[10:]).max() > 0.3, "the body must tumble"


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
