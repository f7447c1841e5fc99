"""Dry friction in place of what looks like it while a machine hardly moves: where each of them lets it stop tells.

A drive below a limit moves nothing, be it that friction holds the machine or that the drive has a dead zone; and while
the machine moves the way it is driven both take the same off the drive. A regression judges friction by the sign of a
measured speed, which is noise at rest, and a linearisation about no friction promises nothing of what rests. So each
dry friction is fitted by itself, from several strengths, and held-out forecasts decide.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bench.diagnose.regression.linearise import starting_points
from bench.diagnose.regression.parameters import entries, with_values
from bench.diagnose.select.catalogue import admissible
from bench.diagnose.select.materiality import Weighing
from bench.diagnose.select.search import Search, View
from bench.diagnose.select.step import remembers, settled, without
from bench.diagnose.settings import MATTERING, STEPPING
from bench.diagnose.simulate.multiple_shooting import (
    error_beside,
    multiple_shooting,
    relative_error,
    relative_errors,
)
from registry.dynamics import DryEffect, InputEffect, PhysicsModel


def friction_that_saves(search: Search, view: View, weighing: Weighing, model: PhysicsModel) -> PhysicsModel | None:
    """The model with dry friction instead of that and effects on the inputs that it has; None: that is no better.

    Args:
        search: of the subject.
        view: of the model, by which starting points are compared.
        weighing: the held-out recordings.
        model: with the effects that were found.

    Returns:
        The model with fewest numbers of those in which no dry friction forecasts the held-out recordings better; where
        it forecasts them better than ``model``, or has fewer numbers than one with effects on the inputs, which do not
        save what is worth them.
    """
    subject, dt = search.subject, search.stack.dt
    found = range(len(subject.model.effects), len(model.effects))
    gone = [i for i in found if isinstance(e := model.effects[i], DryEffect | InputEffect) and not remembers(e, dt)]
    # Of friction that is one number a motion, rows tell that number.
    if all(isinstance(model.effects[i], DryEffect) and not model.effects[i].screen for i in gone):
        return None
    fitted = list[PhysicsModel]()
    # What else was found may be an imitation too: once beside it, and once from what was known at first.
    for rest in (without(model, gone), subject.model)[: 1 + (len(gone) < len(found))]:
        kinds = [kind for _, kind in admissible(subject, rest, search.catalogue) if issubclass(kind, DryEffect)]
        fitted += [other for kind in kinds if (other := _fitted(search, view, rest, kind)) is not None]
    if not fitted:
        return None
    alike = MATTERING.near**2
    errors = relative_errors(model, fitted, subject, subject.held_out)
    good = [m for m, e in zip(fitted, errors, strict=True) if e <= alike * min(errors)]
    simplest = min(good, key=lambda m: _count(search, m))
    if errors[fitted.index(simplest)] < STEPPING.comparable:  # numbers that rows have bent may err more than that
        before, after = (multiple_shooting(m, subject, subject.training).model for m in (model, simplest))
        if relative_error(before, after, subject, subject.held_out) < 1 / alike:
            return after
    drives = any(isinstance(model.effects[i], InputEffect) for i in gone)
    fewer = drives and _count(search, simplest) < _count(search, model)
    return simplest if fewer and not weighing.refutes(simplest, model, model) else None


def _fitted(search: Search, view: View, rest: PhysicsModel, kind: type[DryEffect]) -> PhysicsModel | None:
    """A model with a dry friction of this kind, fitted from the strength that leaves least; None: no thing is so.

    Rows tell what holds a machine at rest to be no less than what pushes it there, free runs when it lets go.
    """
    points, options = starting_points(rest, search.stack), list[PhysicsModel]()
    for share in STEPPING.strengths:
        sizes = {n: size * share if n in ("force", "input") else size for n, size in points.sizes.items()}
        options += [replace(rest, effects=(*rest.effects, e)) for e in replace(points, sizes=sizes).felt(kind)]
    losses = [search.loss(view, m) for m in options]
    if not np.isfinite(min(losses, default=np.inf)):
        return None
    start = options[int(np.argmin(losses))]
    _, fitted = settled(search, start)
    if kind.screen:
        fitted = _shot(
            search, fitted, [replace(fitted, effects=(*fitted.effects[:-1], m.effects[-1])) for m in options]
        )
    else:
        fitted = _nearest(search, fitted, _scanned(search, start))
    return fitted if all(e.possible_in(fitted) for e in fitted.effects) else None


def _scanned(search: Search, start: PhysicsModel) -> PhysicsModel:
    """A model whose friction alone is scaled until its free runs err least.

    What turns round within an interval, as a machine that is held on its path does, rows of that interval know nothing
    of: they bend the constants for it.
    """
    from scipy.optimize import minimize_scalar

    error = error_beside(start, search.subject, search.subject.training)
    most = math.log(max(b / a for a, b in itertools.pairwise(STEPPING.strengths)))

    def log_error(x: float) -> float:
        return math.log(max(error(_scaled(start, math.exp(x))), 1e-300))

    found = minimize_scalar(log_error, bounds=(-most, most), method="bounded", options={"xatol": STEPPING.scanned})
    return _scaled(start, math.exp(found.x))


def _scaled(model: PhysicsModel, factor: float) -> PhysicsModel:
    """With the numbers of its last effect times this."""
    where = [e for e in entries(model, {}) if e.owner == len(model.effects) - 1]
    return with_values(model, where, np.array([e.value * factor for e in where]))


def _nearest(search: Search, one: PhysicsModel, *models: PhysicsModel) -> PhysicsModel:
    """Of these and ``one`` the model whose free runs of the training recordings err least."""
    errors = relative_errors(one, models, search.subject, search.subject.training)
    best = int(np.argmin(errors))
    return models[best] if errors[best] < 1 else one


def _shot(search: Search, by_rows: PhysicsModel, starts: Sequence[PhysicsModel]) -> PhysicsModel:
    """A model fitted to free runs, from where rows have it or from that of some starting points which errs least."""
    subject, names = search.subject, search.subject.training
    starts = (by_rows, _nearest(search, by_rows, *starts))
    return _nearest(search, by_rows, *(multiple_shooting(m, subject, names).model for m in starts))


def _count(search: Search, model: PhysicsModel) -> int:
    """How many numbers of its effects are fitted."""
    return sum(not e.constant for e in entries(model, search.subject.uncertainty))
