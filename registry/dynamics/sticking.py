"""Dry friction over a time step: its sign is taken as a mean over the step, in which a motion may reverse or stop.

At a rate v of motion the friction takes c off it in a step, and all else adds d. Moving, its sign s is that of v. If it
brings the motion to rest, that is after the share τ of the step; then the motion starts the other way if |d| > c, or
sticks: friction balances all else. The mean sign is s where |v| + s d ≥ c, else

    s (τ + (1 − τ) σ),    τ = |v| / (c − s d),    σ = s d / c, but no less than −1.

No step is too long for it, and what sticks does not creep, which a sign that is smoothed over a speed does.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Self

import torch
from torch import Tensor
from typing_extensions import override

from registry.dynamics.effects import RateEffect

_HIDES = 3.0
"""Standard deviations of noise that a motion at rest hardly shows."""
_NOTHING = 1e-12
"""Change of a rate of motion, in its unit, that is none, to divide by."""


@dataclass(frozen=True)
class DryEffect(RateEffect):
    """Resists motions with a force that depends on their sign, and holds them at rest up to its limit."""

    held: Any = field(
        default=None,
        kw_only=True,
        repr=False,
        compare=False,
        metadata={"help": "mean signs (…, n) of the motions over a time step, from an integrator; none: those now"},
    )

    hidden: tuple[float, ...] = field(
        default=(),
        kw_only=True,
        repr=False,
        compare=False,
        metadata={"help": "speeds (n,) of the motions up to which noise hides whether they rest; none: no noise"},
    )

    @abstractmethod
    def motions(self, model: Any) -> Sequence[int]:
        """The n places in the state of the rates of the motions that it resists."""

    def seen_through(self, model: Any, noise: Sequence[float]) -> Self:
        """As it is told from states (s,) with noise of these 1σ."""
        return replace(self, hidden=tuple(_HIDES * noise[i] for i in self.motions(model)))

    @abstractmethod
    def resisting(self, model: Any, state: Tensor, inputs: Tensor, signs: Tensor) -> Tensor:
        """`rate` with the signs (…, n) of the motions given."""

    @abstractmethod
    def signs(self, model: Any, state: Tensor) -> Tensor:
        """Signs (…, n) of the motions now."""

    @override
    def rate(self, model: Any, state: Tensor, inputs: Tensor) -> Tensor:
        """What it adds to dx/dt; see `RateEffect.rate`."""
        return self.resisting(model, state, inputs, self.signs(model, state) if self.held is None else self.held)


def sticks(model: Any) -> bool:
    """Whether it has dry friction."""
    return any(isinstance(e, DryEffect) for e in model.effects)


def held(model: Any, state: Tensor, inputs: Tensor, dt: float, step: Callable[[Any], Tensor]) -> Any:
    """The model with every dry friction held at its mean sign over a time step.

    Args:
        model: a `PhysicsModel`, whose dry frictions are independent but for the inertia that couples their motions.
        state: (…, s) at the start, with the effects' own states.
        inputs: (…, m) at the start.
        dt: [s].
        step: the state (…, s) a time step later, of a model without dry friction.
    """
    dry = _motions(model)
    places = [p for motions in dry.values() for p in motions]

    def with_signs(signs: Sequence[Tensor]) -> Any:
        return _with_signs(model, dry, signs)

    none = [torch.zeros_like(state[..., p]) for p in places]
    ones = [[torch.ones_like(x) if i == j else x for i, x in enumerate(none)] for j in range(len(none))]

    def taken(at: Tensor) -> list[list[Tensor]]:
        """What each friction takes off each rate of motion in a step."""
        bare = with_signs(none).derivative(at, inputs)
        each = [with_signs(one).derivative(at, inputs) for one in ones]
        return [[(bare[..., p] - x[..., p]) * dt for p in places] for x in each]

    rest = torch.stack([torch.zeros_like(x) if i in places else x for i, x in enumerate(state.unbind(-1))], dim=-1)
    moving, resting = taken(state), taken(rest)
    free, signs = step(with_signs(none)), none
    for j, place in enumerate(places):
        others = sum((moving[i][j] * signs[i] for i in range(len(places)) if i != j), torch.zeros_like(none[j]))
        added = free[..., place] - state[..., place] - others
        mean = mean_sign(state[..., place], added, moving[j][j], resting[j][j])
        signs = [mean if i == j else x for i, x in enumerate(signs)]
    return with_signs(signs)


def resting(model: Any, state: Tensor, inputs: Tensor, input_rates: Tensor | None = None) -> Any:
    """The model with every dry friction as the forces on a measured motion say where that rests, up to its limit.

    The sign of a motion that rests is that of noise, and changes over a speed: s = tanh v / v_0. Where friction is
    large enough to hold it, the sign that balances all else is taken instead, in the share 1 − s². Where noise hides
    whether it rests, all else tells that too; and which way it starts, at less than half of that speed, for it is soon
    fast. Not where all else is twice the limit and more: a motion so slow is then one that turns round, and goes the
    way that was measured.

    Args:
        model: see `held`.
        state: (…, s) measured.
        inputs: (…, m) at the same time.
        input_rates: (…, m).
    """
    dry = _motions(model)
    signs = [sign for i in dry for sign in model.effects[i].signs(model, state).unbind(-1)]

    def rate(j: int, sign: Tensor, place: int) -> Tensor:
        given = [sign if i == j else other for i, other in enumerate(signs)]
        rates: Tensor = _with_signs(model, dry, given).derivative(state, inputs, input_rates)
        return rates[..., place]

    hidden = [v for i, motions in dry.items() for v in model.effects[i].hidden or [0.0] * len(motions)]
    for j, place in enumerate(p for motions in dry.values() for p in motions):
        sign = signs[j]
        free = rate(j, torch.zeros_like(sign), place)
        pushed = free / (free - rate(j, torch.ones_like(sign), place)).clamp(min=_NOTHING)
        rests = torch.where(pushed.abs() < 1, 1 - sign**2, 0.0)
        if hidden[j] > 0:
            speed = state[..., place] / hidden[j]
            holds = 1 - torch.tanh(speed) ** 8
            starts = 1 - torch.tanh(2 * speed) ** 8
            starts = starts * (2 - pushed.abs()).clamp(0, 1)
            rests = torch.maximum(rests, torch.where(pushed.abs() < 1, holds, starts))
        signs[j] = sign + rests * (pushed.clamp(-1, 1) - sign)
    return _with_signs(model, dry, signs)


def _motions(model: Any) -> dict[int, list[int]]:
    """Places in the state of the rates of the motions that each dry friction resists, by its place in the effects."""
    return {i: list(e.motions(model)) for i, e in enumerate(model.effects) if isinstance(e, DryEffect)}


def _with_signs(model: Any, dry: Mapping[int, Sequence[int]], signs: Sequence[Tensor]) -> Any:
    """The model with its dry frictions held at the signs (…) of their motions, one after the other."""
    left, effects = list(signs), list(model.effects)
    for i, motions in dry.items():
        mine, left = left[: len(motions)], left[len(motions) :]
        effects[i] = replace(effects[i], **{"held": torch.stack(mine, dim=-1)})
    return replace(model, effects=tuple(effects))


def mean_sign(rate: Tensor, added: Tensor, taken: Tensor, resting: Tensor) -> Tensor:
    """The mean sign over a time step of a motion that dry friction resists; see the head of this file.

    Args:
        rate: v (…) at its start.
        added: d (…) that all else adds to it.
        taken: c (…) that friction takes off it.
        resting: c (…) about standstill, where friction may be larger.
    """
    sign = torch.where(rate < 0, -torch.ones_like(rate), torch.ones_like(rate))
    speed, along = rate * sign, added * sign
    before = (speed / (taken - along).clamp(min=_NOTHING)).clamp(max=1.0)
    after = (along / resting.clamp(min=_NOTHING)).clamp(min=-1.0, max=1.0)
    return sign * torch.where(speed + along >= taken, torch.ones_like(rate), before + (1 - before) * after)
