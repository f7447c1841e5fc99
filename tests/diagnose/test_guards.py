"""What keeps noise from being named, and an effect from being dropped for a constant that imitates it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from test_compare import TRUE, flights, subject_of

from bench.diagnose import verify
from bench.diagnose.choose import accepted
from bench.diagnose.linearise import Directions, Start
from bench.diagnose.parameters import Entry
from bench.diagnose.regression import Normal
from bench.diagnose.search import Search, View
from bench.diagnose.subset import Subsets
from bench.diagnose.weak import TestFunctions
from registry.core import EFFECTS

BLOCKS, ROWS = 40, 1000


def view_of(gain: float) -> View:
    """Four recordings of white noise in which one column explains ``gain`` times what noise leaves, everywhere."""
    rng = np.random.default_rng(0)
    constant, x, noise = rng.normal(size=(3, BLOCKS, ROWS))
    rows = np.stack([constant, x, gain**0.5 * x + noise], axis=-1)
    grams = np.einsum("bri,brj->bij", rows, rows)[:, None]
    entry = Entry(0, "k", None, "1", 0.0, 1.0, -np.inf, np.inf)
    mass = Entry(-1, "mass", None, "kg", 1.0, 0.01, 0.97, 1.03)
    start = Start("drag", None, (entry,), (1,), (-np.inf,), (np.inf,))  # type: ignore[arg-type]
    nothing = np.empty(0)
    linear = Directions(None, None, (mass,), (start,), nothing, nothing, (), (), (), ())  # type: ignore[arg-type]
    normal = Normal(grams, np.arange(BLOCKS) // 10, np.full(BLOCKS, ROWS))
    return View(linear, (), Subsets(linear, normal, {"mass": 1.0}), (), (), 0.0, frozenset())


@pytest.mark.parametrize(("gain", "named"), [(0.006, False), (0.03, True)])
def test_what_noise_dwarfs_is_not_named_however_significant_it_is(gain: float, named: bool) -> None:
    view = view_of(gain)
    smaller, larger = view.subsets.fit(), view.subsets.fit(view.subsets.starts)
    assert smaller.misfit - larger.misfit > 10 * view.subsets.penalty  # 0.6 % of 40 000 rows is significant
    assert accepted(view, smaller, larger) is named


@pytest.mark.parametrize(("share", "buried"), [(0.02, False), (1.5, True)])
def test_a_constant_whose_column_is_noise_of_the_inputs_is_free_and_its_channel_doubtful(
    share: float, buried: bool
) -> None:
    states, force = flights(count=3, samples=2000)
    seen = states + np.random.default_rng(1).normal(size=states.shape) * [1e-4, 1e-3]
    hiss = np.random.default_rng(2).normal(0, share * force.std(), force.shape)
    subject = subject_of(TRUE, seen, force + hiss)
    search = Search(subject, [], lambda what: None)
    view = search.views(search.look(subject.model, broad=False))[0]
    assert bool(view.doubtful) is buried
    constants = [e.constant for e in view.linear.own]
    assert any(p == 0 for p, c in zip(view.subsets.prior, constants, strict=True) if c) is buried


def test_a_widely_uncertain_constant_does_not_stand_in_for_an_effect_that_is_taken_away() -> None:
    """The column of the mass holds the friction; without the friction it must not."""
    states, force = flights(count=3, samples=2000)
    seen = states + np.random.default_rng(1).normal(size=states.shape) * [1e-4, 1e-3]
    subject = subject_of(replace(TRUE, damping=0.0), seen, 0.3 * force, uncertainty={"mass": 0.7, "stiffness": 0.7})
    friction = EFFECTS.get("viscous_friction")(0.5)
    search = Search(subject, [], lambda what: None)
    misfits = []
    for model in (replace(subject.model, effects=(friction,)), subject.model):
        linear = search.look(model, broad=False).linear
        rows = linear.project(TestFunctions.over(search.stack.logs, search.hop, [search.smoothing["speed"]]))
        normal = rows.normal([np.ones(1)] * rows.channels)
        misfits.append(Subsets(linear, normal, search.nominal).fit(drop=range(len(model.effects))).misfit)
    assert misfits[0] == pytest.approx(misfits[1], rel=1e-6)


def test_crumbs_of_something_that_is_not_understood_are_not_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first effect imitates: what it gained is not understood, and the second gains too little beside that."""
    misfit = {(): 100.0, (0,): 1100.0, (1,): 200.0, (2,): 1000.0}
    subsets = SimpleNamespace(fit=lambda drop=(): SimpleNamespace(misfit=misfit[tuple(drop)]))
    view = SimpleNamespace(subsets=subsets)
    monkeypatch.setattr(verify, "needed", lambda view, place, traces: place != 0)
    assert verify.understood(view, [0, 1, 2], [], total=50.0) == [2]  # type: ignore[arg-type]
    monkeypatch.setattr(verify, "needed", lambda view, place, traces: True)
    assert verify.understood(view, [0, 1, 2], [], total=50.0) == [0, 1, 2]  # type: ignore[arg-type]
