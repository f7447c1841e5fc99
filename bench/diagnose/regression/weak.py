"""The weak form: changes of the measured state against the model's integral, through smooth test functions.

With a test function φ (a Hann window over intervals) the residual of ẋ = f(x, u) is

    r_j = Σ_k φ_jk (x_{k+1} − x_k) − dt Σ_k φ_jk (κ ∗ f)_k,

where κ is the smoothing that the measured states went through and f_k the mean of f over an interval (`mean_rates`).
Nothing is differentiated and no initial state is needed; as κ acts on both sides, a smoothed rate is not taken for a
weak motor. After Messenger and Bortz, "Weak SINDy" (2021).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import torch
from torch import Tensor

from bench.diagnose.logs.subject import LogBatch
from bench.diagnose.regression.driving import driving, for_all, how_many, mean_driving, narrowed, simpson, through
from bench.diagnose.regression.recall import RECALLED, recall
from bench.diagnose.regression.recurrence import Solved, normal_equations, solved
from bench.diagnose.settings import LINEARISING
from registry.dynamics import PhysicsModel, joined, resting, sticks
from registry.effects.waves.hidden_mode import HiddenMode
from registry.equations import models
from registry.terms import signals

BLOCK = 7
"""Sampling intervals whose mean tells a beginning."""
NODES = (1, 5)
"""Those of a block that have its mean to the third order: their places have the mean and the variance of all seven."""


def midpoint_rates(model: PhysicsModel, stack: LogBatch, so_far: bool = False) -> Tensor:
    """The model's rates (…, L, N − 1, s) of the state proper at the mean of states and inputs over each interval.

    Where all recordings have the sensors, followed by what they would show (…, L, N − 1, s + f).

    The model's constants and its effects' parameters may be tensors (…, 1, 1), for many models at once.
    """
    mean, slopes = mean_driving(model, stack)
    own = _halfway(_own_path(model, stack, mean, slopes, so_far)) if model.internal_size else None
    return _rates(model, stack, stack.between, own, mean, slopes)


def mean_rates(model: PhysicsModel, stack: LogBatch, so_far: bool = False) -> Tensor:
    """The mean (…, L, N − 1, s) over each sampling interval of the model's rates; like `midpoint_rates` (s + f).

    By Hermite-Simpson: along the cubic through the two samples that has the model's rates at both. The rates at their
    mean are off by h² d²x/dt² / 12 and by what bends the rates themselves, which in an equation that is known well
    looks like something that is missing. Of recordings that were thinned out the mean over all that was left out; of
    slopes, whose means are known better than the samples, the rates at the mean. Where ``so_far``, what a recording
    tells of the effects' own states at a sample is told by what came before.

    Source: Hargraves and Paris, Direct trajectory optimization using nonlinear programming and collocation (1987).
    """
    states = stack.states if stack.finer is None else stack.finer
    if stack.missed is not None or (stack.means is not None and stack.finer is None):
        return midpoint_rates(model, stack, so_far)
    path, mean, slopes = driving(model, stack)
    own = _own_path(model, stack, mean, slopes, so_far) if model.internal_size else None
    stride = max(1, states.shape[1] - 1) // max(1, stack.states.shape[1] - 1)
    slopes, size = slopes.repeat_interleave(stride, -2), states.shape[-1]

    def at(share: float, x: Tensor) -> Tensor:
        """Rates where states are ``x`` (L, (N − 1) stride, s), after a share of each interval between these."""
        since = ((torch.arange(stride) + share) / stride).unsqueeze(-1).to(x)  # (stride, 1), of an interval
        acting = through(path, since).flatten(-3, -2)
        inner = (
            None if own is None else torch.lerp(own[..., :-1, None, :], own[..., 1:, None, :], since).flatten(-3, -2)
        )
        return _rates(model, stack, x, inner, acting, slopes)

    first, last = at(0.0, states[:, :-1]), at(1.0, states[:, 1:])
    measured = torch.tensor([i in stack.measured for i in range(size)])
    bend = torch.where(measured, stack.dt / stride / 8 * (first - last)[..., :size], 0.0)
    halfway = at(0.5, (states[:, :-1] + states[:, 1:]) / 2 + bend)
    means = simpson(first, halfway, last)
    means[..., size:] = (first + last)[..., size:] / 2  # as what sensors showed is summed
    return means.unflatten(-2, (-1, stride)).mean(-2)


def _halfway(own: Tensor) -> Tensor:
    """Effects' own states (…, L, N, i) in the middle of each interval."""
    return (own[..., :-1, :] + own[..., 1:, :]) / 2


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
    dry = sticks(model)
    out = state.new_empty(*shape, size + (len(model.sensed_channels) if sensed else 0))
    step = max(1, LINEARISING.at_once // max(1, math.prod(shape[:-1])))
    for start in range(0, shape[-1], step):
        part = slice(start, start + step)
        at, *driven = for_all(model, many, state[..., part, :], inputs[..., part, :], slopes[..., part, :])
        held = resting(model, at, *driven) if dry else model
        out[..., part, :size] = rates = held.derivative(at, *driven)[..., :size]
        if sensed:
            out[..., part, size:] = held.sensed(at, rates)
    return out


def at_once(fast: models.Compiled, shape: Sequence[int], *given: Tensor) -> Tensor:
    """What a program makes (…, L, N, n) of vectors (…, L, N, k) of one model or of many; ``shape`` is (…, L, N)."""
    vectors = [x.reshape(math.prod(x.shape[:-3]), math.prod(shape[-2:]), x.shape[-1]) for x in given]
    return fast(*vectors).unflatten(1, shape[-2:]).reshape(*shape, -1)


def own_states(model: PhysicsModel, stack: LogBatch) -> Tensor:
    """The effects' own states (…, L, N, i) at every sample, driven by the measured states and by what acts then."""
    mean, slopes = mean_driving(model, stack)
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
        return _solved_path(model, stack, middle, slopes, so_far)
    rest = replace(model, effects=tuple(e for e in model.effects if not isinstance(e, RECALLED)))
    others = _solved_path(rest, stack, middle, slopes, so_far) if rest.internal_size else None
    told = recall(recalled, stack.good, *_left(model, rest, stack), dt=stack.dt, so_far=so_far)
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
    rates, moved = midpoint_rates(rest, stack), torch.from_numpy(stack.paths).diff(dim=1) / stack.dt
    along: dict[str, Tensor] = {}
    drivers: dict[str, Tensor] = {}
    for effect in model.effects:
        if not isinstance(effect, RECALLED):
            continue
        for constant in effect.constants():
            if constant.axis not in along:
                unit = midpoint_rates(replace(rest, effects=(*rest.effects, constant)), stack)
                along[constant.axis] = _share(unit, rates, moved, stack.measured)
        for name in effect.drivers if isinstance(effect, HiddenMode) else ():
            drivers[name] = followed(name, rest, stack)
    return along, drivers


def _share(unit: Tensor, rates: Tensor, moved: Tensor, measured: Sequence[int]) -> Tensor:
    """How much (…, L, N − 1) of a unit brings ``rates`` nearest to what ``moved``; all are (…, L, N − 1, s)."""
    along, size = torch.zeros(()).to(rates), torch.zeros(()).to(rates)
    for c in measured:
        one = unit[..., c] - rates[..., c]
        if one.any():
            along, size = along + one * (moved[..., c] - rates[..., c]), size + one.square()
    return along.expand(rates.shape[:-1]) / size.clamp_min(1e-300)


def followed(name: str, model: PhysicsModel, stack: LogBatch) -> Tensor:
    """A signal (…, L, N − 1) that a term can follow, in the middle of each interval."""
    state = model.project(stack.between)
    inputs, _ = mean_driving(model, stack)
    if signals.flies(type(model)):
        return signals.of_motion(name, model.unloaded(state, inputs)[0])  # type: ignore[attr-defined]
    return signals.of_state(name, model, state, inputs)


def _solved_path(model: PhysicsModel, stack: LogBatch, middle: Tensor, slopes: Tensor, so_far: bool = False) -> Tensor:
    """The effects' own states at every sample, by the midpoint rule: as each recording begins, else from zero."""
    many, size = how_many(model), stack.states.shape[-1]
    states = model.project(stack.between)
    middle, slopes = for_all(model, many, middle, slopes)
    shape = (*(() if many is None else (many,)), *states.shape[:-1])
    through = _own_step(model, stack, states, middle, slopes)
    if through is not None:
        begun = (states[:1, :1], middle[..., :1, :1, :], slopes[..., :1, :1, :])
        first = _own_step(model, stack, *begun)
        found = None if first is None else solved(through, first, shape, model.internal_size, stack.states)
        if found is not None:
            return _as_begun(found, model, stack, middle, slopes, so_far)
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


def _as_begun(
    found: Solved, model: PhysicsModel, stack: LogBatch, middle: Tensor, slopes: Tensor, so_far: bool
) -> Tensor:
    """The own states (…, L, N, i) of recordings that each begin as fits best what is measured of them.

    By least squares of what is left from rest, as means over blocks of intervals. What is known beforehand: a beginning
    is about as large as what drives the states makes them.

    Args:
        found: the own states from wherever they begin.
        model: with the effects.
        stack: measurements.
        middle: (…, L, N − 1, m) what acts in the middle of each interval.
        slopes: (…, L, N − 1, m) its time derivative.
        so_far: whether a sample may know what came before it only.
    """
    path, good = found.path(), stack.good
    blocks = good.shape[-1] // BLOCK
    whole = good[:, : blocks * BLOCK].unflatten(-1, (blocks, BLOCK)).all(-1).unsqueeze(-1)
    if not whole.any():
        return path
    turned, own = found.turned(), _halfway(path)
    seen, acts = _seen_of(turned, own, model, stack, middle, slopes)
    moved = torch.from_numpy(stack.paths).diff(dim=1)[..., acts] / stack.dt
    rates = _rates(model, stack, stack.between, own, middle, slopes)[..., acts]
    left = (moved - rates)[..., : blocks * BLOCK, :].unflatten(-2, (blocks, BLOCK)).mean(-2)
    seen, left = torch.where(whole.unsqueeze(-1), seen, 0.0), torch.where(whole, left, 0.0)
    size = path.square().mean((-3, -2), keepdim=True).sqrt()  # a beginning is told in shares of it
    seen, begin, unit = seen * size.unsqueeze(-2), torch.zeros_like(size), torch.eye(size.shape[-1]).to(size)
    for last in (False, True):  # the noise is what no swing has
        noise = left - (seen @ begin.unsqueeze(-1)).squeeze(-1)
        weight = (whole.sum() / noise.square().sum((-3, -2), keepdim=True).clamp_min(1e-300)).sqrt()
        gram, moment = normal_equations(seen * weight.unsqueeze(-1), left * weight, so_far and last)
        begin = torch.linalg.solve(gram + unit, moment.unsqueeze(-1)).squeeze(-1)
    begin = size * begin
    if so_far:  # a block tells what comes after its last sample
        begin = begin[..., torch.arange(path.shape[-2]) // BLOCK, :]
    return path + (turned * begin.unsqueeze(-2)).sum(-1)


def _seen_of(
    turned: Tensor, own: Tensor, model: PhysicsModel, stack: LogBatch, middle: Tensor, slopes: Tensor
) -> tuple[Tensor, list[int]]:
    """How rates, as means over blocks of intervals, answer a beginning of the own states.

    Args:
        turned: (…, L or 1, N, i, i) what a beginning adds to the own states at every sample.
        own: (…, L, N − 1, i) the own states in the middle of each interval.
        model: with the effects.
        stack: measurements.
        middle: (…, L, N − 1, m) what acts in the middle of each interval.
        slopes: (…, L, N − 1, m) its time derivative.

    Returns:
        (…, L, blocks, c, i), and which of the measured channels these c are.
    """
    blocks = own.shape[-2] // BLOCK
    # Two of each block have the mean of all, to the third order.
    at = (BLOCK * torch.arange(blocks).unsqueeze(-1) + torch.tensor(NODES)).flatten()
    states, own, *driven = (x[..., at, :] for x in (stack.between, own, middle, slopes))
    still = _rates(model, stack, states, own, *driven)
    answers = [_rates(model, stack, states, own + e, *driven) - still for e in torch.eye(own.shape[-1]).to(own)]
    acts = [c for c in stack.measured if any(x[..., c].any() for x in answers)]
    seen = torch.stack([x[..., acts] for x in answers], dim=-1)  # (…, L, nodes, c, i)
    nodes = (turned[..., at, :, :] + turned[..., at + 1, :, :]) / 2
    seen = (seen.unsqueeze(-1) * nodes.unsqueeze(-3)).sum(-2)
    return seen.unflatten(-3, (blocks, len(NODES))).mean(-3), acts


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
