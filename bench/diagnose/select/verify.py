"""What speaks against a choice: a better neighbour, or something left that it only imitates. Its rivals: `tie`."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.special import chdtri, stdtrit

from bench.diagnose.regression.generic import Folds, follow
from bench.diagnose.regression.least_squares import ridge, squares_left
from bench.diagnose.regression.parameters import Entry
from bench.diagnose.select.choose import accepted, within_bounds
from bench.diagnose.select.search import View
from bench.diagnose.select.subset import Fit, acting, t_value
from bench.diagnose.settings import CHOOSING, VERIFYING


@dataclass(frozen=True, eq=False)
class Estimate:
    """One number of a model with its 95 % interval."""

    entry: Entry
    value: float
    low: float
    high: float


@dataclass(frozen=True, eq=False)
class Ratio:
    """Two constants of the base model that are known better together than each alone, with the 95 % interval."""

    over: Entry
    under: Entry
    value: float
    low: float
    high: float


@dataclass(frozen=True)
class ResidualTerm:
    """Something systematic that is left."""

    axis: str
    signal: str
    text: str
    gain: float
    """Squared whitened residual that it saves on recordings not fitted, as a share of what noise leaves."""
    column: int
    """In the view that it was found in."""


def estimates(view: View, fit: Fit) -> list[Estimate]:
    """Numbers of the model with 95 % intervals."""
    own = view.linear.own
    variance = np.diag(view.subsets.covariance(fit))[: len(own)]
    # Where more noise was taken off a column than there is of it, the data say nothing of its coefficient; nor do they
    # of one that was given.
    stated = np.array([e.scale if e.constant else np.inf for e in own])
    spread = np.where(variance > 0, np.sqrt(np.abs(variance)), stated)
    blocks = len(view.subsets.normal.fold)
    reach = float(stdtrit(max(2, blocks - 1), 0.975))
    out = []
    for e, b, s in zip(own, fit.beta, spread, strict=False):
        value = float(np.clip(e.value + b, e.low, e.high))
        out.append(Estimate(e, value, *e.told(value, reach * s)))
    return out


def by_chance(view: View, fit: Fit, place: int) -> bool:
    """Whether recordings disagree about the effect in this place, and are sure of none of its numbers all the same.

    An estimator levels anew in every flight, and gusts have a mean: such numbers are known as well as their mean over
    the recordings is (Student's t). Each recording tells a number with all others held; that they disagree is told by
    Cochran's Q (W. G. Cochran, Biometrics 10, 1954).
    """
    own, normal = view.linear.own, view.subsets.normal
    numbers = [i for i, e in enumerate(own) if e.owner == place and i in fit.columns]
    blocks, variance = normal.products(numbers, fit.columns, fit.beta), np.diag(view.subsets.covariance(fit))
    grams = np.stack([blocks[normal.fold == f].sum(0) for f in np.unique(normal.fold)])
    disagree = False
    for k, i in enumerate(numbers):
        told, count = grams[:, k, k], int((grams[:, k, k] > 0).sum())
        at = fit.columns.index(i)
        if count < 3 or not variance[at] > 0:
            return False  # two tell too little of how they differ
        weight = told / told.sum()
        values = own[i].value - own[i].neutral + fit.beta[at] + grams[:, k, -1] / np.where(told > 0, told, np.inf)
        mean = float(weight @ values)
        apart = float(weight @ (values - mean) ** 2 / variance[at]) > chdtri(count - 1, VERIFYING.disagree)
        disagree |= bool(apart)
        squared = float(weight**2 @ (values - mean) ** 2) * count / (count - 1) if apart else variance[at]
        reach = stdtrit(count - 1 if apart else len(normal.fold) - 1, 0.95)  # held-out recordings confirm it beside
        if abs(mean) > reach * squared**0.5:
            return False
    return disagree


def ratios(view: View, fit: Fit) -> list[Ratio]:
    """Ratios of constants that are better known than the constants, best first; none that follows from those before.

    Motion often tells thrust over mass, or torque over inertia; which of the two is off, only what is stated of them.
    """
    values = {x.entry.label: x.value for x in estimates(view, fit) if x.entry.constant}
    own = [(i, e) for i, e in enumerate(view.linear.own) if e.label in values]
    index, at = [i for i, _ in own], np.array([values[e.label] for _, e in own])
    relative = view.subsets.covariance(fit)[np.ix_(index, index)] / np.outer(at, at)
    alone = np.diag(relative)
    together = alone[:, None] + alone - 2 * relative
    reach = float(stdtrit(max(2, len(view.subsets.normal.fold) - 1), 0.975))
    out, linked = [], np.arange(len(own))
    for i, j in sorted(combinations(range(len(own)), 2), key=lambda pair: together[pair]):
        if 0 < together[i, j] < VERIFYING.together**2 * min(alone[i], alone[j]) and linked[i] != linked[j]:
            linked[linked == linked[j]] = linked[i]
            value, half = float(at[j] / at[i]), reach * float(together[i, j]) ** 0.5
            out.append(Ratio(own[j][1], own[i][1], value, value * (1 - half), value * (1 + half)))
    return out


def neighbours(view: View, known: int) -> Iterator[Fit]:
    """Sets one step from the model's that are better, as linearised: an effect less, exchanged or more."""
    subsets, starts = view.subsets, view.subsets.starts
    current = subsets.fit()
    places = range(known, len(view.linear.model.effects))
    numbers = estimates(view, current)
    for i in places:
        less = subsets.fit(drop=[i])
        # Parameters that share an uncertainty, such as the gains of all rotors, are known together only.
        plain = less.misfit - current.misfit > VERIFYING.plainly * view.floor
        told = plain or any(_told(x) for x in numbers if x.entry.owner == i)
        if not told or at_bound(numbers, i) or not accepted(view, less, current, drop=[i]):
            yield less
    alike = subsets.holding(current)
    options = [f for s in starts for i in places if within_bounds(view, f := alike.fit([s], drop=[i]))]
    best = min(options, key=alike.cost, default=None)
    if best is not None and alike.cost(best) < alike.cost(current) - VERIFYING.odds:
        difference = alike.losses(current) - alike.losses(best)
        relevant = difference.sum() > CHOOSING.relevant * view.explained_where(difference.sum(0))
        sure = relevant and t_value(difference.sum(1)) > CHOOSING.distinct
        if sure or best.parameters < current.parameters:
            yield subsets.fit(best.starts, drop=[i for i in places if i in best.dropped])
    yield from _larger(view, current, CHOOSING.most - len(places))


def _larger(view: View, current: Fit, room: int) -> Iterator[Fit]:
    """Sets with up to ``room`` effects more: one, or two of which none alone clears what is left beside a large one."""
    subsets = view.subsets
    best = sorted((subsets.fit([s]) for s in subsets.starts), key=subsets.cost)[: 3 if room > 0 else 0]
    for more in best:
        if within_bounds(view, more) and accepted(view, current, more):
            yield more
    for one, other in combinations(best if room > 1 else (), 2):
        both = subsets.fit([*one.starts, *other.starts])
        possible = set(one.ids).isdisjoint(other.ids) and within_bounds(view, both)
        if possible and all(accepted(view, less, both) for less in (current, one, other)):
            yield both


def _told(x: Estimate) -> bool:
    """Whether an effect's parameter is known to differ from no effect, and is not merely pushed to its bound."""
    e = x.entry
    return not x.low <= e.neutral <= x.high and e.low < x.value < e.high


def at_bound(numbers: Sequence[Estimate], place: int) -> bool:
    """Whether a parameter of the effect in this place is pushed to a bound that is not its neutral value.

    What is best beyond the physical range is an imitation of something else.
    """
    return any(x.entry.owner == place and x.entry.pushed(x.value) for x in numbers)


def left_over(view: View, dropped: Sequence[int] = ()) -> tuple[list[ResidualTerm], float]:
    """What the residual of a fit follows, and the loss that all of it saves on recordings not fitted."""
    first = len(view.linear.columns)
    allowed = [first + i for i, reach in enumerate(view.reach) if not reach <= view.doubtful]
    found = follow(_anchored(view, dropped), first, allowed=allowed)
    traces = []
    for column, gain in found:
        term = view.dictionary[column - first]
        traces.append(ResidualTerm(term.axis, term.signal, term.text, gain / view.floor, column))
    return traces, sum(g for _, g in found)


def _anchored(view: View, dropped: Sequence[int] = ()) -> Folds:
    """Normal equations of what is left by a fit without some effects; the model's free numbers are kept in them.

    A fold that says little of a number must not run away with it, since noise that was taken off may leave less than
    nothing of what it says: numbers are held by what is known of them, and by what all recordings together say of them.
    One that the fit has at its bound stays there.
    """
    own, subsets = view.linear.own, view.subsets
    fit = subsets.fit(drop=dropped)
    at = fit.beta[: len(own)]
    removed, _ = view.linear.removed(dropped)
    free = [c for c in range(len(own)) if own[c].owner not in removed and subsets.low[c] < at[c] < subsets.high[c]]
    kept = view.linear.changed(free, dropped)
    shift, tail = np.zeros(len(view.grams[0])), np.zeros(len(view.grams[0]))
    shift[list(fit.columns)] = -fit.beta
    offset = subsets.centre[free] - at[free]
    tail[kept] = pull = subsets.anchor[free] * offset
    tail[-1] = pull @ offset
    folds, count = Folds.of(view.grams, kept, shift), len(view.grams)
    tails = [own + tail / count for own in folds.tails]
    variance = np.diag(subsets.covariance(fit))[free]
    told = np.divide(1.0, variance, out=np.zeros_like(variance), where=variance > 0)
    return replace(folds, tails=tails, held=np.diag(subsets.anchor[free] + told) / count)


def least_imitation(
    view: View, places: Sequence[int], traces: Sequence[ResidualTerm], dropped: Sequence[int] = ()
) -> int | None:
    """Of the effects in these places that imitate or are a small part of something unknown, the one that gains least.

    What is left where an effect does not act counts where it is something missing by itself: what the catalogue has not
    may act in forces and torques, and an effect imitate one half of it. A trace that is none is no rival.

    Args:
        view: a model with the effects.
        places: of effects in ``model.effects``.
        traces: what is left.
        dropped: places of effects that the model does without.

    Returns:
        Its place; None: all are what they seem.
    """
    gains = {i: _gains(view, i, dropped) for i in places}
    imitations = [i for i in places if not needed(view, i, traces, dropped)]

    def unknown(channels: set[int]) -> float:
        others = sum(float(gains[i][sorted(channels)].sum()) for i in imitations)
        return _left_where(view, traces, channels) + others

    everything = unknown(set(range(len(view.linear.channels))))

    def rival(place: int) -> float:
        there = unknown(acting(gains[place]))
        return there if everything - there <= VERIFYING.left * view.floor else everything

    small = [i for i in places if i not in imitations and gains[i].sum() <= VERIFYING.part * rival(i)]
    return min((*imitations, *small), key=lambda i: float(gains[i].sum()), default=None)


def _gains(view: View, place: int, dropped: Sequence[int]) -> np.ndarray:
    """The loss (channels,) that the effect in this place saves."""
    subsets = view.subsets
    without, with_it = subsets.fit(drop=[*dropped, place]), subsets.fit(drop=dropped)
    gains: np.ndarray = (subsets.losses(without) - subsets.losses(with_it)).sum(0)
    return gains


def _left_where(view: View, traces: Sequence[ResidualTerm], channels: set[int]) -> float:
    """The loss that the traces make which act in any of these channels."""
    first = len(view.linear.columns)
    return view.floor * sum(t.gain for t in traces if view.reach[t.column - first] & channels)


def needed(view: View, place: int, traces: Sequence[ResidualTerm], dropped: Sequence[int] = ()) -> bool:
    """Whether an effect explains its share as well as as many free terms of the dictionary do where it acts.

    An effect of the catalogue that imitates one outside it is beaten by the terms that are closer to the truth.

    Args:
        view: a model with the effect.
        place: of the effect in ``model.effects``.
        traces: what is left, of which only that counts which acts where the effect does.
        dropped: places of effects that the model does without.
    """
    gains = _gains(view, place, dropped)
    where = acting(gains)
    first, count = len(view.linear.columns), sum(e.owner == place for e in view.linear.own)
    if gains.sum() < _left_where(view, traces, where):
        return False  # what acts there is not understood, and this is less than that
    with_it, without_it = _anchored(view, dropped), _anchored(view, [*dropped, place])
    allowed = [first + i for i, reach in enumerate(view.reach) if reach & where]
    terms = [column for column, _ in follow(without_it, first, count, allowed)]

    def loss(folds: Folds, more: Sequence[int]) -> float:
        some = np.asarray(sum(folds.products(more)))
        return squares_left(some, ridge(some, 1e-9))

    bare, by_terms = (loss(without_it, more) for more in ([], terms))
    by_effect, by_both = (loss(with_it, more) for more in ([], terms))
    alike = max(VERIFYING.left * view.floor, VERIFYING.imitation * view.explained_where(gains))
    if by_terms > by_effect - alike:
        return True
    # The terms may have found something else that is left: then the effect still has its own share beside them.
    return by_terms - by_both > VERIFYING.own_share * (bare - by_effect)
