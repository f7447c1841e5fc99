"""Which axes and signals what is left goes with: penalised splines, added one by one while held-out recordings gain."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from bench.diagnose.learn.candidates import Columns, Pair
from bench.diagnose.learn.held_out import Block, HeldOut
from bench.diagnose.settings import SPLINING
from registry.terms.spline import basis, roughness


@dataclass(frozen=True, eq=False)
class Spline:
    """A term as a spline."""

    pair: Pair
    made: "Made"
    block: Block


@dataclass(frozen=True, eq=False)
class Made:
    """The splines of a pair, as columns."""

    columns: Columns
    """From the smoothest on: a constant, a straight line, then what bends more and more."""
    knots: tuple[float, ...]
    turn: np.ndarray
    """(K, K): coefficients of the columns to values at the knots."""
    roughness: np.ndarray
    """(K, K) of the columns' coefficients, of unit size."""


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


def splines_of(pair: Pair, signals: Sequence[dict[str, np.ndarray]], count: int) -> Made | None:
    """All splines of a pair's first signal, times the second; None: the signal does not vary."""
    knots = knots_of(signals[0][pair.signals[0]], count)
    if len(knots) < 3:
        return None
    rough, at = roughness(knots), np.array(knots)
    turn = np.linalg.eigh(rough)[1]
    turn[:, 0], turn[:, 1] = 1.0, (at - at.mean()) / at.std()  # what has no roughness at all
    values = []
    for paths in signals:
        found = np.moveaxis(basis(knots, torch.from_numpy(paths[pair.signals[0]])).numpy() @ turn, -1, 0)
        values.append(found * paths[pair.signals[1]] if len(pair.signals) > 1 else found)
    rough = turn.T @ rough @ turn
    rough[:2], rough[:, :2] = 0.0, 0.0
    return Made(Columns(pair, tuple(values)), knots, turn, rough / (np.trace(rough) / len(rough)))


def chosen(fits: HeldOut, made: Sequence[Made], places: Sequence[np.ndarray]) -> list[Spline]:
    """The pairs that held-out recordings ask for, in the order in which they were added."""
    taken: list[Spline] = []
    now = before = fits.losses([])
    for _ in range(SPLINING.most):
        beside = [s.block for s in taken]
        used = {s.pair for s in taken}
        free = [i for i, m in enumerate(made) if len(places[i]) and m.columns.pair not in used]
        quick = {i: float(fits.losses([*beside, Block(places[i], made[i].roughness, 1e-3)]).sum()) for i in free}
        found: dict[int, tuple[int, Block, np.ndarray]] = {}
        ranked = sorted(quick, key=lambda j: quick[j])
        alone, both = ([i for i in ranked if len(made[i].columns.pair.signals) == n] for n in (1, 2))
        for i in (*alone[: SPLINING.first], *both[: SPLINING.first]):
            block, losses = fits.smoothed(places[i], made[i].roughness, beside)
            size = len(made[i].columns.pair.signals)
            if size not in found or losses.sum() < found[size][2].sum():
                found[size] = i, block, losses
        if not found:
            break
        i, block, losses = found[min(found)]
        least = max(SPLINING.gain * fits.rows, SPLINING.relative * float((before - losses).sum()))
        # A product of two signals must be better than a function of one, for it holds much of that.
        if len(found) > 1 and confirmed(losses - found[2][2], least):
            i, block, losses = found[2]
        if not confirmed(now - losses, least):
            break
        taken.append(Spline(made[i].columns.pair, made[i], block))
        now = losses
    return taken


def confirmed(gains: np.ndarray, least: float) -> bool:
    """Whether recordings gain enough together, and most of them something."""
    return bool(gains.sum() >= least and (gains > 0).mean() >= SPLINING.agreed)
