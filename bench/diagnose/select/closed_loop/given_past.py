"""What inputs do beside a slow disturbance that nobody measured, as its past tells it.

Below the bandwidth of a controller inputs cancel what disturbs a system: there they seem to do nothing, and a constant
such as the inertia runs away. Fast motion tells it. So numbers and the noise of that equation are fitted in turns, with
the constant known as stated, from rows of differences on: what is slow becomes noise, which its own past foretells
(L. Ljung, *System Identification*, 2nd ed. 1999, section 13.4: a direct fit in closed loop is right only with a right
model of the noise). The likelihood has another maximum, in which the inputs do nothing; which of the two is right is
settled on held-out recordings, by how well each foretells a short horizon *given the moments before*.
"""

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from bench.diagnose.by_equation import GivenPast, ObscuredConstant
from bench.diagnose.logs.subject import Subject, drives_of
from bench.diagnose.regression.least_squares import whitening
from bench.diagnose.regression.linearise import Linearization
from bench.diagnose.regression.parameters import entries, with_values
from bench.diagnose.select.materiality import Weighing
from bench.diagnose.select.release import obscured
from bench.diagnose.select.search import Search, View
from bench.diagnose.select.step import advanced, close, without
from bench.diagnose.select.subset import Fit, Subsets
from bench.diagnose.select.verify import estimates
from bench.diagnose.settings import EXTENDING, MATTERING, RELEASING, STEPPING
from bench.diagnose.simulate.disturbance import pasts
from bench.diagnose.simulate.teacher_forced import increments
from registry.core import EFFECTS
from registry.dynamics import InputEffect, PhysicsModel


def revealed(
    search: Search,
    view: View,
    fit: Fit,
    other: PhysicsModel,
    subject: Subject,
    weighing: Weighing | None,
) -> tuple[ObscuredConstant, ...]:
    """Constants that a fit takes far off where inputs do nothing, and what they are beside a slow disturbance.

    Where inputs do something, what was stated is wrong.

    Args:
        search: of the training recordings.
        view: of the model with its effects.
        fit: its numbers.
        other: the model with these.
        subject: with what was known of the constants before any was let go.
        weighing: held-out recordings; None: there are none, and nothing is confirmed.
    """
    far = obscured(view, fit, search.subject)
    found = [c for c in far if weighing is None or idle(weighing, other, [c.equation])]
    out = []
    for group in dict.fromkeys(c.group for c in found):
        these = [c for c in found if c.group == group]
        model, last = given_past(search, view, other, subject, {c.constant for c in these}, group)
        repeats = max(
            share if rise > RELEASING.slow else 0.0
            for c, f in zip(last.linear.channels, last.filters, strict=True)
            if model.measured_channels[c].group == group
            for share, rise in [memory(f)]
        )
        told = None if weighing is None or not repeats else _told(weighing, last, other, model, group)
        out += [replace(c, repeats=repeats, told=told) for c in these]
    return tuple(out)


def idle(weighing: Weighing, model: PhysicsModel, names: Collection[str]) -> bool:
    """Whether inputs do next to nothing in the equations ``names``: with all at their mean every state errs alike."""
    held = weighing.held
    inputs, drives = held.inputs.clone(), drives_of(model, held.logs[0])
    inputs[..., :drives] = held.samples(inputs)[:, :drives].mean(0)
    at = [c for e in weighing.equations if e.name in names for c in e.group.at]
    horizon = weighing.horizons[1]
    still, driven = (
        (left.over(horizon, max(1, horizon // 4))[0][:, at] ** 2).mean(0)
        for left in (increments(model, replace(held, inputs=inputs), weighing.noise), weighing.increments(model))
    )
    return bool((still <= MATTERING.lost**2 * driven).all())


def _told(weighing: Weighing, last: View, other: PhysicsModel, model: PhysicsModel, group: str) -> GivenPast | None:
    """The numbers of a fit that held-out recordings confirm; None: they do not."""
    gain = foretold(weighing, other, model, group)
    if gain.low <= 0 or gain.saves < MATTERING.share:
        return None
    numbers, effects = {}, model.effects
    worth = {
        i
        for i in range(len(effects))
        if isinstance(effects[i], InputEffect)
        for less in [foretold(weighing, without(model, [i]), model, group)]
        if less.low > 0 and less.saves >= MATTERING.share
    }
    for x in estimates(last, last.subsets.fit()):
        e = x.entry
        narrow = x.high - x.low < EXTENDING.determined * 2 * EXTENDING.interval * e.scale
        if (e.constant and narrow and e.low < x.value < e.high) or e.owner in worth:
            name = e.label if e.constant else f"{EFFECTS.name_of(type(effects[e.owner]))}.{e.label}"
            numbers[name] = (float(x.value), e.unit)
    return replace(gain, numbers=numbers) if any(e.constant and e.label in numbers for e in last.linear.own) else None


def given_past(
    search: Search, view: View, other: PhysicsModel, subject: Subject, names: Collection[str], group: str
) -> tuple[PhysicsModel, View]:
    """``other`` fitted again beside a slow disturbance of one equation, the last view on the way there.

    All other constants stay: what two equations share, the others tell.

    Args:
        search: of the training recordings.
        view: of a model of the same channels; all other equations are whitened as in it.
        other: with constants that were let go.
        subject: with what was known of them before.
        names: theirs.
        group: the states that the equation moves.
    """
    known = entries(subject.model, subject.uncertainty)
    where = [e for e in known if e.constant and e.name in names]
    held = {e.name: 0.0 for e in known if e.constant and e.name not in names}
    beside = search.of(replace(subject, uncertainty=subject.uncertainty | held))
    model = with_values(other, where, np.array([e.value for e in where]))
    for _ in range(STEPPING.steps):
        look = beside.own(model)
        filters = _in_turns(beside, look.linear, _matched(view, look.linear), group)
        (now, *_) = beside.views(look, like=replace(view, linear=look.linear, filters=tuple(filters)))
        before, model = model, advanced(beside, now, now.subsets.fit()).model
        if close(before, model, beside.subject):
            break
    return model, now


def _matched(view: View, linear: Linearization) -> list[np.ndarray]:
    return [view.filters[view.linear.channels.index(c)] for c in linear.channels]


def _in_turns(search: Search, linear: Linearization, filters: list[np.ndarray], group: str) -> list[np.ndarray]:
    """Whitening filters, those of the equation fitted in turns with the numbers."""
    rows = linear.project(search.tests(linear))
    order = max(1, len(filters[0]) - 1)  # rows that all counted alike have no past
    filters = [np.pad(f, (0, order + 1 - len(f))) for f in filters]
    ours = [k for k, c in enumerate(linear.channels) if linear.model.measured_channels[c].group == group]
    difference = np.zeros(order + 1)
    difference[:2] = 1.0, -1.0
    left = rows.residuals(np.zeros(rows.width))
    for k in ours:
        filters[k] = difference / max(float(np.concatenate([np.diff(r[:, k]) for r in left]).std()), 1e-300)
    for _ in range(RELEASING.turns):
        fit = Subsets(linear, rows.whitened(filters).normal()).fit()
        beta = np.zeros(rows.width)
        beta[list(fit.columns)] = fit.beta
        left = rows.residuals(beta)
        for k in ours:
            filters[k] = whitening([r[:, k] for r in left], order)
    return filters


def foretold(weighing: Weighing, without: PhysicsModel, model: PhysicsModel, group: str) -> GivenPast:
    """What ``model`` saves of the error of ``without`` over the short horizon, both given what went before.

    Args:
        weighing: held-out recordings, and those that the past's weights are learned from.
        without: a model.
        model: another one.
        group: the states whose equation is judged.
    """
    at = next(e.group.at for e in weighing.equations if e.group.name == group)
    horizon = weighing.horizons[0]
    before, after = (_unforetold(weighing, m, at, horizon) for m in (without, model))
    block = weighing.blocks(weighing.increments(model), horizon)
    gains = np.bincount(block, before - after) / np.maximum(np.bincount(block), 1)
    mean, all_ = float(gains.mean()), max(float(before.mean()), 1e-300)
    spread = float(gains.std(ddof=1)) / len(gains) ** 0.5 if len(gains) > 1 else np.inf
    low, high = ((mean + side * MATTERING.sure * spread) / all_ for side in (-1, 1))
    return GivenPast({}, mean / all_, low, high, horizon * weighing.held.dt)


def _unforetold(weighing: Weighing, model: PhysicsModel, at: Sequence[int], horizon: int) -> np.ndarray:
    """Squared errors (W,) of a model's equation on held-out recordings that its own past does not tell."""
    late = weighing.noise.half_width
    parts = []
    for left in (increments(model, weighing.train, weighing.noise), weighing.increments(model)):
        errors, recording, first = left.over(horizon, max(1, horizon // 4))
        parts.append((errors[:, list(at)], pasts(left, at, weighing.horizons[1], late)[recording, first]))
    (learnt, known), (errors, past) = parts
    for c in range(len(at)):
        gains = np.linalg.lstsq(known[:, c], learnt[:, c], rcond=None)[0]
        errors[:, c] -= past[:, c] @ gains
    squared: np.ndarray = (errors**2).sum(1)
    return squared


def memory(whitener: np.ndarray) -> tuple[float, float]:
    """Of what a filter makes white: the share of it that its past tells, and its density at rest over the mean one.

    Args:
        whitener: (order + 1,) coefficients; see `least_squares.whitening`.
    """
    answer = np.zeros(RELEASING.remembered)  # to one disturbance: what is left is white noise through this
    for i in range(len(answer)):
        past = answer[max(0, i - len(whitener) + 1) : i][::-1]
        answer[i] = (float(i == 0) - whitener[1 : len(past) + 1] @ past) / whitener[0]
    power = float((answer**2).sum())
    return 1.0 - float(answer[0] ** 2) / power, float(answer.sum() ** 2) / power
