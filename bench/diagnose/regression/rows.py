"""Rows of a regression in the weak form: a channel at a time, each with the columns that act on it.

A torque about one axis moves one channel of six, and a dictionary of signals has hundreds of such columns: normal
equations over all channels and columns alike would multiply zeros.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bench.diagnose.logs.sample import typical_length
from bench.diagnose.regression.generic import Folds, follow
from bench.diagnose.regression.least_squares import Normal, regularised, whitening
from bench.diagnose.regression.parameters import Prior
from bench.diagnose.settings import FOLDING, SEARCHING

_IN_CACHE = 65_536
"""Numbers that are filtered at a time: they and what comes of them stay in the processor's cache."""


@dataclass(frozen=True, eq=False)
class Rows:
    """The weak form of a model and of what could explain its residual."""

    parts: tuple[tuple[np.ndarray, ...], ...]
    """A log, a channel: (J, n) rows of the columns that act on the channel; the last is the residual."""
    acting: tuple[np.ndarray, ...]
    """A channel: (n,) places of these among all columns, ascending."""
    width: int
    """Number of columns without the residual, which is the column of this number."""
    stride: float
    """From one row to the next, in what stands for a second (`Log.second`)."""
    filters: tuple[np.ndarray, ...] = ()
    """A channel: the whitening filter that its rows are seen through; none: as they are. What comes out of it is made
    anew whenever it is asked for: kept, it would take as much memory as the rows."""

    @property
    def channels(self) -> int:
        """Number of channels."""
        return len(self.acting)

    def counts(self) -> list[int]:
        """Rows of each log, a channel."""
        lost = len(self.filters[0]) - 1 if self.filters else 0
        return [max(0, len(log[0]) - lost) for log in self.parts]

    def seen(self, log: int, channel: int) -> np.ndarray:
        """Rows (J, n) of a log in a channel, through its filter."""
        x = self.parts[log][channel]
        return filtered(x, self.filters[channel]) if self.filters else x

    def some(self, columns: Sequence[int]) -> "Rows":
        """The rows with some of the columns, ascending; the residual stays."""
        place = np.full(self.width + 1, -1)
        place[[*columns, self.width]] = range(len(columns) + 1)
        kept = [np.flatnonzero(place[a] >= 0) for a in self.acting]
        parts = tuple(tuple(x[:, k] for x, k in zip(log, kept, strict=True)) for log in self.parts)
        acting = tuple(place[a[k]] for a, k in zip(self.acting, kept, strict=True))
        return replace(self, parts=parts, acting=acting, width=len(columns))

    def only(self, channels: Sequence[int]) -> "Rows":
        """The rows of some channels."""
        return replace(
            self,
            parts=tuple(tuple(log[c] for c in channels) for log in self.parts),
            acting=tuple(self.acting[c] for c in channels),
            filters=tuple(self.filters[c] for c in channels) if self.filters else (),
        )

    def less(self, other: "Rows") -> "Rows":
        """The difference from rows of as many columns, seen through the same filters."""
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
        return replace(self, parts=parts, acting=acting)

    def residuals(self, beta: np.ndarray) -> list[np.ndarray]:
        """A log: what all columns with these coefficients (c,) leave (J, channels)."""
        vector = np.append(-beta, 1.0)
        return [
            np.stack([self.seen(i, c) @ vector[a] for c, a in enumerate(self.acting)], axis=-1)
            for i in range(len(self.parts))
        ]

    def whitened(self, filters: Sequence[np.ndarray]) -> "Rows":
        """The rows through whitening filters of one length, a channel each; nothing is left of a shorter log."""
        return replace(self, filters=tuple(filters))

    def power(self) -> np.ndarray:
        """Squares (channels, c + 1) of every column."""
        out = np.zeros((self.channels, self.width + 1))
        for i in range(len(self.parts)):
            for c, acting in enumerate(self.acting):
                x = self.seen(i, c)
                out[c, acting] += np.einsum("jn,jn->n", x, x)
        return out

    def mean_gram(self) -> np.ndarray:
        """Products of all columns with each other, the mean of a row (channels, c + 1, c + 1)."""
        out = np.zeros((self.channels, self.width + 1, self.width + 1))
        for i in range(len(self.parts)):
            for c, acting in enumerate(self.acting):
                x = self.seen(i, c)
                out[c][np.ix_(acting, acting)] += x.T @ x
        return out / max(1, sum(self.counts()))

    def folds(self) -> list[np.ndarray]:
        """A fold: normal equations (c + 1, c + 1) of its rows, all channels together."""
        out = [np.zeros((self.width + 1, self.width + 1)) for _ in range(max(self._folds_of(len(self.parts) - 1)) + 1)]
        for c, acting in enumerate(self.acting):
            pending: dict[int, np.ndarray] = {}
            for i in range(len(self.parts)):
                folds = self._folds_of(i)
                for fold, rows in zip(folds, np.array_split(self.seen(i, c), len(folds)), strict=True):
                    pending[fold] = pending.get(fold, 0.0) + rows.T @ rows
            for fold, gram in pending.items():
                out[fold][np.ix_(acting, acting)] += gram
        return out

    def crossed(self, columns: Sequence[int]) -> np.ndarray:
        """A fold: products (folds, k, c + 1) of k columns with all, all channels together, as in `folds`.

        Columns are not filtered for it: to filter both sides is to filter one of them there and back.
        """
        last = max(self._folds_of(len(self.parts) - 1))
        out = np.zeros((last + 1, len(columns), self.width + 1))
        for c, acting in enumerate(self.acting):
            which = np.flatnonzero(np.isin(columns, acting))
            if not len(which):
                continue
            at = np.searchsorted(acting, np.asarray(columns)[which])
            for i, log in enumerate(self.parts):
                x, folds = log[c][:, at], self._folds_of(i)
                seen = filtered(x, self.filters[c]) if self.filters else x
                for fold, rows in zip(folds, np.array_split(np.arange(len(seen)), len(folds)), strict=True):
                    if len(rows):
                        back = refiltered(seen[rows], self.filters[c]) if self.filters else seen[rows]
                        crossed = back.T @ log[c][rows[0] : rows[0] + len(back)]
                        out[fold][np.ix_(which, acting)] += crossed
        return out

    def normal(self) -> Normal:
        """The rows in blocks, with their normal equations."""
        fold, count, kept = [], [], []
        for i, rows in enumerate(self.counts()):
            folds = self._folds_of(i)
            length = max(1, min(round(FOLDING.block / self.stride), rows // (5 * len(folds))))
            whole = [min(length, rows - start) for start in range(0, rows, length)]
            if len(whole) > 1 and whole[-1] < length // 2:
                whole.pop()
            kept.append(sum(whole))
            fold += [folds[min(k * length * len(folds) // rows, len(folds) - 1)] for k in range(len(whole))]
            count += whole
        channels = tuple(
            (acting, np.concatenate([self.seen(i, c)[:n].T for i, n in enumerate(kept)], axis=1))
            for c, acting in enumerate(self.acting)
        )
        return Normal(channels, self.width + 1, np.array(fold, dtype=int), np.array(count, dtype=int))

    def apart(self) -> list[Normal]:
        """`normal` of each log by itself."""
        return [replace(self, parts=(log,)).normal() for log in self.parts]

    def _folds_of(self, log: int) -> range:
        """Folds that stretches of a log belong to, ascending: a few logs make several each, many share them."""
        logs = len(self.parts)
        if logs > FOLDING.most:
            return range(log * FOLDING.most // logs, log * FOLDING.most // logs + 1)
        each = 1 if logs >= FOLDING.folds else -(-FOLDING.folds // logs)
        return range(log * each, (log + 1) * each)


class Crossings:
    """Products of some columns of rows with all of them, fold by fold, made when they are first asked for.

    Of a dictionary's hundreds of columns few are ever chosen: all products would take many times as long.
    """

    def __init__(self, rows: Rows) -> None:
        self._rows = rows
        self._made: dict[int, np.ndarray] = {}

    @cached_property
    def squares(self) -> np.ndarray:
        """(c + 1,) of every column, all folds together."""
        return np.asarray(self._rows.power().sum(0))

    def of(self, columns: Sequence[int]) -> np.ndarray:
        """(folds, k, c + 1) products of k columns with all; −1 is the residual."""
        places = [c % (self._rows.width + 1) for c in columns]
        new = [c for c in dict.fromkeys(places) if c not in self._made]
        found = self._rows.crossed(new)
        self._made |= dict(zip(new, found.swapaxes(0, 1), strict=True))
        return np.stack([self._made[c] for c in places], axis=1) if places else found


class Products:
    """A fold: normal equations (c + 1, c + 1) of rows, made when they are first asked for; the rows are not kept then.

    Of a dictionary's columns they take seconds, and most views are never asked.
    """

    def __init__(self, rows: Rows | None = None, columns: Sequence[int] = (), noise: np.ndarray | None = None) -> None:
        """
        Args:
            rows: whitened; None: there are no products.
            columns: some, the residual's among them.
            noise: (n, n) what is taken off their products, over all folds together.
        """
        self._rows = rows
        self._columns, self._noise = list(columns), noise
        self._made: tuple[np.ndarray, ...] = ()

    def made(self) -> tuple[np.ndarray, ...]:
        """Them."""
        if self._rows is not None:
            grams = self._rows.folds()
            if self._noise is not None:
                for gram in grams:
                    gram[np.ix_(self._columns, self._columns)] -= self._noise / max(1, len(grams))
            self._made, self._rows = tuple(grams), None
        return self._made


def filtered(series: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """The whitened series (J − order, …) of one (J, …); nothing is left of a short one."""
    order = len(coefficients) - 1
    out = np.empty_like(series[: max(0, len(series) - order)], dtype=np.result_type(series, coefficients))
    step = max(1, _IN_CACHE // max(1, math.prod(series.shape[1:])))
    lagged = np.empty_like(out[:step])
    for start in range(0, len(out), step):
        part = out[start : start + step]
        np.multiply(coefficients[order], series[start : start + len(part)], out=part)
        for k in range(1, order + 1):
            terms = lagged[: len(part)]
            part += np.multiply(coefficients[order - k], series[start + k : start + k + len(part)], out=terms)
    return out


def refiltered(series: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """The transpose of `filtered`: of a whitened series (J − order, n) one (J, n)."""
    order = len(coefficients) - 1
    padded = np.zeros((len(series) + 2 * order, series.shape[1]))
    padded[order : order + len(series)] = series
    return filtered(padded, coefficients[::-1])


def noise_filters(
    rows: Rows, prior: Prior, memory: int = SEARCHING.memory, owed: Rows | None = None
) -> list[np.ndarray]:
    """Whitening filters, a channel each, of what is left when the model's numbers and the most telling columns fit.

    The numbers fit beside what is known of them: a free fit would give up one equation, call that noise, and believe it
    no more. Few columns, each worth its place on recordings not fitted: many would explain slow disturbances by chance,
    and what is left would be taken for all the noise there is.

    Args:
        rows: of the weak form; the model's numbers are the first columns.
        prior: of these.
        memory: order of the autoregression; 0: what is left is only scaled, so that where it stays on one side counts.
        owed: what the rows owe to noise in their columns, which bends the fit and is taken off.
    """
    spread = [
        max(float(np.concatenate([log[c][:, -1] for log in rows.parts]).std()), 1e-300) for c in range(rows.channels)
    ]
    filters = [np.array([1 / s]) for s in spread]
    own = list(range(len(prior.low)))
    for _ in range(2):
        products = Crossings(rows.whitened(filters))
        columns = [*own, *_telling(products, prior)]
        more = len(columns) - len(own)
        none, free = np.zeros(more), np.full(more, np.inf)
        beta = np.zeros(rows.width)
        gram = np.asarray(sum(Folds.of(products, columns).products()))
        if owed is not None:
            gram = gram - _products(owed.whitened(filters), columns)
        beta[columns] = regularised(
            gram,
            range(len(columns)),
            np.append(prior.precision, none),
            np.append(prior.centre, none),
            np.append(prior.low, -free),
            np.append(prior.high, free),
        )
        left = rows.residuals(beta)
        if memory:
            order = min(memory, max(1, typical_length(left) // 20))
            filters = [whitening([r[:, c] for r in left], order) for c in range(rows.channels)]
        else:
            filters = [np.array([1 / max(rms, 1e-300)]) for rms in _rms(left)]
    return filters


def _products(rows: Rows, columns: Sequence[int]) -> np.ndarray:
    """Products (k + 1, k + 1) of k columns and the residual, all rows together."""
    ascending = sorted(columns)
    total = np.asarray(sum(rows.some(ascending).folds()))
    order = np.append(np.searchsorted(ascending, columns), -1)
    return total[np.ix_(order, order)]


def _rms(left: Sequence[np.ndarray]) -> np.ndarray:
    """Root mean squares (channels,) of residuals (J, channels) of some logs."""
    return np.sqrt(np.mean(np.concatenate(left) ** 2, axis=0))


def _telling(products: Crossings, prior: Prior) -> list[int]:
    """Columns beyond the model's own numbers that tell most of what these leave; those at a bound stay there."""
    own = range(len(prior.low))
    total = np.asarray(sum(Folds.of(products, own).products()))
    beta = regularised(total, own, prior.precision, prior.centre, prior.low, prior.high)
    shift = np.zeros(len(products.squares))
    shift[list(own)] = -beta
    inside = [c for c in own if prior.low[c] < beta[c] < prior.high[c]]
    return [c for c, _ in follow(Folds.of(products, inside, shift), len(own), SEARCHING.telling)]
