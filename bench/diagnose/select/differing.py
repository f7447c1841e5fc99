"""What recordings differ in: an effect that all of them have, each with numbers of its own.

A load that is changed between flights, another wind, a new trim: one number for all is the mean of several, and what it
leaves looks like something that swings, pulls or drifts. Each effect of the catalogue is given numbers of each
recording's own beside what all recordings have in common, and judged on stretches of a few seconds that these were not
fitted to.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bench.diagnose.logs.noise import Noise
from bench.diagnose.logs.subject import Subject
from bench.diagnose.regression.least_squares import Normal, regularised
from bench.diagnose.regression.linearise import Candidate, Linearization
from bench.diagnose.regression.parameters import Entry
from bench.diagnose.regression.weak import mean_rates
from bench.diagnose.result import DifferingEffect, ParameterEstimate
from bench.diagnose.select.search import Search, View
from bench.diagnose.select.subset import Fit, t_value
from bench.diagnose.settings import CHOOSING, DIFFERING, MATTERING, VERIFYING
from bench.diagnose.simulate.teacher_forced import with_noise
from bench.diagnose.simulate.unmeasured import hidden
from registry.core import EFFECTS
from registry.dynamics import PhysicsModel

Parts = Mapping[str, Sequence[Normal]]
"""By recording, the rows of its parts."""


def differing(
    subject: Subject, models: Sequence[PhysicsModel], noise: Noise, catalogue: Sequence[str] | None
) -> tuple[DifferingEffect | None, PhysicsModel]:
    """What the recordings of a subject differ in, beside a model that holds for all.

    Of effects that explain nearly as much the one with the fewest numbers is told, and the others beside it. What was
    found may itself be what recordings differ in, in other words: then far less is left beside a model without it.

    Args:
        subject: measurements, and the nominal model.
        models: calibrated, with the effects that were found, and without.
        noise: of the measurements.
        catalogue: ids of the effects to choose from; None: all.

    Returns:
        The effect and the model beside which it is told; None: none explains most of what is left so, or a state was
        not measured.
    """
    told, beside, least = None, models[0], np.inf
    if hidden(subject.logs):
        return told, beside
    names = tuple(log.name for log in subject.logs)
    search = Search(replace(subject, training=names, held_out=()), catalogue, lambda what: None, noise, memory=0)
    like: View | None = None
    for model in models:
        look = search.look(model, only=(), broad=False)
        if like is not None and not {*look.linear.channels} <= {*like.linear.channels}:
            continue
        view = search.views(look, like=like)[-1]
        parts = _parts(search, look.linear, view)
        base = view.subsets.fit()
        everything = sum(float(r.losses(base.columns, base.beta).sum()) for own in parts.values() for r in own)
        first, like, least = like is None, like or view, min(least, everything)
        judged = [j for option in _options(view) if (j := _Judged(option, parts)).inside]
        if len(parts) < 2 or not judged:
            continue
        chosen, rivals = _simplest(judged, everything)
        if not chosen.sure or not (first or MATTERING.near**2 * chosen.left < least):
            continue
        if (share := chosen.share(_chance(search, view, noise))) > DIFFERING.most:
            told, beside = DifferingEffect(chosen.option.ids, share, chosen.numbers, rivals), model
            least = chosen.left
    return told, beside


def _parts(search: Search, linear: Linearization, view: View) -> dict[str, list[Normal]]:
    """By recording, its rows, whitened as in a view."""
    rows = linear.project(search.tests(linear)).whitened(view.filters)
    parts: dict[str, list[Normal]] = {}
    for log, own in zip(search.stack.logs, rows.apart(), strict=True):
        parts.setdefault(log.part_of or log.name, []).append(own)
    return parts


def _simplest(judged: Sequence["_Judged"], everything: float) -> tuple["_Judged", tuple[str, ...]]:
    """The effect with the fewest numbers of those that explain nearly as much of everything as the best; the others."""
    least = min(j.left for j in judged)
    room = (1 - DIFFERING.alike) * max(everything - least, 0.0)
    alike = [j for j in judged if j.left <= least + room]
    chosen = min(alike, key=lambda j: (len(j.option.places), j.left))
    return chosen, tuple(dict.fromkeys(i for j in alike for i in j.option.ids if i not in chosen.option.ids))


@dataclass(frozen=True, eq=False)
class _Option:
    """An effect whose numbers may differ, and the fit in which all recordings have the same."""

    ids: tuple[str, ...]
    fit: Fit
    places: tuple[int, ...]
    """Of its coefficients in the fit."""
    low: np.ndarray
    high: np.ndarray
    """Bounds of what may be added to these."""
    values: Callable[[np.ndarray], Mapping[str, float]]
    """Parameters at coefficients (k,)."""
    units: Mapping[str, str]
    inside: Callable[[Sequence[float]], bool]
    """Whether no parameter is pushed to a bound at coefficients (k,), but to that at which there is no effect."""

    def solved(self, gram: np.ndarray) -> np.ndarray:
        """What is added to the coefficients (k,), by normal equations (k + 1, k + 1) of what these leave."""
        none = np.zeros(len(self.places))
        return regularised(gram, range(len(none)), none, none, self.low, self.high)


def _options(view: View) -> list[_Option]:
    """The effects of a view's model, and those that it lacks."""
    own, subsets, out = view.linear.own, view.subsets, list[_Option]()

    def option(ids: tuple[str, ...], fit: Fit, places: Sequence[int], low: Sequence[float], high: Sequence[float],
               values: Callable[[np.ndarray], Mapping[str, float]], inside: Callable[[Sequence[float]], bool],
               entries: Sequence[Entry]) -> None:  # fmt: skip
        at, units = fit.beta[list(places)], {e.name: e.unit for e in entries}
        room = np.minimum(np.asarray(low) - at, 0.0), np.maximum(np.asarray(high) - at, 0.0)
        out.append(_Option(ids, fit, tuple(places), *room, values=values, units=units, inside=inside))

    base = subsets.fit()
    for place, effect in enumerate(view.linear.model.effects):
        at = [i for i, e in enumerate(own) if e.owner == place]
        mine, ids = [own[i] for i in at], (EFFECTS.name_of(type(effect)),)
        if mine:
            ends = [e.low - e.value for e in mine], [e.high - e.value for e in mine]
            option(ids, base, at, *ends, values=_values_of_own(mine), inside=_own_inside(mine), entries=mine)
    for s in subsets.starts:
        places = range(len(own), len(own) + len(s.columns))
        option(
            s.ids,
            subsets.fit([s]),
            places,
            s.low,
            s.high,
            values=_values_of_start(s),
            inside=s.within_bounds,
            entries=s.entries,
        )
    return out


def _values_of_own(entries: Sequence[Entry]) -> Callable[[np.ndarray], Mapping[str, float]]:
    def values(beta: np.ndarray) -> dict[str, float]:
        return {e.name: float(np.clip(e.value + b, e.low, e.high)) for e, b in zip(entries, beta, strict=True)}

    return values


def _own_inside(entries: Sequence[Entry]) -> Callable[[Sequence[float]], bool]:
    def inside(beta: Sequence[float]) -> bool:
        return not any(e.pushed(e.value + b) for e, b in zip(entries, beta, strict=True))

    return inside


def _values_of_start(start: Candidate) -> Callable[[np.ndarray], Mapping[str, float]]:
    names = {e.name for e in start.entries}

    def values(beta: np.ndarray) -> dict[str, float]:
        told = (p for effect in start.effects_at(beta.tolist()) for p in effect.parameters())
        return {p.name: float(p.value) for p in told if p.name in names}

    return values


@dataclass(frozen=True, eq=False)
class _Judged:
    """An effect with numbers of each recording's own."""

    option: _Option
    parts: Parts

    @cached_property
    def grams(self) -> dict[str, np.ndarray]:
        """By recording, normal equations (blocks, k + 1, k + 1) of what the numbers of all leave."""
        fit = self.option.fit
        columns = [fit.columns[i] for i in self.option.places]
        return {
            name: np.concatenate([r.products(columns, fit.columns, fit.beta) for r in rows])
            for name, rows in self.parts.items()
        }

    @cached_property
    def saved(self) -> np.ndarray:
        """What numbers of each recording's own save of its blocks (all of them,), each by a fit to every other one."""
        return np.concatenate([self._crossed(gram) for gram in self.grams.values()])

    @cached_property
    def left(self) -> float:
        """Squares that are left then."""
        return sum(float(gram[:, -1, -1].sum()) for gram in self.grams.values()) - float(self.saved.sum())

    @property
    def inside(self) -> bool:
        """Whether no recording has a number at a bound, which is none: what inputs do is lost in their noise there."""
        option = self.option
        common = option.fit.beta[list(option.places)]
        return all(option.inside((common + option.solved(gram.sum(0))).tolist()) for gram in self.grams.values())

    @property
    def sure(self) -> bool:
        """Whether recordings differ by more than chance, and one half of a recording says so of its other half.

        Both savings are of numbers that half of a recording tells. What wanders, as gusts do, is alike in stretches
        that follow each other, and other a while later.
        """
        kept = sum(self._transferred(gram) for gram in self.grams.values())
        return t_value(self.saved) > CHOOSING.significant and kept > DIFFERING.kept * float(self.saved.sum())

    def _crossed(self, grams: np.ndarray) -> np.ndarray:
        """What each block (blocks,) saves by the numbers of every other one."""
        gains = np.zeros(len(grams))
        for held in (0, 1):
            these = np.arange(len(grams)) % 2 == held
            if these.any() and not these.all():
                gains[these] = self._saves(grams[~these], grams[these])
        return gains

    def _transferred(self, grams: np.ndarray) -> float:
        """What each half of a recording saves by the numbers of its other half."""
        first, second = np.array_split(grams, 2)
        if not (len(first) and len(second)):
            return 0.0
        return float(self._saves(first, second).sum() + self._saves(second, first).sum())

    def _saves(self, fitted: np.ndarray, judged: np.ndarray) -> np.ndarray:
        vector = np.append(-self.option.solved(fitted.sum(0)), 1.0)
        saved: np.ndarray = judged[:, -1, -1] - np.einsum("i,bij,j->b", vector, judged, vector)
        return saved

    def share(self, chance: np.ndarray) -> float:
        """What is saved, of what the numbers of all leave above noise in the channels in which that is, 0 to 1.

        Args:
            chance: (channels,) what noise leaves.
        """
        fit, places = self.option.fit, list(self.option.places)
        before = after = np.zeros(len(chance))
        for name, rows in self.parts.items():
            beta = fit.beta.copy()
            beta[places] += self.option.solved(self.grams[name].sum(0))
            for r in rows:
                before = before + r.losses(fit.columns, fit.beta).sum(0)
                after = after + r.losses(fit.columns, beta).sum(0)
        acting, saved = before - after > VERIFYING.acts * (before - after).sum(), float(self.saved.sum())
        return saved / max(float((before - chance)[acting].sum()), saved, 1e-300)

    @property
    def numbers(self) -> dict[str, dict[str, ParameterEstimate]]:
        """By recording, its parameters with 95 % intervals, as its blocks scatter: what is left need not be white."""
        return {name: self._numbers(grams) for name, grams in self.grams.items()}

    def _numbers(self, grams: np.ndarray) -> dict[str, ParameterEstimate]:
        option, total, count = self.option, grams.sum(0), len(grams)
        common, more = option.fit.beta[list(option.places)], option.solved(total)
        inverse = np.linalg.pinv(total[:-1, :-1], hermitian=True)
        scores = grams[:, :-1, -1] - grams[:, :-1, :-1] @ more
        covariance = inverse @ (scores.T @ scores * count / max(1, count - 1)) @ inverse
        drawn = np.random.default_rng(0).multivariate_normal(more, covariance, DIFFERING.draws, method="svd")
        told = [option.values(common + np.clip(d, option.low, option.high)) for d in drawn]
        out = {}
        for name, value in option.values(common + more).items():
            low, high = np.quantile([t[name] for t in told], (0.025, 0.975))
            out[name] = ParameterEstimate(value, float(low), float(high), option.units[name])
        return out


def _chance(search: Search, view: View, noise: Noise) -> np.ndarray:
    """The squares (channels,) that noise alone leaves of a view's rows."""
    model, channels = view.linear.model, list(view.linear.channels)
    bare, left = replace(view.linear, columns=view.linear.columns[:0]), []
    for stack in (search.stack, with_noise(model, search.stack, noise)):
        rates = mean_rates(model, stack).numpy()[..., channels]
        rows = replace(bare, stack=stack, rates=rates).project(search.tests(view.linear)).whitened(view.filters)
        left.append(np.concatenate(rows.residuals(np.zeros(0))))
    found: np.ndarray = ((left[1] - left[0]) ** 2).sum(0)
    return found
