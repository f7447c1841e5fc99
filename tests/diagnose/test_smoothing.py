"""The kernel that carries a smoothing over to the model's side, against SciPy's filters on a signal in closed form."""

import numpy as np
import pytest
from scipy.signal import savgol_filter

from bench.diagnose.logs.smoothing import Smoothing, stated
from registry.errors import BenchError

DT = 0.01
T = np.arange(400) * DT


def position(t):
    return np.sin(5 * t) + 0.3 * np.cos(17 * t)


def velocity(t):
    return 5 * np.cos(5 * t) - 0.3 * 17 * np.sin(17 * t)


@pytest.mark.parametrize(
    ("smoothing", "rate"),
    [
        (Smoothing("savgol", 9, 3, True), lambda: savgol_filter(position(T), 9, 3, deriv=1, delta=DT)),
        (Smoothing("savgol", 15, 2, True), lambda: savgol_filter(position(T), 15, 2, deriv=1, delta=DT)),
        (Smoothing("savgol", 9, 3, True, True), lambda: np.gradient(savgol_filter(position(T), 9, 3), DT)),
        (Smoothing("savgol", 9, 3, False), lambda: savgol_filter(velocity(T), 9, 3)),
        (Smoothing("mean", 5, 0, False), lambda: np.convolve(velocity(T), np.full(5, 0.2), "same")),
        (Smoothing("none", 1, 0, True), lambda: np.gradient(position(T), DT)),
    ],
)
def test_increments_of_a_smoothed_rate_are_the_smoothed_accelerations(smoothing, rate):
    increments = np.diff(rate())[30:-30]
    true = np.diff(velocity(T))
    with_kernel = np.convolve(true, smoothing.kernel(), "same")[30:-30]
    error, without = np.abs(increments - with_kernel).max(), np.abs(increments - true[30:-30]).max()
    if not smoothing.derived:
        assert error < 1e-12
    else:  # the mean over an interval stands for its middle: an error of second order in the step
        assert error < 2e-3 * np.abs(increments).max()
        assert smoothing.window < 15 or error < 0.1 * without


def test_a_kernel_neither_adds_nor_loses():
    for smoothing in (Smoothing(), Smoothing(derived=True), Smoothing("savgol", 21, 3, True), Smoothing("mean", 7)):
        kernel = smoothing.kernel()
        assert kernel.sum() == pytest.approx(1, abs=1e-12)
        np.testing.assert_allclose(kernel, kernel[::-1], atol=1e-12)


@pytest.mark.parametrize("stride", [2, 5, 8])
def test_of_some_samples_the_same_filter_is_taken_back(stride):
    """A window of 33 is no window of 7 at every fifth sample; what smooths one is known to the fifth moment."""
    smoothing = Smoothing("savgol", 33, 3, True)
    rate = savgol_filter(position(T), 33, 3, deriv=1, delta=DT)
    increments, true = (np.diff(x[::stride]) for x in (rate, velocity(T)))
    edge = 40 // stride + 2
    kept, whole = increments[edge:-edge], smoothing.coarser(stride).kernel()
    error = np.abs(kept - np.convolve(true, whole, "same")[edge:-edge]).max()
    near = Smoothing("savgol", 2 * round((33 / stride - 1) / 2) + 1, 3, True).kernel()
    about = np.abs(kept - np.convolve(true, near, "same")[edge:-edge]).max()
    assert whole.sum() == pytest.approx(1) and error < 0.3 * about and error < 0.02 * np.abs(kept).max()


@pytest.mark.parametrize(
    "table",
    [
        {"kind": "savgol", "window": 8, "order": 3},
        {"kind": "median", "window": 9},
        {"kind": "savgol", "window": 9, "order": 9},
        {"kind": "savgol", "window": 9.5, "order": 3},
        {"kind": "savgol", "width": 9},
        "savgol",
    ],
)
def test_an_impossible_filter_is_refused(table):
    with pytest.raises(BenchError, match="smoothing"):
        stated({"smoothing": table})
