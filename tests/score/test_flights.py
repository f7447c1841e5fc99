"""The flights that prove a diagnosis are RotorPy's own, and their hidden effects those of the formulas."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

pytest.importorskip("rotorpy")
from rotorpy.controllers.quadrotor_control import SE3Control
from rotorpy.vehicles.hummingbird_params import quad_params
from rotorpy.vehicles.multirotor import Multirotor
from scipy.spatial.transform import Rotation

from bench.score import oracle
from bench.score.cases import (
    DEVELOPMENT,
    REPORTED,
    Case,
    cases,
    clean,
    fly,
    fly_and_faults,
    nominal,
    truth,
    write_folder,
)
from bench.score.multirotor import corrupt, flights, hidden
from bench.score.multirotor.measure import LEVELS, SMOOTHINGS, Noise, measure
from bench.score.multirotor.strengths import TYPICAL, draw, drive, identity
from registry.core import EFFECTS

SHORT = {"recordings": 2, "seconds": 3.0}
DRAG = {"rotor_drag": {"k_d": 1.19e-4}}
AROUND = hidden.Surroundings(rotor_radius=0.1)


def _states(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    state = rng.normal(size=(13, count))
    state[2] = rng.uniform(0.5, 2, count)
    state[6:10] /= np.linalg.norm(state[6:10], axis=0)
    return state, rng.uniform(300, 700, (4, count))


def _level(
    effects: hidden.Effects, count: int = 1, **state: float
) -> tuple[hidden.HiddenMultirotor, np.ndarray, np.ndarray]:
    """A hovering vehicle with its state (13, 1) and rotor speeds (4, 1)."""
    craft = hidden.HiddenMultirotor(quad_params, effects, AROUND, np.zeros(count))
    x = np.zeros((13 + craft.own_states, count))
    x[2], x[9] = state.get("height", 5.0), 1.0
    x[5] = state.get("climb", 0.0)
    hover = np.sqrt(quad_params["mass"] * 9.81 / 4 / quad_params["k_eta"])
    return craft, x, np.full((4, count), hover)


def _rates(craft: flights.Rotorcraft, x: np.ndarray, speed: np.ndarray, spin: float | np.ndarray = 0.0) -> np.ndarray:
    still = np.zeros((3, x.shape[1]))
    return craft.derivative(np.zeros(x.shape[1]), x, speed, np.zeros_like(speed) + spin, still)


def test_derivative_is_that_of_rotorpy() -> None:
    parameters = {**quad_params, "k_flap": 1e-6, "Ixy": 1e-4, "Ixz": -2e-4}
    rng = np.random.default_rng(0)
    state, speed = _states(rng, 5)
    wind = rng.normal(size=(3, 5))
    ours = flights.Rotorcraft(parameters).derivative(np.zeros(5), state, speed, np.zeros((4, 5)), wind)
    for i in range(5):
        packed = np.concatenate([state[:, i], wind[:, i], speed[:, i]])
        theirs = Multirotor(parameters)._s_dot_fn(0, packed, speed[:, i])
        np.testing.assert_allclose(ours[:, i], theirs[:13], rtol=1e-12, atol=1e-12)


def test_pilot_is_that_of_rotorpy() -> None:
    state, _ = _states(np.random.default_rng(1), 5)
    wanted = np.random.default_rng(2).normal(size=(11, 5))
    commands = flights.Pilot(quad_params).command(state, wanted)
    for i in range(5):
        here = {"x": state[0:3, i], "v": state[3:6, i], "q": state[6:10, i], "w": state[10:13, i]}
        goal = dict(zip(("x", "x_dot", "x_ddot"), wanted[:9, i].reshape(3, 3), strict=True))
        speeds = SE3Control(quad_params).update(0.0, here, {**goal, "yaw": wanted[9, i], "yaw_dot": wanted[10, i]})
        theirs = np.clip(speeds["cmd_motor_speeds"], 0, quad_params["rotor_speed_max"])
        np.testing.assert_allclose(commands[:, i], theirs, rtol=1e-9, atol=1e-6)


def test_a_second_of_flight_is_that_of_rotorpy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(flights, "WARM_UP", 0.0)
    steps = 200
    wanted = np.zeros((steps + 1, 11, 1))
    wanted[:, 0, 0], wanted[:, 2, 0] = 1.0, 1.5  # a metre aside: it has to tilt
    wanted[0, 0] = 0.0
    motors = flights.Motors(quad_params["tau_m"], quad_params["tau_m"])
    craft, pilot = flights.Rotorcraft(quad_params), flights.Pilot(quad_params)
    flown = flights.fly(craft, pilot, motors, wanted, np.zeros((2 * steps + 1, 3, 1)), 1)
    vehicle = Multirotor(quad_params, integrator_kwargs={"method": "RK45", "rtol": 1e-8, "atol": 1e-10})
    state = {"x": wanted[0, :3, 0], "v": np.zeros(3), "q": np.array([0, 0, 0, 1.0]), "w": np.zeros(3)}
    state |= {"wind": np.zeros(3), "rotor_speeds": np.full(4, np.sqrt(0.5 * 9.81 / 4 / quad_params["k_eta"]))}
    for k in range(steps - 2):
        goal = dict(zip(("x", "x_dot", "x_ddot"), wanted[k, :9, 0].reshape(3, 3), strict=True))
        orders = SE3Control(quad_params).update(0.0, state, {**goal, "yaw": 0.0, "yaw_dot": 0.0})
        state = vehicle.step(state, orders, flights.STEP)
    theirs = np.concatenate([state[name] for name in ("x", "v", "q", "w")])
    assert abs(flown.state[-1, 3, 0]) > 0.5
    np.testing.assert_allclose(flown.state[-1, :, 0], theirs, atol=2e-5)


def test_hover_balances_and_a_vehicle_without_effects_is_the_base_model() -> None:
    craft, x, speed = _level({})
    np.testing.assert_allclose(_rates(craft, x, speed)[3:13], 0, atol=1e-12)
    bare = Multirotor({**quad_params, "k_d": 0, "k_z": 0, "k_h": 0, "c_Dx": 0, "c_Dy": 0, "c_Dz": 0})
    state, speeds = _states(np.random.default_rng(3), 1)
    theirs = bare._s_dot_fn(0, np.concatenate([state[:, 0], np.zeros(3), speeds[:, 0]]), speeds[:, 0])
    np.testing.assert_allclose(_rates(craft, state, speeds)[:, 0], theirs[:13], rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("key", TYPICAL)
def test_every_effect_acts_and_vanishes_with_its_strength(key: str) -> None:
    effect = draw(np.random.default_rng(4), key, "hummingbird", 1.0)
    if key in ("motor_lag", "input_delay", "wind"):  # not of the vehicle but of its motors and of the air
        full, none = (hidden.motors({key: e}, drive((key,)), 0.0) for e in (effect, dict.fromkeys(effect, 0.0)))
        assert key == "wind" or full != none == flights.Motors(0.0, 0.0)
        assert (
            key != "wind" or hidden.wind(np.random.default_rng(0), {key: effect}, 3, 1, 0.1)[2, 1, 0] == effect["w_y"]
        )
        return
    neutral = {name: value if name in ("l", "zeta") else 0.0 for name, value in effect.items()}
    state, speed = _states(np.random.default_rng(5), 4)
    state[2], state[5] = 0.3, -3.0  # near the ground, sinking
    out = []
    for effects in ({identity(key): effect}, {identity(key): neutral}, {}):
        craft = hidden.HiddenMultirotor(quad_params, effects, AROUND, np.full(4, 0.1))
        own = np.full((craft.own_states, 4), 0.1)
        spin = np.repeat([[900.0], [-400.0], [300.0], [200.0]], 4, axis=1)
        t, still = np.full(4, 7.0), np.zeros((3, 4))
        out.append(craft.derivative(t, np.concatenate([state, own]), speed, spin, still)[3:13])
    assert np.abs(out[0] - out[2]).max() > 1e-3
    np.testing.assert_allclose(out[1], out[2], atol=1e-12)


def test_hidden_effects_against_values_worked_out_by_hand() -> None:
    mass, k_f, arm = quad_params["mass"], quad_params["k_eta"], 0.17 * 0.70710678118
    inertia = np.array([quad_params[key] for key in ("Ixx", "Iyy", "Izz")])
    thrust = mass * 9.81

    craft, x, speed = _level({"ground_effect": {"c": 4.0}}, height=0.2)
    np.testing.assert_allclose(_rates(craft, x, speed)[5], 9.81 * (1 / (1 - 4 / 64) - 1))
    craft, x, speed = _level({"ground_effect": {"c": 4.0}}, height=0.0)  # no nearer than 1.2 R √c / 4
    np.testing.assert_allclose(_rates(craft, x, speed)[5], 9.81 * (1 / (1 - 1 / 1.44) - 1))
    induced = np.sqrt(thrust / (2 * 1.2 * np.pi * 0.01 * 4))
    craft, x, speed = _level({"vortex_ring_state": {"a": 0.3}}, climb=-induced)
    np.testing.assert_allclose(_rates(craft, x, speed)[5], -0.3 * 9.81)
    craft, x, speed = _level({"rotor_gyroscopic_torque": {"rotor_inertia": 4e-5}})
    x[10], x[11], speed[0] = 1.0, 2.0, speed[0] + 100  # rotor 1 reacts about +z
    twist = 100.0 * 4e-5 * np.array([2.0, -1.0]) / inertia[:2]  # s ω (ω_b × e3) = s ω (q, −p, 0)
    other = _rates(_level({})[0], x, speed)
    np.testing.assert_allclose((_rates(craft, x, speed) - other)[10:13, 0], [*twist, 0], atol=1e-12)
    craft, x, speed = _level({"rotor_reaction_torque": {"rotor_inertia": 4e-5}})
    spin = np.array([[50.0], [0.0], [0.0], [0.0]])
    np.testing.assert_allclose(_rates(craft, x, speed, spin)[12], 4e-5 * 50 / inertia[2])
    craft, x, speed = _level({"cog_offset": {"x": 0.002, "y": 0.003}})  # thrust behind it: nose down
    lever = np.array([-0.003, 0.002]) * thrust / inertia[:2]
    np.testing.assert_allclose(_rates(craft, x, speed)[10:12, 0], lever)
    craft, x, speed = _level({"unequal_rotors": {"eps_1": 0.1, "eps_2": 0.0, "eps_3": 0.0, "eps_4": 0.0}})
    out = _rates(craft, x, speed)
    np.testing.assert_allclose(out[[5, 10, 11], 0], [0.025 * 9.81, *(thrust / 40 * arm / inertia[:2] * [1, -1])])
    craft, x, speed = _level({"rotor_misalignment": {"a_x": 0.01, "a_y": 0.03}})
    np.testing.assert_allclose(_rates(craft, x, speed)[3:5, 0], [0.03 * 9.81, -0.01 * 9.81])
    craft, x, speed = _level({"position_force": {"axis": 2.0, "amplitude": 0.4, "wavelength": 4.0}}, height=1.0)
    np.testing.assert_allclose(_rates(craft, x, speed)[5], 0.4 / mass)
    assert k_f * speed[0, 0] ** 2 * 4 == pytest.approx(thrust)


def test_a_swinging_load_keeps_momentum() -> None:
    """Without damping, load and vehicle swing about their common centre at √(g/l (1 + m_l/m))."""
    m_l, length = 0.1, 0.6
    craft, x, speed = _level({"suspended_load": {"m_l": m_l, "l": length, "zeta": 0.0}})
    x[13] = 0.05
    start, dt = x.copy(), 0.005
    frequency = np.sqrt(9.81 / length * (1 + m_l / quad_params["mass"]))
    # Rest is where load and vehicle do not move: x + m_l/(m + m_l) l θ is carried along unmoved.
    for _ in range(round(np.pi / frequency / dt)):
        x = craft.step(np.zeros(1), x, [speed] * 3, [0 * speed] * 3, [np.zeros((3, 1))] * 3, dt)
    np.testing.assert_allclose(x[13], -start[13], rtol=1e-3)
    moved = m_l / (quad_params["mass"] + m_l) * length * (start[13] - x[13])
    np.testing.assert_allclose(x[0], moved, rtol=2e-3)


def test_motors_are_exact_and_delays_are_in_the_mean() -> None:
    motors = flights.Motors(0.02, 0.04)
    up, down = np.full((4, 1), 500.0), np.full((4, 1), 300.0)
    np.testing.assert_allclose(motors.turn(down, (up, up), 0.01)[0][2], 500 - 200 * np.exp(-0.5))
    np.testing.assert_allclose(motors.turn(up, (down, down), 0.01)[0][2], 300 + 200 * np.exp(-0.25))
    late = flights.Motors(0, 0, delay=0.0137)
    commands = [np.full((4, 1), float(i)) for i in range(40)]
    mean = [late.delayed(commands, k * 0.005, 0.01, 0.005) for k in range(20, 60)]
    for k, (first, second) in enumerate(mean, start=20):
        for half, value in enumerate((first, second)):
            t = k * 0.005 + half * 0.0025 - 0.0137 + (np.arange(1000) + 0.5) * 2.5e-6
            assert value[0, 0] == pytest.approx(np.floor(t / 0.01).mean(), abs=2e-3)


def test_logs_show_the_truth_through_noise_and_smoothing(cache: Path) -> None:
    case = Case("x", **SHORT)
    flown = truth(case, cache)
    still = Noise(0, 0, rotor=0)
    for how in SMOOTHINGS.values():
        parts = (x[:, :, 0] for x in (flown.state, flown.speed, flown.command))
        log = measure(np.random.default_rng(0), *parts, None, still, how, flights.RATE)
        inner = slice(10, -10)
        for name, at, within in (("position", slice(0, 3), 5e-3), ("velocity", slice(3, 6), 0.02)):
            np.testing.assert_allclose(log[name][inner], flown.state[inner, at, 0], atol=within)
        np.testing.assert_allclose(log["body_rates"][inner], flown.state[inner, 10:13, 0], atol=0.25)
    noisy = clean(replace(case, smoothing="none"), flown)[0]
    for name, at, sigma in (("position", 0, 4e-4), ("velocity", 3, 0.02), ("body_rates", 10, 0.02)):
        assert np.std(noisy[name] - flown.state[:, at : at + 3, 0]) == pytest.approx(sigma, rel=0.1)
    turned = Rotation.from_quat(noisy["attitude"]) * Rotation.from_quat(flown.state[:, 6:10, 0]).inv()
    assert np.std(turned.as_rotvec()) == pytest.approx(LEVELS["medium"].attitude, rel=0.1)


def test_flights_are_flown_once_and_noise_is_redrawn(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    case = Case("once", effects=DRAG, **SHORT)
    first = fly(case, cache)
    monkeypatch.setattr(flights, "fly", lambda *_: pytest.fail("flown again"))
    again, other = fly(replace(case, id="other"), cache), fly(replace(case, seed=1, noise="low"), cache)
    for name in first[0]:
        np.testing.assert_array_equal(first[0][name], again[0][name])
    assert np.abs(first[0]["position"] - other[0]["position"]).max() > 0
    np.testing.assert_array_equal(first[1]["rotor_command"], other[1]["rotor_command"])
    with pytest.raises(BaseException, match="flown again"):
        fly(replace(case, effects={"rotor_drag": {"k_d": 1.2e-4}}), cache)


def test_oracle_finds_the_effect_and_nothing_else(cache: Path) -> None:
    case = Case("o", effects={**DRAG, "cog_offset": {"x": 1e-3, "y": 0.0}}, recordings=2, seconds=6.0)
    flown = truth(case, cache)
    full, without = oracle.rmse(case, flown), oracle.rmse(case, flown, ("rotor_drag",))
    assert full["velocity"] < 2e-3 and full["body_rates"] < 5e-3
    assert without["velocity"] > 20 * full["velocity"]
    shares = oracle.shares(case, flown)
    assert all(0.05 < s < 1.05 for s in shares.values())
    # Removed, the effects leave what the same vehicle without them would have been forecast.
    bare = replace(case, effects={}, known={})
    np.testing.assert_array_equal(
        oracle.forecast(case, flown, ("rotor_drag", "cog_offset"))[0], oracle.forecast(bare, flown)[0]
    )


@pytest.mark.parametrize(
    "effects", [{"motor_lag": {"tau_up": 0.02, "tau_down": 0.03}}, {"input_delay": {"delay": 0.017}}]
)
def test_oracle_replays_commands(effects: hidden.Effects, cache: Path) -> None:
    case = Case("c", effects=effects, drive="rotor_command", recordings=2, seconds=6.0)
    flown = truth(case, cache)
    full, without = oracle.rmse(case, flown), oracle.rmse(case, flown, tuple(effects))
    assert full["body_rates"] < 2e-3 < 0.02 < without["body_rates"]


@pytest.mark.parametrize("kind", corrupt.KINDS)
def test_corruption_is_where_it_says(kind: str, cache: Path) -> None:
    good = fly(Case("g", **{**SHORT, "seconds": 6.0}), cache)
    for seed in range(6):
        bad, (fault,) = fly_and_faults(Case("g", corruption=kind, seed=0, **{**SHORT, "seconds": 6.0}), cache)
        bad[fault.recording], fault = corrupt.KINDS[kind](
            np.random.default_rng(seed), good[fault.recording], fault.recording
        )
        assert fault.kind == kind
        before, after = good[fault.recording], bad[fault.recording]
        if kind == "clock_jump":
            first, lost = fault.rows[0], len(before["t"]) - len(after["t"])
            np.testing.assert_array_equal(after["position"][first], before["position"][first + lost])
            np.testing.assert_allclose(np.diff(after["t"]), 0.01)
        elif kind == "clock_rate":
            slope = np.gradient(after["position"], 0.01, axis=0)
            pace = (slope * after["velocity"]).sum() / (after["velocity"] ** 2).sum()
            assert 0.03 < abs(pace - 1) < 0.18
        else:
            changed = {n: np.flatnonzero((before[n] != after[n]).reshape(len(before["t"]), -1).any(1)) for n in before}
            rows = changed.pop(fault.signal)
            assert (rows[0], rows[-1] + 1) == fault.rows and not any(len(c) for c in changed.values())


def test_time_shift_moves_the_inputs_only(cache: Path) -> None:
    case = Case("g", **SHORT)
    good, (bad, faults) = fly(case, cache), fly_and_faults(replace(case, corruption="time_shift"), cache)
    assert [f.recording for f in faults] == [0, 1]
    np.testing.assert_allclose(bad[0]["rotor_speed"][1:], good[0]["rotor_speed"][:-1], rtol=1e-9)
    np.testing.assert_array_equal(bad[0]["velocity"], good[0]["velocity"])


def test_design_covers_what_it_should() -> None:
    suite, reported = cases(DEVELOPMENT), cases(REPORTED)
    singles = [c for c in suite if c.condition == "single"]
    assert {e for c in singles for e in c.effects} == {identity(k) for k in TYPICAL} and len(singles) >= 100
    for field in ("vehicle", "noise", "style"):
        assert len({getattr(c, field) for c in singles}) >= 2
    assert sum(c.condition in ("nothing", "gusts") for c in suite) >= 300
    assert not {c.flight_seed for c in suite} & {c.flight_seed for c in reported}
    assert len({c.id for c in (*suite, *reported)}) == len(suite) + len(reported)
    for name, values in (x for c in (*suite, *reported) for x in c.effects.items() if x[0] in EFFECTS.names()):
        for p in EFFECTS.get(name).neutral().parameters():  # what the catalogue calls unphysical is not hidden
            assert p.high is None or abs(values.get(p.name, 0.0)) < p.high
    quick = cases(DEVELOPMENT, quick=True)
    assert len(quick) < 100 and {c.condition for c in quick} == {c.condition for c in suite}


def test_folder_is_what_a_user_would_bring(cache: Path, tmp_path: Path) -> None:
    from bench.diagnose.logs.load import load

    case = Case("f", effects=DRAG, **SHORT)
    write_folder(case, tmp_path, cache)
    subject = load(tmp_path)
    assert len(subject.logs) == 2 and subject.model.mass == nominal(case)["mass"]
    table = pd.read_csv(tmp_path / "flight_00.csv")
    np.testing.assert_allclose(table[["vx", "vy", "vz"]], fly(case, cache)[0]["velocity"], atol=1e-7)


def test_flights_know_nothing_of_what_they_judge() -> None:
    code = (
        "import sys\n"
        "from bench.score.multirotor import corrupt, flights, hidden, measure, references, strengths\n"
        "sys.exit(any(m.split('.')[0] == 'registry' or m.startswith('bench.diagnose') for m in sys.modules))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_without_rotorpy_one_sentence_says_what_to_do() -> None:
    code = (
        "import sys; sys.modules['rotorpy'] = None\n"
        "from registry.errors import BenchError\n"
        "try:\n    import bench.score.cases\nexcept BenchError as e:\n    print(e)"
    )
    out = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout
    assert out == f"Scoring needs rotorpy: {sys.executable} -m pip install rotorpy==3.0.0\n"
