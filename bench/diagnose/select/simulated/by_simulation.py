"""Which effects a model lacks whose states were not all measured: every set is simulated, fitted and compared.

The weak form needs every state; here each candidate set of effects is fitted by shooting (`simulation_fit`). A larger
set must be better by Bayes's information criterion and on windows that were not fitted.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import torch
from scipy.special import stdtrit

from bench.diagnose.logs.subject import LogBatch, Subject
from bench.diagnose.regression.parameters import Prior
from bench.diagnose.regression.starting_points import StartingPoints
from bench.diagnose.select.catalogue import admissible
from bench.diagnose.select.choose import RejectedCandidate
from bench.diagnose.select.discovery import Discovery, Found
from bench.diagnose.select.simulated.simulated_set import SimulatedSet, independent
from bench.diagnose.select.subset import t_value
from bench.diagnose.select.tie import does_as_well
from bench.diagnose.select.verify import Estimate
from bench.diagnose.settings import GROWING, SIMULATING, VERIFYING
from bench.diagnose.simulate.simulation_fit import Simulated, StartingPoint, Windows, fit, starts
from bench.diagnose.simulate.unmeasured import completed
from registry.core import EFFECTS
from registry.dynamics import PhysicsModel


def discover(subject: Subject, catalogue: Sequence[str] | None, tick: Callable[[str], None]) -> Discovery:
    """Find what the model of ``subject`` lacks; see `bench.diagnose.discover.discover`."""
    windows, known = Windows.of(subject.of(subject.training)), len(subject.model.effects)
    kinds = dict(admissible(subject, subject.model, catalogue))
    with torch.no_grad():
        tick("calibrate")
        base = SimulatedSet((), _fit(subject, windows, [subject.model]), subject, windows)
        fields, taken, points = [[base]], base, _points(windows, base.fitted.model)
        for _ in range(GROWING.most):
            field = []
            for name in kinds:
                if name not in taken.ids:
                    tick(" + ".join((*taken.ids, name)))
                    model = taken.fitted.model
                    grown = [replace(model, effects=(*model.effects, e)) for e in points.felt(EFFECTS.get(name))]
                    field.append(SimulatedSet((*taken.ids, name), _fit(subject, windows, grown), subject, windows))
            if not field:
                break
            fields.append(_refitted(field, taken, points, tick))
            if not _accepted(taken, fields[-1][0]):
                break
            taken = fields[-1][0]
        field = next((f for f in fields if taken in f), [taken])
        alike = [c for c in field if c is not taken and does_as_well(c, taken)]
    numbers = estimates(taken.fitted, len(windows.log))
    effects = taken.fitted.model.effects[known:]
    found = []
    for i, (name, effect) in enumerate(zip(taken.ids, effects, strict=True)):
        rest = set(taken.ids) - {name}
        rivals = tuple(next(iter(set(c.ids) - rest)) for c in alike if rest < set(c.ids))
        own = tuple(x for x in numbers if x.entry.owner == known + i)
        found.append(Found(name, effect, own, float((base.fitted.loss - taken.fitted.loss).sum()), rivals))
    return Discovery(
        base.fitted.model,
        taken.fitted.model,
        tuple(found),
        tuple(_round(base, taken, f) for f in fields[1:]),
        (),
        tuple(x for x in numbers if x.entry.constant),
    )


def fit_by_simulation(
    subject: Subject, model: PhysicsModel, tick: Callable[[str], None] = lambda what: None
) -> tuple[PhysicsModel, list[Estimate]]:
    """Constants within their uncertainty and all effects of ``model``, fitted on the training recordings.

    The last effect is tried from its whole search grid too: the constants of a model without it may lie in the valley
    of another solution.
    """
    tick("shooting")
    windows, starts = Windows.of(subject.of(subject.training)), [model]
    if model.effects:
        rest, last = model.effects[:-1], type(model.effects[-1])
        starts += [replace(model, effects=(*rest, e)) for e in _points(windows, model).felt(last)]
    with torch.no_grad():
        done = _fit(subject, windows, starts)
    return done.model, estimates(done, len(windows.log))


def estimates(of: Simulated, windows: int) -> list[Estimate]:
    """Numbers with 95 % intervals; what is left counts as often as it is independent, less what was fitted.

    Without those that nothing follows, such as the slope over a voltage that was not measured.
    """
    free = max(independent(of) - len(of.where) - windows, 2.0)
    prior = Prior.of(of.where).precision
    information = of.gram * free / float(of.loss.sum()) + np.diag(prior)
    half = float(stdtrit(free, 0.975)) * np.sqrt(np.maximum(np.diag(np.linalg.pinv(information)), 0.0))
    acts = np.diag(information) > 0
    told = zip(of.where, half, acts, strict=True)
    return [Estimate(e, e.value, *e.told(e.value, h)) for e, h, acting in told if acting]


def _fit(subject: Subject, windows: Windows, models: Sequence[PhysicsModel]) -> Simulated:
    """The best fit from several starting points, of which the better half goes on each time, for twice as many steps.

    (Successive halving: Jamieson and Talwalkar, AISTATS 2016.) They are also led there by windows that grow: over a
    short one no free run falls out of step with the measurement, which makes a valley of every missed period; but it
    says little of what is slow, so both ways are gone to their ends: a start that was led has more steps behind it.
    """

    def best(field: Sequence[Simulated], count: int) -> list[Simulated]:
        return sorted(field, key=lambda f: f.loss.sum())[:count]

    def ended(field: Sequence[StartingPoint]) -> Simulated:
        steps = GROWING.first
        while len(field) > 1:
            field = best(fit(subject, windows, field, steps=steps), len(field) // 2)
            steps *= 2
        return fit(subject, windows, field, steps=max(steps, SIMULATING.steps))[0]

    begin = starts(windows, models)
    led: Sequence[StartingPoint] = begin
    for samples in GROWING.lengths:
        led = best(fit(subject, windows.shortened(samples), led, steps=GROWING.first), GROWING.likely)
    return best([ended(begin), ended(led)], 1)[0]


def _points(windows: Windows, model: PhysicsModel) -> StartingPoints:
    """Where a search for effects in ``model`` starts; states that were not measured are as it carries them."""
    stack = LogBatch.of(windows.logs)
    return StartingPoints.of(model, stack.samples(completed(model, stack)), stack.samples(stack.inputs), stack.logs[0])


def _refitted(
    field: Sequence[SimulatedSet], smaller: SimulatedSet, points: StartingPoints, tick: Callable[[str], None]
) -> list[SimulatedSet]:
    """Sets of one size, the best first; it and those like it are fitted a second time before they are compared.

    Other numbers of a set were those of the smaller one when its search grid was tried: that may be the valley of
    another solution. The second time they are its own.
    """
    again: dict[tuple[str, ...], SimulatedSet] = {}
    while True:
        field = sorted((again.get(c.ids, c) for c in field), key=lambda c: c.criterion(smaller))
        close = [c for c in field if c.ids not in again and (c is field[0] or does_as_well(c, field[0]))]
        if not close:
            return field
        tick(" + ".join(close[0].ids))
        again[close[0].ids] = _around(close[0], points)


def _around(choice: SimulatedSet, points: StartingPoints) -> SimulatedSet:
    """The same effects, fitted once more from the whole search grid of each with all else as it was found."""
    model, known = choice.fitted.model, len(choice.fitted.model.effects) - len(choice.ids)
    begin = [
        replace(model, effects=(*model.effects[:i], point, *model.effects[i + 1 :]))
        for i, name in enumerate(choice.ids, known)
        for point in points.felt(EFFECTS.get(name))
    ]
    found = _fit(choice.subject, choice.windows, begin)
    return replace(choice, fitted=found) if found.loss.sum() < choice.fitted.loss.sum() else choice


def _accepted(smaller: SimulatedSet, larger: SimulatedSet) -> bool:
    """Whether the larger set is better by the criterion and on windows that were not fitted."""
    saved = smaller.held_out.sum() > larger.held_out.sum() and t_value(smaller.log_gain(larger)) > GROWING.sure
    return bool(saved) and larger.criterion(smaller) < -VERIFYING.odds


def _round(base: SimulatedSet, taken: SimulatedSet, field: Sequence[SimulatedSet]) -> tuple[RejectedCandidate, ...]:
    """The sets of one size, as a reader compares them."""
    before, out = base.fitted.loss, []
    for c in field[:8]:
        gains = before - c.fitted.loss
        share = float(gains.sum() / before.sum())
        half = 1.96 * float(gains.std(ddof=1)) * len(gains) ** 0.5 / float(before.sum()) if len(gains) > 1 else 0.0
        text = "; ".join(
            f"{n}: " + ", ".join(f"{p.name} = {p.value:.3g} {p.unit}" for p in e.parameters() if p.uncertainty > 0)
            for n, e in zip(c.ids, c.fitted.model.effects[-len(c.ids) :], strict=True)
        )
        why = ""
        if c is not taken:
            times = float(c.fitted.loss.sum() / taken.fitted.loss.sum())
            why = f"leaves {times:.2g} times the squared error of {' + '.join(taken.ids) or 'the base model'}"
        out.append(RejectedCandidate(" + ".join(c.ids), share, share - half, share + half, text, why))
    return tuple(out)
