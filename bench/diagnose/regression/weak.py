"""The weak form: changes of the measured state against the model's integral, through smooth test functions.

With a test function φ (a Hann window over intervals) the residual of ẋ = f(x, u) is

    r_j = Σ_k φ_jk (x_{k+1} − x_k) − dt Σ_k φ_jk (κ ∗ f)_k,

where κ is the smoothing that the measured states went through and f_k the mean of f over an interval (`mean_rates`).
Nothing is differentiated and no initial state is needed; as κ acts on both sides, a smoothed rate is not taken for a
weak motor. After Messenger and Bortz, "Weak SINDy" (2021).
"""

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, TypeVar

import torch
from torch import Tensor

from bench.diagnose.logs.subject import Log, LogBatch
from bench.diagnose.regression.recall import RECALLED, recall
from bench.diagnose.regression.recurrence import solved
from bench.diagnose.settings import LINEARISING
from registry.dynamics import Effect, InputEffect, PhysicsModel, joined
from registry.effects.waves.hidden_mode import HiddenMode
from registry.equations import models
from registry.terms import signals

M = TypeVar("M", bound=PhysicsModel)


def midpoint_rates(model: PhysicsModel, stack: LogBatch) -> Tensor:
    """The model's rates (…, L, N − 1, s) of the state proper at the mean of states and inputs over each interval.

    Where all recordings have the sensors, followed by what they would show (…, L, N − 1, s + f).

    The model's constants and its effects' parameters may be tensors (…, 1, 1), for many models at once.
    """
    _, mean, slopes = _driving(model, stack)
    own = _own_path(model, stack, mean, slopes) if model.internal_size else None
    return _rates(model, stack, stack.between, _halfway(own), mean, slopes)


def mean_rates(model: PhysicsModel, stack: LogBatch) -> Tensor:
    """The mean (…, L, N − 1, s) over each sampling interval of the model's rates; like `midpoint_rates` (s + f).

    By Hermite-Simpson: along the cubic through the two samples that has the model's rates at both. The rates at their
    mean are off by h² d²x/dt² / 12 and by what bends the rates themselves, which in an equation that is known well
    looks like something that is missing. Of recordings that were thinned out the mean over all that was left out; of
    slopes, whose means are known better than the samples, the rates at the mean.

    Source: Hargraves and Paris, Direct trajectory optimization using nonlinear programming and collocation (1987).
    """
    states = stack.states if stack.finer is None else stack.finer
    if stack.missed is not None or (stack.means is not None and stack.finer is None):
        return midpoint_rates(model, stack)
    path, mean, slopes = _driving(model, stack)
    own = _own_path(model, stack, mean, slopes) if model.internal_size else None
    stride = max(1, states.shape[1] - 1) // max(1, stack.states.shape[1] - 1)
    slopes, size = slopes.repeat_interleave(stride, -2), states.shape[-1]

    def at(share: float, x: Tensor) -> Tensor:
        """Rates where states are ``x`` (L, (N − 1) stride, s), after a share of each interval between these."""
        since = ((torch.arange(stride) + share) / stride).unsqueeze(-1).to(x)  # (stride, 1), of an interval
        acting = _through(path, since).flatten(-3, -2)
        inner = (
            None if own is None else torch.lerp(own[..., :-1, None, :], own[..., 1:, None, :], since).flatten(-3, -2)
        )
        return _rates(model, stack, x, inner, acting, slopes)

    first, last = at(0.0, states[:, :-1]), at(1.0, states[:, 1:])
    measured = torch.tensor([i in stack.measured for i in range(size)])
    bend = torch.where(measured, stack.dt / stride / 8 * (first - last)[..., :size], 0.0)
    halfway = at(0.5, (states[:, :-1] + states[:, 1:]) / 2 + bend)
    means = _simpson(first, halfway, last)
    means[..., size:] = (first + last)[..., size:] / 2  # as what sensors showed is summed
    return means.unflatten(-2, (-1, stride)).mean(-2)


def _through(path: Tensor, since: Tensor) -> Tensor:
    """The parabola (…, N, J, m) through what is known at start, middle and end (…, N, 3, m), after shares (J, 1)."""
    first, middle, last = path.unsqueeze(-3).unbind(-2)
    return first + since * (last - first) + 4 * since * (1 - since) * (middle - (first + last) / 2)


def _simpson(first: Tensor, halfway: Tensor, last: Tensor) -> Tensor:
    """The mean over an interval, of what is known at its start, in its middle and at its end."""
    return (first + 4 * halfway + last) / 6


def _driving(model: PhysicsModel, stack: LogBatch) -> tuple[Tensor, Tensor, Tensor]:
    """What acts (…, L, N − 1, 3, m) at start, middle and end of each interval, its mean (…, m) and time derivative."""
    path = _transmitted(model, stack)
    return path, _simpson(*path.unbind(-2)), (path[..., 2, :] - path[..., 0, :]) / stack.dt


def _halfway(own: Tensor | None) -> Tensor | None:
    """Effects' own states (…, L, N, i) in the middle of each interval."""
    return None if own is None else (own[..., :-1, :] + own[..., 1:, :]) / 2


def _rates(
    model: PhysicsModel, stack: LogBatch, states: Tensor, own: Tensor | None, inputs: Tensor, slopes: Tensor
) -> Tensor:
    """Rates (…, L, N, s), and what sensors show (…, L, N, s + f), at states (L, N, s) and own states (…, L, N, i)."""
    state, many, sensed = model.project(states), how_many(model), stack.sensed
    size, shape = state.shape[-1], (*(() if many is None else (many,)), *state.shape[-3:-1])
    if own is not None:
        state = torch.cat([state.expand(*own.shape[:-1], size), own], dim=-1)
    fast = models.rates(model, inputs.shape[-1], sensed)
    if fast is not None:
        return at_once(fast, shape, state, inputs, slopes)
    out = state.new_empty(*shape, size + (len(model.sensed_channels) if sensed else 0))
    step = max(1, LINEARISING.at_once // max(1, math.prod(shape[:-1])))
    for start in range(0, shape[-1], step):
        part = slice(start, start + step)
        at, *driven = _for_all(model, many, state[..., part, :], inputs[..., part, :], slopes[..., part, :])
        out[..., part, :size] = rates = model.derivative(at, *driven)[..., :size]
        if sensed:
            out[..., part, size:] = model.sensed(at, rates)
    return out


def at_once(fast: models.Compiled, shape: Sequence[int], *given: Tensor) -> Tensor:
    """What a program makes (…, L, N, n) of vectors (…, L, N, k) of one model or of many; ``shape`` is (…, L, N)."""
    vectors = [x.reshape(math.prod(x.shape[:-3]), math.prod(shape[-2:]), x.shape[-1]) for x in given]
    return fast(*vectors).unflatten(1, shape[-2:]).reshape(*shape, -1)


def _of_all(many: int | None, *signals: Tensor) -> list[Tensor]:
    """Signals (…, L, N, n) as each of so many models sees them."""
    return list(signals) if many is None else [x.expand(many, *x.shape[-3:]) for x in signals]


def _for_all(model: PhysicsModel, many: int | None, *signals: Tensor) -> list[Tensor]:
    """`_of_all`; but once for all where the equations are known to broadcast: what is alike is computed once."""
    ours = __name__.partition(".")[0], PhysicsModel.__module__.partition(".")[0]
    broadcasts = model.broadcasts and all(type(x).__module__.partition(".")[0] in ours for x in (model, *model.effects))
    return list(signals) if broadcasts else _of_all(many, *signals)


def _transmitted(model: PhysicsModel, stack: LogBatch) -> Tensor:
    """What acts (…, L, N − 1, 3, m) at start, middle and end of each interval, after delays and lags."""
    few, which = _driven_apart(model)
    driving, extras, held = _driven(few, stack)
    for effect in narrowed(few).input_effects():
        driving = effect.transmitted(effect.steady(driving[..., 0, 0, :], stack.dt), driving, stack.dt, held)
    out = torch.cat([driving, extras], dim=-1)
    return out if which is None else out[which]


def _driven_apart(model: M) -> tuple[M, list[int] | None]:
    """Of many models those whose input effects differ, and for each model its place among them; None: it is its own."""
    values = _tensors(*model.input_effects())
    many = _most(values)
    if many is None:
        return model, None
    table = torch.cat([v.reshape(len(v), -1).expand(many, -1) for _, v in values], dim=1)
    keys = list(map(tuple, table.tolist()))
    places = {key: i for i, key in enumerate(dict.fromkeys(keys))}
    if len(places) == many:
        return model, None
    first = [keys.index(key) for key in places]

    def some(effect: Effect) -> Effect:
        changes: dict[str, Any] = {n: v.expand(many, *v.shape[1:])[first] for n, v in _tensors(effect)}
        return replace(effect, **changes)

    effects = tuple(some(e) if isinstance(e, InputEffect) else e for e in model.effects)
    return replace(model, effects=effects), [places[key] for key in keys]


def acting(model: PhysicsModel, log: Log) -> Tensor:
    """What acts (N, m) at every sample, after the delays and lags of ``model``."""
    path = _transmitted(model, LogBatch.of([log]))[0]
    return torch.cat([path[:, 0], path[-1:, 2]])


def memories(model: PhysicsModel, stack: LogBatch) -> Tensor:
    """Memories (…, L, N, size) of delays and lags at every sample, as the inputs until then left them."""
    driving, _, held = _driven(model, stack)
    parts = []
    for effect in narrowed(model).input_effects():
        memory, driving = effect.over(effect.steady(driving[..., 0, 0, :], stack.dt), driving, stack.dt, held)
        parts.append(memory)
    (out,) = _of_all(how_many(model), torch.cat(parts, dim=-1))
    return out


def _driven(model: PhysicsModel, stack: LogBatch) -> tuple[Tensor, Tensor, bool]:
    """What drives the model over each interval (…, L, N − 1, 3, m), its extras alike, and whether samples are held."""
    many = _most(_tensors(*model.input_effects()))  # models that differ in what comes after these are driven alike
    segments, held = _segments(model, stack), model.input_hold == "previous"
    if many is not None:
        segments = segments.expand(many, *segments.shape)
    driving, extras = segments.split([segments.shape[-1] - len(model.extras), len(model.extras)], dim=-1)
    return driving, extras, held


def _segments(model: PhysicsModel, stack: LogBatch) -> Tensor:
    """Inputs (L, N − 1, 3, m) at start, middle and end of each interval, as the model takes them between samples."""
    before, after = stack.inputs[:, :-1], stack.inputs[:, 1:]
    held = model.input_hold == "previous"
    return torch.stack([before, before, before] if held else [before, (before + after) / 2, after], dim=-2)


def own_states(model: PhysicsModel, stack: LogBatch) -> Tensor:
    """The effects' own states (…, L, N, i) at every sample, driven by the measured states and by what acts then."""
    _, mean, slopes = _driving(model, stack)
    return _own_path(model, stack, mean, slopes, so_far=True)


def _own_path(model: PhysicsModel, stack: LogBatch, middle: Tensor, slopes: Tensor, so_far: bool = False) -> Tensor:
    """The effects' own states (…, L, N, i) at every sample.

    Args:
        model: with the effects.
        stack: measurements.
        middle: (…, L, N − 1, m) what acts in the middle of each interval.
        slopes: (…, L, N − 1, m) its time derivative.
        so_far: whether a sample may know what came before it only, of states that only the past tells.
    """
    recalled = [e for e in model.effects if isinstance(e, RECALLED)]
    if not recalled:
        return _solved_path(model, stack, middle, slopes)
    rest = replace(model, effects=tuple(e for e in model.effects if not isinstance(e, RECALLED)))
    others = _solved_path(rest, stack, middle, slopes) if rest.internal_size else None
    good = torch.zeros(stack.states.shape[0], stack.states.shape[1] - 1, dtype=torch.bool)
    for i, log in enumerate(stack.logs):
        good[i, : len(log) - 1] = log.valid[:-1] & log.valid[1:]
    told = recall(recalled, good, *_left(model, rest, stack), dt=stack.dt, so_far=so_far)
    parts, at = [], 0
    for effect in model.effects:
        if isinstance(effect, RECALLED):
            parts.append(told.pop(0))
        elif effect.internal_size:
            assert others is not None
            parts.append(others[..., at : at + effect.internal_size])
            at += effect.internal_size
    return joined(parts)


def _left(model: PhysicsModel, rest: PhysicsModel, stack: LogBatch) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
    """What a model without some effects leaves along their axes, and what drives them, over each interval.

    Args:
        model: with all effects.
        rest: without those whose states only the past tells.
        stack: measurements.

    Returns:
        By axis, and by signal, (…, L, N − 1).
    """
    rates, places = midpoint_rates(rest, stack), list(stack.measured)
    left = (torch.from_numpy(stack.paths).diff(dim=1) / stack.dt - rates)[..., places]
    along: dict[str, Tensor] = {}
    drivers: dict[str, Tensor] = {}
    for effect in model.effects:
        if not isinstance(effect, RECALLED):
            continue
        for constant in effect.constants():
            if constant.axis not in along:
                unit = replace(rest, effects=(*rest.effects, constant))
                one = (midpoint_rates(unit, stack) - rates)[..., places]
                along[constant.axis] = (one * left).sum(-1) / one.square().sum(-1).clamp_min(1e-300)
        for name in effect.drivers if isinstance(effect, HiddenMode) else ():
            drivers[name] = followed(name, rest, stack)
    return along, drivers


def followed(name: str, model: PhysicsModel, stack: LogBatch) -> Tensor:
    """A signal (…, L, N − 1) that a term can follow, in the middle of each interval."""
    state = model.project(stack.between)
    _, inputs, _ = _driving(model, stack)
    if signals.flies(type(model)):
        return signals.of_motion(name, model.unloaded(state, inputs)[0])  # type: ignore[attr-defined]
    return signals.of_state(name, model, state, inputs)


def _solved_path(model: PhysicsModel, stack: LogBatch, middle: Tensor, slopes: Tensor) -> Tensor:
    """The effects' own states at every sample, from zero by the midpoint rule."""
    many, size = how_many(model), stack.states.shape[-1]
    states = model.project(stack.between)
    middle, slopes = _for_all(model, many, middle, slopes)
    shape = (*(() if many is None else (many,)), *states.shape[:-1])
    through = _own_step(model, stack, states, middle, slopes)
    if through is not None:
        path = solved(through, shape, model.internal_size, stack.states)
        if path is not None:
            return path
    fast = models.own_step(model, middle.shape[-1], stack.dt)
    if fast is not None:
        return _one_by_one(fast, shape, model.internal_size, states, middle, slopes)
    narrow, own = narrowed(model), stack.states.new_zeros(*shape[:-1], model.internal_size)

    def rate(k: int, own: Tensor) -> Tensor:
        at = states[:, k].expand(*shape[:-1], size)
        return narrow.derivative(torch.cat([at, own], dim=-1), middle[..., k, :], slopes[..., k, :])[..., size:]

    one_by_one = [own]
    for k in range(states.shape[1]):
        own = own + stack.dt * rate(k, own + stack.dt / 2 * rate(k, own))
        one_by_one.append(own)
    return torch.stack(one_by_one, dim=-2)


def _one_by_one(fast: models.Compiled, shape: tuple[int, ...], size: int, *given: Tensor) -> Tensor:
    """The effects' own states (…, L, N, size) from zero, by a program for one interval; ``shape`` is (…, L, N − 1)."""
    begin = given[0].new_zeros(1, shape[-2], size)
    vectors = [x.reshape(math.prod(x.shape[:-3]), *x.shape[-3:]) for x in given]
    path = fast(begin, *vectors, steps=shape[-1]).reshape(*shape, size)
    return torch.cat([path.new_zeros(*shape[:-1], 1, size), path], dim=-2)


def _own_step(
    model: PhysicsModel, stack: LogBatch, states: Tensor, middle: Tensor, slopes: Tensor
) -> Callable[[Tensor], Tensor] | None:
    """The effects' own states after each interval from those before it (…, L, N − 1, i), all at once.

    None: only one interval after another tells.
    """
    if type(model).internal_rates is PhysicsModel.internal_rates:
        return None
    fast = models.own_step(model, middle.shape[-1], stack.dt)
    if fast is not None:
        return lambda own: at_once(fast, own.shape[:-1], own, states, middle, slopes)
    internal = model.internal_rates(states, middle, slopes)
    return None if internal is None else lambda own: own + stack.dt * internal(own + stack.dt / 2 * internal(own))


def how_many(model: PhysicsModel) -> int | None:
    """How many models the parameters (B, 1, 1) stand for; None: numbers."""
    return _most(_tensors(model, *model.effects))


def _most(values: Sequence[tuple[str, Tensor]]) -> int | None:
    return max((v.shape[0] for _, v in values), default=None)


def _tensors(*owners: PhysicsModel | Effect) -> list[tuple[str, Tensor]]:
    return [(p.name, p.value) for o in owners for p in o.parameters() if isinstance(p.value, Tensor)]


def narrowed(model: M) -> M:
    """The model with parameters (B, 1) in place of (B, 1, 1): for one time step at a time."""

    def narrow(owner: PhysicsModel | Effect) -> dict[str, Tensor]:
        return {name: value.squeeze(1) for name, value in _tensors(owner)}

    changes: dict[str, Any] = narrow(model)
    effects = tuple(dataclasses.replace(e, **narrow(e)) for e in model.effects)
    return dataclasses.replace(model, effects=effects, **changes)
