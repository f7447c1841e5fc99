"""Two effects, each a part of what a far larger one leaves, and one beside a trace that nothing predicts better."""

from dataclasses import replace
from pathlib import Path

import pytest

pytest.importorskip("rotorpy")

from bench.diagnose import discover
from bench.diagnose.select.search import Search
from bench.diagnose.select.step import settled
from bench.diagnose.select.verify import neighbours
from bench.score.chain import suite
from bench.score.chain.case import ChainCase, measured
from registry.effects.mass import CogOffset

BOX = {
    "cog_offset": {"x": 0.02, "y": -0.015},
    "inertia_products": {"J_xy": 8e-5, "J_xz": 1.6e-4, "J_yz": -1e-4},
    "recorded_point": {"x": -0.015, "y": 0.012, "z": 0.004},
}
"""Of a box beside the centre: thrust turns the vehicle, its axes are tilted, and markers go round where it is."""


def test_two_that_only_together_clear_what_a_large_one_leaves_are_tried_together(cache: Path) -> None:
    how = {"style": "aggressive", "noise": "low", "control_hz": 500, "log_hz": 100, "recordings": 5, "seconds": 12.0}
    subject = measured(ChainCase("box", "survey", effects=BOX, flight_seed=5, **how), cache)
    search = Search(subject, None, lambda what: None)
    begun = replace(subject.model, effects=(CogOffset(**BOX["cog_offset"]),))
    view, model = settled(search, begun)
    by_offset = 1e3 * view.subsets.fit().misfit  # what is left is little beside it
    explained = dict.fromkeys(view.linear.channels, by_offset)
    view = search.views(search.look(model), explained)[0]
    assert {"inertia_products", "recorded_point"} in [set(f.ids) for f in neighbours(view, 0)]
    assert {f.id for f in discover(subject).found} == set(BOX)


@pytest.mark.slow
def test_what_nothing_predicts_better_is_no_riddle(cache: Path) -> None:
    """A trace in force z, which errs less than its noise, had made an imitation of a racer's products of inertia."""
    name = "113-single-inertia_products-racer-1-gentle-low-capture-250c100"
    (case,) = (c for c in suite.cases(113) if c.id == name)
    assert [f.id for f in discover(measured(case, cache)).found] == ["inertia_products"]
