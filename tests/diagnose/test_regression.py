"""Bounded least squares against SciPy, whitening against a process whose filter is known."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import lsq_linear
from scipy.signal import lfilter

from bench.diagnose.regression.least_squares import Normal, bounded, regularised, ridge, squares_left, whitening
from bench.diagnose.regression.rows import Crossings, Rows, filtered, refiltered
from bench.diagnose.select.subset import Subsets


@pytest.mark.parametrize("seed", range(8))
def test_bounded_least_squares_is_that_of_scipy(seed):
    rng = np.random.default_rng(seed)
    a = rng.normal(size=(60, 7)) @ rng.normal(size=(7, 7))
    y = rng.normal(size=60) + a @ rng.normal(size=7)
    low, high = np.full(7, -np.inf), np.full(7, np.inf)
    low[rng.choice(7, 3, replace=False)] = 0.0
    high[rng.choice(7, 2, replace=False)] = 0.2
    expected = lsq_linear(a, y, (low, high), tol=1e-14).x
    np.testing.assert_allclose(bounded(a.T @ a, a.T @ y, low, high), expected, atol=1e-6)


def test_a_coefficient_between_equal_bounds_stays_there():
    gram, moment = np.array([[2.0, 1.0], [1.0, 2.0]]), np.array([1.0, 5.0])
    beta = bounded(gram, moment, np.array([1.0, -np.inf]), np.array([1.0, np.inf]))
    np.testing.assert_allclose(beta, [1.0, 2.0])


def test_nothing_to_fit_is_no_fault():
    assert bounded(np.zeros((0, 0)), *(np.zeros(0) for _ in range(3))).shape == (0,)


def test_what_only_a_prior_tells_apart_it_tells_however_little_noise_there_is():
    """Of two columns that are one: the known number stays, and the other has what rows say."""
    x = np.random.default_rng(3).normal(size=1000)
    rows = 1e6 * np.column_stack([x, 2 * x, 6 * x])
    free = np.full(2, np.inf)
    found = regularised(rows.T @ rows, [0, 1], np.array([1e4, 0.0]), np.zeros(2), -free, free)
    assert found == pytest.approx([0, 3], abs=0.1)


def test_whitening_finds_the_process():
    rng = np.random.default_rng(0)
    noise, series = rng.normal(size=40_000) * 0.5, np.zeros(40_000)
    for k in range(2, len(series)):
        series[k] = 1.2 * series[k - 1] - 0.5 * series[k - 2] + noise[k]
    coefficients = whitening([series[:20_000], series[20_000:]], 4)
    np.testing.assert_allclose(coefficients / coefficients[0], [1, -1.2, 0.5, 0, 0], atol=0.03)
    white = filtered(series, coefficients)
    assert white.std() == pytest.approx(1, abs=0.02)
    assert abs(np.corrcoef(white[1:], white[:-1])[0, 1]) < 0.02


def test_a_filter_and_its_transpose_do_not_see_the_parts_that_they_work_in():
    rng = np.random.default_rng(5)
    series, coefficients = rng.normal(size=(50_000, 3)), rng.normal(size=9)
    white = filtered(series, coefficients)
    whole = np.column_stack([np.convolve(x, coefficients, "valid") for x in series.T])
    np.testing.assert_allclose(white, whole, atol=1e-12)
    other = rng.normal(size=white.shape)
    assert (white * other).sum() == pytest.approx((series * refiltered(other, coefficients)).sum(), abs=1e-8)


def test_normal_equations_hold_a_part_out():
    rng = np.random.default_rng(1)
    x, y = rng.normal(size=(30, 2)), rng.normal(size=30)
    rows = np.column_stack([x, y]).reshape(3, 10, 3)
    normal = Normal(((np.arange(3), rows.reshape(30, 3).T),), 3, np.array([0, 1, 2]), np.full(3, 10))
    free = np.full(2, np.inf)
    beta, misfit = normal.fit([0, 1], np.zeros(2), np.zeros(2), -free, free, without=1)
    kept = np.r_[0:10, 20:30]
    expected = np.linalg.lstsq(x[kept], y[kept], rcond=None)[0]
    np.testing.assert_allclose(beta, expected, rtol=1e-6)
    assert misfit == pytest.approx(((y[kept] - x[kept] @ expected) ** 2).sum(), rel=1e-6)
    held_out = ((y[10:20] - x[10:20] @ expected) ** 2).sum()
    assert normal.losses([0, 1], beta)[1, 0] == pytest.approx(held_out, rel=1e-6)
    scores = [x[10 * i : 10 * i + 10].T @ (y - x @ expected)[10 * i : 10 * i + 10] for i in range(3)]
    np.testing.assert_allclose(normal.scores([0, 1], expected), scores, atol=1e-12)
    noise = np.cov(rng.normal(size=(3, 20)))[None]
    vector = np.append(-expected, 1.0)
    quieter = normal.less(noise)
    np.testing.assert_allclose(quieter.total, normal.total - 30 * noise[0])
    taken_off = normal.losses([0, 1], expected) - quieter.losses([0, 1], expected)
    np.testing.assert_allclose(taken_off, np.full((3, 1), 10 * vector @ noise[0] @ vector))
    taken_off = normal.scores([0, 1], expected) - quieter.scores([0, 1], expected)
    np.testing.assert_allclose(taken_off, np.tile(10 * noise[0, :2] @ vector, (3, 1)))


def test_rows_of_the_columns_that_act_give_the_normal_equations_of_all():
    """Against the plain way: every channel with every column, zeros and all, through SciPy's filter."""
    rng = np.random.default_rng(2)
    acting, width, filters = ([0, 2, 5], [1, 2, 5]), 5, [np.array([2.0, -1.0]), np.array([1.0, 0.5])]
    parts = tuple(
        tuple(rng.normal(size=(n, len(a))) for a in acting) for n in (51, 41)
    )  # so that blocks of 5 and 4 come out even
    rows = Rows(parts, tuple(map(np.array, acting)), width, 0.1)
    full = np.zeros((2, 2, width + 1, width + 1))  # logs, channels
    beta, left = rng.normal(size=width), []
    for i, log in enumerate(parts):
        for c, (x, a) in enumerate(zip(log, acting, strict=True)):
            dense = np.zeros((len(x), width + 1))
            dense[:, a] = x
            left.append(dense @ np.append(-beta, 1.0))
            white = lfilter(filters[c], 1.0, dense, axis=0)[len(filters[c]) - 1 :]
            full[i, c] = white.T @ white
    white = rows.whitened(filters)
    np.testing.assert_allclose(sum(white.folds()), full.sum((0, 1)), atol=1e-12)
    np.testing.assert_allclose(white.power(), full.sum(0).diagonal(axis1=1, axis2=2), atol=1e-12)
    crossings, all_of_them = Crossings(white), np.stack(white.folds())
    for some in ([2, 0], [0, -1, 1], list[int]()):
        np.testing.assert_allclose(crossings.of(some), all_of_them[:, some], atol=1e-12)
    np.testing.assert_allclose(crossings.squares, full.sum((0, 1)).diagonal(), atol=1e-12)
    np.testing.assert_allclose(np.concatenate([r.T.ravel() for r in rows.residuals(beta)]), np.concatenate(left))
    np.testing.assert_allclose(white.less(white.some([0, 1, 2, 3, 4])).power(), 0.0, atol=1e-12)
    some = [1, 2, 5]  # the last is the residual
    np.testing.assert_allclose(white.some(some[:-1]).normal().total, full.sum((0, 1))[np.ix_(some, some)], atol=1e-12)


def test_what_the_draws_of_a_noise_that_is_taken_off_leave_to_chance_is_that_of_their_sum() -> None:
    """Of m white samples in each of F folds n'n has variance 2 m, and β n'n is what the scores owe to them."""
    rng, folds, samples, slope = np.random.default_rng(0), 6, 50, 1.5
    white = rng.normal(size=(2000, folds, samples))
    told = []
    for power in (white**2).sum(-1):
        drawn = tuple(np.diag([p, 0.0]) for p in power)
        none = np.array([0, 1]), np.zeros((2, folds * samples))
        normal = Normal((none,), 2, np.arange(folds), np.full(folds, samples), drawn=drawn)
        told.append(normal.drawn_meat([0], np.array([slope])).item())
    assert np.mean(told) == pytest.approx(slope**2 * folds * 2 * samples, rel=0.05)
    one = Normal((none,), 2, np.arange(1), np.full(1, samples), drawn=drawn[:1])
    assert one.drawn_meat([0], np.array([slope])).item() == 0.0  # one draw does not tell


def test_an_interval_counts_the_noise_that_is_taken_off() -> None:
    rng, folds, samples = np.random.default_rng(1), 4, 40
    x = rng.normal(size=folds * samples)
    rows = np.stack([x, 5.0 * x + 0.01 * rng.normal(size=len(x))])
    plain = Normal(((np.array([0, 1]), rows),), 2, np.arange(folds), np.full(folds, samples))
    linear = SimpleNamespace(own=(), starts=())
    drawn = tuple(np.diag([p, 0.0]) for p in (rng.normal(size=(folds, samples)) ** 2).sum(1))
    fit = SimpleNamespace(columns=(0,), beta=np.array([5.0]), fixed=(), misfit=0.0)
    narrow, wide = (
        Subsets(linear, n).covariance(fit).item()  # type: ignore[arg-type]
        for n in (plain, replace(plain, drawn=drawn))
    )
    chance = plain.total[0, 0] ** -2 * replace(plain, drawn=drawn).drawn_meat([0], fit.beta).item()
    assert narrow < 0.5 * chance and wide == pytest.approx(chance, rel=0.05)


def test_what_an_exact_equation_leaves_is_never_negative() -> None:
    """It was in every other case, and the logarithm of what a wave saves of it no number, which no rule refused."""
    below = 0
    for seed in range(50):
        x = np.random.default_rng(seed).normal(size=(200, 4))
        table = np.column_stack([x, x @ [1.0, -2.0, 0.5, 3.0]])
        gram = table.T @ table
        beta = ridge(gram, 0.0)
        vector = np.append(-beta, 1.0)
        below += vector @ gram @ vector < 0
        assert 0 < squares_left(gram, beta) <= 1e-13 * gram[-1, -1]
        table[:, -1] += np.random.default_rng(seed + 50).normal(size=200)
        gram = table.T @ table
        left = table[:, -1] - table[:, :-1] @ (beta := ridge(gram, 0.0))
        assert squares_left(gram, beta) == pytest.approx(left @ left, rel=1e-9)
    assert below > 5
