"""Random-effects fits against published numbers, another route to the same numbers, and simulation."""

import math

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.stats import t as student

from bench.analysis.random_effects import adjusted, differences, fit

BCG = np.array(
    [
        [4, 119, 11, 128], [6, 300, 29, 274], [3, 228, 11, 209], [62, 13536, 248, 12619], [33, 5036, 47, 5761],
        [180, 1361, 372, 1079], [8, 2537, 10, 619], [505, 87886, 499, 87892], [29, 7470, 45, 7232],
        [17, 1699, 65, 1600], [186, 50448, 141, 27197], [5, 2493, 3, 2338], [27, 16886, 29, 17825],
    ],
    dtype=float,
)  # fmt: skip
"""Trials of the BCG vaccine (Colditz and others 1994): cases and others among the vaccinated, then the controls."""


def relative_risks() -> tuple[np.ndarray, np.ndarray]:
    """Logs (13,) and their standard errors (13,)."""
    a, b, c, d = BCG.T
    return np.log((a / (a + b)) / (c / (c + d))), np.sqrt(1 / a - 1 / (a + b) + 1 / c - 1 / (c + d))


def test_the_vaccine_trials_are_as_published() -> None:
    """Viechtbauer (2010), J. Stat. Software 36(3): Q = 152.23; empirical Bayes (Paule and Mandel): τ² = 0.318."""
    found = fit(*relative_risks())
    assert found.q == pytest.approx(152.233, abs=0.001) and found.heterogeneity < 1e-20
    assert found.between**2 == pytest.approx(0.3181, abs=1e-4)
    assert found.beta[0] == pytest.approx(-0.7150, abs=1e-4)
    assert math.sqrt(found.covariance[0, 0]) == pytest.approx(0.1809, abs=1e-4)
    half = student.ppf(0.975, 12) * 0.18089
    assert found.interval() == pytest.approx((-0.71497 - half, -0.71497 + half), abs=1e-3)


def test_a_line_is_that_of_weighted_least_squares_at_its_spread() -> None:
    y, s = relative_risks()
    x = np.column_stack([np.ones(13), np.array([44, 55, 42, 52, 13, 44, 19, 13, 27, 42, 18, 33, 33.0])])

    def off(tau2: float) -> float:
        w = 1 / np.sqrt(s**2 + tau2)
        _, rest, *_ = np.linalg.lstsq(x * w[:, None], y * w, rcond=None)
        return float(abs(rest[0] - 11))

    tau2 = minimize_scalar(off, bounds=(0, 1), method="bounded", options={"xatol": 1e-12}).x
    w = 1 / np.sqrt(s**2 + tau2)
    line = np.linalg.lstsq(x * w[:, None], y * w, rcond=None)[0]
    found = fit(y, s, x)
    assert found.between**2 == pytest.approx(tau2, rel=1e-4) and found.freedom == 11
    assert found.beta == pytest.approx(line, rel=1e-4)
    assert found.p_value(1) < 0.02 < found.p_value(0)


def test_estimates_that_agree_have_no_spread_and_the_plain_weighted_mean() -> None:
    y, s = np.array([1.0, 1.1, 0.9]), np.array([0.2, 0.1, 0.4])
    found, w = fit(y, s), 1 / s**2
    assert found.between == 0 and found.beta[0] == pytest.approx(w @ y / w.sum())
    assert found.covariance[0, 0] == pytest.approx(1 / w.sum())
    one = fit(y[:1], s[:1])
    assert one.beta[0] == 1 and one.covariance[0, 0] == pytest.approx(0.04) and math.isnan(one.interval()[0])


@pytest.mark.parametrize("scale", [1e-12, 1.0, 1e9])
def test_units_change_nothing(scale: float) -> None:
    y, s = relative_risks()
    plain, scaled = fit(y, s), fit(y * scale, s * scale)
    assert scaled.between == pytest.approx(plain.between * scale)
    assert scaled.interval() == pytest.approx([v * scale for v in plain.interval()])
    assert [d.p for d in differences(y * scale, s * scale)] == pytest.approx([d.p for d in differences(y, s)])


def test_a_deleted_residual_is_the_test_of_a_shift_of_that_unit() -> None:
    """The mean-shift model: a column that is 1 for the unit alone."""
    y, s = relative_risks()
    for i, found in enumerate(differences(y, s)):
        shift = fit(y, s, np.column_stack([np.ones(13), np.arange(13) == i]))
        assert found.t == pytest.approx(shift.beta[1] / math.sqrt(shift.covariance[1, 1]), rel=1e-6)
        assert found.p == pytest.approx(shift.p_value(1), rel=1e-6)


def test_benjamini_and_hochberg_step_up() -> None:
    p = [0.001, 0.8, math.nan, 0.012, 0.04, 0.02]
    known = sorted(x for x in p if not math.isnan(x))
    expected = {x: min(known[j] * len(known) / (j + 1) for j in range(i, len(known))) for i, x in enumerate(known)}
    found = adjusted(p)
    assert math.isnan(found[2])
    assert [f for f in found if not math.isnan(f)] == pytest.approx([expected[x] for x in p if not math.isnan(x)])
    assert adjusted([math.nan]) != [0.0] and adjusted([]) == []


@pytest.mark.parametrize("between", [0.0, 2.0])
def test_alike_units_are_rarely_said_to_differ(between: float) -> None:
    """In at most 5 % of fleets of equal vehicles any is told, up to what 400 fleets can show."""
    random, told = np.random.default_rng(1), 0
    for _ in range(400):
        s = random.uniform(0.5, 2.0, 12)
        y = random.normal(0, between, 12) + random.normal(0, s)
        told += min(adjusted([d.p for d in differences(y, s)])) <= 0.05
    assert told <= 400 * 0.05 + 2.6 * math.sqrt(400 * 0.05 * 0.95)


def test_a_unit_that_is_far_off_is_told_and_does_not_hide_itself() -> None:
    random = np.random.default_rng(2)
    s = np.full(12, 1.0)
    y = random.normal(0, 1.5, 12)
    y[4] += 14
    found = differences(y, s)
    assert [i for i, p in enumerate(adjusted([d.p for d in found])) if p <= 0.05] == [4]
    assert found[4].others.beta[0] == pytest.approx(np.delete(y, 4).mean(), abs=0.2)
