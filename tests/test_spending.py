"""Looks at growing evidence: how often any of them errs, by sums that are drawn and by contrasts as they are judged."""

import math
from dataclasses import replace

import numpy as np
import pytest
import scipy.stats
from test_contrast import WORLDS, World

from bench.analysis.contrast import Cell, contrast
from bench.analysis.spending import level
from bench.experiment.seeds import MOST_SEEDS


def crossed(levels: list[float], first: int) -> float:
    """Share of 200,000 sums of independent trainings that lie beyond the upper limit at any look."""
    z = np.random.default_rng(1).standard_normal((200_000, MOST_SEEDS)).cumsum(1) / np.sqrt(
        np.arange(1, MOST_SEEDS + 1)
    )
    return float((z[:, first - 1 :] > scipy.stats.norm.isf(np.array(levels) / 2)).any(1).mean())


@pytest.mark.parametrize(("alpha", "first"), [(0.05, 3), (0.05, 5), (0.01, 2)])
def test_all_looks_together_err_as_often_as_one_may(alpha: float, first: int) -> None:
    levels = [level(alpha, first, n) for n in range(first, MOST_SEEDS + 1)]
    error = math.sqrt(alpha / 200_000)
    assert levels[0] == alpha
    assert crossed(levels, first) == pytest.approx(alpha, abs=3 * error)
    assert crossed([alpha] * len(levels), first) > 1.2 * alpha  # to look without spending


def test_one_look_takes_everything_and_those_after_the_last_no_more() -> None:
    assert level(0.05, 3, 3) == level(0.05, MOST_SEEDS, MOST_SEEDS + 3) == 0.05
    assert level(0.05, 3, 2) == 0.05
    assert level(0.05, 3, MOST_SEEDS + 8) == level(0.05, 3, MOST_SEEDS)


def wrong_at_any_look(world: World, studies: int, most: int = 8) -> float:
    """Share of studies in which some interval, at the level of its look, lies wholly on one side of the truth."""
    rng = np.random.default_rng(0)
    above = below = 0
    for _ in range(studies):
        cells, weighted = replace(world, seeds=most).draw(rng)
        sides = set()
        for n in range(world.seeds, most + 1):
            early = {id(c): Cell(c.values[:n]) for c in cells}
            found = contrast([(w, early[id(c)]) for w, c in weighted], list(early.values()))
            if abs(found.value) > found.half_width(level(0.05, world.seeds, n)):
                sides.add(found.value > 0)
        above, below = above + (True in sides), below + (False in sides)
    return (above + below) / (2 * studies)


@pytest.mark.parametrize("world", WORLDS.values(), ids=WORLDS)
def test_contrasts_err_on_a_side_in_5_of_100_studies_however_often_they_are_looked_at(world: World) -> None:
    assert wrong_at_any_look(world, 300) <= 0.05 + 2 * math.sqrt(0.05 * 0.95 / 600)
