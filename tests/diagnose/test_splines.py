"""Which terms are learned, on rows whose truth is written down here."""

import numpy as np
import pytest

from bench.diagnose.learn.candidates import Columns, Pair
from bench.diagnose.learn.held_out import HeldOut
from bench.diagnose.learn.splines import Made, chosen

ROWS, FOLDS = 400, 6


def fits_of(columns: np.ndarray, residual: np.ndarray) -> HeldOut:
    """Normal equations of rows (FOLDS ROWS, n) whose noise has unit variance, without numbers of a model."""
    fits = HeldOut.__new__(HeldOut)
    rows = np.column_stack([columns, residual]).reshape(FOLDS, ROWS, -1)
    fits.own, fits.folds = [], [x.T @ x for x in rows]
    fits.known = fits.centre = fits.low = fits.high = np.zeros(0)
    fits.total = np.asarray(sum(fits.folds))
    fits.held, fits.rows = np.zeros_like(fits.total), float(FOLDS * ROWS)
    return fits


@pytest.mark.parametrize(("else_left", "expected"), [(0.0, ["x", "z"]), (12.0, ["x"])])
def test_a_small_term_that_is_all_that_is_left_is_taken_and_a_trace_of_something_else_is_not(
    else_left: float, expected: list[str]
) -> None:
    rng = np.random.default_rng(0)
    columns = rng.normal(size=(FOLDS * ROWS, 3))
    left = 30 * columns[:, 0] + 3 * columns[:, 1] + else_left * columns[:, 2] + rng.normal(size=FOLDS * ROWS)
    # What is left beside z follows no signal that is offered.
    fits = fits_of(columns[:, :2], left)
    made = [
        Made(Columns(Pair(f"world_force_{a}", (f"position.{a}",)), ()), (), np.eye(1), np.zeros((1, 1))) for a in "xz"
    ]
    taken = chosen(fits, made, [np.array([0]), np.array([1])])
    assert [s.pair.axis[-1] for s in taken] == expected


@pytest.mark.parametrize(("sigma", "expected"), [(0.3, "x"), (3.0, "z")])
def test_of_two_axes_that_a_constant_makes_alike_the_one_near_what_is_stated_is_taken(
    sigma: float, expected: str
) -> None:
    """Along z, with the constant 3 off, the same is left as along x, and for other reasons a trace less."""
    rng = np.random.default_rng(1)
    constant, along_x, trace, noise = rng.normal(size=(4, FOLDS * ROWS))
    along_z = along_x + constant + 0.05 * trace
    fits = fits_of(np.column_stack([constant, along_x, along_z]), 3 * along_x + 0.15 * trace + noise)
    fits.own, fits.known, fits.centre = [0], np.array([sigma**-2]), np.zeros(1)
    fits.held[0, 0] = sigma**-2
    fits.low, fits.high = np.array([-np.inf]), np.array([np.inf])
    made = [
        Made(Columns(Pair(f"world_force_{a}", (f"position.{a}",)), ()), (), np.eye(1), np.zeros((1, 1))) for a in "xz"
    ]
    taken = chosen(fits, made, [np.array([1]), np.array([2])])
    assert taken[0].pair.axis[-1] == expected
