"""The quadrotor against an independent integration, conservation laws and numerical gradients."""

import math

import numpy as np
import pytest
import torch
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from registry.core import PHYSICS
from registry.effects.air import Wind
from registry.effects.rotor import RotorDrag, RotorReactionTorque
from registry.errors import BenchError
from registry.physics.helicopter import Helicopter
from registry.physics.quadrotor import Quadrotor

F64 = torch.float64


def rotor_speeds(t):
    """Linear in time, so that samples joined by straight lines are exact."""
    return np.array([500.0, 490.0, 495.0, 503.0]) + np.array([6.0, 9.0, 5.0, 2.0]) * t


def newton_euler(t, x):
    """Textbook right-hand side for the default vehicle, attitude as a rotation matrix."""
    v, R, w = x[3:6], x[6:15].reshape(3, 3), x[15:18]
    k_f, k_m, arm = 9.9865e-6, 1.5978e-7, 0.21
    t1, t2, t3, t4 = k_f * rotor_speeds(t) ** 2
    J = np.diag([0.01, 0.01, 0.02])
    torque = np.array([arm * (t2 - t4), arm * (t3 - t1), k_m / k_f * (t1 - t2 + t3 - t4)])
    skew = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
    acceleration = R @ [0, 0, t1 + t2 + t3 + t4] - [0, 0, 9.81]
    return np.concatenate([v, acceleration, (R @ skew).ravel(), np.linalg.solve(J, torque - np.cross(w, J @ w))])


def test_agrees_with_an_independent_integration_over_the_long_horizon():
    start = Rotation.from_euler("ZYX", [0.4, -0.2, 0.3])
    v, w, dt, steps = [1.0, -0.5, 0.2], [0.8, -0.6, 0.4], 0.01, 190
    x0 = np.concatenate([[0, 0, 1], v, start.as_matrix().ravel(), w])
    exact = solve_ivp(newton_euler, (0, 1.9), x0, method="DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
    state = torch.tensor([0, 0, 1, *v, *start.as_quat(), *w], dtype=F64)
    inputs = torch.tensor(np.stack([rotor_speeds(k * dt) for k in range(steps + 1)]), dtype=F64)
    end = Quadrotor().simulate(state, inputs, dt)[-1].numpy()
    assert np.abs(end[:6] - exact[:6]).max() < 1e-6
    assert np.abs(Rotation.from_quat(end[6:10]).as_matrix() - exact[6:15].reshape(3, 3)).max() < 1e-6
    assert np.abs(end[10:] - exact[15:]).max() < 1e-6
    assert np.linalg.norm(exact[15:]) > 1, "the case must turn"


@pytest.mark.parametrize("products", [(0.0, 0.0, 0.0), (0.002, -0.003, 0.004)])
def test_a_free_body_keeps_energy_and_angular_momentum(products):
    inertia = (0.01, 0.02, 0.025)
    model = Quadrotor(inertia=inertia, inertia_products=products, gravity=0.0)
    state = torch.tensor([0, 0, 0, 1, 2, 3, 0.1, 0.2, 0.3, 0.9, 3.0, 0.2, -2.0], dtype=F64)
    states = model.simulate(model.project(state), torch.zeros(501, 4, dtype=F64), 0.004)[[0, -1]].numpy()
    xy, xz, yz = products
    J = np.array([[inertia[0], xy, xz], [xy, inertia[1], yz], [xz, yz, inertia[2]]])
    energy = [0.5 * (s[3:6] @ s[3:6] + J @ s[10:] @ s[10:]) for s in states]
    spin = [Rotation.from_quat(s[6:10]).apply(J @ s[10:]) for s in states]
    assert abs(energy[1] - energy[0]) < 1e-9 * energy[0]
    assert np.abs(spin[1] - spin[0]).max() < 1e-9
    assert np.abs(states[1][10:] - states[0][10:]).max() > 0.5, "the body must tumble"


def test_hover_is_an_equilibrium_and_yaw_follows_the_rotor_directions():
    hover = math.sqrt(9.81 / (4 * 9.9865e-6))
    state = torch.zeros(13, dtype=F64)
    state[9] = 1
    assert Quadrotor().derivative(state, torch.full((4,), hover, dtype=F64)).abs().max() < 1e-12
    faster = torch.tensor([hover + 10, hover, hover + 10, hover], dtype=F64)  # s = +1 for the first and third
    assert Quadrotor().derivative(state, faster)[12] > 0


@pytest.mark.parametrize("name", ["quadrotor", "helicopter"])
@pytest.mark.parametrize("hold", ["linear", "previous"])
def test_step_has_exact_gradients(name, hold):
    model = PHYSICS.get(name)(input_hold=hold)
    generator = torch.Generator().manual_seed(0)
    state = torch.randn(2, len(model.state_channels), generator=generator, dtype=F64).requires_grad_()
    inputs = (3 + torch.rand(2, 2, 4, generator=generator, dtype=F64)).requires_grad_()
    size = 100 if name == "quadrotor" else 1
    assert torch.autograd.gradcheck(lambda x, u: model.step(x, size * u[0], size * u[1], 0.01), (state, inputs))


def test_gradient_of_constants():
    mass = torch.tensor(1.1, dtype=F64, requires_grad=True)
    state = torch.zeros(13, dtype=F64)
    state[9] = 1
    Quadrotor(mass=mass).derivative(state, torch.full((4,), 500.0, dtype=F64))[5].backward()
    assert mass.grad.item() == pytest.approx(-4 * 9.9865e-6 * 500**2 / 1.1**2)


@pytest.mark.parametrize("stick, state, sign", [(0, 10, 1), (1, 11, 1), (2, 12, 1), (3, 5, 1)])
def test_helicopter_sticks_move_what_they_should(stick, state, sign):
    start, inputs = torch.zeros(19, dtype=F64), torch.zeros(31, 4, dtype=F64)
    start[9] = 1
    rest = Helicopter().simulate(start, inputs, 0.01)[-1]
    inputs[:, stick] = 0.3
    assert sign * (Helicopter().simulate(start, inputs, 0.01)[-1] - rest)[state] > 0.05
    assert rest[3:6].abs().max() < 1e-9, "centred sticks hover"


def test_an_effect_that_does_not_fit_is_refused():
    with pytest.raises(
        BenchError, match="wind needs another one in the model: rotor_drag, linear_drag, parasitic_drag"
    ):
        Quadrotor(effects=(Wind(w_x=1.0),))
    with pytest.raises(BenchError, match="rotor_drag does not fit helicopter"):
        Helicopter(effects=(RotorDrag(),))
    assert Quadrotor(effects=(Wind(), RotorDrag())) and Helicopter(effects=(Wind(),))


def test_motor_commands_drive_through_their_map():
    state = torch.tensor([0, 0, 1, 1, 0, 0, 0.1, 0, 0, 0.995, 0.3, 0, 0], dtype=F64)
    pwm, slopes = torch.tensor([0.0, 4000, 9000, 12000], dtype=F64), torch.tensor([0.0, 50, -70, 90], dtype=F64)
    spinning, drag = RotorReactionTorque(rotor_inertia=1e-4), RotorDrag(k_d=1e-4)
    driven = Quadrotor(drive="pwm", pwm_gain=0.05, pwm_offset=-40.0, effects=(spinning, drag))
    speeds = torch.tensor([0.0, 160, 410, 560], dtype=F64)  # .05 u − 40, not below zero
    expected = Quadrotor(effects=(spinning, drag)).derivative(state, speeds, slopes * 0.05)
    torch.testing.assert_close(driven.derivative(state, pwm, slopes), expected)


def test_the_map_of_motor_commands_is_fitted_only_where_it_acts():
    fixed = {p.name for p in Quadrotor().parameters() if p.uncertainty == 0}
    assert {"pwm_gain", "pwm_offset"} <= fixed
    assert not {p.name for p in Quadrotor(drive="pwm").parameters() if p.uncertainty == 0} & {"pwm_gain", "pwm_offset"}
    with pytest.raises(BenchError, match="drive = 'pvm': did you mean pwm"):
        Quadrotor(drive="pvm")


def test_fixed_constants_take_part_in_gradients_after_inference():
    state, speeds = torch.zeros(13, dtype=F64), torch.full((4,), 500.0, dtype=F64)
    state[9] = 1
    model = Quadrotor(mass=1.25, thrust_coefficient=9.1e-6)
    with torch.inference_mode():
        model.derivative(state, speeds)
    model.derivative(state, speeds.requires_grad_())[5].backward()
    assert speeds.grad == pytest.approx(2 * 9.1e-6 * 500 / 1.25)
