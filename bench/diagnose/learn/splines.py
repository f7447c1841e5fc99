"""Which axes and signals what is left goes with: penalised splines, added one by one while held-out recordings gain."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from bench.diagnose.learn.candidates import PRODUCT, Columns, Pair
from bench.diagnose.learn.formulas import Option, blocks_of, option_columns, waves_of
from bench.diagnose.learn.held_out import Block, HeldOut
from bench.diagnose.settings import CHOOSING, SPLINING
from registry.terms.spline import basis, roughness


@dataclass(frozen=True, eq=False)
class Spline:
    """A term as one of the functions that were tried."""

    pair: Pair
    made: "Made"
    which: int
    """Of `Made.blocks`."""

    def block(self, places: np.ndarray) -> Block:
        """It, where the columns of all functions are in some places."""
        return self.made.blocks(places)[self.which]


@dataclass(frozen=True, eq=False)
class Made:
    """The splines of a pair and, if asked, waves of which no spline is as good a likeness, as columns."""

    columns: Columns
    """From the smoothest on: a constant, a straight line, then what bends more and more; then the waves."""
    knots: tuple[float, ...]
    turn: np.ndarray
    """(K, K): coefficients of the columns to values at the knots."""
    roughness: np.ndarray
    """(K, K) of the coefficients of the splines' columns, of unit size."""
    waves: tuple[Option, ...] = ()

    def splines(self, places: np.ndarray, penalties: Sequence[float] = SPLINING.penalties) -> list[Block]:
        """The splines of each penalty, where all columns are in some places."""
        return [Block(places[: len(self.turn)], self.roughness, p) for p in penalties]

    def blocks(self, places: np.ndarray, penalties: Sequence[float] = SPLINING.penalties) -> list[Block]:
        """These, then the waves."""
        return [*self.splines(places, penalties), *blocks_of(self.waves, places[len(self.turn) :])]


def knots_of(x: np.ndarray, count: int) -> tuple[float, ...]:
    """Knots for a signal of any shape; fewer than three where it hardly varies."""
    flat = x[np.isfinite(x)]
    low, high = (float(np.quantile(flat, q)) for q in (SPLINING.outer, 1 - SPLINING.outer))
    inner = np.quantile(flat, np.linspace(0, 1, count)[1:-1])
    even = np.linspace(low, high, count)[1:-1]
    # Half by how often a value is met, half by where it lies: rare values are where shapes differ.
    found = np.unique([low, *((inner + even) / 2), high])
    least = 1e-6 * (found[-1] - found[0])
    kept = [float(found[0])]
    for k in found[1:]:
        if k - kept[-1] > least:
            kept.append(float(k))
    return tuple(kept)


class Splines:
    """All splines of the first signal of pairs, made once, times the second."""

    def __init__(self, signals: Sequence[dict[str, np.ndarray]]) -> None:
        """Prepare; ``signals`` are what terms can follow: as measured and, where inputs are noisy, with more noise."""
        self.signals = signals
        self._of: dict[tuple[tuple[str, ...], int, bool], Made | None] = {}

    def of(self, pair: Pair, count: int, waves: bool = False) -> Made | None:
        """The splines of ``count`` knots, and waves if asked; None: the first signal does not vary."""
        key = (pair.signals, count, waves)
        if key not in self._of:
            self._of[key] = self._made(pair, count, waves)
        made = self._of[key]
        return made and replace(made, columns=Columns(pair, made.columns.values))

    def _made(self, pair: Pair, count: int, waves: bool) -> Made | None:
        if len(pair.signals) == 1:
            return _of_first(pair, self.signals, count, waves)
        made = self.of(Pair(pair.axis, pair.signals[:1]), count, waves)
        if made is None:
            return None
        both = zip(made.columns.values, self.signals, strict=True)
        return replace(made, columns=Columns(pair, tuple(v * paths[pair.signals[1]] for v, paths in both)))


def _of_first(pair: Pair, signals: Sequence[dict[str, np.ndarray]], count: int, waves: bool) -> Made | None:
    """See `Splines.of`, of a pair of one signal."""
    knots = knots_of(signals[0][pair.signals[0]], count)
    if len(knots) < 3:
        return None
    rough, at = roughness(knots), np.array(knots)
    turn = np.linalg.eigh(rough)[1]
    turn[:, 0], turn[:, 1] = 1.0, (at - at.mean()) / at.std()  # what has no roughness at all
    paths = [torch.from_numpy(of[pair.signals[0]]) for of in signals]
    values = [np.moveaxis(basis(knots, x).numpy() @ turn, -1, 0) for x in paths]
    rough = turn.T @ rough @ turn
    rough[:2], rough[:, :2] = 0.0, 0.0
    some = waves_of(signals[0][pair.signals[0]]) if waves else ()
    if some:
        more = option_columns(pair, some, signals).values
        values = [np.concatenate(both) for both in zip(values, more, strict=True)]
    return Made(Columns(pair, tuple(values)), knots, turn, rough / (np.trace(rough) / len(rough)), some)


_Addition = tuple[int, int, np.ndarray]
"""A candidate's number, which of its functions, and the losses (folds,) with it."""


def chosen(fits: HeldOut, made: Sequence[Made], places: Sequence[np.ndarray]) -> list[Spline]:
    """The pairs that held-out recordings ask for, in the order in which they were added."""
    taken: list[Spline] = []
    beside: list[Block] = []
    now = fits.losses([])
    gained: dict[str, float] = defaultdict(float)

    def best(beside: Sequence[Block], among: Sequence[int]) -> _Addition | None:
        """The candidate that leaves least beside some blocks, with what is known of the constants.

        A force along one axis and a constant that was stated otherwise may make the same of another axis.
        """
        # Beside a first spline formulas would mend what that is too coarse for.
        tried = Made.splines if beside else Made.blocks
        few = SPLINING.penalties[1::2]
        quick = {i: float(fits.best(tried(made[i], places[i], few), beside)[1].sum()) for i in among}
        first = sorted(quick, key=lambda i: quick[i])[: SPLINING.first]
        found = [(i, *fits.best(tried(made[i], places[i]), beside)) for i in first]

        def cost(one: _Addition) -> float:
            i, which, losses = one
            return float(losses.sum()) + fits.prior([*beside, made[i].blocks(places[i])[which]])

        return min(found, key=cost, default=None)

    def least(pair: Pair, before: np.ndarray, losses: np.ndarray) -> float:
        """What a term must gain: more than noise, and not little of what its equation gains in all or of what is left.

        Beside much larger terms what another axis lacks is little of all that is gained, and all that is left.
        """
        relevant = SPLINING.relative * (gained[pair.equation] + float((now - losses).sum()))
        left = float(before.sum()) - fits.rows
        if left > fits.rows:
            relevant = min(relevant, CHOOSING.clearing * left)
        return max(SPLINING.gain * fits.rows, relevant)

    for _ in range(SPLINING.most):
        used = {s.pair for s in taken}
        free = [i for i, m in enumerate(made) if len(places[i]) and m.columns.pair not in used]
        by_length = {n: [i for i in free if made[i].columns.pair.length == n] for n in (1, 2, PRODUCT)}
        found = {n: addition for n, among in by_length.items() if (addition := best(beside, among))}
        if not found:
            break
        i, which, losses = found[min(found)]
        # Two signals must be better than one, for they hold much of that; and a product better than a sum of two terms.
        for length in sorted(found)[1:]:
            if confirmed(losses - found[length][2], least(made[i].columns.pair, losses, losses)):
                if length == PRODUCT:
                    alone = [j for n in found if n < PRODUCT for j in by_length[n] if j != i]
                    second = best([*beside, made[i].blocks(places[i])[which]], alone)
                    if second and second[2].sum() <= found[length][2].sum():
                        continue
                i, which, losses = found[length]
        if not confirmed(now - losses, least(made[i].columns.pair, now, losses)):
            break
        gained[made[i].columns.pair.equation] += float((now - losses).sum())
        taken.append(Spline(made[i].columns.pair, made[i], which))
        beside.append(taken[-1].block(places[i]))
        now = losses
    return taken


def confirmed(gains: np.ndarray, least: float) -> bool:
    """Whether recordings gain enough together, and most of them something."""
    return bool(gains.sum() >= least and (gains > 0).mean() >= SPLINING.agreed)
