"""Filters of sampled signals: a local polynomial and a first-order lag.

`scipy.signal` has both; importing it takes more time and memory than all else that a diagnosis needs of SciPy.
"""

import numpy as np
from scipy.linalg import lapack, lstsq


def savitzky_golay(window: int, order: int, slope: bool = False) -> np.ndarray:
    """Weights (window,) on samples, later ones last, of the middle of a local polynomial or of its slope a sample.

    Savitzky and Golay, "Smoothing and differentiation of data by simplified least squares procedures", Analytical
    Chemistry 36 (1964).

    Args:
        window: odd number of samples.
        order: of the polynomial, less than ``window``.
        slope: whether its slope is asked for.
    """
    powers = np.arange(order + 1)
    sample = np.arange(window) - window // 2.0
    return np.asarray(lstsq(sample ** powers[:, None], (powers == int(slope)).astype(float))[0])


def lagged(x: np.ndarray, keep: float, before: np.ndarray | float = 0.0) -> np.ndarray:
    """y_k = keep · y_{k−1} + (1 − keep) x_k along the first axis of ``x`` (N, …), from y_{−1} = ``before`` (…).

    The recurrence is a lower bidiagonal system, which LAPACK solves by substitution.
    """
    if not x.size:
        return x
    band = np.ones((2, len(x)))
    band[1] = -keep
    given = np.asfortranarray((1 - keep) * x.reshape(len(x), -1))
    given[0] += np.reshape(keep * np.broadcast_to(before, x.shape[1:]), -1)
    made: np.ndarray = lapack.dtbtrs(band, given, uplo="L", diag="U", overwrite_b=True)[0]
    return made.reshape(x.shape)
