"""Effects against numbers computed by hand, where `test_catalogue` does not write their equation out."""

import itertools
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from bench.diagnose.report import model_file
from registry.core import EFFECTS
from registry.dynamics import InputEffect
from registry.effects.actuation import InputDelay, MotorLag
from registry.effects.air import LinearDrag
from registry.effects.mass import CogOffset
from registry.effects.mechanics.hysteresis import Backlash
from registry.effects.mechanics.stiffness import JointElasticity
from registry.effects.process import CurvedDrive, DeadZone, Saturation
from registry.effects.rotor import GroundEffect, RotorReactionTorque
from registry.effects.suspended_load import SuspendedLoad
from registry.effects.thrust import BatterySag, RotorMisalignment, UnequalRotors
from registry.equations import lanes
from registry.errors import BenchError
from registry.model_file import read
from registry.physics.quadrotor import Quadrotor
from registry.terms.unit_algebra import product
from registry.units import exponents

F64 = torch.float64


def of_the_quadrotor():
    of_it = [e for e in map(EFFECTS.get, EFFECTS.names()) if e.suits(Quadrotor)]
    return [e for e in of_it if not e.learned]  # what was learned is data, of any system: see test_learned_term.py


@pytest.mark.parametrize("effect", of_the_quadrotor(), ids=EFFECTS.name_of)
def test_a_fit_can_start_at_rest_on_the_ground(effect):
    """Bounds on both sides, and finite gradients at neutral values where velocities, rates and thrust are zero."""
    values = {p.name: torch.tensor(p.neutral, dtype=F64, requires_grad=True) for p in effect.neutral().parameters()}
    assert all(p.high is not None for p in effect.neutral().parameters() if p.uncertainty > 0)
    others = (LinearDrag(0.4, 0.4, 0.4),) if effect.requires else ()
    extras = ("battery",) if effect is BatterySag else ()
    state = torch.zeros(13, dtype=F64)
    state[9] = 1
    inputs = torch.zeros(3, 4 + len(extras), dtype=F64, requires_grad=True)
    model = Quadrotor(effects=(effect(**values), *others), extras=extras)
    model.simulate(state.requires_grad_(), inputs, 0.01).sum().backward()
    assert all(v.grad is None or v.grad.isfinite().all() for v in (state, inputs, *values.values()))


def added(effect, *, position=(0, 0, 9.0), velocity=(0, 0, 0), rates=(0, 0, 0), speeds=(400.0,) * 4, slopes=(0,) * 4):
    """What an effect adds to the derivative (13,) of a level quadrotor, in unit mass and the default inertia."""
    state = torch.tensor([*position, *velocity, 0, 0, 0, 1, *rates], dtype=F64)
    u, du = torch.tensor(speeds, dtype=F64), torch.tensor(slopes, dtype=F64)
    effects = effect if isinstance(effect, tuple) else (effect,)
    return (Quadrotor(effects=effects).derivative(state, u, du) - Quadrotor().derivative(state, u, du)).numpy()


def test_ground_effect_lifts_and_is_clamped():
    thrust = 9.9865e-6 * 400**2
    out = added(GroundEffect(c=1.0), position=(0, 0, 0.2))
    assert out[5] == pytest.approx(4 * thrust * (1 / (1 - (0.127 / 0.8) ** 2) - 1))
    assert added(GroundEffect(c=1.0), position=(0, 0, 0.001))[5] == pytest.approx(4 * thrust * (1.44 / 0.44 - 1))


def test_reaction_torque_integrates_to_the_change_of_speed():
    state = torch.zeros(13, dtype=F64)
    state[9] = 1
    inputs = torch.tensor([[400.0] * 4, [400 + 7.0, 400, 400, 400]], dtype=F64)
    model = Quadrotor(effects=(RotorReactionTorque(rotor_inertia=1e-4),), torque_coefficient=0.0)
    assert model.simulate(state, inputs, 0.01)[-1][12].item() == pytest.approx(1e-4 * 7 / 0.02)


def acting(effect, inputs, hold, dt=0.01):
    """Acting inputs at the end of each step, from the effect alone."""
    memory, out = effect.steady(inputs[0], dt), []
    for before, after in itertools.pairwise(inputs):
        held = hold == "previous"
        segment = torch.stack([before] * 3 if held else [before, (before + after) / 2, after])
        memory, segment = effect.act(memory, segment, dt, held)
        out.append(segment[-1])
    return torch.stack(out).numpy()[:, 0]


def test_motor_lag_is_exact_for_steps_and_ramps():
    t = np.arange(1, 9) * 0.01
    up = torch.tensor([[0.0]] + [[1.0]] * 8, dtype=F64)
    lag = MotorLag(tau_up=0.02, tau_down=0.05)
    held = acting(lag, up, "previous")
    assert held[1:] == pytest.approx(1 - np.exp(-t[:-1] / 0.02), abs=1e-12) and held[0] == 0
    assert acting(lag, 1 - up, "previous")[1:] == pytest.approx(np.exp(-t[:-1] / 0.05), abs=1e-12)
    ramp = torch.arange(9, dtype=F64)[:, None] * 0.01
    assert acting(lag, ramp, "linear") == pytest.approx(t - 0.02 * (1 - np.exp(-t / 0.02)), abs=1e-12)


def test_input_delay_is_fractional():
    ramp = torch.arange(30, dtype=F64)[:, None]
    assert acting(InputDelay(delay=0.025), ramp, "linear")[10:] == pytest.approx(np.arange(11, 30) - 2.5)
    assert acting(InputDelay(delay=0.2), ramp, "linear")[-1] == pytest.approx(9)
    pulse = torch.zeros(10, 1, dtype=F64)
    pulse[3] = 1.0  # held over the step from 3 to 4: with 1.25 samples of delay, .75 of it in the next
    assert acting(InputDelay(delay=0.0125), pulse, "previous") == pytest.approx([0, 0, 0, 0, 0.75, 0.25, 0, 0, 0])


def test_thrust_that_effects_change_is_what_others_see():
    weak = UnequalRotors(eps_1=-0.4, eps_2=-0.4, eps_3=-0.4, eps_4=-0.4)
    for effect in (GroundEffect(c=5.0), RotorMisalignment(a_x=0.1, a_y=0.2), CogOffset(x=0.01, y=0.02)):
        alone = added(effect, position=(0, 0, 0.2))
        both = added((weak, effect), position=(0, 0, 0.2)) - added(weak, position=(0, 0, 0.2))
        assert both == pytest.approx(0.6 * alone, abs=1e-12) and np.abs(alone).max() > 0.1


def test_unequal_rotors_are_as_many_as_the_vehicle_has(tmp_path: Path):
    angles = [math.pi / 6 + i * math.pi / 3 for i in range(6)]
    places = tuple((0.3 * math.cos(a), 0.3 * math.sin(a), 0.0) for a in angles)
    craft = {"rotor_positions": places, "rotor_directions": (1.0, -1.0) * 3}
    hexarotor = Quadrotor(**craft)
    neutral = UnequalRotors.neutral_for(hexarotor, {})
    assert [p.name for p in neutral.parameters()] == [f"eps_{i}" for i in range(1, 7)]
    with pytest.raises(BenchError, match="factors of 4 rotors, and the vehicle has 6"):
        replace(hexarotor, effects=(UnequalRotors(),))
    weak = replace(hexarotor, effects=(replace(neutral, eps_5=-0.2),))
    state, u = torch.tensor([0, 0, 9.0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0], dtype=F64), torch.full((6,), 400.0, dtype=F64)
    out = weak.derivative(state, u) - hexarotor.derivative(state, u)
    lost = 0.2 * 9.9865e-6 * 400**2  # of rotor 5, at 270 degrees: on the right
    assert out[5] == pytest.approx(-lost) and out[10:12] == pytest.approx([0.3 * lost / 0.01, 0.0], abs=1e-9)
    model_file.write(tmp_path / "model.toml", weak, ())
    assert read(tmp_path / "model.toml").effects == weak.effects


def test_battery_sag_asks_for_a_signal():
    with pytest.raises(BenchError, match="battery_sag needs a model with extras"):
        added(BatterySag(slope=0.1))


@pytest.mark.parametrize("zeta", [0.0, 0.1])
def test_a_suspended_load_swings_at_its_frequency(zeta):
    """Small swings under a free body: θ = θ0 e^(−ζωt) cos(…), with ω² = (g/l)(1 + m_l/m) of a pendulum on a cart."""
    m, m_l, length, dt = 1.0, 0.25, 0.7, 0.01
    hover = math.sqrt(9.81 * m / (4 * 9.9865e-6))
    model = Quadrotor(effects=(SuspendedLoad(m_l=m_l, l=length, zeta=zeta),))
    state, inputs = torch.zeros(13, dtype=F64), torch.full((201, 4), hover, dtype=F64)
    state[8], state[9] = math.sin(0.6), math.cos(0.6)  # any heading
    full = model.initial(state, inputs[0], dt)
    full[13:15] = torch.tensor([0.02, -0.01])
    path = [full := model.step(full, inputs[0], inputs[0], dt) for _ in range(200)]
    omega = math.sqrt(9.81 / length * (1 + m_l / m))
    t, damped = np.arange(1, 201) * dt, omega * math.sqrt(1 - zeta**2)
    decay = np.exp(-zeta * omega * t)
    swing = decay * (np.cos(damped * t) + zeta * omega / damped * np.sin(damped * t))
    found = torch.stack(path).numpy()
    assert found[:, 13] == pytest.approx(0.02 * swing, abs=1e-7)
    assert found[:, 14] == pytest.approx(-0.01 * swing, abs=1e-7)
    # The body's momentum is what the load's pull has given it: m v = ∫ m_l g θ dt.
    speed = 0.02 * m_l * 9.81 / m * np.sin(omega * t) / omega
    assert zeta or found[:, 3] == pytest.approx(speed, abs=1e-7)


@pytest.mark.parametrize("thrust", [1.0, 1.4])
def test_a_suspended_load_and_the_vehicle_pull_at_one_rope(thrust):
    """Two masses and n (p_l − p) = l: accelerations of both, and the tension, of one system of equations."""
    m, m_l, length, tilt, g = 1.0, 0.25, 0.7, 1e-3, 9.81
    swing, rate = np.array([2e-3, -1e-3]), np.array([3e-3, 1e-3])
    n, turning = np.array([*swing, -math.sqrt(1 - swing @ swing)]), rate @ rate
    lift = thrust * (m + m_l) * g * np.array([math.sin(tilt), 0.0, math.cos(tilt)])
    system, known = np.zeros((7, 7)), np.zeros(7)
    system[:3, :3], system[3:6, 3:6] = m * np.eye(3), m_l * np.eye(3)
    system[:3, 6], system[3:6, 6] = -n, n
    system[6, :3], system[6, 3:6] = -n, n
    known[:3], known[5], known[6] = lift - [0, 0, m * g], -m_l * g, -length * turning
    body, load = np.linalg.solve(system, known)[:6].reshape(2, 3)

    model = Quadrotor(effects=(SuspendedLoad(m_l=m_l, l=length, zeta=0.0),))
    assert model.mass == m and model.gravity == g
    state = torch.zeros(17, dtype=F64)
    state[7], state[9] = math.sin(tilt / 2), math.cos(tilt / 2)
    state[13:] = torch.tensor([*swing, *rate])
    speed = math.sqrt(thrust * (m + m_l) * g / (4 * model.thrust_coefficient))
    found = model.derivative(state, torch.full((4,), speed, dtype=F64)).numpy()
    assert found[5] == pytest.approx(body[2], abs=1e-4)
    linear = replace(model, effects=(SuspendedLoad(m_l=m_l, l=length, zeta=0.0, carried=0.0),))
    rest = linear.derivative(state, torch.full((4,), speed, dtype=F64)).numpy()
    assert rest[5] == pytest.approx(lift[2] / m - g) and np.delete(rest, 5) == pytest.approx(np.delete(found, 5))
    if thrust == 1.0:  # while it does not climb, small swings are those of the formula
        assert found[3:5] == pytest.approx(body[:2], abs=1e-6)
        assert found[15:] == pytest.approx((load - body)[:2] / length, abs=1e-6)


def test_units_of_parameters_are_read():
    assert exponents("N m s^2") == {"N": 1, "m": 1, "s": 2} and exponents("1/V") == {"V": -1} and exponents("1") == {}
    assert (
        exponents("1/(N m)") == {"N": -1, "m": -1} == exponents(product(("N m", -1)))
        and product(("N m", -1)) == "1/(N m)"
    )
    assert exponents("rad/s/pwm") == {"rad": 1, "s": -1, "pwm": -1}
    assert exponents("m^1.5/s") == {"m": 1.5, "s": -1}  # of a force that goes with height^−1.5
    for wrong in ("deg/s", "N m2", "kg m^", "m^-1", "m^1.", "furlong", ""):
        with pytest.raises(BenchError):
            exponents(wrong)


def both_ways(effect, segments, held):
    """Memories and segments of the later half at once and step by step, from what the first half left."""
    start = effect.steady(segments[..., 0, 0, :], 0.01)
    before, after = segments.tensor_split(2, dim=-3)
    memory = InputEffect.over(effect, start, before, 0.01, held)[0][..., -1, :]
    return effect.over(memory, after, 0.01, held), InputEffect.over(effect, memory, after, 0.01, held)


@pytest.mark.parametrize("held", [False, True])
@pytest.mark.parametrize("delay", [0.0, 0.0137, 0.02, 0.2, torch.tensor([[0.01], [0.033]], dtype=F64)])
def test_a_delay_of_a_whole_recording_at_once_is_that_of_its_steps(held, delay):
    u = torch.randn(3, 40, 2, generator=torch.Generator().manual_seed(0), dtype=F64)
    before, after = u[:, :-1], u[:, 1:]
    segments = torch.stack([before] * 3 if held else [before, (before + after) / 2, after], dim=-2)
    if isinstance(delay, torch.Tensor):
        segments = segments.expand(2, *segments.shape)
    for at_once, stepped in zip(*both_ways(InputDelay(delay), segments, held), strict=True):
        torch.testing.assert_close(at_once, stepped, rtol=1e-13, atol=1e-13)


MANY = torch.tensor([[0.2], [0.9]], dtype=F64)


@pytest.mark.parametrize("held", [False, True])
@pytest.mark.parametrize(
    "effect",
    [
        Backlash(0.3),
        Backlash(MANY),
        DeadZone(0.3),
        DeadZone(MANY),
        Saturation(0.8),
        CurvedDrive(MANY, 1.2),
        JointElasticity(0.19, 0.2),
        JointElasticity(0.0, 0.1),
        JointElasticity(MANY / 2, MANY / 2),
    ],
    ids=lambda e: type(e).__name__,
)
def test_a_drive_of_a_whole_recording_at_once_is_that_of_its_steps(held, effect):
    u = torch.randn(3, 40, 2, generator=torch.Generator().manual_seed(0), dtype=F64)
    before, after = u[:, :-1], u[:, 1:]
    segments = torch.stack([before] * 3 if held else [before, (before + after) / 2, after], dim=-2)
    if any(isinstance(p.value, torch.Tensor) for p in effect.parameters()):
        segments = segments.expand(2, *segments.shape)
    for at_once, one_by_one in zip(*both_ways(effect, segments, held), strict=True):
        torch.testing.assert_close(at_once, one_by_one, rtol=1e-11, atol=1e-12)


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("held", [False, True])
@pytest.mark.parametrize(
    "up, down, exact",
    [
        (0.03, 0.07, 0.0),
        (0.0, 0.0, 0.0),
        (torch.tensor([[0.01], [0.4]], dtype=F64), torch.tensor([[0.0], [0.05]], dtype=F64), 0.0),
        (0.03, 0.03, 1e-12),
        (MANY / 3, MANY / 3, 1e-12),
    ],
)
def test_a_lag_of_a_whole_recording_at_once_is_that_of_its_steps(held, up, down, exact, compiled, monkeypatch):
    monkeypatch.setattr(lanes, "available", (lambda: compiled) if lanes.available() else lanes.available)
    u = torch.randn(3, 60, 2, generator=torch.Generator().manual_seed(0), dtype=F64)
    before, after = u[:, :-1], u[:, 1:]
    segments = torch.stack([before] * 3 if held else [before, (before + after) / 2, after], dim=-2)
    if isinstance(up, torch.Tensor):
        segments = segments.expand(2, *segments.shape)
    lag = MotorLag(up, down)
    for at_once, stepped in zip(*both_ways(lag, segments, held), strict=True):
        torch.testing.assert_close(at_once, stepped, rtol=exact, atol=exact)
    moved = segments.clone().requires_grad_()
    lag.transmitted(segments[..., 0, 0, :], moved, 0.01, held).sum().backward()  # where a gradient is asked for
    assert moved.grad.abs().max() > 0.5
