"""Which effects a model lacks whose states were not all measured: every set is simulated, fitted and compared.

The weak form needs every state; here each candidate set of effects is fitted by shooting (`simulation_fit`). A larger
set must be better by Bayes's information criterion and on windows that were not fitted.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np
import torch
from scipy.special import stdtrit

from bench.diagnose.logs.subject import Subject
from bench.diagnose.regression.parameters import Prior
from bench.diagnose.select.discovery import Discovery, Found, RejectedCandidate
from bench.diagnose.select.search import admissible
from bench.diagnose.select.subset import t_value
from bench.diagnose.select.verify import Estimate
from bench.diagnose.settings import GROWING, SIMULATING, VERIFYING
from bench.diagnose.simulate.simulation_fit import Simulated, StartingPoint, Windows, fit, starts
from registry.core import EFFECTS
from registry.dynamics import Effect, PhysicsModel


@dataclass(frozen=True, eq=False)
class Choice:
    """A set of effects, fitted."""

    ids: tuple[str, ...]
    fitted: Simulated
    subject: Subject
    windows: Windows

    @property
    def parameters(self) -> int:
        """Numbers of the added effects."""
        return sum(not e.constant for e in self.fitted.where)

    @cached_property
    def held_out(self) -> np.ndarray:
        """(W,) squared error of each window, from fits without it."""
        count = len(self.windows.log)
        folds = np.array_split(np.arange(count), min(GROWING.folds, count))
        weights = np.ones((len(folds), count))
        for row, fold in zip(weights, folds, strict=True):
            row[fold] = 0.0
        apart = fit(self.subject, self.windows, [self.fitted] * len(folds), weights, GROWING.first)
        return np.concatenate([a.loss[f] for a, f in zip(apart, folds, strict=True)])


def discover(subject: Subject, catalogue: Sequence[str] | None, tick: Callable[[str], None]) -> Discovery:
    """Find what the model of ``subject`` lacks; see `bench.diagnose.discover.discover`."""
    windows, known = Windows.of(subject.of(subject.training)), len(subject.model.effects)
    kinds = dict(admissible(subject, subject.model, catalogue))
    with torch.no_grad():
        tick("calibrate")
        base = Choice((), _fit(subject, windows, [subject.model]), subject, windows)
        fields, taken = [[base]], base
        for _ in range(GROWING.most):
            field = []
            for name in kinds:
                if name not in taken.ids:
                    tick(" + ".join((*taken.ids, name)))
                    model = taken.fitted.model
                    grown = [replace(model, effects=(*model.effects, e)) for e in _points(name, model)]
                    field.append(Choice((*taken.ids, name), _fit(subject, windows, grown), subject, windows))
            if not field:
                break
            fields.append(_refitted(field, taken, tick))
            if not _accepted(taken, fields[-1][0]):
                break
            taken = fields[-1][0]
        field = next((f for f in fields if taken in f), [taken])
        alike = [c for c in field if c is not taken and _alike(taken, c)]
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
        rest, name = model.effects[:-1], EFFECTS.name_of(type(model.effects[-1]))
        starts += [replace(model, effects=(*rest, e)) for e in _points(name, model)]
    with torch.no_grad():
        done = _fit(subject, windows, starts)
    return done.model, estimates(done, len(windows.log))


def estimates(of: Simulated, windows: int) -> list[Estimate]:
    """Numbers with 95 % intervals; what is left counts as often as it is independent, less what was fitted."""
    free = max(independent(of) - len(of.where) - windows, 2.0)
    prior = Prior.of(of.where).precision
    information = of.gram * free / float(of.loss.sum()) + np.diag(prior)
    half = float(stdtrit(free, 0.975)) * np.sqrt(np.maximum(np.diag(np.linalg.pinv(information)), 0.0))
    pairs = zip(of.where, half, strict=True)
    return [Estimate(e, e.value, *e.interval(e.value, h)) for e, h in pairs]


def independent(of: Simulated) -> float:
    """How many independent observations the errors of a fit are worth, by their correlation in time."""
    total = 0.0
    for x in of.errors.transpose(0, 2, 1).reshape(-1, of.errors.shape[1]):
        y = x - x.mean()
        own = np.correlate(y, y, "full")[len(y) - 1 :] / max(float(y @ y), 1e-300)
        until = int(np.argmax(own < 0)) or len(own)
        total += len(x) / max(1.0, 2 * float(own[:until].sum()) - 1)
    return total


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


def _refitted(field: Sequence[Choice], smaller: Choice, tick: Callable[[str], None]) -> list[Choice]:
    """Sets of one size, the best first; it and those like it are fitted a second time before they are compared.

    Other numbers of a set were those of the smaller one when its search grid was tried: that may be the valley of
    another solution. The second time they are its own.
    """
    again: dict[tuple[str, ...], Choice] = {}
    while True:
        field = sorted((again.get(c.ids, c) for c in field), key=lambda c: _criterion(c, smaller))
        close = [c for c in field if c.ids not in again and (c is field[0] or _alike(field[0], c))]
        if not close:
            return field
        tick(" + ".join(close[0].ids))
        again[close[0].ids] = _around(close[0])


def _around(choice: Choice) -> Choice:
    """The same effects, fitted once more from the whole search grid of each with all else as it was found."""
    model, known = choice.fitted.model, len(choice.fitted.model.effects) - len(choice.ids)
    begin = [
        replace(model, effects=(*model.effects[:i], point, *model.effects[i + 1 :]))
        for i, name in enumerate(choice.ids, known)
        for point in _points(name, model)
    ]
    found = _fit(choice.subject, choice.windows, begin)
    return replace(choice, fitted=found) if found.loss.sum() < choice.fitted.loss.sum() else choice


def _points(name: str, model: PhysicsModel) -> list[Effect]:
    """An effect from every value of its search grid, all else typical, so that every parameter is felt."""
    kind = EFFECTS.get(name)
    grid = [dict(zip(kind.screen, values, strict=True)) for values in product(*kind.screen.values())]
    return [replace(kind.typical_for(model), **values) for values in grid]


def _criterion(c: Choice, other: Choice) -> float:
    """Bayes's information criterion against another choice."""
    free = independent(c.fitted)
    gain = free * float(np.log(c.fitted.loss.sum() / other.fitted.loss.sum()))
    return gain + (c.parameters - other.parameters) * float(np.log(free))


def _log_gain(smaller: Choice, larger: Choice) -> np.ndarray:
    return np.asarray(np.log(np.maximum(smaller.held_out, 1e-300) / np.maximum(larger.held_out, 1e-300)))


def _accepted(smaller: Choice, larger: Choice) -> bool:
    """Whether the larger set is better by the criterion and on windows that were not fitted."""
    saved = smaller.held_out.sum() > larger.held_out.sum() and t_value(_log_gain(smaller, larger)) > GROWING.sure
    return bool(saved) and _criterion(larger, smaller) < -VERIFYING.odds


def _alike(taken: Choice, other: Choice) -> bool:
    """Whether another set of the same size does as well, or nearly."""
    near = _criterion(other, taken)
    return near < VERIFYING.odds or (
        near < GROWING.disputed * VERIFYING.odds and t_value(_log_gain(other, taken)) < GROWING.sure
    )


def _round(base: Choice, taken: Choice, field: Sequence[Choice]) -> tuple[RejectedCandidate, ...]:
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
