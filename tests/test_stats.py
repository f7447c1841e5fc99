"""Intervals and comparisons against scipy and against data whose truth is known."""

import math
import time

import numpy as np
import pytest
import scipy.signal
import scipy.stats

from bench.analysis.stats import compare, interval, rare_gain, relative_gain, uneven_gain

EFFECT = 0.8


def errors(
    rng: np.random.Generator, trainings: int, recordings: int, of_recording: float, of_training: float, effect: float
) -> tuple[np.ndarray, np.ndarray]:
    """Errors of two models, b's spread widely over recordings, a's ``effect`` times b's but for two crossed effects."""
    shape = (trainings, recordings)
    b = np.exp(rng.normal(2, 1, (1, recordings)) + rng.normal(0, 0.2, shape))
    log_ratio = np.log(effect) + rng.normal(0, of_recording, shape[1:]) + rng.normal(0, of_training, (trainings, 1))
    return b * np.exp(log_ratio + rng.normal(0, 0.1, shape)), b


def test_interval_is_students() -> None:
    values = [3.1, 2.7, 3.9, 3.3]
    expected = scipy.stats.t.interval(0.9, 3, np.mean(values), scipy.stats.sem(values))
    assert interval(values, 0.9) == pytest.approx(expected)
    assert interval([3.0]) is None
    assert interval([]) is None


@pytest.mark.parametrize(("trainings", "recordings"), [(6, 1), (1, 6), (1, 200)])
def test_one_source_of_spread_agrees_with_scipys_paired_test(trainings: int, recordings: int) -> None:
    a, b = errors(np.random.default_rng(3), trainings, recordings, 0.2, 0.2, EFFECT)
    found = compare(a, b)
    expected = scipy.stats.ttest_rel(np.log(a).ravel(), np.log(b).ravel()).confidence_interval()
    exact = recordings < 8
    assert np.log([found.low, found.high]) == pytest.approx(list(expected), rel=1e-9 if exact else 0.05)
    assert ("bootstrap" in found.basis) != exact


@pytest.mark.parametrize(
    ("trainings", "recordings", "of_recording", "of_training"),
    [(3, 10, 0.2, 0.0), (3, 10, 0.05, 0.2), (5, 12, 0.1, 0.1), (3, 5, 0.2, 0.1), (1, 8, 0.2, 0.0), (3, 1, 0.0, 0.2)],
)
def test_the_truth_is_covered_as_often_as_promised(
    trainings: int, recordings: int, of_recording: float, of_training: float
) -> None:
    rng, repeats = np.random.default_rng(0), 500
    held = 0
    for _ in range(repeats):
        found = compare(*errors(rng, trainings, recordings, of_recording, of_training, EFFECT))
        held += found.low <= EFFECT <= found.high
    assert 0.92 <= held / repeats <= 0.985


def test_a_reduction_of_the_smallest_visible_size_is_seen_four_times_in_five() -> None:
    rng, layout = np.random.default_rng(0), (4, 15, 0.2, 0.02)
    smallest = np.mean([compare(*errors(rng, *layout, 1.0)).smallest for _ in range(200)])
    seen = np.mean([compare(*errors(rng, *layout, 1 - smallest)).verdict == "better" for _ in range(400)])
    assert 0.7 <= seen <= 0.9


def test_verdicts() -> None:
    rng = np.random.default_rng(0)
    half, b = errors(rng, 3, 10, 0.1, 0.02, 0.5)
    assert compare(half, b).verdict == "better"
    assert compare(b, half).verdict == "worse"
    assert compare(b, half).ratio == pytest.approx(1 / compare(half, b).ratio)
    assert not compare(half, b).alike
    same, b = errors(rng, 3, 10, 0.1, 0.02, 1.0)
    assert compare(same, b).verdict == "cannot tell"
    assert compare(same, b).alike
    noisy, b = errors(rng, 3, 3, 1.0, 0.5, 1.0)
    assert compare(noisy, b).verdict == "cannot tell"
    assert not compare(noisy, b).alike


def test_one_training_has_an_interval_but_no_verdict() -> None:
    found = compare(*errors(np.random.default_rng(0), 1, 10, 0.02, 0.0, 0.5))
    assert found.high < 1
    assert (found.verdict, found.alike) == ("cannot tell", False)
    assert np.isnan(found.smallest)
    lone = compare(np.array([[1.0]]), np.array([[2.0]]))
    assert lone.ratio == pytest.approx(0.5)
    assert (np.isnan(lone.low), lone.verdict) == (True, "cannot tell")
    assert compare(np.empty((0, 4)), np.empty((0, 4))).verdict == "cannot tell"


def test_a_comparison_repeats_exactly_and_is_quick() -> None:
    a, b = errors(np.random.default_rng(0), 5, 54, 0.2, 0.1, EFFECT)
    started = time.perf_counter()
    first = compare(a, b)
    assert time.perf_counter() - started < 0.2
    assert compare(a, b) == first
    with pytest.raises(ValueError, match="shape"):
        compare(a, b[:4])


def test_an_interval_too_wide_for_a_number_is_infinite() -> None:
    a = np.exp([[0.1, 0.5], [2.0, 2.1]])
    found = compare(a, np.ones_like(a), confidence=1 - 1e-6)
    assert found.high == math.inf and 0 <= found.low < found.ratio and found.verdict == "cannot tell"


def test_gains_of_a_few_manoeuvres_are_uneven_and_sure():
    """One block of eight has nearly all: each gains, and only the sum's size is unsure."""
    gains = np.array([100.0, 1.0, 1.5, 0.8, 1.2, 0.9, 1.1, 1.3])
    assert gains.mean() - 2 * gains.std(ddof=1) / 8**0.5 < 0 < uneven_gain(gains) < 1
    by_scipy = scipy.stats.permutation_test(
        (gains - uneven_gain(gains, 0.9), np.zeros(8)),
        lambda a, b: np.sum(a - b),
        permutation_type="samples",
        alternative="greater",
    )
    assert by_scipy.pvalue == pytest.approx(0.05, abs=1 / 256)
    assert uneven_gain(gains - 1.4) < 0, "most blocks lose"
    assert uneven_gain(gains[:5]) == -np.inf, "no five signs are rare enough"


def test_blocks_that_all_save_their_share_are_sure_though_one_has_nearly_all():
    before = np.array([100.0, 1.0, 1.5, 0.8, 1.2, 0.9])
    share = np.array([0.8, 0.2, 0.25, 0.3, 0.2, 0.15])
    low = relative_gain(before, before * (1 - share), 2.0)
    assert 0 < low < share.mean()
    assert low == relative_gain(7 * before, 7 * before * (1 - share), 2.0)
    assert relative_gain(before, before * (1 + np.array([-0.8, 0.1, 0.1, 0.1, 0.1, 0.1])), 2.0) < 0, "most blocks lose"
    assert relative_gain(before[:2], before[:2] / 2, 2.0) == -np.inf


@pytest.mark.parametrize("count", [8, 16])
def test_gains_without_a_mean_are_seldom_called_sure(count):
    random = np.random.default_rng(1)
    sure = [uneven_gain(random.standard_cauchy(count)) > 0 for _ in range(600)]
    assert np.mean(sure) < 0.025 + 2 * (0.025 * 0.975 / 600) ** 0.5
    assert np.mean([uneven_gain(random.normal(1.2, 1, count)) > 0 for _ in range(100)]) > 0.75


def drifting(random: np.random.Generator) -> np.ndarray:
    """Errors (400, 2) that remember .7 of the one before."""
    return scipy.signal.lfilter([1.0], [1.0, -0.7], random.normal(size=(500, 2)), axis=0)[100:]


def test_what_one_manoeuvre_shows_is_sure_by_its_course():
    """Of two recordings with five blocks each one holds it; what errors follow by chance is seldom called sure."""
    random = np.random.default_rng(2)
    recording, block = np.arange(400) // 200, np.arange(400) // 40
    course = np.zeros((400, 2))
    course[90:115] = np.stack([np.hanning(25), np.sin(np.arange(25) / 4)], 1)

    def low(errors: np.ndarray, size: float, sure: float = 2.0) -> float:
        return rare_gain(errors + size * course, errors, recording, block, sure)

    draws = [drifting(random) for _ in range(300)]
    assert np.mean([low(e, 5.0) > 0 for e in draws]) > 0.9
    imagined = [rare_gain(e, e - 3.0 * course, recording, block, 2.0) > 0 for e in draws]
    assert np.mean(imagined) < 0.025 + 2 * (0.025 * 0.975 / 300) ** 0.5
    spread = np.std([2 * (e * course).sum() for e in draws])
    told = [400 * (low(e, 1.0, 0.0) - low(e, 1.0, 1.0)) for e in draws]
    assert spread < np.mean(told) < 1.3 * spread, "the larger of two estimates"
    assert rare_gain(draws[0] + 1.0, draws[0], recording, block, 2.0) == -np.inf, "it acts in all blocks"
    assert rare_gain(draws[0], draws[0], recording, block, 2.0) == -np.inf, "it does not act"
    few = slice(80, 120)
    assert rare_gain(draws[0][few] + 5 * course[few], draws[0][few], recording[few], block[few] // 3, 2.0) == -np.inf
