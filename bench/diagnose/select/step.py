"""From a linearised model to the next one: a step is measured before it is believed.

A linearisation promises what a model does only near by. Each step of the numbers is therefore tried whole, by half and
by a quarter, and the one is taken that the recordings like best; effects are exchanged only where the misfit moves
about as was promised.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from bench.diagnose.logs.subject import Subject
from bench.diagnose.regression.parameters import Entry, entries
from bench.diagnose.select.choose import updated
from bench.diagnose.select.discovery import supported
from bench.diagnose.select.search import Search, View, ids_of
from bench.diagnose.select.subset import Fit
from bench.diagnose.select.verify import neighbours
from bench.diagnose.settings import CHOOSING, STEPPING, VERIFYING
from registry.core import EFFECTS
from registry.dynamics import Effect, InputEffect, PhysicsModel


@dataclass(frozen=True, eq=False)
class Step:
    """A model near a linearised one."""

    model: PhysicsModel
    loss: float
    """Measured: squared whitened residual, and distance of the constants from what is known; infinite: unstable."""
    exchanged: bool
    """Whether it has other effects."""


def advanced(search: Search, view: View, fit: Fit) -> Step:
    """The model of a fit; one on the way there where that does not keep what was promised and fits worse."""
    count, options = len(view.linear.own), list[Step]()
    for share in STEPPING.shares:
        beta = fit.beta.copy()
        beta[:count] *= share
        model = without(updated(view, replace(fit, beta=beta)), fit.dropped)
        options.append(Step(model, search.loss(view, model), bool(fit.starts or fit.dropped)))
        if options[-1].loss <= fit.loss + VERIFYING.left * view.floor:
            break
    best = min(options, key=lambda s: s.loss)
    if np.isfinite(best.loss):
        return best
    return Step(view.linear.model, search.loss(view, view.linear.model), exchanged=False)  # no step is stable


def next_step(search: Search, view: View, known: int, past: Sequence[PhysicsModel] = ()) -> Step:
    """The next model: with one effect more, less or exchanged where that is better, else with better numbers.

    What a linearisation likes best may not keep its promise: with a wind a drag becomes another one, and its first step
    goes too far. Then the numbers are fitted once more, those of the present effects too, or these would seem worse
    than they are; and if that does not help, the next best is tried. An exchange that was made before is not made
    again: effects that come at once and go one by one, as a wind with a drag, would go round in circles.

    Args:
        search: tells what a model leaves.
        view: of the present model.
        known: effects that the model had from the start, which stay.
        past: the models before it, each a step from the one before.
    """
    here = view.subsets.fit()
    stay, small = advanced(search, view, here), CHOOSING.visible * view.floor
    if stay.loss - here.loss > small:
        stay = _refitted(search, view, stay)
    ids = [ids_of(model.effects) for model in (*past, view.linear.model)]
    tried = {after for before, after in pairwise(ids) if before == ids[-1]}
    for changed in neighbours(view, known):
        if tried and _ids_after(view.linear.model, changed) in tried:
            continue
        promised = here.loss - changed.loss
        least = min(promised, STEPPING.kept * promised) - small
        other = advanced(search, view, changed)
        if other.exchanged and stay.loss - other.loss < least:
            other = _refitted(search, view, other)
        if stay.loss - other.loss >= least:
            return other
    return min([stay, *_in_series(search, view, stay, here, known)], key=lambda s: s.loss)


def _ids_after(model: PhysicsModel, fit: Fit) -> tuple[str, ...]:
    """Ids of a model's effects as a fit exchanges them."""
    return tuple(sorted([*ids_of(without(model, fit.dropped).effects), *fit.ids]))


def _in_series(search: Search, view: View, stay: Step, here: Fit, known: int) -> list[Step]:
    """Steps that exchange a lag or a delay for another one and are better than ``stay`` for sure.

    What stands between inputs and what they move acts one after the other: an exchange is no sum of a term less and one
    more, as a linearisation promises it, so every one is fitted and measured.
    """
    effects, dt = view.linear.model.effects, search.stack.dt
    small, steps = CHOOSING.visible * view.floor, list[Step]()
    for i in (i for i in range(known, len(effects)) if remembers(effects[i], dt)):
        best: dict[str, Fit] = {}
        for start in view.subsets.starts:
            if start.through is None and remembers(start.effect, dt):
                fit = view.subsets.fit([start], drop=[i])
                best[start.id] = min(best.get(start.id, fit), fit, key=lambda f: f.loss)
        for fit in best.values():
            other = _refitted(search, view, advanced(search, view, fit))
            price = view.subsets.penalty * (fit.parameters - here.parameters)
            if other.exchanged and stay.loss - other.loss > small + max(price, 0.0):
                steps.append(other)
    return steps


def remembers(effect: Effect, dt: float) -> bool:
    """Whether what comes out of an effect follows from inputs of some time ago."""
    return isinstance(effect, InputEffect) and effect.memory_size(1, dt) > 0


def _refitted(search: Search, view: View, step: Step) -> Step:
    """A step with its model's numbers fitted until they move no more, where that is better."""
    _, model = settled(search, step.model, view)
    return min(step, replace(step, model=model, loss=search.loss(view, model)), key=lambda s: s.loss)


def settled(search: Search, model: PhysicsModel, like: View | None = None) -> tuple[View, PhysicsModel]:
    """A model with its own numbers fitted until they move no more, and the last view on the way there.

    Args:
        search: tells what a model leaves.
        model: with the effects that it keeps.
        like: a view whose whitening filters are kept, of as many channels or more; default: anew in every step.
    """
    for _ in range(STEPPING.steps):
        # What effects do alone is asked for only where filters are made: it is among what tells most of what is left.
        look = search.own(model, settled=like is not None)
        view = min(search.views(look, like=like), key=lambda v: v.subsets.fit().prior)
        before, model = model, advanced(search, view, view.subsets.fit()).model
        if close(before, model, search.subject) and not search.bent(view):
            break
    return view, model


def close(before: PhysicsModel, after: PhysicsModel, subject: Subject) -> bool:
    """Whether a step moved every number by little: a constant against what is known of it, others by themselves."""
    pairs = zip(entries(before, subject.uncertainty), entries(after, subject.uncertainty), strict=True)
    return all(abs(a.value - b.value) <= 1e-12 + _little(b) for a, b in pairs)


def _little(e: Entry) -> float:
    return 0.3 * e.scale if e.constant and not e.hardly_known else 0.05 * abs(e.value)


def without(model: PhysicsModel, dropped: Sequence[int]) -> PhysicsModel:
    """The model without the effects in these places, and without those that then have none of what they need."""
    left = [e for i, e in enumerate(model.effects) if i not in dropped]
    kept = supported([EFFECTS.name_of(type(e)) for e in left], replace(model, effects=()))
    return replace(model, effects=tuple(e for e in left if EFFECTS.name_of(type(e)) in kept))
