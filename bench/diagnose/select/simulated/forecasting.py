"""Effects that free runs ask for and no equation does by itself.

Under feedback an equation that is judged at measured states says little of what brings these states back: a controller
answers every disturbance that nobody measured, and the damping beside it hides in what the inputs cancel. A free run
lives on it. Such effects make better forecasts and are no finding: the air and the controller look the same in them.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import torch

from bench.diagnose.logs.parts import stretch
from bench.diagnose.logs.subject import LogBatch, Subject
from bench.diagnose.regression.parameters import entries, probes, with_values
from bench.diagnose.regression.weak import midpoint_rates
from bench.diagnose.select.catalogue import admissible
from bench.diagnose.select.verify import Estimate
from bench.diagnose.settings import EXTENDING, FORECASTING
from bench.diagnose.simulate.free_run import default_steps
from bench.diagnose.simulate.multiple_shooting import Shot, multiple_shooting, relative_error
from bench.diagnose.simulate.unmeasured import hidden
from bench.execution.parallel import side_by_side
from registry.dynamics import Effect, PhysicsModel


def forecasting(
    subject: Subject,
    model: PhysicsModel,
    catalogue: Sequence[str] | None = None,
    tick: Callable[[str], None] = lambda what: None,
) -> tuple[PhysicsModel, tuple[Estimate, ...]]:
    """A model with the one effect of the catalogue without which its free runs err far more.

    Only recordings that are learnt from choose and fit. Beside all numbers as they are, what is fitted to one half of
    them must help the other half; the numbers of the equation in which the effect acts are then fitted with it.

    Args:
        subject: measurements, read when the inputs act.
        model: with the effects that were found.
        catalogue: ids of the effects to choose from; None: all.
        tick: called with what is being done.

    Returns:
        The model with the effect behind its own, and all numbers that were fitted; ``model`` itself where there is
        none, where a state was not measured, and where there are no two recordings to learn from in which a free run
        finds room.
    """
    halves = subject.training[::2], subject.training[1::2]
    room = min(max(map(stretch, subject.of(names)), default=0) for names in halves)
    if hidden(subject.logs) or room <= default_steps(subject.logs):
        return model, ()
    tick("forecasts")

    def alone(candidate: tuple[str, type[Effect]]) -> Shot:
        _, kind = candidate
        grown = replace(model, effects=(*model.effects, kind.neutral_for(model, {})))
        return _fitted(subject, grown, subject.training, _own(subject, grown))

    shots = side_by_side(alone, admissible(subject, model, catalogue))
    best = min(shots, key=lambda s: s.after, default=None)
    if best is None or best.after >= FORECASTING.gain:
        return model, ()
    own = _own(subject, best.model)
    parts = [_fitted(subject, best.model, names, own) for names in halves]
    if any(relative_error(model, s.model, subject, n) >= 1 for s, n in zip(parts, halves[::-1], strict=True)):
        return model, ()
    whole = _fitted(subject, best.model, subject.training, own | _beside(subject, best.model))
    return whole.model, tuple(_estimates(whole, best, parts))


Numbers = set[tuple[int, str]]
"""Owner and label of each."""


def _own(subject: Subject, model: PhysicsModel) -> Numbers:
    """The numbers of the last effect."""
    numbers = entries(model, subject.uncertainty, subject.model)
    return {(e.owner, e.label) for e in numbers if e.owner == len(model.effects) - 1}


def _beside(subject: Subject, model: PhysicsModel) -> Numbers:
    """The numbers, but of learned terms, that move the same states as the last effect, and no others."""
    *rest, last = model.effects
    model = replace(model, effects=(*rest, type(last).typical_for(model)))  # at its neutral value it moves nothing
    where = entries(model, subject.uncertainty, subject.model)
    (log, *_), (values, _) = subject.of(subject.training), probes(where)
    stack = LogBatch.of([log.part(slice(0, FORECASTING.looked_at), log.name)])
    with torch.no_grad():
        rates = midpoint_rates(with_values(model, where, values), stack).flatten(1, 2)
    acts = (rates[1:] != rates[0]).any(1)  # (numbers, states)
    where_last = acts[[e.owner == len(rest) for e in where]].any(0)
    learned = {i for i, e in enumerate(rest) if e.learned}
    return {
        (e.owner, e.label)
        for e, at in zip(where, acts, strict=True)
        if e.owner not in learned and at.any() and not (at & ~where_last).any()
    }


def _fitted(subject: Subject, model: PhysicsModel, names: Sequence[str], free: Numbers) -> Shot:
    """A model, of which these numbers are fitted to free runs of some recordings."""
    numbers = {(e.owner, e.label) for e in entries(model, subject.uncertainty, subject.model)}
    return multiple_shooting(model, subject, names, held=numbers - free)


def _estimates(whole: Shot, alone: Shot, parts: Sequence[Shot]) -> list[Estimate]:
    """Numbers with 95 % intervals, not narrower than what is told of an effect alone and by halves of the recordings.

    Numbers that were there before have no interval of their own: they are told as far as they moved.
    """
    half = EXTENDING.interval * np.sqrt(np.maximum(np.diag(alone.covariance), 0.0))
    others = [{e.label: e.value for e in s.free} for s in (alone, *parts)]
    known = {e.label: (h, [o[e.label] for o in others]) for e, h in zip(alone.free, half.tolist(), strict=True)}
    out = []
    for e in whole.free:
        width = 0.0
        if e.owner == alone.free[0].owner:
            sigma, values = known[e.label]
            width = max(sigma, *(abs(v - e.value) for v in values))
        out.append(Estimate(e, e.value, *e.interval(e.value, width)))
    return out
