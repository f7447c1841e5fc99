"""Fit all numbers of a model with its effects: the weak form first, then free runs by shooting."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from bench.diagnose.logs.noise import Noise
from bench.diagnose.logs.subject import Subject
from bench.diagnose.select.search import Search
from bench.diagnose.select.simulated import by_simulation
from bench.diagnose.select.step import settled
from bench.diagnose.select.verify import Estimate, estimates
from bench.diagnose.settings import EXTENDING
from bench.diagnose.simulate.multiple_shooting import Shot, multiple_shooting
from bench.diagnose.simulate.unmeasured import hidden
from registry.dynamics import InputEffect, PhysicsModel


def fit_parameters(
    subject: Subject,
    model: PhysicsModel,
    noise: Noise | None = None,
    tick: Callable[[str], None] = lambda what: None,
    through_simulator: bool = True,
) -> tuple[PhysicsModel, list[Estimate]]:
    """Constants within their uncertainty and all effects of ``model``, fitted on the training recordings.

    The weak form first, which needs no good start; then, with ``through_simulator``, multi-step shooting, whose numbers
    are taken where they predict plainly better. Intervals hold both.

    Raises:
        BenchError: the recordings are too short.
    """
    if hidden(subject.logs):
        return by_simulation.fit_by_simulation(subject, model, tick)
    search = Search(subject, (), tick, noise)
    view, model = settled(search, model)
    found = estimates(view, view.subsets.fit())
    if not through_simulator:
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
