"""Fit all numbers of a model with its effects: the weak form first, then free runs by shooting; where a fit starts."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from bench.diagnose.logs.noise import Noise
from bench.diagnose.logs.subject import Subject
from bench.diagnose.regression.linearise import Candidate
from bench.diagnose.select.choose import within_bounds
from bench.diagnose.select.release import contradicted
from bench.diagnose.select.search import Search, View
from bench.diagnose.select.simulated import by_simulation
from bench.diagnose.select.step import advanced, settled
from bench.diagnose.select.subset import Fit
from bench.diagnose.select.verify import Estimate, estimates
from bench.diagnose.settings import EXTENDING, STEPPING
from bench.diagnose.simulate.multiple_shooting import Shot, multiple_shooting
from bench.diagnose.simulate.unmeasured import hidden
from registry.core import EFFECTS
from registry.dynamics import Effect, InputEffect, PhysicsModel


def fit_parameters(
    subject: Subject,
    model: PhysicsModel,
    noise: Noise | None = None,
    tick: Callable[[str], None] = lambda what: None,
    through_simulator: bool = True,
) -> tuple[PhysicsModel, list[Estimate]]:
    """Constants within their uncertainty and all effects of ``model``, fitted on the training recordings.

    The weak form first, which needs no good start; then, with ``through_simulator``, multi-step shooting, whose numbers
    are taken where they predict plainly better. Intervals hold both. Not where noise of the states bends numbers: a
    free run begins at a noisy state, and a model that forgets faster than the system does forecasts better from there.

    Raises:
        BenchError: the recordings are too short.
    """
    if hidden(subject.logs):
        return by_simulation.fit_by_simulation(subject, model, tick)
    search = Search(subject, (), tick, noise)
    view, model = settled(search, model)
    found = estimates(view, view.subsets.fit())
    if not through_simulator or view.of_states:
        return model, between_samples(model, subject.logs[0].dt, found)
    tick("shooting")
    shot = multiple_shooting(model, subject, subject.training, tick)
    held: set[tuple[int, str]] = set()
    while turned := against(found, shot):
        held |= turned
        shot = multiple_shooting(model, subject, subject.training, tick, held)
    better = not lost(found, shot) and shot.after < EXTENDING.shooting_gain * shot.before
    numbers = found if lost(found, shot) else _between(found, shot, better)
    return (shot.model if better else model), between_samples(model, subject.logs[0].dt, numbers)


def started(
    subject: Subject,
    model: PhysicsModel,
    names: Sequence[str],
    noise: Noise | None = None,
    tick: Callable[[str], None] = lambda what: None,
) -> tuple[Subject, PhysicsModel]:
    """``model`` with effects of these ids in their order, all numbers where one regression puts them together.

    Each effect is linearised about the best value of its search grid beside the others. One after another they would
    not do: a drag that is fitted before the wind through which it acts is known goes to its bounds, and so it does
    beside a constant that is held where it cannot be.

    Returns:
        The subject, with the stated constants let go that its recordings contradict, and the model.
    """
    added, grown = dict[str, Effect](), model
    search = None if hidden(subject.logs) else Search(subject, names, tick, noise)
    if search is not None and (look := search.look(model, broad=False)).linear.starts:
        view = search.views(look)[0]
        fit = _beside_one_another(view, names)
        while _let_go(search, view, fit):
            view = search.as_known(view)
            fit = _beside_one_another(view, names)
        step, added = advanced(search, view, fit), fit.effects(len(view.linear.own))
        subject, grown = search.subject, step.model if step.exchanged else model
    # What is not observed is simulated, and what was asked for may lack its signals: such effects start as is typical.
    more = (added[name] if name in added else EFFECTS.get(name).typical_for(model) for name in names)
    return subject, replace(grown, effects=(*grown.effects[: len(model.effects)], *more))


def released(
    subject: Subject, model: PhysicsModel, noise: Noise | None = None, tick: Callable[[str], None] = lambda what: None
) -> tuple[Subject, PhysicsModel]:
    """``model`` fitted, and its subject with the stated constants let go that the recordings contradict beside it.

    One after another, the numbers fitted in between.
    """
    search = Search(subject, (), tick, noise)
    while True:
        _, model = settled(search, model)
        view = min(search.views(search.look(model)), key=lambda v: v.subsets.fit().prior)
        if not _let_go(search, view, view.subsets.fit()):
            return search.subject, model


def _let_go(search: Search, view: View, fit: Fit) -> bool:
    """Whether a stated constant is let go, which would bend those that its equation shares with others.

    Where one equation alone is told there is nothing to bend, and what is stated of it holds.
    """
    equations = {view.linear.model.measured_channels[c].group for c in view.linear.channels}
    return len(equations) > 1 and search.let_go(contradicted(view, fit))


def _beside_one_another(view: View, names: Sequence[str]) -> Fit:
    """A fit of one start of each effect that has any; what acts only through another effect comes with that one.

    Chosen effect by effect, beside those before, and again beside all others until none changes.
    """
    starts = view.linear.starts
    alone = {s.id for s in starts if s.through is None}
    taken: list[Candidate] = []

    def best(beside: Sequence[Candidate], options: Sequence[Candidate]) -> Candidate:
        fits = [view.subsets.fit([*beside, s]) for s in options]
        return min(fits, key=lambda f: (not within_bounds(view, f), f.loss)).starts[-1]

    for name in sorted(names, key=lambda n: n in alone):
        have = {i for s in taken for i in s.ids}
        options = [s for s in starts if name in s.ids and have.isdisjoint(s.ids)]
        taken += [best(taken, options)] if name not in have and options else []
    for _ in range(STEPPING.steps if len(taken) > 1 else 0):
        before = list(taken)
        for i, one in enumerate(before):
            taken[i] = best([*taken[:i], *taken[i + 1 :]], [s for s in starts if s.ids == one.ids])
        if all(a is b for a, b in zip(taken, before, strict=True)):
            break
    return view.subsets.fit(taken)


def between_samples(model: PhysicsModel, dt: float, found: Sequence[Estimate]) -> list[Estimate]:
    """Estimates with what is open between two samples of held commands.

    A controller that gives commands P apart, more often than they are logged, has given them (dt − P) / 2 earlier, on
    average, than held samples say; a lag or a delay behind them is longer by as much, up to dt / 2, than it seems.
    """
    if model.input_hold != "previous":
        return list(found)
    late = {i for i, e in enumerate(model.effects) if isinstance(e, InputEffect)}
    return [
        replace(x, high=min(x.high + dt / 2, x.entry.high)) if x.entry.owner in late and x.entry.unit == "s" else x
        for x in found
    ]


def lost(found: Sequence[Estimate], shot: Shot) -> bool:
    """Whether free runs take a number that the weak form is sure of to where it makes no effect.

    Where torques are a riddle free runs lose the attitude, and say nothing of what acts in forces.
    """
    return any(
        abs(_shot_to(x, shot) - x.entry.neutral) < EXTENDING.neutral * abs(x.value - x.entry.neutral)
        for x in _sure(found)
    )


def against(found: Sequence[Estimate], shot: Shot) -> set[tuple[int, str]]:
    """Owner and label of numbers whose sign the weak form is sure of and free runs turn round.

    Where a free run grows unstable it uses a small effect to steady it, with the wrong sign as well as with the right
    one: such a number is the weak form's, and free runs fit the others around it.
    """
    sure = ((x, x.value - x.entry.neutral, _shot_to(x, shot) - x.entry.neutral) for x in _sure(found))
    return {(x.entry.owner, x.entry.label) for x, before, after in sure if before * after < 0}


def _sure(found: Sequence[Estimate]) -> list[Estimate]:
    """Numbers of effects that differ from no effect for sure."""
    return [x for x in found if not x.entry.constant and not x.low <= x.entry.neutral <= x.high]


def _shot_to(x: Estimate, shot: Shot) -> float:
    """The value of a number after shooting; its own where that left it out."""
    ends = (e.value for e in shot.free if (e.owner, e.label) == (x.entry.owner, x.entry.label))
    return next(ends, x.value)


def _between(found: Sequence[Estimate], shot: Shot, moved: bool) -> list[Estimate]:
    """Estimates of the weak form, ``moved`` to where shooting has them or not, worth no more than both differ."""
    sigma = np.sqrt(np.maximum(np.diag(shot.covariance), 0.0))
    spread = {(e.owner, e.label): s for e, s in zip(shot.free, sigma, strict=True)}
    out = []
    for x in found:
        after = _shot_to(x, shot)
        half = max((x.high - x.low) / 2, abs(after - x.value))
        if moved:
            half = max(half, EXTENDING.interval * spread.get((x.entry.owner, x.entry.label), 0.0))
        value = after if moved else x.value
        low, high = x.entry.interval(value, half)
        out.append(replace(x, value=value, low=low, high=high))
    return out
