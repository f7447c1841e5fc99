"""Rates and steps of models as compiled programs, for many models that differ in their numbers, at many states.

A program is recorded once for models alike: one system with the same effects, whatever their numbers are. What cannot
be recorded, or does not come out as torch has it, is left to torch.
"""

import dataclasses
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from registry.dynamics import Effect, PhysicsModel, Rates, advanced, resting, sticks
from registry.equations import lanes
from registry.equations.lanes import Lanes
from registry.equations.trace import Recorder, Traced, recorded
from registry.errors import BenchError

_MOST = 1000
"""Programs that are kept."""
_EXACT = 1e-12
"""Largest difference from torch, relative to the largest entry, of a program that is taken."""


@dataclass(frozen=True, eq=False)
class Compiled:
    """A program, with the numbers of the models that it is run for."""

    program: Lanes
    numbers: Tensor
    """(B, 1, P)."""

    def __call__(self, *given: Tensor, steps: int = 0) -> Tensor:
        """See `Lanes.run`: vectors (B or 1, W or 1, …, n), to results (B, W, …, n)."""
        sizes = [x.shape[:2] for x in (*given, self.numbers)]
        counts = ([s[i] for s in sizes] for i in range(2))
        models, width = (max(n) if all(n) else 0 for n in counts)
        if len(given[0]) < models and steps:
            given = given[0].expand(models, -1, -1), *given[1:]
        return self.program.run((*given, self.numbers), models, width, steps)


def rates(model: PhysicsModel, inputs: int, sensed: bool = False) -> Compiled | None:
    """`PhysicsModel.derivative` of the state proper, and with ``sensed`` what `PhysicsModel.sensed` says of it.

    Dry friction acts as on a measured motion (`resting`).

    Args:
        model: its numbers may be tensors (B, …), for B models at once.
        inputs: channels of the inputs.
        sensed: whether sensors are asked.

    Returns:
        state with the effects' own, inputs, input_rates → (…, s + f); None: torch has to do it.
    """
    size = len(model.state_channels)

    def function(of: PhysicsModel, derivative: Rates, state: Tensor, now: Tensor, slopes: Tensor) -> Tensor:
        if sticks(of):
            of = resting(of, state, now, slopes)
            derivative = of.derivative
        found = derivative(state, now, slopes)[..., :size]
        return torch.cat([found, of.sensed(state, found)], dim=-1) if sensed else found

    return _compiled(model, inputs, ("rates", sensed), (size + model.internal_size, inputs, inputs), function)


def own_step(model: PhysicsModel, inputs: int, dt: float) -> Compiled | None:
    """The effects' own states a time step later, by the midpoint rule; arguments as for `step`.

    Returns:
        own states, state proper, inputs, input_rates → own states; None: torch has to do it.
    """
    size = len(model.state_channels)

    def function(
        of: PhysicsModel, derivative: Rates, own: Tensor, state: Tensor, now: Tensor, slopes: Tensor
    ) -> Tensor:
        def rate(own: Tensor) -> Tensor:
            return derivative(torch.cat([state, own], dim=-1), now, slopes)[..., size:]

        return own + dt * rate(own + dt / 2 * rate(own))

    return _compiled(model, inputs, ("own", dt), (model.internal_size, size, inputs, inputs), function)


def step(model: PhysicsModel, inputs: int, dt: float, drifting: bool = False) -> Compiled | None:
    """A time step of the state with the effects' own states, as `PhysicsModel.step` makes it.

    Args:
        model: its numbers may be tensors (B, …), for B models at once.
        inputs: channels of the inputs.
        dt: [s].
        drifting: whether something is added to the state proper after the step.

    Returns:
        state, inputs at start, middle and end (3 m), drift → state; None: torch has to do it.
    """
    size = len(model.state_channels)
    if type(model).step is not PhysicsModel.step:
        return None

    def function(of: PhysicsModel, derivative: Rates, state: Tensor, segment: Tensor, *drift: Tensor) -> Tensor:
        after = advanced(of, derivative, state, segment.unflatten(-1, (3, inputs)), dt)
        return torch.cat([after[..., :size] + drift[0], after[..., size:]], dim=-1) if drift else after

    widths = (size + model.internal_size, 3 * inputs, *((size,) if drifting else ()))
    return _compiled(model, inputs, ("step", dt, drifting), widths, function)


def carried(model: PhysicsModel, inputs: int, dt: float, at: Sequence[int]) -> Compiled | None:
    """Some states and the effects' own a time step later, as `PhysicsModel.step` makes them, the other states known.

    Args:
        model: its numbers may be tensors (B, …), for B models at once.
        inputs: channels of the inputs.
        dt: [s].
        at: H places of these states in the state proper.

    Returns:
        these and the own states, state proper, inputs at start, middle and end (3 m) → these and the own states; None:
        torch has to do it.
    """
    size, places = len(model.state_channels), list(at)
    if type(model).step is not PhysicsModel.step:
        return None

    def function(of: PhysicsModel, derivative: Rates, carried: Tensor, known: Tensor, segment: Tensor) -> Tensor:
        proper = [carried[..., places.index(i)] if i in places else known[..., i] for i in range(size)]
        state = torch.cat([torch.stack(proper, dim=-1), carried[..., len(places) :]], dim=-1)
        after = advanced(of, derivative, state, segment.unflatten(-1, (3, inputs)), dt)
        return torch.cat([torch.stack([after[..., i] for i in places], dim=-1), after[..., size:]], dim=-1)

    widths = (len(places) + model.internal_size, size, 3 * inputs)
    return _compiled(model, inputs, ("carried", dt, tuple(at)), widths, function)


def _compiled(
    model: PhysicsModel, inputs: int, what: tuple[Any, ...], widths: Sequence[int], function: Callable[..., Tensor]
) -> Compiled | None:
    """A function of a model, its derivative and vectors of these widths, as a program."""
    alike = _Alike.of(model) if lanes.available() else None
    if alike is None:
        return None
    key = (alike.key, what, tuple(widths))
    if key not in _programs:
        if len(_programs) >= _MOST:
            _programs.clear()
            _derivatives.clear()
        _programs[key] = _recorded(model, alike, inputs, widths, function)
    program = _programs[key]
    return None if program is None else Compiled(program, alike.numbers(model))


_programs: dict[Hashable, Lanes | None] = {}
_derivatives: dict[Hashable, Traced] = {}


def _recorded(
    model: PhysicsModel, alike: "_Alike", inputs: int, widths: Sequence[int], function: Callable[..., Tensor]
) -> Lanes | None:
    """See `_compiled`; None: it cannot be recorded, or is another function then."""
    numbers = alike.numbers(model)[:1]

    sizes = {**{str(i): n for i, n in enumerate(widths)}, "numbers": numbers.shape[-1]}
    try:
        derivative = _derivative(model, alike, inputs)

        def whole(recorder: Recorder, *given: Tensor) -> Tensor:
            *vectors, values = given
            return function(alike.put(model, values), lambda *x: recorder.insert(derivative, *x, values), *vectors)

        found = Lanes.of(recorded(whole, sizes))
    except (BenchError, RuntimeError, IndexError, TypeError, ValueError):  # of a system that takes batches only, say
        return None
    generator, of = torch.Generator().manual_seed(1), alike.put(model, numbers[0, 0])
    given = [0.5 + torch.rand(3, n, generator=generator, dtype=torch.float64) for n in widths]
    with torch.no_grad():
        wanted = function(of, of.derivative, *given)
    off = (Compiled(found, numbers)(*(x[None] for x in given))[0] - wanted).abs().max()
    return found if off <= _EXACT * max(1.0, float(wanted.abs().max())) else None


def _derivative(model: PhysicsModel, alike: "_Alike", inputs: int) -> Traced:
    """state, inputs, input_rates, numbers → `PhysicsModel.derivative`, of all models alike."""
    key = (alike.key, inputs)
    if key not in _derivatives:
        size, count = len(model.state_channels) + model.internal_size, sum(p.width for p in alike.places)
        _derivatives[key] = recorded(
            lambda _, state, now, slopes, numbers: alike.put(model, numbers).derivative(state, now, slopes),
            {"state": size, "inputs": inputs, "slopes": inputs, "numbers": count},
        )
    return _derivatives[key]


@dataclass(frozen=True)
class _Place:
    """A number, or a vector of them, of a model or of one of its effects."""

    owner: int
    """−1: the model."""
    name: str
    size: int
    """Of a vector; 0: a single number."""

    @property
    def width(self) -> int:
        """How many numbers."""
        return self.size or 1


@dataclass(frozen=True, eq=False)
class _Alike:
    """Models that differ in their numbers only."""

    places: tuple[_Place, ...]
    key: Hashable
    """Of everything else."""

    @classmethod
    def of(cls, model: PhysicsModel) -> "_Alike | None":
        """Those that are like this one; None: something about it is neither a number nor known by its value."""
        places, rest = list[_Place](), list[Any]()
        owners: list[PhysicsModel | Effect] = [model, *model.effects]
        for i, owner in enumerate(owners, start=-1):
            known = {p.name: p for p in owner.parameters()}
            rest.append(type(owner))
            for field in dataclasses.fields(owner):
                value, p = getattr(owner, field.name), known.get(field.name)
                if field.name == "effects":
                    continue
                if isinstance(value, Tensor) and (p is None or value.requires_grad):
                    return None
                if p is None or np.ndim(p.neutral) > 1 or not (isinstance(value, Tensor) or p.uncertainty > 0):
                    rest.append(value)
                elif np.ndim(p.neutral):
                    places.append(_Place(i, field.name, value.shape[-1] if isinstance(value, Tensor) else len(value)))
                else:
                    places.append(_Place(i, field.name, 0))
        try:
            hash(tuple(rest))
        except TypeError:
            return None
        return None if any(isinstance(v, Tensor) for v in rest) else cls(tuple(places), (*rest, *places))

    def numbers(self, model: PhysicsModel) -> Tensor:
        """(B, 1, P) of a model whose numbers may be tensors (B, …), or (B, …, n) where they are vectors."""
        found = []
        for place in self.places:
            value = getattr(model if place.owner < 0 else model.effects[place.owner], place.name)
            found.append(torch.as_tensor(value, dtype=torch.float64).reshape(-1, 1, place.width))
        many = max(map(len, found), default=1)
        return torch.cat([x.expand(many, -1, -1) for x in found] or [torch.empty(1, 1, 0)], dim=-1)

    def put(self, model: PhysicsModel, numbers: Tensor) -> PhysicsModel:
        """The model with these numbers (P,)."""
        changes: dict[int, dict[str, Any]] = {}
        parts = numbers.split([p.width for p in self.places]) if self.places else []
        for place, part in zip(self.places, parts, strict=True):
            changes.setdefault(place.owner, {})[place.name] = part if place.size else part[0]
        effects = tuple(replace(e, **changes.get(i, {})) for i, e in enumerate(model.effects))
        return replace(model, effects=effects, **changes.get(-1, {}))
