"""Rows of a regression in the weak form: a channel at a time, each with the columns that act on it.

A torque about one axis moves one channel of six, and a dictionary of signals has hundreds of such columns: normal
equations over all channels and columns alike would multiply zeros.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench.diagnose.regression.least_squares import Normal
from bench.diagnose.settings import FOLDING


@dataclass(frozen=True, eq=False)
class Rows:
    """The weak form of a model and of what could explain its residual."""

    parts: tuple[tuple[np.ndarray, ...], ...]
    """A log, a channel: (J, n) rows of the columns that act on the channel; the last is the residual."""
    acting: tuple[np.ndarray, ...]
    """A channel: (n,) places of these among all columns, ascending."""
    width: int
    """Number of columns without the residual, which is the column of this number."""
    hop: float
    """From one row to the next [s]."""

    @property
    def channels(self) -> int:
        """Number of channels."""
        return len(self.acting)

    def counts(self) -> list[int]:
        """Rows of each log, a channel."""
        return [len(log[0]) for log in self.parts]

    def some(self, columns: Sequence[int]) -> "Rows":
        """The rows with some of the columns, ascending; the residual stays."""
        place = np.full(self.width + 1, -1)
        place[[*columns, self.width]] = range(len(columns) + 1)
        kept = [np.flatnonzero(place[a] >= 0) for a in self.acting]
        parts = tuple(tuple(x[:, k] for x, k in zip(log, kept, strict=True)) for log in self.parts)
        acting = tuple(place[a[k]] for a, k in zip(self.acting, kept, strict=True))
        return Rows(parts, acting, len(columns), self.hop)

    def less(self, other: "Rows") -> "Rows":
        """The difference from rows of as many columns."""
        acting = tuple(np.union1d(a, b) for a, b in zip(self.acting, other.acting, strict=True))

        def spread(x: np.ndarray, of: np.ndarray, into: np.ndarray) -> np.ndarray:
            out = np.zeros((len(x), len(into)))
            out[:, np.searchsorted(into, of)] = x
            return out

        parts = tuple(
            tuple(
                spread(x, a, into) - spread(y, b, into)
                for x, y, a, b, into in zip(own, its, self.acting, other.acting, acting, strict=True)
            )
            for own, its in zip(self.parts, other.parts, strict=True)
        )
        return Rows(parts, acting, self.width, self.hop)

    def residuals(self, beta: np.ndarray) -> list[np.ndarray]:
        """A log: what all columns with these coefficients (c,) leave (J, channels)."""
        vector = np.append(-beta, 1.0)
        return [np.stack([x @ vector[a] for x, a in zip(log, self.acting, strict=True)], axis=-1) for log in self.parts]

    def whitened(self, filters: Sequence[np.ndarray]) -> "Rows":
        """The rows through a whitening filter a channel; nothing is left of a log shorter than its filter."""
        parts = tuple(tuple(filtered(x, f) for x, f in zip(log, filters, strict=True)) for log in self.parts)
        return Rows(parts, self.acting, self.width, self.hop)

    def power(self) -> np.ndarray:
        """Squares (channels, c + 1) of every column."""
        out = np.zeros((self.channels, self.width + 1))
        for log in self.parts:
            for total, x, acting in zip(out, log, self.acting, strict=True):
                total[acting] += np.einsum("jn,jn->n", x, x)
        return out

    def mean_gram(self) -> np.ndarray:
        """Products of all columns with each other, the mean of a row (channels, c + 1, c + 1)."""
        out = np.zeros((self.channels, self.width + 1, self.width + 1))
        for log in self.parts:
            for total, x, acting in zip(out, log, self.acting, strict=True):
                total[np.ix_(acting, acting)] += x.T @ x
        return out / max(1, sum(self.counts()))

    def folds(self) -> list[np.ndarray]:
        """A fold: normal equations (c + 1, c + 1) of its rows, all channels together."""
        out = []
        for log in self.parts:
            pieces = [np.zeros((self.width + 1, self.width + 1)) for _ in range(self._stretches)]
            for x, acting in zip(log, self.acting, strict=True):
                for total, rows in zip(pieces, np.array_split(x, len(pieces)), strict=True):
                    total[np.ix_(acting, acting)] += rows.T @ rows
            out += pieces
        return out

    def normal(self) -> Normal:
        """The rows in blocks, with their normal equations."""
        fold, count, kept = [], [], []
        for i, rows in enumerate(self.counts()):
            length = max(1, min(round(FOLDING.block / self.hop), rows // (5 * self._stretches)))
            whole = [min(length, rows - start) for start in range(0, rows, length)]
            if len(whole) > 1 and whole[-1] < length // 2:
                whole.pop()
            kept.append(sum(whole))
            fold += [
                i * self._stretches + min(k * length * self._stretches // rows, self._stretches - 1)
                for k in range(len(whole))
            ]
            count += whole
        channels = tuple(
            (acting, np.concatenate([log[c][:n] for log, n in zip(self.parts, kept, strict=True)]).T.copy())
            for c, acting in enumerate(self.acting)
        )
        return Normal(channels, self.width + 1, np.array(fold), np.array(count))

    @property
    def _stretches(self) -> int:
        """Folds that each log makes."""
        return 1 if len(self.parts) >= FOLDING.folds else -(-FOLDING.folds // len(self.parts))


def filtered(series: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """The whitened series (J − order, n) of one (J, n); nothing is left of a short one."""
    order = len(coefficients) - 1
    if len(series) <= order:
        return series[:0]
    count = len(series) - order
    out: np.ndarray = coefficients[order] * series[:count]
    lagged = np.empty_like(out)
    for k in range(1, order + 1):
        np.multiply(coefficients[order - k], series[k : k + count], out=lagged)
        out += lagged
    return out
