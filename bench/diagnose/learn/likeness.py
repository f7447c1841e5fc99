"""Which effects of the catalogue do most of what a learned term does."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import scipy  # scipy.optimize is imported when it is used

from bench.diagnose.regression.linearise import Candidate, Linearization
from bench.diagnose.settings import TELLING


@dataclass(frozen=True)
class Likeness:
    """What a term is like."""

    effects: tuple[str, ...]
    """Ids of the effects of the catalogue that come nearest to it."""
    share: float
    """Of the squared rates that the term makes of the recordings, what the first of them would make too, 0 to 1."""


def nearest(linear: Linearization, place: int) -> Likeness | None:
    """The candidates that tell most of what the effect in a place of the model does; None: none tells much.

    Rates of all groups of channels on which the term acts count alike, over all recordings that ``linear`` is of.
    """
    gone = linear.columns.responses[linear.removals[place]]
    group = {c: linear.model.measured_channels[c].group for c in gone}
    power = dict.fromkeys(group.values(), 0.0)
    for c, x in gone.items():
        power[group[c]] += float(np.mean(x**2))
    scale = {c: power[g] ** 0.5 for c, g in group.items()}
    y = -np.concatenate([x.ravel() / scale[c] for c, x in gone.items()])  # what goes with the term is what it does
    shares: dict[str, float] = {}
    for s in (s for s in linear.starts if s.through is None):
        shares[s.id] = max(shares.get(s.id, 0.0), _told(linear, s, gone, scale, y))
    best = max(shares.values(), default=0.0)
    near = sorted((i for i in shares if shares[i] >= best - TELLING.as_near), key=lambda i: -shares[i])
    return Likeness(tuple(near[: TELLING.nearest]), best) if best >= TELLING.alike else None


def _told(
    linear: Linearization, start: Candidate, gone: Mapping[int, np.ndarray], scale: Mapping[int, float], y: np.ndarray
) -> float:
    """R² of a candidate, with numbers that it may have, on what the term does: what pushes away is no spring."""
    zeros = np.zeros(linear.columns.shape)
    columns = [
        np.concatenate([linear.columns.responses[j].get(c, zeros).ravel() / scale[c] for c in gone])
        for j in start.columns
    ]
    x, low, high = np.stack(columns, axis=1), np.array(start.low), np.array(start.high)
    acts = np.isfinite(x).all(0) & (np.abs(x).max(0) > 0)
    given = acts & (low == high)  # an effect that is not linear in its numbers, as it is at this value of them
    rest = y - x[:, given] @ low[given]
    free = acts & ~given
    if free.any():
        size = np.linalg.norm(x[:, free], axis=0)
        triangle = np.asarray(np.linalg.qr(np.column_stack([x[:, free] / size, rest]), mode="r"))
        ends = low[free] * size, high[free] * size
        fit = scipy.optimize.lsq_linear(triangle[:, :-1], triangle[:, -1], ends, method="bvls")
        rest = rest - x[:, free] @ (fit.x / size)
    return float(1 - rest @ rest / (y @ y))
