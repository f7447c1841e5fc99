"""What functions of the measured signals would predict of the error of an equation, whatever causes it."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from bench.diagnose.regression.generic import Dictionary, Folds, follow
from bench.diagnose.regression.least_squares import ridge, ridge_losses
from bench.diagnose.settings import FOLDING, MATTERING
from bench.diagnose.simulate.teacher_forced import Increments
from registry.errors import BenchError


@dataclass(frozen=True, eq=False)
class Signals:
    """Functions of measured signals, and the axes along which equations are judged."""

    words: Dictionary
    channels: tuple[int, ...]
    """That the axes of ``words`` are of."""
    dt: float
    _integrals: dict[int, dict[int, tuple[np.ndarray, np.ndarray]]] = field(default_factory=dict)
    """See `_over`; the same along all axes."""

    def of(self, channels: Sequence[int]) -> "Signals":
        """The axes that act on these channels."""
        place = [self.channels.index(c) for c in channels]
        axes = self.words.axes[..., place]
        acting = [i for i, axis in enumerate(axes) if np.abs(axis).max() > 0]
        names = tuple(self.words.names[i] for i in acting)
        words = replace(self.words, axes=axes[acting], names=names)
        return replace(self, words=words, channels=tuple(channels))

    @property
    def axes(self) -> tuple[str, ...]:
        """Their names."""
        return self.words.names

    def along(self, left: Increments, axes: Sequence[str]) -> Increments:
        """What is left along these axes, in their order."""
        steps = left.steps[..., list(self.channels)]
        some = [np.einsum("lnc,lnc->ln", self.words.axes[self.axes.index(a)], steps) for a in axes]
        return Increments(np.stack(some, axis=-1), left.valid)

    def folds(self, left: Increments, horizon: int) -> list[np.ndarray]:
        """A fold: products (functions + axes, functions + axes) of integrals and errors over its windows, summed.

        Raises:
            BenchError: no window fits.
        """
        y, recording, first = self.along(left, self.axes).over(horizon, max(1, horizon // 2))
        if not len(y):
            raise BenchError(
                f"No recording has {horizon * self.dt:.2g} s of valid samples in a row, over which equations are "
                "judged: record longer."
            )
        logs, width = self.words.values.shape[1], len(self.words.values) + y.shape[1]
        out = [np.zeros((width, width)) for _ in range(min(logs, FOLDING.most))]
        for log, (integrals, products) in self._over(horizon, recording, first).items():
            errors = y[recording == log]
            both = integrals @ errors
            out[log * len(out) // logs] += np.block([[products, both], [both.T, errors.T @ errors]])
        return [gram for gram in out if gram.any()]

    def _over(self, horizon: int, recording: np.ndarray, first: np.ndarray) -> dict[int, tuple[np.ndarray, np.ndarray]]:
        """By recording: integrals (functions, w) of the functions over its windows, and their products.

        Windows of a horizon are where samples are valid, whatever a model leaves there, so they are made once.
        """
        if horizon not in self._integrals:
            made = self._integrals[horizon] = {}
            for log in np.unique(recording):
                own, values = first[recording == log], self.words.values[:, log]
                total = np.concatenate([np.zeros_like(values[:, :1]), np.cumsum(values, axis=-1)], axis=-1)
                integrals = (total[:, own + horizon] - total[:, own]) * self.dt
                made[int(log)] = integrals, integrals @ integrals.T
        return self._integrals[horizon]


def left_of(folds: Sequence[np.ndarray], held_out: np.ndarray, axes: int) -> tuple[np.ndarray, np.ndarray]:
    """Held-out squares (axes,) of errors that a regression on functions leaves, no more than all, and all.

    For each axis the better one, with one fold left out after another, of ridge regression and of a few columns taken
    one by one.

    Args:
        folds: products (functions + axes, functions + axes) of integrals and errors; see `Signals.folds`.
        held_out: of recordings held out.
        axes: how many.
    """
    power = np.asarray(sum(folds)).diagonal()[:-axes]
    used = np.flatnonzero(power > 0)
    size, sizes = (np.append(1 / np.sqrt(power[used]), np.ones(n)) for n in (1, axes))
    left = []
    every = [*used, *range(len(held_out) - axes, len(held_out))]
    all_axes = [gram[np.ix_(every, every)] * np.outer(sizes, sizes) for gram in folds]
    by_ridge = {s: ridge_losses(all_axes, s, axes) for s in MATTERING.shrinkage}
    for place, axis in enumerate(range(len(held_out) - axes, len(held_out))):
        some = np.ix_([*used, axis], [*used, axis])
        grams = [gram[some] * np.outer(size, size) for gram in folds]
        whole = np.asarray(sum(grams))
        losses = {0.0: float(whole[-1, -1])} | {s: float(loss[place]) for s, loss in by_ridge.items()}
        penalty = min(losses, key=lambda s: losses[s])
        beta = np.zeros(len(used))
        if penalty:
            inner = whole[:-1, :-1]
            beta = np.linalg.solve(inner + penalty * np.trace(inner) / len(inner) * np.eye(len(inner)), whole[:-1, -1])
        chosen = follow(Folds.of(grams, []), 0, MATTERING.terms)
        if chosen and losses[0.0] - sum(gain for _, gain in chosen) < losses[penalty]:
            index = [column for column, _ in chosen]
            beta = np.zeros(len(used))
            beta[index] = ridge(whole[np.ix_([*index, -1], [*index, -1])], 1e-9)
        vector = np.append(-beta, 1.0) * size
        rest = max(float(vector @ held_out[some] @ vector), 0.0)
        left.append(min(rest, float(held_out[axis, axis])))
    return np.array(left), held_out.diagonal()[-axes:]
