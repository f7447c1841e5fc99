"""Contrasts of configurations from few seeds: strata that are fixed, and a variance of seeds that borrows from others.

A cell is one configuration on one problem (an axis): its trainings, each judged on every recording. A contrast weighs
the mean logs of cells. Axes and configurations are fixed, so they are strata: their differences are no noise. What
repeats are trainings, independent from cell to cell, and recordings, which all cells share.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.special import chdtri, digamma, fdtri, polygamma, stdtrit

CAUTION = 0.2
"""Quantile of the sampling distribution at which the spread between cells is taken: few cells lend little."""
TOO_NOISY, TOO_QUIET = 0.2, 0.1
"""Tail chances of the F-test that a contrast's own seeds spread as those of the other cells; else they lend nothing."""
_FIRM = 1e6
"""Degrees of freedom of a prior between whose cells no difference is seen."""


@dataclass(frozen=True, eq=False)
class Cell:
    """The trainings of one configuration on one problem."""

    values: np.ndarray
    """(S, R) log errors, or differences of them, of S trainings on R recordings."""
    fixed: bool = False
    """The model has no seed: the same training every time."""

    @property
    def trainings(self) -> int:
        """S, the number of trainings."""
        return len(self.values)

    @property
    def repeats(self) -> bool:
        """Whether it tells how far seeds spread."""
        return not self.fixed and len(self.values) > 1

    @cached_property
    def of_seeds(self) -> float:
        """Variance between trainings, of their means over the recordings."""
        return float(self.values.mean(1).var(ddof=1))

    @cached_property
    def scatter(self) -> float:
        """Variance of a training on a recording beyond what both do elsewhere."""
        v = self.values
        rest = v - v.mean(0) - v.mean(1, keepdims=True) + v.mean()
        return float((rest**2).sum()) / ((v.shape[0] - 1) * (v.shape[1] - 1))


@dataclass(frozen=True)
class Contrast:
    """A weighted sum of cell means with the two variances that its interval rests on."""

    value: float
    """In logs."""
    of_recordings: float
    """Variance of the value from the recordings, with `trainings` as they are."""
    of_seeds: float
    """Variance of the value from the seeds, moderated."""
    shared: float
    """The part of both that is of a seed on a recording."""
    recordings: int
    trainings: int
    """Seeds of the cell that has fewest."""
    networks: int
    """Trainings in all cells."""
    strata: int
    freedom: float
    """Degrees of freedom of `of_seeds`; 0: no seed repeats."""
    borrowed: float = field(default=0.0)
    """How many of them come from other cells."""

    def half_width(self, alpha: float, seeds: float = 1.0, recordings: float = 1.0) -> float:
        """Of the interval at confidence 1 − ``alpha``, or of the one expected with more repetition; NaN for none.

        Args:
            alpha: chance that the truth lies outside.
            seeds: factor on the number of trainings.
            recordings: factor on the number of recordings.
        """
        count = self.recordings * recordings
        a = max(self.of_recordings - self.shared, 0.0) / recordings + self.shared / (seeds * recordings)
        b = max(self.of_seeds - self.shared, 0.0) / seeds + self.shared / (seeds * recordings)
        if seeds == recordings == 1:
            a, b = self.of_recordings, self.of_seeds
        more = (self.trainings * seeds - 1) / (self.trainings - 1) if self.trainings > 1 else 1.0
        parts = [(a, count - 1)] if count > 1 else []
        parts += [(b, self.freedom * more)] if self.freedom else []
        total = sum(v for v, _ in parts)
        if not parts:
            return math.nan
        if total == 0:
            return 0.0
        freedom = total**2 / sum(v**2 / f for v, f in parts)
        return float(stdtrit(freedom, 1 - alpha / 2)) * math.sqrt(total)


def contrast(weighted: Sequence[tuple[float, Cell]], pool: Sequence[Cell] = ()) -> Contrast:
    """Estimate a contrast; its seeds' variance is moderated by that of the pool.

    The variance over recordings is that of the contrast's own mean on each. The variance over seeds is estimated within
    each cell; for the contrast it is a weighted mean of its own (Satterthwaite's degrees of freedom) and of what the
    mean of all cells makes expect, the weights being degrees of freedom: its own, and those of a scaled inverse
    chi-square prior fitted to the variances of all cells (Smyth 2004), with the spread between cells at a cautious
    quantile. As Phipson et al. (2016) exempt genes that vary too much, a contrast whose own variance is unlike that of
    the others (F-test) keeps its own. Both variances hold a seed's scatter on a recording; it is not taken off.

    Args:
        weighted: (weight, cell); a cell may come more than once. All are of the same recordings.
        pool: other cells of the same kind; those of the contrast need not be left out.
    """
    weights: dict[int, float] = {}
    cells = {id(cell): cell for _, cell in weighted}
    for weight, cell in weighted:
        weights[id(cell)] = weights.get(id(cell), 0.0) + weight
    used = [(weights[i], cell) for i, cell in cells.items() if weights[i]]
    means = sum(w * c.values.mean(0) for w, c in used)
    recordings = len(means)
    repeated = [(w, c) for w, c in used if c.repeats]
    own = np.array([w * w * c.of_seeds / c.trainings for w, c in repeated])
    freedom = np.array([c.trainings - 1.0 for _, c in repeated])
    trained = [c for _, c in used if not c.fixed]
    variance = float(own.sum())
    total = variance**2 / float((own**2 / freedom).sum()) if variance > 0 else float(freedom.sum())
    others = [c for c in pool if c.repeats and id(c) not in cells]
    borrowed = 0.0
    if variance > 0 and others:
        per_seed = sum(w * w / c.trainings for w, c in repeated)
        variance, moderated = _moderated(variance, total, per_seed, [c for _, c in repeated], others)
        borrowed, total = moderated - total, moderated
    scatter = sum(w * w * c.scatter / (c.trainings * recordings) for w, c in repeated) if recordings > 1 else 0.0
    return Contrast(
        value=float(means.mean()),
        of_recordings=float(means.var(ddof=1)) / recordings if recordings > 1 else 0.0,
        of_seeds=variance,
        shared=min(scatter, variance),
        recordings=recordings,
        trainings=min((c.trainings for c in trained), default=1),
        networks=sum(c.trainings for c in trained),
        strata=len(used),
        freedom=total if len(repeated) else 0.0,
        borrowed=borrowed,
    )


def _moderated(
    own: float, freedom: float, per_seed: float, cells: Sequence[Cell], others: Sequence[Cell]
) -> tuple[float, float]:
    """A contrast's variance of seeds with what the cells around it lend: the variance, its degrees of freedom."""
    elsewhere = [(c.of_seeds, c.trainings - 1) for c in others]
    known = [(v, d) for v, d in [*((c.of_seeds, c.trainings - 1) for c in cells), *elsewhere] if v > 0]
    expected = per_seed * float(np.mean([v for v, _ in elsewhere]))
    pooled = sum(d for _, d in known)
    if expected == 0 or len(known) < 2:
        return own, freedom
    count = sum(d for _, d in elsewhere)
    low, high = fdtri(freedom, count, TOO_QUIET), fdtri(freedom, count, 1 - TOO_NOISY)
    if not low <= own / expected <= high:
        return own, freedom
    lent = _prior_freedom(known)
    centre = per_seed * float(np.mean([v for v, _ in known]))
    return (lent * centre + freedom * own) / (lent + freedom), max(min(lent + freedom, pooled), freedom)


def _prior_freedom(known: Sequence[tuple[float, int]]) -> float:
    """Degrees of freedom of the inverse chi-square distribution that variances (value, freedom) were drawn from."""
    values, freedom = (np.array(x, dtype=float) for x in zip(*known, strict=True))
    logs = np.log(values) - digamma(freedom / 2) + np.log(freedom / 2)
    count = len(values) - 1
    spread = logs.var(ddof=1) * count / chdtri(count, 1 - CAUTION) - float(np.mean(polygamma(1, freedom / 2)))
    return min(_FIRM, 2 * _inverse_trigamma(spread)) if spread > 0 else _FIRM


def _inverse_trigamma(value: float) -> float:
    """x of which the trigamma function is ``value``: Newton's method from below (Smyth 2004, appendix)."""
    if value > 1e7:
        return 1 / math.sqrt(value)
    if value < 1e-6:
        return 1 / value
    x = 0.5 + 1 / value
    for _ in range(50):
        trigamma = float(polygamma(1, x))
        step = trigamma * (1 - trigamma / value) / float(polygamma(2, x))
        x += step
        if -step < 1e-8 * x:
            break
    return x
