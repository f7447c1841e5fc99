"""The suite of the unknown: what is hidden, what is right about an answer, and one case from end to end."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

pytest.importorskip("rotorpy")

from bench.diagnose import diagnose
from bench.diagnose.fit import fit_parameters
from bench.diagnose.learn.candidates import dynamic_axes
from bench.diagnose.learn.learn import learn
from bench.diagnose.logs.subject import Subject
from bench.diagnose.select.timing.reading import prepared, retimed
from bench.score.chains import write_folder
from bench.score.run import Job, part, work
from bench.score.unknown import machines, rotorcraft
from bench.score.unknown.cart import CartPendulum
from bench.score.unknown.case import measured
from bench.score.unknown.condition import EMPTY, KINDS, UnknownCase
from bench.score.unknown.judge import JudgedUnknown
from bench.score.unknown.suite import DEVELOPMENT, REPORTED, cases
from bench.score.unknown.table import table
from bench.score.unknown.terms import FORMS, Term
from registry.core import EFFECTS
from registry.effects.waves.hidden_mode import HiddenMode
from registry.terms.shapes import SHAPES
from registry.terms.signals import drives_of


@pytest.fixture(scope="module")
def suite() -> list[UnknownCase]:
    return [c for c in cases(DEVELOPMENT) if isinstance(c, UnknownCase)]


def test_every_kind_is_met_at_three_levels_of_noise_and_seeds_share_nothing(suite: list[UnknownCase]) -> None:
    hidden = [c for c in suite if c.condition not in EMPTY]
    assert len(hidden) == 120 and len(suite) - len(hidden) == 300
    assert {(c.condition, c.noise) for c in hidden} == {(k, n) for k in KINDS for n in ("low", "medium", "high")}
    assert {c.system for c in hidden} == {"quadrotor", "oscillator", "tanks", "cart"}
    assert len({c.id for c in suite}) == len(suite)
    assert not {c.flight_seed for c in suite} & {c.flight_seed for c in cases(REPORTED)}
    assert {c.condition for c in part(suite, 0.01)} == {*KINDS, *EMPTY}
    assert {e for c in suite for e in c.catalogue_without} <= set(EFFECTS.names())
    of_pitch = [c for c in hidden if any(t.signals == ("body_velocity.x", "body_velocity.z") for t in c.terms)]
    assert of_pitch and all("munk_moment" in c.catalogue_without for c in of_pitch)


def test_forms_are_called_as_the_diagnosis_calls_them() -> None:
    assert set(FORMS) <= set(SHAPES)


def test_what_is_hidden_moves_a_machine_and_nothing_else_does(suite: list[UnknownCase]) -> None:
    wall = next(c for c in suite if c.condition == "wall" and c.system == "oscillator")
    short = replace(wall, recordings=1, seconds=2.0)
    (pushed,), (free,) = machines.logs(short), machines.logs(replace(short, terms=()))
    first = int(np.argmax(free["displacement"] > wall.terms[0].values[1]))
    assert first > 3 and np.abs(pushed["speed"] - free["speed"])[first + 5 :].max() > 0.1
    np.testing.assert_allclose(pushed["speed"][:first], free["speed"][:first], atol=0.01)  # noise goes with the spread


def test_what_is_hidden_moves_a_flight(suite: list[UnknownCase]) -> None:
    spring = next(c for c in suite if c.condition == "spring" and c.vehicle == "crazyflie")
    short = replace(spring, recordings=1, seconds=1.0)
    (pulled,), (free,) = rotorcraft.logs(short), rotorcraft.logs(replace(short, terms=()))
    assert np.abs(pulled["position"] - free["position"])[:, 1].max() > 0.02


TERM = Term("speed.q", ("displacement.q",), "cubic", (-300.0,))
CASE = UnknownCase("1-spring-00-oscillator-low", condition="spring", system="oscillator", terms=(TERM,))
X = np.linspace(-1, 1, 5)


def said(**learned: Any) -> dict[str, Any]:
    curve = {"x": X.tolist(), "low": (TERM.curve(X) - 1).tolist(), "high": (TERM.curve(X) + 1).tolist()}
    term = {"axis": "speed.q", "signals": ["displacement.q"], "shape": "cubic", "swings": False, "frequency": None}
    term |= {"curve": curve, **learned}
    errors = {"nominal": {"q": 1.0}, "calibrated": {"q": 0.9}, "extended": {"q": 0.15}, "floor": {"q": 0.1}}
    empty: dict[str, Any] = {"named": {}, "rivals": {}, "follows": [], "problems": [], "faults": [], "notes": []}
    return {**empty, "verdict": "unknown_effect", "error": errors, "extra": {"terms": [term]}}


def judged(case: UnknownCase, answer: dict[str, Any]) -> JudgedUnknown:
    return JudgedUnknown(case, answer, {})


def test_axes_signals_form_and_band_are_held_against_the_truth() -> None:
    right = judged(CASE, said())
    assert right.place and right.form and right.right and not right.worse and right.band == (5, 5)
    assert right.remaining == pytest.approx(0.05 / 0.9)
    assert judged(CASE, said(shape="linear")).place and not judged(CASE, said(shape="linear")).right
    elsewhere = judged(CASE, said(signals=["speed.q"]))
    assert not elsewhere.place and not elsewhere.form and elsewhere.band == (0, 0)
    two = said()
    two["extra"]["terms"].append({**said()["extra"]["terms"][0], "axis": "displacement.q"})
    assert not judged(CASE, two).place
    named = {**said(), "named": {"coulomb_friction": {}}}
    assert not judged(CASE, named).place
    worse = said()
    worse["error"]["extended"] = {"q": 0.95}
    assert judged(CASE, worse).worse and not judged(CASE, worse).right


def test_an_error_below_the_floor_is_not_worse() -> None:
    none = replace(CASE, condition="undersampled", terms=(), verdicts=("nothing",))
    quiet = {**said(), "verdict": "nothing", "extra": {"terms": []}}
    quiet["error"] = {"nominal": {"q": 0.9}, "calibrated": {"q": 0.8}, "extended": {"q": 0.8}, "floor": {"q": 1.0}}
    assert judged(none, quiet).right and not judged(none, quiet).worse
    quiet["error"]["extended"] = {"q": 1.1}
    assert judged(none, quiet).worse


def test_a_force_on_the_cart_may_be_said_where_its_motor_pushes() -> None:
    (term,) = CASE.terms
    pushed = judged(replace(CASE, terms=(replace(term, instead=("push",)),)), said(axis="push"))
    assert pushed.place and pushed.form and pushed.right
    assert pushed.band == (0, 0)  # in another unit
    assert not judged(CASE, said(axis="push")).place


def test_the_model_of_the_cart_moves_as_the_simulated_cart_does() -> None:
    """Without what the joint's damping does to the cart, that was found, rightly, where nothing was to be hidden."""
    stated, rng = machines.MACHINES["cart"], np.random.default_rng(3)
    for state in rng.normal(size=(5, 4)):
        rate = CartPendulum(**stated.constants).own_rate(torch.tensor(state), torch.tensor([1.7], dtype=torch.float64))
        np.testing.assert_allclose(rate.numpy(), stated.rate(stated.constants, state, 1.7), rtol=1e-12)


def test_the_push_of_a_cart_moves_its_bob_too() -> None:
    """Its one input has no axes with names: what acts where it acts was not offered."""
    assert drives_of(CartPendulum) == ("push",) and "push" in dynamic_axes(CartPendulum())


@pytest.mark.parametrize("noise", ["low", "medium", "high"])
def test_a_rail_with_many_bumps_is_described_where_the_cart_is_pushed(
    noise: str, suite: list[UnknownCase], tmp_path: Path
) -> None:
    """Up to seven waves are too short for splines, and what these leave hid that a push explains both rates."""
    bumpy = next(c for c in suite if (c.condition, c.system, c.noise) == ("place_lift", "cart", noise))
    subject, noise = prepared(measured(bumpy, tmp_path))
    calibrated, _ = fit_parameters(subject, subject.model, noise, through_simulator=False)
    (term,) = learn(subject, calibrated, noise)
    assert (term.axis, term.signals, term.shape) == ("push", ("place.x",), "wave")
    assert term.values[-1] == pytest.approx(bumpy.terms[0].values[1], rel=0.01)


def test_a_frequency_is_right_within_three_per_cent_of_one_of_the_true_ones() -> None:
    wave = replace(CASE, condition="load", terms=(), frequencies=(0.8, 1.0))
    assert judged(wave, said(swings=True, frequency=0.98)).right
    assert not judged(wave, said(swings=True, frequency=0.9)).right
    assert not judged(wave, said()).right


def test_the_table_counts_what_is_asked() -> None:
    none = replace(CASE, id="1-empty-000", condition="empty", terms=(), verdicts=("nothing",))
    quiet = {**said(), "verdict": "nothing", "extra": {"terms": []}}
    found = table([CASE, none], {(CASE.id, "diagnosis"): said(), (none.id, "diagnosis"): quiet})
    values = {x.text: (x.value.partition(" (")[0], x.met) for _, lines in found.sections for x in lines}
    assert found.scored == 2 and not found.failures
    assert values["axes and signals"] == ("1/1 = 100 %", True)
    assert values["error above the floor left, median"] == ("5.56 %", True)
    assert values["points of true curves inside the 95 % band"] == ("5/5 = 100 %", False)  # too wide is wrong as well
    assert values["a learned term (≥ 300 sets)"] == ("0/1 = 0 %", None)
    invented = table([none], {(none.id, "diagnosis"): {**said(), "verdict": "unknown_effect"}})
    assert [name for name, *_ in invented.failures] == [none.id]


def test_a_wall_on_an_oscillator_is_described_from_its_folder(suite: list[UnknownCase], tmp_path: Path) -> None:
    wall = next(c for c in suite if c.id.endswith("wall-06-oscillator-medium"))
    answer = work(Job(wall, "diagnosis"), tmp_path)
    assert judged(wall, answer).right, judged(wall, answer).answer_line
    write_folder(wall, tmp_path / "folder", tmp_path)
    assert (tmp_path / "folder" / "dataset.toml").is_file()


def test_poses_of_a_system_of_ones_own_are_known_by_their_rates(suite: list[UnknownCase], tmp_path: Path) -> None:
    cart = next(c for c in suite if c.system == "cart")
    assert set(measured(cart, tmp_path).model.equation_names()) == {"pace", "tilt_rate"}


def sloshing(suite: list[UnknownCase], cache: Path) -> tuple[UnknownCase, Subject]:
    """Tanks in which something sloshes."""
    case = next(c for c in suite if (c.condition, c.system, c.noise) == ("slosh", "tanks", "medium"))
    return case, measured(case, cache)


def test_an_input_is_read_again_beside_the_mode_that_made_it_look_late(
    suite: list[UnknownCase], tmp_path: Path
) -> None:
    case, tanks = sloshing(suite, tmp_path)
    late, noise = prepared(tanks)
    assert late.logs is not tanks.logs and " later than it is filed" in " ".join(late.notes)
    frequency, strength, zeta = case.swing
    gains = (0.0, -strength / (2 * np.pi * frequency) ** 2)
    mode = HiddenMode(("upper_level.h",), ("voltage",), 2, frequency, zeta, gains)
    assert retimed(tanks, replace(tanks.model, effects=(mode,)), noise).logs is tanks.logs


@pytest.mark.slow
def test_what_sloshes_is_no_transport_delay(suite: list[UnknownCase], tmp_path: Path) -> None:
    case, tanks = sloshing(suite, tmp_path)
    said, _ = diagnose(tanks, catalogue=[n for n in EFFECTS.names() if n not in case.catalogue_without], brief=True)
    (effect,) = said.effects
    assert said.verdict == "unknown_effect" and effect.id == "hidden_mode"
    assert effect.parameters["frequency"].value == pytest.approx(case.swing[0], rel=0.03)
