"""Penalised least squares on normal equations, judged recording by recording by a fit to the others."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench.diagnose.regression.least_squares import bounded, equilibrium
from bench.diagnose.select.search import View
from bench.diagnose.settings import LINEARISING


@dataclass(frozen=True, eq=False)
class Block:
    """Columns that belong together, and how rough they may be."""

    places: np.ndarray
    """(k,) columns."""
    roughness: np.ndarray | None = None
    """(k, k) penalty of unit size; None: none."""
    penalty: float = 0.0


class HeldOut:
    """Fits of some columns beside a model's own numbers."""

    def __init__(self, view: View, own: Sequence[int], within: bool = False) -> None:
        """Prepare.

        Args:
            view: of the model.
            own: columns that are always fitted, held as what is known of the constants says.
            within: whether constants that are known well stay within their bounds, as in every fit of all numbers: one
                that went further would take the straight part of what a formula has to say. Before all terms are there
                they may.
        """
        self.own, subsets = list(own), view.subsets
        width = view.grams[0].shape[0]
        held = np.zeros((width, width))
        pull = subsets.anchor[self.own] * subsets.centre[self.own]
        held[self.own, self.own] = subsets.anchor[self.own]
        held[self.own, -1] = held[-1, self.own] = pull
        self.folds = list(view.grams)
        self.held = held
        self.total = np.asarray(sum(self.folds))
        self.rows = view.floor
        entries = (view.linear.own[i] for i in self.own)
        well = [e.constant and e.scale < LINEARISING.wide * abs(e.stated) for e in entries]
        self.known, self.centre = np.where(well, subsets.prior[self.own], 0.0), subsets.centre[self.own]
        kept = np.array(well, dtype=bool) & within
        self.low, self.high = (
            np.where(kept, of[self.own], far) for of, far in ((subsets.low, -np.inf), (subsets.high, np.inf))
        )

    def losses(self, blocks: Sequence[Block]) -> np.ndarray:
        """Squared residuals (folds,) of each fold by a fit to the others."""
        index = [*self.own, *(int(c) for b in blocks for c in b.places)]
        some = np.ix_([*index, -1], [*index, -1])
        total, penalty = self.total[some], self._penalty(index, blocks, some)
        out = []
        for fold in self.folds:
            here = fold[some]
            vector = np.append(-self._solved(total - here + penalty), 1.0)
            out.append(float(vector @ here @ vector))
        return np.array(out)

    def prior(self, blocks: Sequence[Block]) -> float:
        """Squared distance, in standard deviations, of constants that are known well from what is known of them."""
        index = [*self.own, *(int(c) for b in blocks for c in b.places)]
        some = np.ix_([*index, -1], [*index, -1])
        beta = self._solved(self.total[some] + self._penalty(index, blocks, some))[: len(self.own)]
        return float((self.known * (beta - self.centre) ** 2).sum())

    def fit(self, blocks: Sequence[Block]) -> list[np.ndarray]:
        """Coefficients of each block, fitted to all recordings."""
        index = [*self.own, *(int(c) for b in blocks for c in b.places)]
        some = np.ix_([*index, -1], [*index, -1])
        beta = self._solved(self.total[some] + self._penalty(index, blocks, some))
        ends = len(self.own) + np.cumsum([len(b.places) for b in blocks])
        return [beta[end - len(b.places) : end] for b, end in zip(blocks, ends, strict=True)]

    def best(self, blocks: Sequence[Block], beside: Sequence[Block]) -> tuple[int, np.ndarray]:
        """Which of some blocks held-out recordings prefer beside others, and their losses (folds,) with it."""
        losses = [self.losses([*beside, b]) for b in blocks]
        at = int(np.argmin([loss.sum() for loss in losses]))
        return at, losses[at]

    def _penalty(self, index: list[int], blocks: Sequence[Block], some: tuple[np.ndarray, ...]) -> np.ndarray:
        out = self.held[some].copy()
        at = len(self.own)
        for b in blocks:
            part = slice(at, at + len(b.places))
            if b.roughness is not None:
                size = float(np.diag(self.total)[b.places].mean())
                out[part, part] += b.penalty * size * b.roughness
            at += len(b.places)
        return out

    def _solved(self, gram: np.ndarray) -> np.ndarray:
        """Coefficients of all columns but the last, for that one; the model's own numbers within their bounds."""
        inner = gram[:-1, :-1]
        scale, free = equilibrium(np.diag(inner)), np.full(len(inner) - len(self.own), np.inf)
        scaled = inner * np.outer(scale, scale) + 1e-9 * np.eye(len(scale))
        low, high = np.append(self.low, -free) / scale, np.append(self.high, free) / scale
        return bounded(scaled, gram[:-1, -1] * scale, low, high) * scale
