"""A stated constant that one equation contradicts must not bend those that it shares with another."""

from dataclasses import replace

import numpy as np
import pytest
from test_compare import TRUE, flights, subject_of

from bench.diagnose.discover import discover
from bench.diagnose.regression.least_squares import Normal
from bench.diagnose.regression.linearise import Linearization
from bench.diagnose.regression.parameters import Entry, Prior, entries
from bench.diagnose.select.choose import updated
from bench.diagnose.select.release import contradicted
from bench.diagnose.select.search import Search, View
from bench.diagnose.select.step import advanced
from bench.diagnose.select.subset import Subsets
from registry.effects.mass import CogOffset
from registry.effects.torque import TorqueBias
from registry.physics.quadrotor import Quadrotor

BLOCKS, ROWS = 40, 1000


def constant(name: str, spread: float) -> Entry:
    return Entry(-1, name, None, "1", 1.0, spread, np.exp(-3 * spread), np.exp(3 * spread), stated=1.0)


def two_equations(wanted: float, *known: Entry) -> View:
    """Forces, gain over mass, that are as stated; torques, gain over inertia, of which data want ``wanted`` less."""
    signal, *noise = np.random.default_rng(0).normal(size=(3, BLOCKS * ROWS))
    acting = {"gain": (1.0, 1.0), "mass": (-1.0, 0.0), "inertia": (0.0, -1.0)}
    columns = np.array([[acting[e.name]] for e in known])[:, :, None]  # (c, 1, 1, channels)
    linear = Linearization(None, None, known, (), columns[0] * 0, columns, (0, 1), (), (), ())  # type: ignore[arg-type]
    channels = []
    for c, residual in enumerate((noise[0], noise[1] - wanted * signal)):
        rows = [*(columns[j, 0, 0, c] * signal for j in range(len(known))), residual]
        channels.append((np.arange(len(known) + 1), np.stack(rows)))
    normal = Normal(tuple(channels), len(known) + 1, np.arange(BLOCKS) // 10, np.full(BLOCKS, ROWS))
    return View(linear, (), Subsets(linear, normal), (), (), {}, frozenset(), ())


@pytest.mark.parametrize(
    ("wanted", "known", "gone"),
    [
        (0.3, {"gain": 0.3, "mass": 0.25, "inertia": 0.3}, None),  # within what is known
        (1.4, {"gain": 0.3, "mass": 0.03, "inertia": 0.3}, "inertia"),
        (1.4, {"gain": 0.3, "mass": 0.25, "inertia": 0.3}, "inertia"),
        (1.4, {"gain": 0.3, "mass": 0.25}, "gain"),  # less mass would only make room for the gain
        (1.4, {"gain": 0.3, "mass": 0.03, "inertia": 0.02}, "gain"),  # inertia is well known: far off it is an effect
    ],
)
def test_what_its_own_equation_contradicts_is_let_go(wanted: float, known: dict[str, float], gone: str | None) -> None:
    view = two_equations(wanted, *(constant(n, s) for n, s in known.items()))
    assert contradicted(view, view.subsets.fit()) == gone


def test_a_rough_constant_may_as_well_be_half_as_twice_what_is_stated() -> None:
    entry = constant("inertia", 0.3)
    (half, to_one), (twice, back) = (entry.pull(v) for v in (0.5, 2.0))
    assert half * to_one**2 == pytest.approx(twice * back**2) == pytest.approx((np.log(2) / 0.3) ** 2)
    step = 1e-6  # the gradient of (log(v / stated) / spread)² / 2
    slope = ((np.log(2 + step) / 0.3) ** 2 - (np.log(2 - step) / 0.3) ** 2) / (4 * step)
    assert -twice * back == pytest.approx(slope, rel=1e-6)


@pytest.mark.parametrize(("stated", "relative"), [({}, 0.03), ({"rotor_positions": 0.005}, 0.005)])
def test_a_centre_of_gravity_is_known_no_better_than_the_arms_that_it_is_told_relative_to(
    stated: dict[str, float], relative: float
) -> None:
    """Arms stated 1.9 % too long put it 1.9 % too far out, which recordings were sure of to .2 %."""
    model = Quadrotor(effects=(CogOffset(x=0.01), TorqueBias()))
    offset, *_, bias = (e for e in entries(model, stated) if not e.constant)
    assert (offset.label, bias.relative) == ("x", 0.0)
    low, high = offset.told(0.01, 2e-5)
    assert high - 0.01 == pytest.approx(0.01 - low) == pytest.approx(np.hypot(2e-5, 1.96 * relative * 0.01), rel=1e-3)


def test_a_step_that_goes_too_far_is_shortened() -> None:
    states, force = flights(count=3, samples=2000)
    seen = states + np.random.default_rng(1).normal(size=states.shape) * [1e-4, 1e-3]
    off = replace(TRUE, stiffness=80.0)
    search = Search(subject_of(off, seen, force, uncertainty={"stiffness": 0.3, "mass": 0.3}), [], lambda what: None)
    view = search.views(search.look(off, broad=False))[-1]
    fit = view.subsets.fit()
    straight = advanced(search, view, fit)
    assert straight.loss == pytest.approx(search.loss(view, updated(view, fit)))
    far = replace(fit, beta=4 * fit.beta)
    assert advanced(search, view, far).loss == pytest.approx(straight.loss)
    assert search.loss(view, updated(view, far)) > 10 * straight.loss


def test_a_constant_that_was_let_go_is_known_no_more_and_that_is_said() -> None:
    states, force = flights(count=3, samples=2000)
    search = Search(subject_of(TRUE, states, force, uncertainty={"stiffness": 0.3}), [], lambda what: None)
    assert not search.let_go(None) and not search.subject.notes
    assert search.let_go("stiffness")
    assert "The stated stiffness (100 N/m) was let go" in search.subject.notes[-1]
    known = {e.label: e for e in entries(search.subject.model, search.subject.uncertainty)}["stiffness"]
    assert known.low < 1 < 10_000 < known.high
    assert Prior.of([known]).precision[0] == pytest.approx((100.0 * np.log(10)) ** -2)


@pytest.mark.parametrize("stated", [4.0, 0.25])
def test_what_a_wrong_constant_spoils_is_no_part_of_what_an_effect_could_explain(stated: float) -> None:
    """A fourth of the mass is far more than all of the damping: what is left is weighed once the mass is fitted."""
    states, force = flights(count=6, samples=1500)
    seen = states + np.random.default_rng(1).normal(size=states.shape) * [1e-4, 1e-3]
    undamped = replace(TRUE, damping=0.0, mass=stated)
    subject = subject_of(undamped, seen, force, uncertainty={"mass": 1.0, "stiffness": 0.01})
    subject = replace(subject, training=subject.training[:4], held_out=subject.held_out[4:])
    found = discover(subject, [])
    assert found.calibrated.mass == pytest.approx(1.0, rel=0.02)  # type: ignore[attr-defined]
    assert found.traces[0].signal == "speed" and not found.remarks
    assert all(e.unexplained > 0.5 for e in found.equations)
