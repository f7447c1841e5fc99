"""Estimates of one quantity from many units, each with its own error: their mean, their spread, what they follow.

y_i = x_i β + u_i + e_i with u_i ~ N(0, τ²) between units and e_i ~ N(0, s_i²) of a known size within. τ² is the one at
which the weighted residuals are as large as they are expected to be (Paule and Mandel 1982, DerSimonian and Kacker
2007), 0 where they are smaller; tests use Student's t with k − p degrees of freedom (Knapp and Hartung 2003, with their
factor never below 1).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy  # its parts are imported when they are used: scipy.stats takes longer than most of what is here

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class Fit:
    """A weighted regression of k estimates on p columns."""

    beta: Array
    """(p,) coefficients."""
    covariance: Array
    """(p, p) of them."""
    between: float
    """τ: standard deviation between units, in the unit of the estimates."""
    freedom: int
    """k − p."""
    q: float
    """Σ of squared residuals in units of s_i, of the fit without τ: χ² with k − p degrees of freedom where τ = 0."""

    @property
    def heterogeneity(self) -> float:
        """Chance of so large a `q` were there nothing between units; NaN without degrees of freedom."""
        return float(scipy.stats.chi2.sf(self.q, self.freedom)) if self.freedom > 0 else math.nan

    def interval(self, i: int = 0, confidence: float = 0.95) -> tuple[float, float]:
        """Limits of a coefficient; NaN without degrees of freedom."""
        if self.freedom < 1:
            return math.nan, math.nan
        half = float(scipy.stats.t.ppf((1 + confidence) / 2, self.freedom) * math.sqrt(self.covariance[i, i]))
        return float(self.beta[i]) - half, float(self.beta[i]) + half

    def p_value(self, i: int) -> float:
        """Two-sided, of a coefficient that is 0; NaN without degrees of freedom."""
        if self.freedom < 1:
            return math.nan
        return float(2 * scipy.stats.t.sf(abs(self.beta[i]) / math.sqrt(self.covariance[i, i]), self.freedom))


def fit(y: Array, s: Array, x: Array | None = None) -> Fit:
    """Fit a random-effects regression.

    Args:
        y: (k,) estimates.
        s: (k,) their standard errors, above 0.
        x: (k, p) what they are regressed on, of full rank; default: a constant, so that β is the mean.
    """
    x = np.ones((len(y), 1)) if x is None else x
    scale = float(np.median(s))  # in this unit, so that squares of small numbers stay numbers
    y, s, freedom = y / scale, s / scale, len(y) - x.shape[1]

    def solved(tau2: float) -> tuple[Array, Array, float]:
        w = 1 / (s**2 + tau2)
        covariance = np.linalg.inv((x.T * w) @ x)
        beta = covariance @ (x.T @ (w * y))
        return beta, covariance, float(w @ (y - x @ beta) ** 2)

    q, tau2 = solved(0.0)[2], 0.0
    if q > freedom > 0:
        most = 1.0
        while solved(most)[2] > freedom:
            most *= 4
        tau2 = float(scipy.optimize.brentq(lambda t: solved(t)[2] - freedom, 0.0, most, xtol=1e-9, rtol=1e-9))
    beta, covariance, _ = solved(tau2)
    return Fit(beta * scale, covariance * scale**2, math.sqrt(tau2) * scale, freedom, q)


@dataclass(frozen=True)
class Difference:
    """One unit against all others."""

    others: Fit
    """Their mean."""
    t: float
    p: float
    """Two-sided; NaN where the others are too few."""


def differences(y: Array, s: Array) -> list[Difference]:
    """Whether each of k units is drawn as the others are: residuals of a fit without the unit itself.

    The studentized deleted residuals of Viechtbauer and Cheung (2010): a unit does not widen the spread that it is
    held against. (y_i − μ) / √(s_i² + τ² + var μ) with mean and τ of the others is t with k − 2 degrees of freedom.
    """
    found = []
    for i in range(len(y)):
        rest = np.arange(len(y)) != i
        others = fit(y[rest], s[rest])
        t = (y[i] - others.beta[0]) / math.sqrt(s[i] ** 2 + others.between**2 + others.covariance[0, 0])
        found.append(Difference(others, float(t), _tail(t, len(y) - 2)))
    return found


def _tail(t: float, freedom: int) -> float:
    return float(2 * scipy.stats.t.sf(abs(t), freedom)) if freedom > 0 else math.nan


def adjusted(p: Sequence[float]) -> list[float]:
    """p-values of one family as Benjamini and Hochberg (1995) adjust them; NaN stays, and is no test.

    Of those at or below 0.05 at most 5 % are expected to be wrong.
    """
    known = [i for i, value in enumerate(p) if math.isfinite(value)]
    out = [math.nan] * len(p)
    if known:
        for i, value in zip(known, scipy.stats.false_discovery_control([p[i] for i in known]), strict=True):
            out[i] = float(value)
    return out
