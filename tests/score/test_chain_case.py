"""Logs of the second chain: what is filed when, what is stated of the vehicle, and what the suite holds."""

import json
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

pytest.importorskip("rotorpy")

from bench.diagnose.logs.load import load
from bench.score import cases as first
from bench.score.chain import case as chain_case
from bench.score.chain import flight, paths, point, recorder, suite
from bench.score.chain.case import ROUGH, UNCERTAINTY, ChainCase, built, measured, stated, true_model, write
from bench.score.chain.recorder import Logging
from bench.score.chain.vehicle.airframe import AIRFRAMES
from bench.score.chain.vehicle.body import Body, P
from bench.score.chain.vehicle.motors import Motors
from bench.score.chains import write_folder
from bench.score.judge import Judged
from registry.core import EFFECTS

SHORT = {"recordings": 3, "seconds": 4.0}
CLEAN = Logging(100, "capture", "low", "even", 0.1, 0.0, True, False)


@pytest.fixture(scope="module")
def flown() -> tuple[flight.Truth, Body]:
    craft, rng = AIRFRAMES["racer"], np.random.default_rng(3)
    manner, seconds = paths.MANNERS["aggressive"], flight.BEFORE + 6
    wanted = np.stack([paths.path(rng, kind, manner, 0.4, seconds, flight.DT) for kind in ("sines", "circle")], axis=2)
    body = Body(craft, {}, np.zeros(2))
    air = np.zeros((wanted.shape[1], 3, 2))
    return flight.fly(rng, body, craft, Motors(0.01, 0.01), 0.004, wanted, air), body


def _logs(flown: tuple[flight.Truth, Body], how: Logging) -> list[dict[str, np.ndarray]]:
    truth, body = flown
    rng = np.random.default_rng(8)
    return recorder.record(rng, truth, body, how, recorder.observe(rng, truth, body, how))


def _late(log: dict[str, np.ndarray], truth: flight.Truth, i: int) -> float:
    """By how much the logged rotor speeds fit the true ones best when they are taken later [s]."""
    steps = np.round((log["t"] + 0.02) / flight.DT).astype(int)[10:-10]
    left = [np.abs(truth.speed[steps - k, :, i] - log["rotor_speed"][10:-10]).mean() for k in range(-12, 13)]
    return (int(np.argmin(left)) - 12) * flight.DT


def test_a_flight_in_which_the_vehicle_is_lost_is_flown_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    def tried(case: ChainCase, vessel: Body, again: tuple[int, ...]) -> tuple[flight.Truth, np.ndarray]:
        first = {(): [0.5, 5000.0, np.inf, 50.0], (1,): [9000.0, 20.0, 1.0, 90.0]}
        attempt = np.full((4, 2, 4), float(sum(again)))
        return flight.Truth(*[attempt] * 6), np.array(first.get(again, [2.0, 3.0, 4.0, 90.0]))

    one = ChainCase("x", "racer", condition="single", recordings=4)
    monkeypatch.setattr(chain_case, "_tried", tried)
    truth = chain_case._flown(one, Body(AIRFRAMES["racer"], {}, np.zeros(4)))
    # The last one is lost on every path, and stays as it strayed least.
    assert truth.state[0, 0].tolist() == truth.felt[-1, 1].tolist() == [0.0, 2.0, 1.0, 0.0]


def test_how_far_a_flight_strays_is_told_from_its_own_path() -> None:
    one = replace(next(c for c in suite.cases(suite.DEVELOPMENT) if not c.effects), **SHORT)
    truth, strayed = chain_case._tried(one, chain_case.body(one), ())
    other, _ = chain_case._tried(one, chain_case.body(one), (1,))
    assert strayed.shape == (3,) and (strayed < 2).all()  # paths are metres wide, the pilot follows them
    assert not np.allclose(truth.state[0], other.state[0])


@pytest.mark.parametrize("delay", [0.0, 0.007])
def test_rotor_speeds_are_filed_as_late_as_the_telemetry_brings_them(
    flown: tuple[flight.Truth, Body], delay: float
) -> None:
    for i, log in enumerate(_logs(flown, replace(CLEAN, telemetry=delay))):
        assert _late(log, flown[0], i) == pytest.approx(delay, abs=1e-9)


def test_a_clock_is_even_or_uneven_and_told_or_uneven_and_not_told(flown: tuple[flight.Truth, Body]) -> None:
    truth = flown[0]
    off = {}
    for clock in recorder.CLOCKS:
        log = _logs(flown, replace(CLEAN, clock=clock))[0]
        seen = np.interp(log["t"] + 0.02, np.arange(len(truth.state)) * flight.DT, truth.state[:, 0, 0])
        off[clock] = (np.ptp(np.diff(log["t"])), np.abs(log["position"][:, 0] - seen).mean())
    assert off["even"][0] < 1e-12
    assert off["hidden"][0] < 1e-12
    assert 2e-3 < off["stamped"][0] < 4e-3  # up to a tenth of a period to either side, twice
    assert off["hidden"][1] > 5 * off["even"][1]


def test_errors_of_an_estimator_last_and_those_of_motion_capture_do_not(flown: tuple[flight.Truth, Body]) -> None:
    truth, body = flown
    kept = {}
    for states in ("capture", "estimator"):
        how = replace(CLEAN, states=states, quality="medium")
        seen = recorder.observe(np.random.default_rng(1), truth, body, how).states
        error = (seen.position - truth.state[:: round(seen.period / flight.DT), P])[200:-50]
        late = round(0.1 / seen.period)
        kept[states] = (error[late:] * error[:-late]).mean() / (error**2).mean()
    assert kept["estimator"] > 0.6
    assert abs(kept["capture"]) < 0.15


def test_a_point_off_the_centre_moves_as_its_sensors_say(flown: tuple[flight.Truth, Body]) -> None:
    """Its velocity is the slope of its position, and what it feels that of its velocity, by finite differences."""
    truth, _ = flown
    seen = point.recorded(truth, np.array([[0.02], [-0.01], [0.05]]))
    slopes = np.gradient(seen.state[:, :6], flight.DT, axis=0)[5:-5]
    np.testing.assert_allclose(slopes[:, :3], seen.state[5:-5, 3:6], atol=2e-3)
    turns = [Rotation.from_quat(seen.state[5:-5, [7, 8, 9, 6], i]).inv() for i in range(2)]
    felt = np.stack([r.apply(slopes[..., 3:, i] + [0, 0, 9.81]) for i, r in enumerate(turns)], axis=-1)
    assert np.median(np.abs(felt - seen.felt[5:-5])) < 5e-3
    assert np.abs(seen.felt - truth.felt).max() > 0.2


def test_a_folder_is_read_as_a_users_and_states_what_the_case_says(cache: Path, tmp_path: Path) -> None:
    drag = {"linear_drag": {"d_x": 0.2, "d_y": 0.2, "d_z": 0.2}}
    lag = {"motor_lag": {"tau_up": 0.02, "tau_down": 0.03}}
    case = ChainCase("one", effects=lag, known=drag, drive="rotor_command", accelerometer=True, rough=True, **SHORT)
    write_folder(case, tmp_path, cache)
    description = tomllib.loads((tmp_path / "dataset.toml").read_text())
    assert "uncertainty" not in description["physics"]
    assert "processing" not in description
    assert "rotor_speed" not in description["signals"]
    assert not any(c.startswith("rotor") for c in pd.read_csv(tmp_path / "flight_1.csv").columns)
    assert tomllib.loads((tmp_path / "model.toml").read_text())["effects"] == [
        {"id": "linear_drag", **drag["linear_drag"]}
    ]
    found = load(tmp_path)
    assert found.model.drive == "rotor_command"
    assert found.model.input_hold == "previous"
    assert "specific_force" in found.signals
    assert len(found.logs) == 3
    assert json.loads((tmp_path / "truth.json").read_text())["shares"].keys() == lag.keys()


def test_stated_constants_are_as_far_off_as_is_said() -> None:
    rough, well = (ChainCase("c", rough=r, vehicle="nano") for r in (True, False))
    for seed in range(40):
        true = built(replace(well, flight_seed=seed))
        told = stated(replace(rough, flight_seed=seed))
        off = np.abs(np.array(told["inertia"]) / true.inertia - 1)
        assert ((off >= ROUGH["inertia"][0]) & (off <= ROUGH["inertia"][1])).all()
        assert 0.1 <= abs(told["thrust_coefficient"] / true.thrust - 1) <= 0.25
        assert abs(told["mass"] / true.mass - 1) <= 0.03
        near = stated(replace(well, flight_seed=seed))
        assert abs(near["mass"] / true.mass - 1) <= 2.0001 * UNCERTAINTY["mass"]
        assert near["rotor_positions"] == [[x, y, 0.0] for x, y in true.hubs]


def test_the_true_model_forecasts_what_happened(cache: Path) -> None:
    """Half a second from the logged states with the logged rotor speeds, by the code that diagnoses."""
    from bench.diagnose.simulate.free_run import free_run

    drag = {"rotor_drag": {"k_d": 1.2e-4}, "cog_offset": {"x": 0.003, "y": -0.002}}
    case = ChainCase("two", effects=drag, noise="low", control_hz=500, log_hz=200, style="aggressive", **SHORT)
    who = measured(case, cache)
    starts = [np.array([100, 200, 300, 400, 500]) for _ in who.logs]
    miss = {}
    for name, model in (("true", true_model(case, who.model)), ("stated", who.model)):
        runs = free_run(model, who.logs, starts, 100).numpy()
        seen = np.concatenate(
            [log.states.numpy()[at[:, None] + np.arange(101)] for log, at in zip(who.logs, starts, strict=True)]
        )
        miss[name] = np.sqrt(((runs[:, :, 3:6] - seen[:, :, 3:6]) ** 2).mean())
    assert miss["true"] < 0.03
    assert miss["true"] < 0.1 * miss["stated"]


def test_an_effect_that_drowns_in_noise_has_no_share_although_it_is_alone(tmp_path: Path) -> None:
    shares = []
    for k_d in (2e-4, 2e-7):
        case = ChainCase("s", effects={"rotor_drag": {"k_d": k_d}}, noise="high", states="estimator", **SHORT)
        write(case, tmp_path / f"{k_d}")
        shares.append(json.loads((tmp_path / f"{k_d}" / "truth.json").read_text())["shares"]["rotor_drag"])
    assert shares[0] > 0.5
    assert abs(shares[1]) < 0.02


def test_parameters_that_only_the_yaw_inertia_tells_are_not_judged_where_it_is_stated_roughly() -> None:
    case = ChainCase("d", effects={"rotational_damping": {"d_x": 0.1, "d_y": 0.1, "d_z": 0.1}}, condition="single")
    said = {"verdict": "named", "named": {"rotational_damping": {a: (0.1, 0.0, 0.2) for a in ("d_x", "d_y", "d_z")}}}

    def asked(one: ChainCase) -> list[str]:
        return [e.name for e in Judged(one, said, {"rotational_damping": 1.0}).estimates]

    assert len(asked(case)) == 3
    assert asked(replace(case, rough=True)) == ["rotational_damping.d_x", "rotational_damping.d_y"]


def test_the_suite_holds_what_was_asked_for() -> None:
    ours, reported = suite.cases(suite.DEVELOPMENT), suite.cases(suite.REPORTED)
    assert not {c.flight_seed for c in ours} & {c.flight_seed for c in reported}
    others = [*first.cases(first.DEVELOPMENT), *first.cases(first.REPORTED)]
    assert not {c.id for c in ours} & {c.id for c in [*others, *reported]}
    assert len({c.flight_seed for c in ours}) == len(ours)
    hidden = {e for c in ours if c.condition == "single" for e in c.effects}
    physical = {n for n in EFFECTS.names() if "quadrotor" in EFFECTS.get(n).systems}
    assert physical - hidden <= {"downwash", "worn_rotors"}
    assert sum(c.condition == "nothing" for c in ours) + sum(c.condition == "gusts" for c in ours) >= 300
    seen = {(c.control_hz, c.log_hz) for c in ours}
    assert seen == {(a, b) for a in (100, 250, 500) for b in (50, 100, 200)}
    assert min(min(c.lag) for c in ours) < 0.007
    assert max(max(c.lag) for c in ours) > 0.055
    constants = {"mass", "thrust_scale", "torque_scale", "inertia_products"}
    assert not any(c.rough and constants & set(c.effects) for c in ours)
    for c in ours:
        assert c.drive == ("rotor_command" if {"motor_lag", "input_delay"} & set(c.effects) else "rotor_speed")
