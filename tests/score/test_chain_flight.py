"""The second simulator against what is known of bodies, motors and gusts, against RotorPy and the catalogue."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

pytest.importorskip("rotorpy")
from rotorpy.vehicles.multirotor import Multirotor

from bench.score.chain import flight, paths, pilot, point
from bench.score.chain.case import _tuples, constants
from bench.score.chain.strengths import TYPICAL, draw, identity
from bench.score.chain.suite import SLOWEST, VEHICLES
from bench.score.chain.vehicle import turbulence
from bench.score.chain.vehicle.airframe import AIRFRAMES, GRAVITY, specimen
from bench.score.chain.vehicle.body import LOAD, Body, Moment, Q, V, W, rotation
from bench.score.chain.vehicle.motors import Motors
from registry.core import EFFECTS
from registry.physics.quadrotor import Quadrotor

CALM = np.zeros((3, 1))
STILL = Moment(0.0, np.zeros((4, 1)), np.zeros((4, 1)), CALM)


def _at_rest(size: int = 13) -> np.ndarray:
    state = np.zeros((size, 1))
    state[6] = 1.0
    return state


def _flown(body: Body, state: np.ndarray, now: Moment, seconds: float, dt: float = 1e-3) -> np.ndarray:
    for _ in range(round(seconds / dt)):
        state = body.step(state, (now, now, now), dt)
    return state


def test_a_body_that_falls_through_linear_drag_reaches_the_analytic_speed() -> None:
    craft = AIRFRAMES["survey"]
    body = Body(craft, {"linear_drag": {"d_x": 0.1, "d_y": 0.1, "d_z": 0.4}}, np.zeros(1))
    end = _flown(body, _at_rest(), STILL, 2.0)
    time = craft.mass / 0.4
    assert end[5, 0] == pytest.approx(-GRAVITY * time * (1 - np.exp(-2 / time)), rel=1e-11)
    assert end[2, 0] == pytest.approx(-GRAVITY * time * (2 - time * (1 - np.exp(-2 / time))), rel=1e-11)


def test_a_body_free_of_torque_keeps_angular_momentum_and_energy_as_it_tumbles() -> None:
    products = {"J_xy": 4e-4, "J_xz": -3e-4, "J_yz": 2e-4}
    body = Body(AIRFRAMES["survey"], {"inertia_products": products}, np.zeros(1))
    state = _at_rest()
    state[W, 0] = 3.0, 6.0, -2.0
    j = np.diag(body.craft.inertia) + np.array([[0, 4e-4, -3e-4], [4e-4, 0, 2e-4], [-3e-4, 2e-4, 0]])

    def kept(x: np.ndarray) -> np.ndarray:
        turn, rates = rotation(x[Q])[..., 0], x[W, 0]
        return np.append(turn @ j @ rates, rates @ j @ rates)

    end = _flown(body, state, STILL, 5.0)
    assert np.abs(rotation(end[Q]) - rotation(state[Q])).max() > 0.5
    np.testing.assert_allclose(kept(end), kept(state), rtol=1e-7, atol=1e-10)


def test_a_body_hovers_at_the_speed_that_carries_it() -> None:
    craft = AIRFRAMES["nano"]
    speed = np.full((4, 1), np.sqrt(craft.mass * 9.81 / 4 / craft.thrust))
    end = _flown(Body(craft, {}, np.zeros(1)), _at_rest(), Moment(0.0, speed, 0 * speed, CALM), 3.0)
    np.testing.assert_allclose(end, _at_rest(), atol=1e-10)


def test_a_load_swings_at_the_frequency_of_a_pendulum_under_a_free_mass() -> None:
    craft = AIRFRAMES["racer"]  # its arms are of one length: it stays level
    body = Body(craft, {"suspended_load": {"m_l": 0.3, "l": 0.7, "zeta": 0.0}}, np.zeros(1))
    state, hover = _at_rest(17), np.full((4, 1), craft.hover)
    state[LOAD.start, 0] = 1e-3
    half = np.pi / np.sqrt(GRAVITY / 0.7 * (1 + 0.3 / craft.mass))
    end = _flown(body, state, Moment(0.0, hover, 0 * hover, CALM), half, half / 1000)
    np.testing.assert_allclose(end[LOAD, 0], [-1e-3, 0, 0, 0], atol=1e-10)


@pytest.mark.parametrize("vehicle", ["survey", "nano"])
def test_forces_and_torques_are_rotorpys(vehicle: str) -> None:
    rng = np.random.default_rng(4)
    craft = specimen(rng, vehicle)
    k, c, j = craft.mass / (4 * craft.hover), craft.mass * np.array([0.03, 0.05, 0.04]), craft.inertia[0]
    products = (0.05 * j, -0.04 * j, 0.03 * j)
    effects = {
        "rotor_drag": {"k_d": 0.4 * k},
        "inflow_thrust_loss": {"k_z": 0.6 * k},
        "parasitic_drag": dict(zip(("c_x", "c_y", "c_z"), c, strict=True)),
        "blade_flapping": {"k_flap": 0.5 * j / (4 * craft.hover)},
        "translational_lift": {"k_h": 0.01 * craft.mass},
        "inertia_products": dict(zip(("J_xy", "J_xz", "J_yz"), products, strict=True)),
    }
    named = dict(zip(("mass", "Ixx", "Iyy", "Izz"), (craft.mass, *craft.inertia), strict=True))
    named |= dict(zip(("Ixy", "Ixz", "Iyz"), products, strict=True))
    named |= dict(zip(("c_Dx", "c_Dy", "c_Dz"), c, strict=True))
    named |= {"k_eta": craft.thrust, "k_m": craft.drag, "k_d": 0.4 * k, "k_z": 0.6 * k, "k_h": 0.01 * craft.mass}
    named |= {"k_flap": 0.5 * j / (4 * craft.hover), "tau_m": 0.01, "num_rotors": 4}
    named |= {"rotor_speed_min": 0, "rotor_speed_max": 1e5, "motor_noise_std": 0}
    hubs = {f"r{i + 1}": np.array([*hub, 0.0]) for i, hub in enumerate(craft.hubs)}
    named |= {"rotor_pos": hubs, "rotor_directions": np.array(craft.turns)}
    theirs = Multirotor(named, control_abstraction="cmd_motor_speeds", aero=True)
    state = rng.normal(size=(13, 6))
    state[Q] /= np.linalg.norm(state[Q], axis=0)
    speed, wind = rng.uniform(0.6, 1.4, (4, 6)) * craft.hover, rng.normal(size=(3, 6))
    ours = Body(craft, effects, np.zeros(6)).rates(state, Moment(0.0, speed, 0 * speed, wind))
    for i in range(6):
        x = {"x": state[:3, i], "v": state[V, i], "q": state[[7, 8, 9, 6], i], "w": state[W, i]}
        x |= {"wind": wind[:, i], "rotor_speeds": speed[:, i]}
        said = theirs.statedot(x, {"cmd_motor_speeds": speed[:, i]}, 0.01)
        np.testing.assert_allclose(ours[V, i], said["vdot"], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(ours[W, i], said["wdot"], rtol=1e-9, atol=1e-9)


ELSEWHERE = {"motor_lag", "input_delay", "wind", "recorded_point"}
"""Effects in motors, in the air and in what sensors see."""


def test_a_recorded_point_moves_as_the_catalogue_says() -> None:
    """Rates of the point by differences of the body's motion, held against the model whose state is the point's."""
    rng = np.random.default_rng(2)
    craft = specimen(rng, "nano")
    values = draw(rng, "recorded_point", craft, 1.0)
    at, body, still = point.arm({"recorded_point": values}), Body(craft, {}, np.zeros(5)), np.zeros((3, 5))
    state = rng.normal(size=(13, 5))
    state[Q] /= np.linalg.norm(state[Q], axis=0)
    speed = rng.uniform(0.7, 1.3, (4, 5)) * craft.hover
    now, h = Moment(0.0, speed, 0 * speed, still), 1e-4
    after, before = (point.moved(body.step(state, (now, now, now), side * h), at) for side in (1, -1))
    ours = (after - before) / (2 * h)
    model = Quadrotor(
        **{k: _tuples(v) for k, v in constants(craft).items()},
        extras=("time",),
        effects=(EFFECTS.get("recorded_point")(**values),),
    )
    swap = [0, 1, 2, 3, 4, 5, 7, 8, 9, 6, 10, 11, 12]
    inputs = torch.tensor(np.concatenate([speed, np.zeros((1, 5))]).T)
    theirs = model.derivative(torch.tensor(point.moved(state, at)[swap].T), inputs).numpy().T
    np.testing.assert_allclose(ours[swap], theirs, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("key", [k for k in TYPICAL if k not in ELSEWHERE])
def test_an_effect_means_what_it_means_in_the_catalogue(key: str) -> None:
    rng = np.random.default_rng(1)
    craft = specimen(rng, "carrier")
    name, values = identity(key), draw(rng, key, craft, 1.0)
    body = Body(craft, {name: values}, np.zeros(5))
    state = 0.4 * rng.normal(size=(body.size, 5))
    state[2], state[V] = rng.uniform(0.1, 0.5, 5), 6 * state[V]
    state[Q] /= np.linalg.norm(state[Q], axis=0)
    speed, spin = rng.uniform(0.7, 1.3, (4, 5)) * craft.hover, rng.normal(size=(4, 5)) * craft.hover
    moment = Moment(3.0, speed, spin, np.zeros((3, 5)))
    ours = body.rates(state, moment)
    assert np.abs(ours[:13] - Body(craft, {}, np.zeros(5)).rates(state[:13], moment)).max() > 1e-3
    extra, said = ("battery", body.volts(3.0, speed)) if "slope" in values else ("time", np.full(5, 3.0))
    model = Quadrotor(
        **{k: _tuples(v) for k, v in constants(craft).items()},
        extras=(extra,),
        effects=(EFFECTS.get(name)(**values),),
    )
    swap = [0, 1, 2, 3, 4, 5, 7, 8, 9, 6, *range(10, body.size)]
    inputs = torch.tensor(np.concatenate([speed, said[None]]).T)
    if name == "rotor_reaction_torque":
        # It acts on the change of rotor speed over a step: take one so short that it is the rate.
        torque = values["rotor_inertia"] * (np.array(craft.turns)[:, None] * spin).sum(0)
        base = Body(craft, {}, np.zeros(5)).rates(state, moment)
        np.testing.assert_allclose((ours - base)[12], torque / craft.inertia[2], rtol=1e-9)
        return
    theirs = model.derivative(torch.tensor(state[swap].T), inputs).numpy().T
    np.testing.assert_allclose(ours[swap], theirs, rtol=1e-9, atol=1e-9)


def test_an_effect_that_no_strength_is_known_of_is_refused() -> None:
    with pytest.raises(ValueError, match=r"No such hidden effect: tether\. Add it to TYPICAL"):
        Body(AIRFRAMES["survey"], {"tether": {"k": 0.2}}, np.zeros(1))


def test_motors_answer_a_held_step_as_a_first_order_lag_with_a_time_of_its_own_up_and_down() -> None:
    motors, speed = Motors(0.03, 0.06), np.array([[100.0], [300.0], [200.0], [200.0]])
    command = np.full((4, 1), 200.0)
    for _ in range(60):
        (_, _, speed), spins = motors.step(speed, command, 1e-3)
    np.testing.assert_allclose(speed[:, 0], [200 - 100 * np.exp(-2), 200 + 100 * np.exp(-1), 200, 200], rtol=1e-12)
    assert spins[2][0, 0] == pytest.approx((200 - speed[0, 0]) / 0.03)


def test_commands_are_held_between_ticks_and_reach_rotors_late() -> None:
    craft = AIRFRAMES["survey"]
    rng = np.random.default_rng(0)
    wanted = paths.path(rng, "sines", paths.MANNERS["brisk"], 0.5, flight.BEFORE + 2, flight.DT)[:, :, None]
    air = np.zeros((wanted.shape[1], 3, 1))
    truth = flight.fly(rng, Body(craft, {}, np.zeros(1)), craft, Motors(0.0, 0.0, 0.007), 0.01, wanted, air)
    changes = np.flatnonzero(np.diff(truth.command[:, 0, 0])) + 1
    assert len(changes) > 190
    assert (changes % 10 == 0).all()
    np.testing.assert_array_equal(truth.speed[7:], truth.command[:-7])


@pytest.mark.parametrize("vehicle", VEHICLES)
def test_every_vehicle_follows_aggressive_paths_with_its_slowest_motors(vehicle: str) -> None:
    craft, motors, seconds = AIRFRAMES[vehicle], Motors(SLOWEST[vehicle], 1.4 * SLOWEST[vehicle]), flight.BEFORE + 5
    manner = paths.eased(paths.MANNERS["aggressive"], pilot.gains(motors.slowest, 0.01).attitude)
    wanted = np.stack(
        [
            paths.path(np.random.default_rng([i, 7]), kind, manner, 0.5, seconds, flight.DT)
            for i, kind in enumerate(paths.KINDS)
        ],
        axis=2,
    )
    body = Body(craft, {}, np.zeros(4))
    air = np.zeros((wanted.shape[1], 3, 4))
    truth = flight.fly(np.random.default_rng(0), body, craft, motors, 0.01, wanted, air)
    away = truth.state[:, :3] - np.moveaxis(wanted[:3, round(flight.BEFORE / flight.DT) : -1], 0, 1)
    assert np.linalg.norm(away, axis=1).max() < 2.5
    assert truth.state[:, 2].min() > 0.1


def test_yaw_is_tuned_for_the_reaction_of_the_rotors(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is half a second ahead of their drag here: tuned without it the motors swing between their ends, at 25 Hz."""
    craft, gains = AIRFRAMES["racer"], flight.gains
    wanted = paths.path(np.random.default_rng(3), "sines", paths.MANNERS["gentle"], 0.5, 5.0, flight.DT)[:, :, None]
    body = Body(craft, {"rotor_reaction_torque": {"rotor_inertia": 0.006 * craft.inertia[2]}}, np.zeros(1))
    least, greatest = craft.hover * np.sqrt([0.03 * craft.power, craft.power])

    def at_an_end() -> float:
        rng, air = np.random.default_rng(0), np.zeros((wanted.shape[1], 3, 1))
        command = flight.fly(rng, body, craft, Motors(0.014, 0.014), 0.004, wanted, air).command
        return float(((command < 1.01 * least) | (command > 0.99 * greatest)).mean())

    tuned = at_an_end()
    monkeypatch.setattr(flight, "gains", lambda lag, period, lead: gains(lag, period))
    assert tuned < 0.05 and at_an_end() > 0.2


def test_an_accelerometer_feels_the_change_of_velocity_less_gravity() -> None:
    craft = AIRFRAMES["racer"]
    rng = np.random.default_rng(2)
    wanted = paths.path(rng, "lemniscate", paths.MANNERS["aggressive"], 0.5, flight.BEFORE + 2, flight.DT)[:, :, None]
    drag = {"linear_drag": {"d_x": 0.3, "d_y": 0.3, "d_z": 0.2}}
    air = np.zeros((wanted.shape[1], 3, 1))
    truth = flight.fly(rng, Body(craft, drag, np.zeros(1)), craft, Motors(0.02, 0.02), 0.004, wanted, air)
    slope = (truth.state[2:, V, 0] - truth.state[:-2, V, 0]) / (2 * flight.DT) + [0, 0, GRAVITY]
    turn = Rotation.from_quat(truth.state[1:-1, [7, 8, 9, 6], 0])
    np.testing.assert_allclose(turn.inv().apply(slope), truth.felt[1:-1, :, 0], atol=0.02)


def test_gusts_have_the_variance_and_the_correlation_of_the_dryden_model() -> None:
    height, wind, flights = 10.0, 6.0, 400
    (along, across, up), sigmas = turbulence.scales(height, wind)
    found = turbulence.gusts(np.random.default_rng(5), height, wind, 12.0, flights, 0.01)
    assert sigmas[2] == pytest.approx(0.1 * wind)
    late = round(0.8 / 0.01)
    for axis, (length, sigma) in enumerate(zip((along, across, up), sigmas, strict=True)):
        x, ratio = found[:, axis], wind * 0.8 / length
        # Transverse gusts lose half of the correlation that those along the wind keep: Dryden's g = f + r f'/2.
        share = np.exp(-ratio) * (1 if axis == 0 else 1 - ratio / 2)
        assert (x**2).mean() == pytest.approx(sigma**2, rel=0.12)
        assert (x[late:] * x[:-late]).mean() == pytest.approx(share * sigma**2, abs=0.1 * sigma**2)
