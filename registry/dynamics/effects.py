"""Kinds of physical effects, by what they act on."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar, Self

import torch
from torch import Tensor

from registry.dynamics.parameters import Parameter, cross, in_measure, parameters_of, tensor


@dataclass(frozen=True)
class Motion:
    """What an effect sees of a rigid body at one instant. Shapes (…, 3) unless said."""

    model: Any
    """The rigid body's model, for its constants."""
    position: Tensor
    """World [m]."""
    velocity: Tensor
    """World [m/s]."""
    rotation: Tensor
    """(…, 3, 3), body to world."""
    body_rates: Tensor
    """[rad/s]."""
    air_velocity: Tensor
    """Rᵀ(v − wind): velocity through the air in the body frame [m/s]."""
    inputs: Tensor
    """(…, m) what acts on the body now, such as rotor speeds [rad/s]."""
    input_rates: Tensor
    """(…, m) its time derivative."""
    thrust: Tensor
    """(…, rotors) of each rotor along body z [N], after the effects that scale it."""
    extras: dict[str, Tensor] = field(default_factory=dict)
    """Other signals that were measured, such as the battery's voltage (…); see `PhysicsModel.extras`."""
    internal: Tensor | None = None
    """(…, internal_size) of the effect that looks, if it is an `InternalEffect`."""

    @cached_property
    def total_thrust(self) -> Tensor:
        """(…) sum over the rotors [N]."""
        return self.thrust.sum(-1)

    @cached_property
    def hub_velocity(self) -> Tensor:
        """(…, rotors, 3) of each hub through the air, body frame [m/s]: v_i = v_b + ω_b × r_i."""
        arms = tensor(self.model.rotor_positions, self.air_velocity)
        return self.air_velocity.unsqueeze(-2) + cross(self.body_rates.unsqueeze(-2), arms)


@dataclass(frozen=True)
class Effect(ABC):
    """A physical effect. Subclass one of the kinds below, give the fields as `constant` and register it."""

    equation: ClassVar[str]
    """As text, in the symbols of the field."""
    needs: ClassVar[tuple[str, ...]] = ()
    """Signals without which the effect cannot be seen in data."""
    requires: ClassVar[tuple[str, ...]] = ()
    """Ids of effects one of which must be in the model (a model can bring them itself, `provides`)."""
    systems: ClassVar[tuple[str, ...]] = ()
    """Physics models the effect fits; empty: all."""
    acts_in: ClassVar[str] = ""
    """What models it `suits`, where that is not told by their names, as a phrase that follows "it is for "."""
    screen: ClassVar[dict[str, tuple[float, ...]]] = {}
    """Of parameters that the effect is not linear in: values from which a search for them starts.

    Of a parameter that has a measure (`constant`), shares of that: so that it is found in a machine of any size.
    """
    manoeuvre: ClassVar[str] = ""
    """What to do so that the effect shows and can be told from others, as a phrase that follows "to see it, "."""
    internal_size: ClassVar[int] = 0
    """Number of states of its own."""
    changes_model: ClassVar[bool] = False
    """Whether it alters what the model's constants do to a motion, as what stands before the input always does."""
    learned: ClassVar[bool] = False
    """Whether it is estimated from what the catalogue leaves, and no member of it."""

    def parameters(self) -> list[Parameter]:
        """The parameters, in order; a field that is None is none of this vehicle's."""
        return [p for p in parameters_of(self) if p.value is not None]

    def options(self) -> dict[str, Any]:
        """What a model file says of it beside the parameters; most effects are told by their parameters alone."""
        return {}

    @classmethod
    def from_options(cls, where: str, given: dict[str, Any]) -> Self | None:
        """The effect of a model file's table, of one that has `options`; None: it has parameters only.

        Args:
            where: the table, to name in an error.
            given: its keys and values without the id.
        """
        return None

    def misfit(self, model: Any) -> str:
        """Why it does not act in a model although it `suits` its class, as a sentence; empty: it does."""
        return ""

    @classmethod
    def suits(cls, kind: Any) -> bool:
        """Whether it acts in models of this class, a `PhysicsModel`; one of the input does where there is an input."""
        driven = bool(kind.input_signals) or not issubclass(cls, InputEffect)
        return driven and (not cls.systems or not kind.systems().isdisjoint(cls.systems))

    @classmethod
    def neutral(cls) -> Self:
        """With the parameters that make it no effect."""
        return cls()

    @classmethod
    def neutral_for(cls, model: Any, medians: Mapping[str, float]) -> Self:
        """`neutral`, with as many parameters as a model wants, and what is not fitted of it as recordings suggest.

        Args:
            model: a `PhysicsModel` that it suits.
            medians: of the signals that the model has as `PhysicsModel.extras`, by name, SI.
        """
        return cls.neutral()

    @classmethod
    def met_by(cls, there: Collection[str]) -> bool:
        """Whether one of these ids is among what it `requires`, if it requires any."""
        return not cls.requires or not set(cls.requires).isdisjoint(there)

    def possible_in(self, model: Any) -> bool:
        """Whether anything has such numbers beside the model's, beyond the bounds of each: peaks are no dips."""
        return True

    @classmethod
    def together(cls, values: Mapping[str, float]) -> str:
        """What its numbers say only together, in a few words; empty: each says what it does by itself."""
        return ""

    @property
    def fastest(self) -> float:
        """Period of the fastest oscillation that it brings [s]; infinite: it brings none."""
        return math.inf

    @classmethod
    def grid(cls, sizes: Mapping[str, float]) -> dict[str, tuple[float, ...]]:
        """`screen` in the units of the parameters, where signals were as large as ``sizes``; see `in_measure`."""
        own = {p.name: in_measure(p, sizes) for p in parameters_of(cls()) if p.measure}
        return {name: tuple(own.get(name, 1.0) * v for v in values) for name, values in cls.screen.items()}

    def sized(self, sizes: Mapping[str, float], fitted: bool = True) -> Self:
        """With the parameters that have a share at that share of what was recorded.

        Args:
            sizes: how large signals became, as for `in_measure`.
            fitted: whether those that are fitted are put there too.
        """
        changed = [p for p in self.parameters() if p.share is not None and (fitted or p.uncertainty == 0)]
        return replace(self, **{p.name: float(p.share or 0.0) * in_measure(p, sizes) for p in changed})

    @classmethod
    def typical(cls) -> Self:
        """With parameters met on real vehicles."""
        return cls(**{p.name: p.typical for p in parameters_of(cls()) if p.typical is not None})

    @classmethod
    def typical_for(cls, model: Any) -> Self:
        """`typical`, with as many parameters as ``model`` wants."""
        neutral = cls.neutral_for(model, {})
        return replace(neutral, **{p.name: p.typical for p in neutral.parameters()})


class LoadEffect(Effect):
    """Adds a force and a torque to a rigid body."""

    @abstractmethod
    def load(self, motion: Motion) -> tuple[Tensor, Tensor]:
        """Force (…, 3) [N] and torque about the centre of gravity (…, 3) [N m], body frame."""


class InternalEffect(Effect):
    """Adds a force and a torque that depend on states of its own, which start at zero."""

    @abstractmethod
    def load(self, motion: Motion, acceleration: Tensor) -> tuple[Tensor, Tensor]:
        """Force (…, 3) [N] and torque about the centre of gravity (…, 3) [N m], body frame.

        Args:
            motion: the motion now.
            acceleration: (…, 3) of the body without this kind of effect, gravity included, world frame [m/s²].
        """

    @abstractmethod
    def internal_rate(self, motion: Motion, acceleration: Tensor) -> Tensor:
        """Time derivative (…, internal_size) of ``motion.internal``; arguments as of `load`."""


class HubEffect(Effect):
    """Adds a force at each rotor hub, and with it the torque r × F."""

    @abstractmethod
    def hub_force(self, motion: Motion) -> Tensor:
        """Forces (…, rotors, 3) [N], body frame."""


class ThrustEffect(Effect):
    """Scales the thrust of each rotor, for the body and for all other effects that it enters."""

    @abstractmethod
    def thrust_factor(self, motion: Motion) -> Tensor:
        """Factor (…, rotors) or (…, 1) on ``motion.thrust``, which holds the factors of the effects before this one."""


class TorqueEffect(Effect):
    """Acts on the sum of all torques, before the moments of inertia turn it into angular acceleration."""

    @abstractmethod
    def net_torque(self, torque: Tensor) -> Tensor:
        """What acts (…, 3) [N m] in place of the sum ``torque`` (…, 3), body frame."""


class RateEffect(Effect):
    """Adds to the time derivative of the state of any system."""

    sees_extras: ClassVar[bool] = False
    """Whether `rate` is given `PhysicsModel.extras` too, such as the time, after what drives the system."""

    @abstractmethod
    def rate(self, model: Any, state: Tensor, inputs: Tensor) -> Tensor:
        """What it adds to dx/dt.

        Args:
            model: the system's model, for its constants.
            state: (…, s + internal_size) the state proper and the effect's own states, which start at zero.
            inputs: (…, m) what acts now.

        Returns:
            (…, s + internal_size): the addition to dx/dt, and the derivative of the own states.
        """


class WindEffect(Effect):
    """Moves the air."""

    @abstractmethod
    def wind(self, like: Tensor) -> Tensor:
        """Velocity of the air (…, 3) [m/s], world frame, of the type of ``like``."""


class PointEffect(Effect):
    """Says of which point of a rigid body position and velocity are recorded."""

    @abstractmethod
    def arm(self, like: Tensor) -> Tensor:
        """Where it is (…, 3) [m], from the centre of gravity along the body's axes, of the type of ``like``."""


class ModelEffect(Effect):
    """Acts on the model's constants."""

    @abstractmethod
    def adapt(self, model: Any) -> Any:
        """The model with changed constants."""


class InputEffect(Effect):
    """Stands between the given input and the one that acts; has a memory of its own."""

    changes_model: ClassVar[bool] = True

    @abstractmethod
    def memory_size(self, inputs: int, dt: float) -> int:
        """Length of the memory for ``inputs`` channels at a step of ``dt`` [s]."""

    @abstractmethod
    def steady(self, inputs: Tensor, dt: float) -> Tensor:
        """Memory (…, memory_size) after inputs (…, m) that have not changed for long."""

    @abstractmethod
    def act(self, memory: Tensor, segment: Tensor, dt: float, held: bool) -> tuple[Tensor, Tensor]:
        """Pass one time step.

        Args:
            memory: (…, memory_size) at its start.
            segment: (…, 3, m) the input at its start, middle and end, linear between them.
            dt: its length [s].
            held: whether the samples are held over a step (else they are joined by straight lines).

        Returns:
            The memory at its end and the segment (…, 3, m) that comes out.
        """

    def over(self, memory: Tensor, segments: Tensor, dt: float, held: bool) -> tuple[Tensor, Tensor]:
        """Pass many time steps; an effect that can do them at once may, with the same result.

        Args:
            memory: (…, memory_size) at their start.
            segments: (…, K, 3, m) the input over each of K time steps.
            dt: length of a step [s].
            held: as for `act`.

        Returns:
            The memory (…, K + 1, memory_size) at every sample and the segments (…, K, 3, m) that come out.
        """
        memories, out = [memory], []
        for k in range(segments.shape[-3]):
            memory, segment = self.act(memory, segments[..., k, :, :], dt, held)
            memories.append(memory)
            out.append(segment)
        return torch.stack(memories, dim=-2), torch.stack(out, dim=-3)

    def transmitted(self, memory: Tensor, segments: Tensor, dt: float, held: bool) -> Tensor:
        """The segments (…, K, 3, m) that come out of `over`, where nobody asks for the memory between."""
        return self.over(memory, segments, dt, held)[1]
