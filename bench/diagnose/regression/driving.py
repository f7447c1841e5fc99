"""What acts on a model over every sampling interval: measured inputs, after delays and lags.

The model's constants and its effects' parameters may be tensors (B, 1, 1), for many models at once.
"""

import dataclasses
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, TypeVar

import torch
from torch import Tensor

from bench.diagnose.logs.subject import Log, LogBatch
from registry.dynamics import Effect, InputEffect, PhysicsModel

M = TypeVar("M", bound=PhysicsModel)


def driving(model: PhysicsModel, stack: LogBatch) -> tuple[Tensor, Tensor, Tensor]:
    """What acts (…, L, N − 1, 3, m) at start, middle and end of each interval, its mean (…, m) and time derivative."""
    path, which = _transmitted(model, stack)
    mean, slopes = _means(path, stack.dt, which)
    return path if which is None else path[which], mean, slopes


def mean_driving(model: PhysicsModel, stack: LogBatch) -> tuple[Tensor, Tensor]:
    """The mean (…, L, N − 1, m) of what acts over each interval, and its time derivative; as `driving` has them."""
    path, which = _transmitted(model, stack)
    return _means(path, stack.dt, which)


def acting(model: PhysicsModel, log: Log) -> Tensor:
    """What acts (N, m) at every sample, after the delays and lags of ``model``."""
    path = _transmitted(model, LogBatch.of([log]))[0][0]
    return torch.cat([path[:, 0], path[-1:, 2]])


def memories(model: PhysicsModel, stack: LogBatch) -> Tensor:
    """Memories (…, L, N, size) of delays and lags at every sample, as the inputs until then left them."""
    driving, _, held = _driven(model, stack)
    parts = []
    for effect in narrowed(model).input_effects():
        memory, driving = effect.over(effect.steady(driving[..., 0, 0, :], stack.dt), driving, stack.dt, held)
        parts.append(memory)
    (out,) = of_all(how_many(model), torch.cat(parts, dim=-1))
    return out


def through(path: Tensor, since: Tensor) -> Tensor:
    """The parabola (…, N, J, m) through what is known at start, middle and end (…, N, 3, m), after shares (J, 1)."""
    first, middle, last = path.unsqueeze(-3).unbind(-2)
    return first + since * (last - first) + 4 * since * (1 - since) * (middle - (first + last) / 2)


def simpson(first: Tensor, halfway: Tensor, last: Tensor) -> Tensor:
    """The mean over an interval, of what is known at its start, in its middle and at its end."""
    return (first + 4 * halfway + last) / 6


def _transmitted(model: PhysicsModel, stack: LogBatch) -> tuple[Tensor, list[int] | None]:
    """What acts (…, L, N − 1, 3, m) at start, middle and end of each interval, after delays and lags.

    Of many models only those that are driven apart, and for each model its place among them; None: its own.
    """
    few, which = _driven_apart(model)
    driving, extras, held = _driven(few, stack)
    for effect in narrowed(few).input_effects():
        driving = effect.transmitted(effect.steady(driving[..., 0, 0, :], stack.dt), driving, stack.dt, held)
    return torch.cat([driving, extras], dim=-1), which


def _means(path: Tensor, dt: float, which: list[int] | None) -> tuple[Tensor, Tensor]:
    """Means (…, N − 1, m) and slopes of paths (…, N − 1, 3, m), for each model those of its place among the paths."""
    means = simpson(*path.unbind(-2)), (path[..., 2, :] - path[..., 0, :]) / dt
    return means if which is None else (means[0][which], means[1][which])


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


def _driven(model: PhysicsModel, stack: LogBatch) -> tuple[Tensor, Tensor, bool]:
    """What drives the model over each interval (…, L, N − 1, 3, m), its extras alike, and whether samples are held."""
    many = _most(_tensors(*model.input_effects()))  # models that differ in what comes after these are driven alike
    segments, held = model.between(stack.inputs[:, :-1], stack.inputs[:, 1:]), model.input_hold == "previous"
    if many is not None:
        segments = segments.expand(many, *segments.shape)
    driving, extras = segments.split([segments.shape[-1] - len(model.extras), len(model.extras)], dim=-1)
    return driving, extras, held


def of_all(many: int | None, *signals: Tensor) -> list[Tensor]:
    """Signals (…, L, N, n) as each of so many models sees them."""
    return list(signals) if many is None else [x.expand(many, *x.shape[-3:]) for x in signals]


def for_all(model: PhysicsModel, many: int | None, *signals: Tensor) -> list[Tensor]:
    """`of_all`; but once for all where the equations are known to broadcast: what is alike is computed once."""
    ours = __name__.partition(".")[0], PhysicsModel.__module__.partition(".")[0]
    broadcasts = model.broadcasts and all(type(x).__module__.partition(".")[0] in ours for x in (model, *model.effects))
    return list(signals) if broadcasts else of_all(many, *signals)


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
