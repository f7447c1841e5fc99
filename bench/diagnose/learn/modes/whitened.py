"""What hidden modes of given poles leave, many poles after another: what does not depend on the poles is made once."""

from collections.abc import Sequence

import numpy as np

from bench.diagnose.learn.axis_series import Stretch
from bench.diagnose.learn.modes.filters import Pole
from bench.diagnose.regression.least_squares import ridge, squares_left
from bench.diagnose.regression.rows import filtered

RIDGE = 1e-9
"""By which least squares along an axis are shrunk, relative to each column."""


class Whitened:
    """Stretches through a whitening filter, side by side and filled up with zeros, with their products."""

    def __init__(
        self,
        stretches: Sequence[Stretch],
        step: float,
        columns: Sequence[int],
        drivers: Sequence[int],
        whiten: np.ndarray,
    ) -> None:
        """Prepare.

        Args:
            stretches: each longer than the filter.
            step: from one row to the next [s].
            columns: what is fitted beside a mode.
            drivers: places of the signals that could drive it, among those measured.
            whiten: the filter.
        """
        self.step, self.whiten, self.many, self.width = step, whiten, len(drivers), len(columns)
        longest, lost = max(len(s.t) for s in stretches), len(whiten) - 1
        self.driven = np.zeros((longest, len(stretches), len(drivers)))
        self.rest = np.zeros((len(stretches), longest - lost, len(columns) + len(drivers) + 1))
        self.there = np.zeros((len(stretches), longest - lost, 1))
        for i, s in enumerate(stretches):
            count, driven = len(s.t), s.measured[:, drivers]
            self.driven[:count, i] = driven - driven[0]
            self.rest[i, : count - lost] = filtered(np.column_stack([s.beside[:, columns], driven, s.left]), whiten)
            self.there[i, : count - lost] = 1.0
        self.gram = np.einsum("sab->ab", self.rest.transpose(0, 2, 1) @ self.rest)
        self.rows = int(self.there.sum())

    def scan(self, pole: Pole) -> tuple[np.ndarray, np.ndarray]:
        """Squares (drivers,) left if each drives a mode of these poles, and the log-likelihood that driving saves.

        However a stretch begins, the mode swings out: what it does undriven is taken off everything first.
        """
        free, moved = self._free(pole), self._moved(pole)
        by_rest, by_moved = (free.transpose(0, 2, 1) @ x for x in (self.rest, moved))
        static = self.gram - np.einsum("sja,sjb->ab", by_rest, by_rest)
        cross = np.einsum("sab->ab", moved.transpose(0, 2, 1) @ self.rest) - np.einsum("sja,sjb->ab", by_moved, by_rest)
        both = moved, by_moved
        each = (x.reshape(len(x), x.shape[1], pole.order, self.many) for x in both)
        driven, swung = (np.einsum("sjad,sjbd->dab", x, x, optimize=True) for x in each)
        losses, gains = np.zeros(self.many), np.zeros(self.many)
        for d in range(self.many):
            fixed = [*range(self.width), self.width + d, -1]
            gram, between = static[np.ix_(fixed, fixed)], cross[d :: self.many][:, fixed]
            inner = np.block([[gram[:-1, :-1], between[:, :-1].T], [between[:, :-1], driven[d] - swung[d]]])
            last = np.concatenate([gram[-1, :-1], between[:, -1]])
            whole = np.block([[inner, last[:, None]], [last, gram[-1, -1]]])
            losses[d] = left_of(whole)[0]
            gains[d] = self.rows / 2 * np.log(left_of(gram)[0] / losses[d])
        return losses, gains

    def _free(self, pole: Pole) -> np.ndarray:
        """What a mode does undriven (S, J, order), for every beginning; each stretch's columns orthonormal."""
        times = self.step * np.arange(len(self.driven))
        found = filtered(pole.turned(times)[:, 0], self.whiten) * self.there
        for i in range(pole.order):
            for _ in range(2):  # the second time what rounding left of the first
                before = found[..., :i]
                found[..., i:] -= before @ (before.transpose(0, 2, 1) @ found[..., i:])
            found[..., i] /= np.maximum(np.linalg.norm(found[..., i], axis=1, keepdims=True), 1e-300)
        return found

    def _moved(self, pole: Pole) -> np.ndarray:
        """What a unit of each gain does for each driver (S, J, order · drivers), through the filter."""
        flat = self.driven.reshape(len(self.driven), -1)
        moved = [filtered(x, self.whiten).reshape(-1, *self.driven.shape[1:]) for x in pole.response(flat, self.step)]
        return np.concatenate(moved, axis=2).transpose(1, 0, 2) * self.there


def left_of(gram: np.ndarray) -> tuple[float, np.ndarray]:
    """Squares that the columns of normal equations leave of the last one, and their coefficients."""
    values = ridge(gram, RIDGE)
    return squares_left(gram, values), values
