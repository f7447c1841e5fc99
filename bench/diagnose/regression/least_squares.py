"""Bounded least squares by Gram matrices: a fit of a few columns takes microseconds, not a pass over the data."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np


def bounded(gram: np.ndarray, moment: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """β (p,) that minimises ½ βᵀGβ − mᵀβ within low ≤ β ≤ high, by an active set.

    Args:
        gram: (p, p), positive definite.
        moment: (p,).
        low: (p,), may be −inf.
        high: (p,), may be inf.
    """
    free = low < high
    beta = np.where(free, np.clip(0.0, low, high), low)
    for _ in range(3 * len(beta) + 3):
        fixed = ~free
        target = beta.copy()
        if free.any():
            target[free] = np.linalg.solve(
                gram[np.ix_(free, free)], moment[free] - gram[np.ix_(free, fixed)] @ beta[fixed]
            )
        outside = free & ((target < low) | (target > high))
        if outside.any():
            beta = np.where(outside, np.clip(target, low, high), np.where(free, target, beta))
            free &= ~outside
            continue
        beta = target
        slope = gram @ beta - moment
        tolerance = 1e-9 * np.abs(moment).max(initial=1e-300)
        wrong = ~free & (low < high) & (((beta <= low) & (slope < -tolerance)) | ((beta >= high) & (slope > tolerance)))
        if not wrong.any():
            break
        free[int(np.argmax(np.where(wrong, np.abs(slope), -1)))] = True
    return np.clip(beta, low, high)


def whitening(residual: Sequence[np.ndarray], order: int) -> np.ndarray:
    """Coefficients (order + 1,) of the filter that makes a residual white with unit variance.

    An autoregression (Yule–Walker) over all series (J,) together; the first coefficient is one over the standard
    deviation of the innovation.
    """
    cleaned = [r - np.median(r) for r in residual if len(r)]
    lags = [sum(float(r[: len(r) - k] @ r[k:]) for r in cleaned if len(r) > k) for k in range(order + 1)]
    covariance = np.array(lags) / max(1, sum(map(len, cleaned)))
    covariance[0] = covariance[0] * (1 + 1e-9) + 1e-300
    matrix = covariance[np.abs(np.subtract.outer(np.arange(order), np.arange(order)))]
    ar = np.linalg.solve(matrix, covariance[1:]) if order else np.zeros(0)
    innovation = covariance[0] - ar @ covariance[1:]
    return np.concatenate([[1.0], -ar]) / np.sqrt(max(innovation, 1e-300))


def equilibrium(diagonal: np.ndarray) -> np.ndarray:
    """Factors that bring the diagonal of normal equations to 1, and leave the row of an empty column alone."""
    return np.where(diagonal > 0, 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0)), 1.0)


def steadying(power: np.ndarray, prior: np.ndarray) -> float:
    """What is added to the diagonal of normal equations in equilibrium, where columns are sums of others.

    No more than a hundredth of what was known before of the number that is known best against what rows tell of it:
    else, of recordings without noise, it would hold what only that tells, such as a mass beside a drag.

    Args:
        power: (p,) diagonal of the normal equations, with the prior.
        prior: (p,) precision of each; 0: none.
    """
    known = prior > 0
    return float(np.clip(0.01 * (prior[known] / power[known]).max(initial=0.0), 1e-14, 1e-9)) if known.any() else 1e-9


def steadied(posterior: np.ndarray, prior: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Normal equations (p, p) with their ``prior`` in equilibrium and steadied, and the factors (p,) that made it."""
    power = np.diag(posterior)
    scale = equilibrium(power)
    return posterior * np.outer(scale, scale) + steadying(power, prior) * np.eye(len(scale)), scale


def ridge(gram: np.ndarray, strength: float = 1e-6) -> np.ndarray:
    """Free coefficients (c,) of all columns for the last one of (c + 1, c + 1), lightly shrunk."""
    scale = equilibrium(np.diag(gram)[:-1])
    inner = gram[:-1, :-1] * np.outer(scale, scale) + strength * np.eye(len(scale))
    out: np.ndarray = np.linalg.solve(inner, gram[:-1, -1] * scale) * scale
    return out


def squares_left(gram: np.ndarray, beta: np.ndarray) -> float:
    """Squares that coefficients (c,) leave of the last column of (c + 1, c + 1); at least what rounding leaves of it.

    An equation that holds exactly, such as that of an angle whose rate was read from its slope, leaves less than that,
    of either sign.
    """
    vector, epsilon = np.append(-beta, 1.0), np.finfo(float)
    rounding = len(gram) * epsilon.eps * float(gram[-1, -1])
    return max(float(vector @ gram @ vector), rounding, float(epsilon.tiny))


def regularised(
    gram: np.ndarray, columns: Sequence[int], prior: np.ndarray, centre: np.ndarray, low: np.ndarray, high: np.ndarray
) -> np.ndarray:
    """β (p,) of p columns for the last one of ``gram`` (c, c), within bounds and with a normal prior.

    Args:
        gram: normal equations.
        columns: which.
        prior: (p,) precision 1/σ² of each about its centre; 0: none.
        centre: (p,) of the priors.
        low: (p,) bounds.
        high: (p,).
    """
    index = list(columns)
    posterior = gram[np.ix_(index, index)] + np.diag(prior)
    scaled, scale = steadied(posterior, prior)
    return bounded(scaled, (gram[index, -1] + prior * centre) * scale, low / scale, high / scale) * scale


def shifted(rows: np.ndarray, shift: np.ndarray, moved: np.ndarray) -> np.ndarray:
    """The last column (c,) of normal equations whose residual has ``shift`` (c,) times the columns added.

    Args:
        rows: (k + 1, c) of them, those of the k columns that the shift has and the last one.
        shift: no more than these columns.
        moved: (k,) their places.
    """
    more: np.ndarray = shift[moved] @ rows[:-1]
    out = rows[-1] + more
    out[-1] += more[-1] + shift @ more
    return out


@dataclass(frozen=True, eq=False)
class Normal:
    """Whitened rows and their normal equations, block by block (a block is some seconds of one recording).

    Only the sums over folds are kept as matrices: of hundreds of columns those of every block would take gigabytes.
    """

    channels: tuple[tuple[np.ndarray, np.ndarray], ...]
    """A channel: the places (n,) of the columns that act on it, ascending, and their rows (n, J)."""
    width: int
    """Columns of all; the last is the residual to be explained."""
    fold: np.ndarray
    """(blocks,) the part that is held out with a block: its recording, or a stretch of it, or several; ascending."""
    count: np.ndarray
    """(blocks,) rows a channel; those of a block follow those of the one before."""
    noise: np.ndarray | None = None
    """(channels, c, c) what a row owes to noise, which is taken off."""
    drawn: tuple[np.ndarray, ...] = ()
    """A fold: (c, c) what its rows owe to noise that was drawn for them, all channels together."""

    def less(self, noise: np.ndarray, drawn: Sequence[np.ndarray] = ()) -> "Normal":
        """The same with what a row owes to noise (channels, c, c) taken off; ``drawn``: fold by fold, its draws."""
        return replace(self, noise=noise if self.noise is None else self.noise + noise, drawn=tuple(drawn))

    @property
    def rows(self) -> int:
        """Rows of all blocks and channels."""
        return int(self.count.sum()) * len(self.channels)

    @cached_property
    def by_fold(self) -> dict[int, np.ndarray]:
        """By fold, (c, c) of all its rows."""
        ends, out = np.cumsum(self.count), {}
        for fold in np.unique(self.fold):
            these = np.flatnonzero(self.fold == fold)
            part = slice(ends[these[0]] - self.count[these[0]], ends[these[-1]])
            gram = np.zeros((self.width, self.width))
            for acting, rows in self.channels:
                gram[np.ix_(acting, acting)] += rows[:, part] @ rows[:, part].T
            if self.noise is not None:
                gram -= self.count[these].sum() * self.noise.sum(0)
            out[int(fold)] = gram
        return out

    @cached_property
    def total(self) -> np.ndarray:
        """(c, c) of all rows."""
        return np.asarray(sum(self.by_fold.values()))

    def fit(
        self,
        columns: Sequence[int],
        prior: np.ndarray,
        centre: np.ndarray,
        low: np.ndarray,
        high: np.ndarray,
        without: int | None = None,
    ) -> tuple[np.ndarray, float]:
        """β (p,) of p of the columns, and the sum of squared residuals of all rows that were fitted.

        Args:
            columns: which.
            prior: (p,) precision 1/σ² of each about its centre; 0: none.
            centre: (p,) of the priors.
            low: (p,) bounds.
            high: (p,).
            without: a fold that is not fitted.
        """
        gram = self.total if without is None else self.total - self.by_fold[without]
        beta = regularised(gram, columns, prior, centre, low, high)
        index = list(columns)
        inner, moment = gram[np.ix_(index, index)], gram[index, -1]
        return beta, float(gram[-1, -1] - 2 * moment @ beta + beta @ inner @ beta)

    def scatter(self, columns: Sequence[int], beta: np.ndarray) -> float:
        """1σ of what a sum of squared residuals differs by, by chance, from what it is without the noise taken off.

        That of the noise in the recordings, as of so many independent rows, and that of the draws that were taken for
        it: each fold has noise of its own, so that what is taken off is the mean of several draws, with its error.
        """
        vector = self._vector(columns, beta)
        owed = np.array([vector @ gram @ vector for gram in self.drawn]).reshape(-1, 1)
        left = max(float(self.rows), vector @ self.total @ vector + owed.sum())
        return float((2 * left**2 / self.rows + self._by_chance(owed).sum()) ** 0.5)

    def drawn_meat(self, columns: Sequence[int], beta: np.ndarray) -> np.ndarray:
        """Covariance (p, p) of the sum of `scores` for the noise that is taken off, which is the mean of few draws."""
        vector = self._vector(columns, beta)
        owed = [gram[list(columns)] @ vector for gram in self.drawn]
        return self._by_chance(np.array(owed).reshape(len(owed), len(columns)))

    def _by_chance(self, owed: np.ndarray) -> np.ndarray:
        """Covariance (n, n) of the sum of what each fold (folds, n) owes to its draw."""
        if len(owed) < 2:
            return np.zeros((owed.shape[1], owed.shape[1]))
        share = np.bincount(self.fold, self.count, len(owed)) / self.count.sum()
        off = owed - share[:, None] * owed.sum(0)
        return np.asarray(len(owed) / (len(owed) - 1) * (off.T @ off))

    def losses(self, columns: Sequence[int], beta: np.ndarray) -> np.ndarray:
        """Sum of squared whitened residuals (blocks, channels) with these coefficients."""
        vector, index = self._vector(columns, beta), [*columns, self.width - 1]
        out = np.empty((len(self.count), len(self.channels)))
        for k, channel in enumerate(self.channels):
            out[:, k] = self._by_block(_left(channel, vector) ** 2)
            if self.noise is not None:
                out[:, k] -= self.count * (vector[index] @ self.noise[k][np.ix_(index, index)] @ vector[index])
        return out

    def scores(self, columns: Sequence[int], beta: np.ndarray) -> np.ndarray:
        """Products (blocks, p) of p columns with what they leave with these coefficients."""
        vector, index = self._vector(columns, beta), [*columns, self.width - 1]
        out = np.zeros((len(self.count), len(columns)))
        for k, (acting, rows) in enumerate(self.channels):
            own = np.flatnonzero(np.isin(columns, acting))
            at = np.searchsorted(acting, np.asarray(columns)[own])
            out[:, own] += self._by_block(rows[at] * _left((acting, rows), vector)).T
            if self.noise is not None:
                out -= self.count[:, None] * (self.noise[k][np.ix_(columns, index)] @ vector[index])
        return out

    def products(self, few: Sequence[int], columns: Sequence[int], beta: np.ndarray) -> np.ndarray:
        """Normal equations (blocks, k + 1, k + 1) of ``few`` columns for what ``columns`` leave with ``beta``.

        Of rows from which no noise is taken off.
        """
        vector = self._vector(columns, beta)
        out = np.zeros((len(self.count), len(few) + 1, len(few) + 1))
        for acting, rows in self.channels:
            own = np.flatnonzero(np.isin(few, acting))
            x = np.stack([*rows[np.searchsorted(acting, np.asarray(few)[own])], _left((acting, rows), vector)])
            at = [*own, len(few)]
            for i, row in zip(at, x, strict=True):
                out[:, i, at] += self._by_block(x * row).T
        return out

    def _vector(self, columns: Sequence[int], beta: np.ndarray) -> np.ndarray:
        """What all columns (c,) are multiplied by to leave the residual."""
        vector = np.zeros(self.width)
        vector[list(columns)] = -beta
        vector[-1] = 1.0
        return vector

    def _by_block(self, values: np.ndarray) -> np.ndarray:
        """Sums (…, blocks) of values (…, J)."""
        return np.add.reduceat(values, np.cumsum(self.count) - self.count, axis=-1)


def _left(channel: tuple[np.ndarray, np.ndarray], vector: np.ndarray) -> np.ndarray:
    """What remains of the rows (J,) of a channel."""
    acting, rows = channel
    used = np.flatnonzero(vector[acting])
    out: np.ndarray = vector[acting[used]] @ rows[used]
    return out


def ridge_losses(grams: Sequence[np.ndarray], shrinkage: float, axes: int) -> np.ndarray:
    """Squares (axes,) of the last columns that the others leave, each fold's by a fit to the others."""
    whole, losses = np.asarray(sum(grams)), np.zeros(axes)
    for gram in grams:
        rest = whole - gram
        inner = rest[:-axes, :-axes]
        strength = max(shrinkage * np.trace(inner) / len(inner), 1e-300)
        beta = np.linalg.solve(inner + strength * np.eye(len(inner)), rest[:-axes, -axes:])
        vectors = np.concatenate([-beta, np.eye(axes)])
        losses += ((gram @ vectors) * vectors).sum(0)
    return losses
