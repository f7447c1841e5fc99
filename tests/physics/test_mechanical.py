"""Systems that do not fly, and their effects, against solutions known in closed form."""

import itertools
import math

import numpy as np
import pytest
import torch

from registry.core import EFFECTS
from registry.effects.mechanics.friction import (
    STICKING,
    CoulombFriction,
    OffsetForce,
    QuadraticDrag,
    StribeckFriction,
    ViscousFriction,
)
from registry.effects.mechanics.hysteresis import Backlash, BoucWen
from registry.effects.mechanics.stiffness import (
    Cogging,
    CubicStiffness,
    GravityTorque,
    JointElasticity,
    LinearStiffness,
)
from registry.effects.polynomial import Monomial
from registry.effects.process import DeadZone, Overflow, Saturation, TransportDelay
from registry.errors import BenchError
from registry.physics.falling_body import FallingBody, Projectile
from registry.physics.lorenz import Lorenz
from registry.physics.mass_on_rail import MassOnRail
from registry.physics.oscillator import Oscillator
from registry.physics.pendulum import Pendulum
from registry.physics.tanks import Tanks
from registry.physics.van_der_pol import VanDerPol
from tests.servos import Servo

F64 = torch.float64


POLYNOMIALS = [e for e in map(EFFECTS.get, EFFECTS.names()) if issubclass(e, Monomial)]


def test_every_polynomial_term_is_there_once():
    ids = [EFFECTS.name_of(e) for e in POLYNOMIALS]
    assert len(ids) == 2 * 10 + 3 * 20 + 8
    assert {"van_der_pol.dy.y3", "lorenz.dx.y3", "lorenz.dz.1", "pendulum.domega.theta3"} <= set(ids)
    assert "pendulum.domega.omega" not in ids  # viscous_friction says it


def test_every_effect_that_does_not_fly_is_bounded_or_measured_in_what_was_recorded():
    of_others = {"quadrotor", "helicopter"}
    grounded = {e for e in map(EFFECTS.get, EFFECTS.names()) if e.systems and not of_others & set(e.systems)}
    assert {CubicStiffness, TransportDelay} < grounded
    for effect in grounded:
        parameters = effect.neutral().parameters()
        assert all((p.low is not None and p.high is not None) or p.measure for p in parameters), effect


def added(model, effect, state, inputs=()):
    """What an effect adds to the derivative (s,) of a model."""
    x, u = torch.tensor(state, dtype=F64), torch.tensor(inputs, dtype=F64)
    bare, changed = type(model)(**fields(model)), type(model)(**fields(model), effects=(effect,))
    own = torch.zeros(changed.internal_size, dtype=F64)
    return changed.derivative(torch.cat([x, own]), u)[: len(x)].sub(bare.derivative(x, u)).tolist()


def fields(model):
    return {p.name: p.value for p in model.parameters()}


def test_a_system_that_only_says_it_is_like_a_rail_has_no_weight_that_turns_it():
    class Other(Lorenz):
        alike = ("mass_on_rail",)

    assert GravityTorque.suits(Servo) and not GravityTorque.suits(MassOnRail)
    assert not GravityTorque.suits(Other)


def test_forces_by_hand():
    rail = MassOnRail(mass=50.0)
    assert added(rail, ViscousFriction(f_v=200.0), (0.1, 0.3), (0.0,)) == pytest.approx([0, -200 * 0.3 / 50])
    assert added(rail, CoulombFriction(f_c=20.0), (0.1, -0.3), (0.0,)) == pytest.approx([0, 20 / 50])
    assert added(rail, OffsetForce(f_0=-3.0), (0.1, 0.3), (0.0,)) == pytest.approx([0, -3 / 50])
    stribeck = StribeckFriction(f_c=20.0, f_s=30.0, v_s=0.3)
    assert added(rail, stribeck, (0.0, 0.3), (0.0,)) == pytest.approx([0, -(20 + 10 / math.e) / 50])
    assert added(rail, Cogging(a=2.0, b=1.0, pitch=0.02), (0.005, 0.0), (0.0,)) == pytest.approx([0, 2 / 50])
    assert added(rail, LinearStiffness(k=40.0), (0.2, 0.3), (0.0,)) == pytest.approx([0, -40 * 0.2 / 50])
    # An arm of .3 kg m² whose 1.2 kg are .25 m from its axis, level at zero, 30 deg up.
    weight = added(Servo(mass=0.3), GravityTorque(b=-1.2 * 9.81 * 0.25), (math.pi / 6, 0.0), (0.0,))
    assert weight == pytest.approx([0, -1.2 * 9.81 * 0.25 * math.cos(math.pi / 6) / 0.3])
    spring = Oscillator(mass=2.0)
    assert added(spring, CubicStiffness(k_3=7.0), (0.3, 0.0), (0.0,)) == pytest.approx([0, -7 * 0.3**3 / 2])
    # On a pendulum of length 2 m a force F along the path turns by F/(m l).
    pendulum = Pendulum(mass=3.0, length=2.0)
    assert added(pendulum, ViscousFriction(f_v=0.6), (0.4, 0.5)) == pytest.approx([0, -0.6 * 0.5 / 3])
    drag = added(Projectile(mass=2.0), QuadraticDrag(c=0.1), (0, 0, 0, 3.0, 0.0, -4.0))
    assert drag == pytest.approx([0, 0, 0, -0.1 * 5 * 3 / 2, 0, 0.1 * 5 * 4 / 2])
    term = EFFECTS.get("lorenz.dy.xz2")(c=0.01)
    assert added(Lorenz(), term, (2.0, 5.0, 3.0)) == pytest.approx([0, 0.01 * 2 * 9, 0])


def test_bouc_wen_follows_its_published_equation():
    """Against the equation written out in numpy, by Euler steps a hundred times as small."""
    values = {"alpha": 5e4, "beta": 1e3, "gamma": 0.8, "delta": -1.1, "nu": 1.0}
    t = np.arange(400) / 750
    drive = 120 * np.sin(2 * np.pi * 20 * t)
    model = Oscillator(2.0, 10.0, 5e4, effects=(BoucWen(**values),))
    found = model.simulate(torch.zeros(2, dtype=F64), torch.from_numpy(drive)[:, None], 1 / 750).numpy()
    q = v = z = 0.0
    path, fine = [], 400
    for k in range(399):
        path.append(q)
        for j in range(fine):
            u = drive[k] + (drive[k + 1] - drive[k]) * j / fine
            dz = 5e4 * v - 1e3 * (0.8 * abs(v) * z - 1.1 * v * abs(z))
            q, v, z = q + v / 750 / fine, v + (u - 10 * v - 5e4 * q - z) / 2 / 750 / fine, z + dz / 750 / fine
    assert found[:399, 0] == pytest.approx(np.array(path), abs=0.02 * np.abs(path).max())


def free(model, state, seconds, dt):
    """Free run (N, s) of an undriven (or undisturbed) model."""
    n = round(seconds / dt) + 1
    inputs = torch.zeros(n, len(model.input_signals), dtype=F64)
    return model.simulate(torch.tensor(state, dtype=F64), inputs, dt).numpy()


def test_damped_oscillator_rings_as_it_must():
    m, d, k = 2.0, 0.8, 50.0
    q = free(Oscillator(m, 0.0, k, effects=(ViscousFriction(f_v=d),)), (0.1, 0.0), 4.0, 0.01)[:, 0]
    t, decay = np.arange(401) * 0.01, d / (2 * m)
    w = math.sqrt(k / m - decay**2)
    assert q == pytest.approx(0.1 * np.exp(-decay * t) * (np.cos(w * t) + decay / w * np.sin(w * t)), abs=1e-6)


def test_coulomb_friction_stops_a_mass_after_its_braking_distance():
    path = free(MassOnRail(mass=95.0, effects=(CoulombFriction(f_c=20.0),)), (0.0, 0.1), 1.0, 0.001)
    assert path[-1, 0] == pytest.approx(95 * 0.1**2 / (2 * 20), rel=1e-3)  # m v²/2 = F_c s
    assert abs(path[-1, 1]) < STICKING * 1e-3


def test_dry_friction_brakes_and_holds_a_mass_at_any_step():
    """Braked from .1 m/s at 2 m/s² within a step of .1 s, and then held against half of what friction can."""
    mass = MassOnRail(mass=1.0, force_gain=1.0, effects=(CoulombFriction(f_c=2.0),))
    path = free(mass, (0.0, 0.1), 1.0, 0.1)
    assert path[1:, 1] == pytest.approx(0.0, abs=1e-12) and path[1:, 0] == pytest.approx(path[1, 0], abs=1e-12)
    pushed = mass.simulate(torch.zeros(2, dtype=F64), torch.ones(101, 1, dtype=F64), 0.02)
    assert pushed.abs().max() < 1e-12


def test_small_swings_of_a_pendulum():
    theta = free(Pendulum(length=0.7), (0.01, 0.0), 3.0, 0.01)[:, 0]
    assert theta == pytest.approx(0.01 * np.cos(math.sqrt(9.81 / 0.7) * np.arange(301) * 0.01), abs=2e-6)


def test_a_bernoulli_tank_empties_in_torricellis_time():
    """√h falls at k/2: the lower tank, with nothing above it, is empty after 2 √h0 / k."""
    tank = Tanks(upper_linear=0.0, lower_linear=0.0, lower_outflow=0.1)
    level = free(tank, (0.0, 9.0), 60.0, 0.1)[:, 1]
    t = np.arange(601) * 0.1
    before = t < 2 * 3 / 0.1 - 1
    assert level[before] == pytest.approx((3 - 0.1 * t[before] / 2) ** 2, abs=1e-6)
    assert 0 <= level[-1] < 2e-3


def test_what_leaves_the_upper_tank_reaches_the_lower():
    tank = Tanks(lower_outflow=0.0, lower_linear=0.0, pump_gain=0.0, effects=(Overflow(0.2, 8.0, 99.0, 1.0),))
    levels = free(tank, (12.0, 1.0), 300.0, 1.0)
    assert levels.sum(axis=1) == pytest.approx(13.0)
    over = added(Tanks(), Overflow(k=0.2, upper_rim=8.0, lower_rim=9.5, share=0.3), (10.0, 9.6), (0.0,))
    assert over == pytest.approx([-0.2 * 2, 0.3 * 0.2 * 2 - 0.2 * 0.1])


def test_a_falling_body_reaches_its_terminal_speed():
    fall = free(FallingBody(mass=2.0, effects=(QuadraticDrag(c=0.05),)), (0.0, 0.0), 10.0, 0.01)
    terminal, t = math.sqrt(2 * 9.81 / 0.05), np.arange(1001) * 0.01
    assert fall[:, 1] == pytest.approx(-terminal * np.tanh(9.81 * t / terminal), abs=1e-6)
    thrown = free(Projectile(), (0, 0, 2.0, 3.0, -1.0, 4.0), 1.0, 0.01)[-1]
    assert thrown[:3] == pytest.approx([3.0, -1.0, 2 + 4 - 9.81 / 2])


def test_undriven_systems_run_without_inputs_and_with_time_beside():
    for model, state in ((VanDerPol(), (1.0, 0.5)), (Lorenz(), (1.0, 2.0, 20.0))):
        path = free(model, state, 1.0, 0.01)
        timed = type(model)(extras=("time",)).simulate(
            torch.tensor(state, dtype=F64), torch.arange(101, dtype=F64)[:, None], 0.01
        )
        assert np.isfinite(path).all() and (timed.numpy() == path).all()
    x, y = 1.3, -0.7
    rate = VanDerPol(mu=0.5).derivative(torch.tensor([x, y], dtype=F64), torch.empty(0, dtype=F64))
    assert rate.tolist() == pytest.approx([y, 0.5 * (1 - x**2) * y - x])


def acting(effect, inputs, dt=0.01, held=False):
    """What acts at the end of each step, from the effect alone."""
    drive = torch.tensor(inputs, dtype=F64)[:, None]
    memory, out = effect.steady(drive[0], dt), []
    for before, after in itertools.pairwise(drive):
        segment = torch.stack([before] * 3 if held else [before, (before + after) / 2, after])
        memory, segment = effect.act(memory, segment, dt, held)
        out.append(segment[-1].item())
    return out


def test_what_lies_between_drive_and_force():
    assert acting(DeadZone(width=0.5), [0, 0.3, 0.8, -2]) == pytest.approx([0, 0.3, -1.5])
    assert acting(Saturation(inverse=0.5), [0, 1.5, 3, -7]) == pytest.approx([1.5, 2, -2])
    assert acting(Backlash(width=0.5), [0, 2, 1.4, 0.5, -1, -0.2]) == pytest.approx([1.5, 1.5, 1.0, -0.5, -0.5])
    ramp = acting(TransportDelay(delay=10.0), list(np.arange(12.0)), dt=4.0)
    assert ramp[2:] == pytest.approx(np.arange(3, 12) - 2.5)


def test_joint_elasticity_is_exact_for_a_step():
    w, zeta, t = 1 / 0.03, 0.2, np.arange(1, 60) * 0.01
    step = acting(JointElasticity(resonance_period=2 * math.pi * 0.03, damping=zeta), [0.0] + [1.0] * 60, held=True)[1:]
    damped = w * math.sqrt(1 - zeta**2)
    expected = 1 - np.exp(-zeta * w * t) * (np.cos(damped * t) + zeta * w / damped * np.sin(damped * t))
    assert step == pytest.approx(expected.tolist(), abs=1e-12)


def test_an_effect_of_another_system_is_refused():
    with pytest.raises(BenchError, match="overflow does not fit mass_on_rail"):
        MassOnRail(effects=(Overflow(),))
