"""Discovery on the problems that others published, and on flights of a simulator that shares no code with this one."""

from dataclasses import replace

import numpy as np
import pytest
from undriven import undriven

from bench.diagnose import diagnose, discover, extend
from bench.diagnose.confirm import confirmed
from bench.diagnose.fit import fit_parameters
from bench.diagnose.regression.parameters import effect_entries
from bench.diagnose.report.sentences import explanation
from bench.diagnose.select.verify import Estimate, at_bound
from registry.core import EFFECTS
from registry.errors import BenchError

RNG = np.random.default_rng(1)
NEAR, FAR = RNG.uniform(-2, 2, (6, 2)).tolist(), RNG.uniform(-8, 8, (6, 3)).tolist()


@pytest.mark.parametrize(
    ("system", "effect", "value", "starts", "dt", "samples"),
    [
        ("van_der_pol", "van_der_pol.dy.y3", 0.01, NEAR, 0.01, 2000),
        ("lorenz", "lorenz.dx.y3", 0.01, FAR, 0.005, 2000),
        ("pendulum", "viscous_friction", 0.1, NEAR, 0.02, 1000),
    ],
)
def test_a_small_hidden_term_is_found_and_nothing_else(system, effect, value, starts, dt, samples):
    kind = EFFECTS.get(effect)
    name = kind.neutral().parameters()[0].name
    said, model = diagnose(undriven(system, [kind(**{name: value})], starts, dt, samples, 1e-3), brief=True)
    assert (said.verdict, [e.id for e in said.effects]) == ("named", [effect])
    found = said.effects[0].parameters[name]
    assert found.value == pytest.approx(value, rel=0.02)
    assert found.low <= value <= found.high
    for group, error in said.error.extended.items():
        assert error.rmse < 1.5 * said.noise_floor[group].rmse < 0.5 * said.error.nominal[group].rmse
    assert len(model.effects) == 1


@pytest.mark.parametrize(
    ("system", "starts", "dt"), [("van_der_pol", NEAR, 0.01), ("lorenz", FAR, 0.005), ("lorenz", FAR, 0.01)]
)
def test_a_model_that_lacks_nothing_is_left_alone(system, starts, dt):
    said, model = diagnose(undriven(system, [], starts, dt, 2000, 1e-3), brief=True)
    assert (said.verdict, said.effects, model.effects) == ("nothing", (), ())


def test_a_term_outside_the_catalogue_is_called_unknown_followed_and_learned():

    kind = EFFECTS.get("viscous_friction")
    parameter = kind.neutral().parameters()[0].name
    subject = undriven("pendulum", [kind(**{parameter: 0.3})], NEAR, 0.02, 1000, 1e-3)
    catalogue = ["coulomb_friction", "offset_force"]
    said, _ = diagnose(subject, catalogue=catalogue, brief=True)
    assert said.verdict == "unknown_effect" and said.unexplained.axes
    ((effect,), unexplained) = said.effects, said.unexplained.share
    assert effect.learned and (effect.term.signals, effect.term.shape) == (("angle_rate.theta",), "linear")
    assert effect.parameters["k"].value == pytest.approx(-0.3, rel=0.01) and unexplained < 0.1


def test_an_effect_that_spoils_the_forecast_of_held_out_recordings_is_not_named():
    damped, free = (
        undriven("pendulum", [EFFECTS.get("viscous_friction")(d)] * (d > 0), NEAR, 0.02, 1000, 1e-3) for d in (0.1, 0)
    )
    said, model = diagnose(replace(damped, logs=(*damped.logs[:-2], *free.logs[-2:])), brief=True)
    assert (said.verdict, said.effects, model.effects) == ("unknown_effect", (), ())
    assert said.evidence.contradicted_effects == ("viscous_friction",)
    assert "learnt from show viscous friction" in explanation(said)


@pytest.mark.parametrize(
    ("length", "damping", "edge"), [(0.6, 0.0, False), (0.6, 0.03, False), (0.1, 0.03, True), (0.4, 0.2, True)]
)
def test_a_parameter_that_is_pushed_to_its_bound_betrays_an_imitation(length, damping, edge):
    effect = EFFECTS.get("suspended_load")(m_l=0.1, l=length, zeta=damping)
    numbers = [Estimate(e, e.value, e.low, e.high) for e in effect_entries(effect, 2)]
    assert at_bound(numbers, 2) is edge
    assert not at_bound(numbers, 1)


@pytest.mark.parametrize(
    ("hidden", "verdict", "left"),
    [
        ({"viscous_friction": 0.1, "offset_force": 0.3}, "named", ["viscous_friction"]),
        ({"offset_force": 0.3}, "unknown_effect", []),
    ],
)
def test_what_the_last_fit_pushes_to_a_bound_is_fitted_no_more(monkeypatch, hidden, verdict, left):
    def pushed(subject, model, noise=None, tick=print, through_simulator=True):
        model, numbers = fit_parameters(subject, model, noise, tick, through_simulator)
        ends = {e: replace(e, f_0=1e3) for e in model.effects if EFFECTS.name_of(type(e)) == "offset_force"}
        return replace(model, effects=tuple(ends.get(e, e) for e in model.effects)), numbers

    def at_end(numbers, place):  # a constant force has no bound of its own
        return any(x.entry.owner == place and x.entry.name == "f_0" and x.entry.value >= 1e3 for x in numbers)

    monkeypatch.setitem(extend.__globals__, "fit_parameters", pushed)
    monkeypatch.setitem(confirmed.__globals__, "at_bound", at_end)
    effects = [EFFECTS.get(name)(value) for name, value in hidden.items()]
    subject = undriven("pendulum", effects, NEAR, 0.02, 1000, 1e-3)
    said, model = diagnose(subject, catalogue=["viscous_friction", "offset_force"], brief=True)
    assert (said.verdict, [e.id for e in said.effects if not e.learned]) == (verdict, left)
    assert all(EFFECTS.name_of(type(e)) != "offset_force" for e in model.effects)
    assert any(note.startswith("offset_force fits best at the end") for note in said.evidence.notes)


def test_an_effect_is_not_added_twice():
    kind = EFFECTS.get("viscous_friction")
    subject = undriven("pendulum", [kind(0.1)], NEAR[:3], 0.02, 400, 1e-3)
    first = extend(subject, subject.model, ["viscous_friction"])
    with pytest.raises(BenchError, match="already"):
        extend(subject, first.model, ["viscous_friction"])


TWIN = (
    ("rotor_reaction_torque", "rotor_inertia", 4e-5),
    ("rotor_gyroscopic_torque", "rotor_inertia", 4e-5),
    ("rotor_drag", "k_d", 8.1e-5),
)
"""What `registry.datasets.twin.quadrotor` is made with; no delay."""


@pytest.fixture(scope="module")
def twin():
    """The README's first command."""
    return diagnose("pelican_twin", brief=True)[0]


@pytest.mark.slow
def test_the_flights_that_come_along_are_explained_by_what_they_were_made_with(twin):
    found = {e.id: e.parameters for e in twin.effects}
    assert twin.verdict == "named"
    assert set(found) == {effect for effect, _, _ in TWIN}
    for effect, name, value in TWIN:
        assert found[effect][name].low <= value <= found[effect][name].high
    for group, error in twin.error.extended.items():
        assert error.rmse < 1.15 * twin.noise_floor[group].rmse


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effect", "name", "value"),
    TWIN,
)
def test_their_numbers_are_known_to_two_percent(twin, effect, name, value):
    (found,) = (e.parameters[name] for e in twin.effects if e.id == effect)
    assert found.value == pytest.approx(value, rel=0.02)


flights = pytest.importorskip("bench.score.cases", reason="needs RotorPy: pip install .[score]")


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    return tmp_path_factory.mktemp("flights")


def diagnosed(case, cache, **options):
    from bench.score.attempt import attempt

    return attempt(case, cache, **options)


def test_two_effects_of_a_flight_are_found_with_their_parameters(cache):
    effects = {"rotor_drag": {"k_d": 1.2e-4}, "cog_offset": {"x": 0.003, "y": -0.002}}
    case = flights.Case("both", effects=effects, recordings=4, seconds=12.0, condition="pair", flight_seed=77)
    answer = diagnosed(case, cache)
    assert answer.verdict == "named" and set(answer.named) == set(effects)
    for effect, parameters in effects.items():
        for name, value in parameters.items():
            assert answer.named[effect][name][0] == pytest.approx(value, rel=0.05)
    for group, error in answer.error["extended"].items():
        assert error < 1.2 * answer.error["floor"][group] < 0.2 * answer.error["nominal"][group]


@pytest.mark.parametrize("effect", ["worn_rotors", "unequal_rotors"])
def test_a_chipped_blade_is_one_effect_in_thrust_and_yaw(effect, cache):
    """It loses thrust and drag; where only thrust is lost, that is told from it."""
    hidden = {effect: {"eps_1": 0.0, "eps_2": 0.0, "eps_3": -0.13, "eps_4": 0.0}}
    case = flights.Case("chipped", effects=hidden, recordings=4, seconds=12.0, flight_seed=81)
    answer = diagnosed(case, cache)
    assert (answer.verdict, list(answer.named)) == ("named", [effect])
    found = {name: value for name, (value, *_) in answer.named[effect].items()}
    assert found["eps_3"] - found["eps_1"] == pytest.approx(-0.13, rel=0.1)


def test_a_flight_without_a_hidden_effect_gets_none(cache):
    case = flights.Case("none", recordings=4, seconds=12.0, condition="nothing", style="gentle", flight_seed=78)
    answer = diagnosed(case, cache)
    assert (answer.verdict, answer.named) == ("nothing", {})


def test_a_constant_that_is_off_within_what_is_stated_is_calibrated_and_said(cache):
    """What turns and lifts tells thrust over mass to a thousandth, and which of them is off to a per cent."""
    from bench.score.case import changed_constants, parameters

    case = flights.Case("stronger", effects={"thrust_scale": {"eps": 0.05}}, recordings=4, seconds=12.0, flight_seed=80)
    answer = diagnosed(case, cache)
    assert (answer.verdict, answer.named) == ("nothing", {})
    true = changed_constants(case)["thrust_scale"][0]["thrust_coefficient"]
    nominal, _, low, high = answer.constants["thrust_coefficient"]
    assert nominal < low < true < high < 1.05 * low
    nominal, _, low, high = answer.constants["thrust_coefficient / mass"]
    assert nominal < low < true / parameters(case)["mass"] < high < 1.003 * low


@pytest.mark.slow
def test_a_force_that_goes_with_the_place_is_followed_there(cache):
    force = {"position_force": {"axis": 1.0, "amplitude": 0.4, "wavelength": 2.2}}
    case = flights.Case("place", effects=force, recordings=4, seconds=12.0, condition="unknown", flight_seed=79)
    answer = diagnosed(case, cache)
    assert (answer.verdict, answer.named) == ("unknown_effect", {})
    assert answer.follows[0] == "position"


@pytest.mark.slow
def test_a_slow_effect_in_noise_is_found_in_rows_as_long_as_a_free_run(cache):
    """Rows of two samples are differences of noise, which whitening with eight of them cannot add up again."""
    from bench.score.chains import measured

    (case,) = (
        c for c in flights.cases(flights.DEVELOPMENT) if c.id == "1-single-blade_flapping-crazyflie-1-gentle-medium"
    )
    found = discover(measured(case, cache)[0])
    assert [f.id for f in found.found] == ["blade_flapping"] and found.long_windows
    (estimate,) = found.found[0].estimates
    assert estimate.low < case.effects["blade_flapping"]["k_flap"] < estimate.high
    slow = found.equations[-1]
    assert (slow.equation, slow.horizon_s) == ("torques", 0.5)
    assert slow.models["extended"] < 1.15 * slow.floor < 0.65 * slow.models["calibrated"]


@pytest.mark.parametrize(("seed", "error"), [(110, 0.05), (111, 0.35)])
@pytest.mark.slow
def test_what_short_windows_bury_is_sought_in_long_ones_where_more_than_noise_is_left(cache, seed, error):
    """The change of the rotors' speeds is noise from sample to sample: nothing seemed to follow it."""
    from bench.score.chain import suite
    from bench.score.chains import measured

    name = f"{seed}-pair-rotor_reaction_torque+inertia_products-nano"
    case = next(c for c in suite.cases(seed) if c.id.startswith(name))
    found = discover(measured(case, cache)[0])
    assert {f.id for f in found.found} == set(case.effects) and found.long_windows
    for one in found.found:
        for x in one.estimates:
            assert x.value == pytest.approx(case.effects[one.id][x.entry.label], rel=error)
    torques = next(e for e in found.equations if e.equation == "torques" and e.horizon_s > 0.3)
    assert torques.models["extended"] < 1.15 * torques.own_floor and torques.models["calibrated"] > 1.6 * torques.floor
    if seed == 110:  # with little noise
        assert torques.models["extended"] < 1.6 * torques.floor < 0.3 * torques.models["calibrated"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effect", "axes"), [("rotor_drag-crazyflie-2", "z"), ("inflow_thrust_loss-hummingbird-1", "xy")]
)
def test_what_an_effect_outside_the_catalogue_does_to_turns_is_a_damping_of_that_size(effect, axes, cache):
    """A force k Ω v at each rotor, r from the centre, damps turns by Σ k Ω r²; what it does to forces is not named."""
    (case,) = (c for c in flights.cases(flights.DEVELOPMENT) if c.id == f"{flights.DEVELOPMENT}-unknown-{effect}")
    answer = diagnosed(case, cache)
    assert "velocity" in answer.follows and set(answer.named) == {"rotational_damping"}
    from bench.score.chains import measured

    subject, _ = measured(case, cache)
    turning = np.mean([log.inputs[:, :4].mean(0).numpy() for log in subject.logs], axis=0)  # rad/s
    arms = np.square(np.asarray(subject.model.rotor_positions))
    across = {"x": arms[:, 1], "y": arms[:, 0], "z": arms[:, 0] + arms[:, 1]}
    (k,) = case.effects[effect.partition("-")[0]].values()
    for axis in "xyz":
        value, low, high = answer.named["rotational_damping"][f"d_{axis}"]
        if axis in axes:
            assert low < k * turning @ across[axis] < high < 1.1 * value
        else:
            assert low == 0
