"""Filters of our own against those of SciPy, and what importing a diagnosis leaves alone."""

import subprocess
import sys

import numpy as np
import pytest
from scipy.signal import lfilter, savgol_coeffs
from scipy.signal.windows import blackmanharris

from bench.diagnose.logs.filters import lagged, savitzky_golay
from bench.diagnose.logs.noise import _taper


@pytest.mark.parametrize("order", [2, 3, 4])
@pytest.mark.parametrize("slope", [False, True])
def test_a_local_polynomial_is_scipys(order: int, slope: bool) -> None:
    for window in range(7, 27, 2):
        expected = savgol_coeffs(window, order, deriv=int(slope), use="dot")
        np.testing.assert_array_equal(savitzky_golay(window, order, slope), expected)


def test_a_lag_is_scipys_recurrence() -> None:
    x = np.random.default_rng(0).normal(size=(400, 3, 2))
    np.testing.assert_allclose(lagged(x, 0.9), lfilter([0.1], [1, -0.9], x, axis=0), rtol=0, atol=1e-14)
    begun, _ = lfilter([0.1], [1, -0.9], x, axis=0, zi=0.9 * x[:1])
    np.testing.assert_allclose(lagged(x, 0.9, before=x[0]), begun, rtol=0, atol=1e-14)
    assert lagged(x[:0], 0.9).shape == (0, 3, 2)


@pytest.mark.parametrize("length", [64, 128])
def test_the_taper_is_scipys(length: int) -> None:
    np.testing.assert_array_equal(_taper(length)[:length], blackmanharris(length, sym=False))


def test_a_diagnosis_is_imported_without_what_it_seldom_needs() -> None:
    heavy = ("scipy.signal", "scipy.stats", "scipy.optimize", "scipy.integrate", "scipy.interpolate", "matplotlib")
    code = f"import bench.diagnose.diagnose, bench.fleet, sys; print(*(m for m in {heavy} if m in sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120)
    assert not done.stdout.split()
