"""Physics models and the effects that a simple one leaves out.

A model's constants and an effect's parameters are the fields of frozen dataclasses; each may hold a number,
a tuple of numbers or a tensor (to fit it by gradient, or one value a batch element). Everything is batched
over leading dimensions and differentiable. SI inside; world z up, body x forward, y left, z up.
"""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property, lru_cache
from typing import Any, ClassVar, Self

import torch
from torch import Tensor

from registry.contracts import Channel
from registry.core import EFFECTS, PHYSICS, option
from registry.errors import BenchError

# ------------------------------------------------------------------------------------------------ parameters


@dataclass(frozen=True)
class Parameter:
    """A physical constant: nominal value, bounds and what is known about it."""

    name: str
    unit: str
    value: Any
    low: float | None
    high: float | None
    uncertainty: float
    """Relative, 1σ."""
    neutral: Any
    """Of an effect: the value that makes it no effect."""
    typical: Any
    """Of an effect: a value met on real vehicles."""
    source: str
    about: str


def constant(
    value: Any,
    about: str,
    unit: str,
    *,
    low: float | None = None,
    high: float | None = None,
    source: str = "",
    uncertainty: float = 0.02,
    typical: Any = None,
) -> Any:
    """A dataclass field for a physical constant; of an effect, ``value`` is the neutral one.

    Args:
        value: nominal value, SI.
        about: one line of explanation.
        unit: SI unit.
        low: inclusive bound.
        high: inclusive bound.
        source: where the value comes from.
        uncertainty: relative, 1σ.
        typical: of an effect, a value met on real vehicles.
    """
    base = option(value, about, unit=unit, low=low, high=high, source=source)
    return field(default=value, metadata={**base.metadata, "uncertainty": uncertainty, "typical": typical})


def _parameters(entry: Any) -> Iterator[Parameter]:
    for f in dataclasses.fields(entry):
        if "uncertainty" in f.metadata:
            m = f.metadata
            spread, neutral, typical = m["uncertainty"], f.default, m["typical"]
            value = getattr(entry, f.name)
            yield Parameter(
                f.name, m["unit"], value, m["low"], m["high"], spread, neutral, typical, m["source"], m["help"]
            )


def tensor(value: Any, like: Tensor) -> Tensor:
    """A constant (number, nested tuple or tensor) as a tensor of the type and device of ``like``: to read only."""
    if isinstance(value, (float, tuple)):
        return _fixed(value, like.dtype, like.device)
    return torch.as_tensor(value, dtype=like.dtype, device=like.device)


@lru_cache(maxsize=1024)
def _fixed(value: float | tuple[Any, ...], dtype: torch.dtype, device: torch.device) -> Tensor:
    # Made once: in a free run the same few numbers are asked for at every instant. Not as an inference tensor, which
    # could not take part in a later backward pass.
    with torch.inference_mode(False):
        return torch.as_tensor(value, dtype=dtype, device=device)


def vector(values: Sequence[Any], like: Tensor) -> Tensor:
    """Constants (numbers, or tensors (…)) side by side (…, len) in a tensor of the type and device of ``like``."""
    if any(isinstance(v, Tensor) for v in values):
        return torch.stack(torch.broadcast_tensors(*(tensor(v, like) for v in values)), dim=-1)
    return tensor(tuple(values), like)


def cross(a: Tensor, b: Tensor) -> Tensor:
    """a × b over the last dimension (…, 3), with broadcasting."""
    ax, ay, az = a.unbind(-1)
    bx, by, bz = b.unbind(-1)
    return torch.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], dim=-1)


# --------------------------------------------------------------------------------------------------- effects


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
    screen: ClassVar[dict[str, tuple[float, ...]]] = {}
    """Of parameters that the effect is not linear in: values from which a search for them starts."""
    manoeuvre: ClassVar[str] = ""
    """What to do so that the effect shows and can be told from others, as a phrase that follows "to see it, "."""
    internal_size: ClassVar[int] = 0
    """Number of states of its own."""

    def parameters(self) -> list[Parameter]:
        """The parameters, in order."""
        return list(_parameters(self))

    @classmethod
    def suits(cls, kind: type[PhysicsModel]) -> bool:
        """Whether it acts in models of this class; one of the input does where there is an input."""
        driven = bool(kind.input_signals) or not issubclass(cls, InputEffect)
        return driven and (not cls.systems or not kind.systems().isdisjoint(cls.systems))

    @classmethod
    def neutral(cls) -> Self:
        """With the parameters that make it no effect."""
        return cls()

    @classmethod
    def typical(cls) -> Self:
        """With parameters met on real vehicles."""
        return cls(**{p.name: p.typical for p in _parameters(cls())})


class LoadEffect(Effect):
    """Adds a force and a torque to a rigid body."""

    @abstractmethod
    def load(self, motion: Motion) -> tuple[Tensor, Tensor]:
        """Force (…, 3) [N] and torque about the centre of gravity (…, 3) [N m], body frame."""


class InternalEffect(LoadEffect):
    """Adds a load that depends on states of its own, which start at zero."""

    @abstractmethod
    def internal_rate(self, motion: Motion, acceleration: Tensor) -> Tensor:
        """Time derivative (…, internal_size) of ``motion.internal``.

        Args:
            motion: the motion now.
            acceleration: (…, 3) of the body without this kind of effect, gravity included, world frame [m/s²].
        """


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


class ModelEffect(Effect):
    """Acts on the model's constants."""

    @abstractmethod
    def adapt(self, model: Any) -> Any:
        """The model with changed constants."""


class InputEffect(Effect):
    """Stands between the given input and the one that acts; has a memory of its own."""

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

    def over(self, first: Tensor, segments: Tensor, dt: float, held: bool) -> tuple[Tensor, Tensor]:
        """Pass a whole recording; an effect that can do it at once may, with the same result.

        Args:
            first: (…, m) the input until the recording begins.
            segments: (…, K, 3, m) the input over each of K time steps.
            dt: length of a step [s].
            held: as for `act`.

        Returns:
            The memory (…, K + 1, memory_size) at every sample and the segments (…, K, 3, m) that come out.
        """
        memory, out = self.steady(first, dt), []
        memories = [memory]
        for k in range(segments.shape[-3]):
            memory, segment = self.act(memory, segments[..., k, :, :], dt, held)
            memories.append(memory)
            out.append(segment)
        return torch.stack(memories, dim=-2), torch.stack(out, dim=-3)


# ---------------------------------------------------------------------------------------------------- models


def unsuited(name: str, effect: Effect | type[Effect], kind: type[PhysicsModel]) -> str:
    """That an effect does not act in a model of this class, and what to do where the class is one's own."""
    kinds = effect if isinstance(effect, type) else type(effect)
    if issubclass(kinds, InputEffect) and not kind.input_signals:
        return f"The effect {name} does not fit {kind.system_name()}: it acts on an input, and that has none."
    return (
        f"The effect {name} does not fit {kind.system_name()}: it is for {', '.join(effect.systems)}, and for a class "
        f'of your own that says alike = ("{effect.systems[0]}",).'
    )


@dataclass(frozen=True)
class PhysicsModel(ABC):
    """A continuous-time model dx/dt = f(x, u) and its integrator (4th-order Runge–Kutta).

    The full state is the state proper, `state_channels`, followed by the own states of effects that have some, and
    the memories of the input effects. The inputs (…, m) are the driving signal followed by `extras`.
    """

    effects: tuple[Effect, ...] = field(
        default=(), kw_only=True, metadata={"help": "effects added to the base model, in order"}
    )
    input_hold: str = field(
        default="linear",
        kw_only=True,
        metadata={
            "help": "inputs between samples: linear (measured) or previous (commands)",
            "choices": ("linear", "previous"),
        },
    )

    extras: tuple[str, ...] = field(
        default=(),
        kw_only=True,
        metadata={"help": "signals that follow the driving one in the inputs, such as battery or time"},
    )

    state_channels: ClassVar[tuple[Channel, ...]]
    """The state proper."""
    input_signals: ClassVar[tuple[str, ...]]
    """Signals that can drive the model; the first is its own."""
    equation: ClassVar[str]
    """As text."""
    provides: ClassVar[tuple[str, ...]] = ()
    """Ids of effects that the base model holds already."""
    alike: ClassVar[tuple[str, ...]]
    """Registered systems whose effects act in it too; default: those of the classes that it derives from."""

    @classmethod
    @cache  # models are made by the thousand
    def systems(cls) -> frozenset[str]:
        """The names under which effects know it (`Effect.systems`)."""
        bases = [b for b in cls.__bases__ if issubclass(b, PhysicsModel)]
        others = vars(cls)["alike"] if "alike" in vars(cls) else set[str]().union(*(b.systems() for b in bases))
        return frozenset(others if cls.__abstractmethods__ else {cls.system_name(), *others})

    @classmethod
    def system_name(cls) -> str:
        """The registered name, or that of the class."""
        return PHYSICS.name_of(cls) if PHYSICS.knows(cls) else cls.__name__

    def __post_init__(self) -> None:
        if self.input_hold not in ("linear", "previous"):
            raise BenchError(f"input_hold = {self.input_hold!r}: choose linear or previous.")
        if not self.effects:
            return
        ids = [EFFECTS.name_of(type(e)) for e in self.effects]
        for effect, label in zip(self.effects, ids, strict=True):
            if not effect.suits(type(self)):
                raise BenchError(unsuited(label, effect, type(self)))
            if effect.requires and not set(effect.requires) & {*ids, *self.provides}:
                raise BenchError(f"The effect {label} needs another one in the model: {', '.join(effect.requires)}.")

    @abstractmethod
    def derivative(self, state: Tensor, inputs: Tensor, input_rates: Tensor | None = None) -> Tensor:
        """Time derivative (…, s) of the state without memories (…, s).

        Args:
            state: (…, s) the state proper and the effects' own states, in the order of the effects.
            inputs: (…, m) what acts now (after the input effects), and the extras.
            input_rates: (…, m) its time derivative; None: constant inputs.
        """

    def project(self, state: Tensor) -> Tensor:
        """The state (…, s) put back on its manifold after a step, such as a quaternion to unit length."""
        return state

    def parameters(self) -> list[Parameter]:
        """The constants, in order (those of the effects are theirs)."""
        return list(_parameters(self))

    def input_effects(self) -> list[InputEffect]:
        """The effects between the given input and the acting one, in order."""
        return [e for e in self.effects if isinstance(e, InputEffect)]

    @property
    def internal_size(self) -> int:
        """Number of states that the effects have of their own."""
        return sum(e.internal_size for e in self.effects)

    def extra(self, name: str, inputs: Tensor) -> Tensor | None:
        """The extra signal (…) of that name within the inputs (…, m); None: it is not there."""
        if name not in self.extras:
            return None
        return inputs[..., inputs.shape[-1] - len(self.extras) + self.extras.index(name)]

    def initial(self, state: Tensor, inputs: Tensor, dt: float) -> Tensor:
        """Full state from the state proper (…, s) and inputs (…, m) that have been steady until now."""
        driving = inputs[..., : inputs.shape[-1] - len(self.extras)]
        own = state.new_zeros((*state.shape[:-1], self.internal_size))
        return torch.cat([state, own, *(e.steady(driving, dt) for e in self.input_effects())], dim=-1)

    def transmit(self, memory: Tensor, before: Tensor, after: Tensor, dt: float) -> tuple[Tensor, Tensor]:
        """Pass one time step through the input effects.

        Args:
            memory: (…, size) their memories at t.
            before: (…, m) inputs at t.
            after: (…, m) inputs at t + dt; not looked at when inputs are held (but for the extras).
            dt: [s].

        Returns:
            The memories at t + dt and the segment (…, 3, m) of the inputs that act at its start, middle and end.
        """
        held = self.input_hold == "previous"
        segment = torch.stack([before, before, before] if held else [before, (before + after) / 2, after], dim=-2)
        effects = self.input_effects()
        if not effects:
            return memory, segment
        driving, extras = segment.split([segment.shape[-1] - len(self.extras), len(self.extras)], dim=-1)
        memories, at = [], 0
        for effect in effects:
            size = effect.memory_size(driving.shape[-1], dt)
            changed, driving = effect.act(memory[..., at : at + size], driving, dt, held)
            memories.append(changed)
            at += size
        return torch.cat(memories, dim=-1), torch.cat([driving, extras], dim=-1)

    def step(self, state: Tensor, before: Tensor, after: Tensor, dt: float) -> Tensor:
        """One time step of the full state.

        Args:
            state: (…, s) full state at t.
            before: (…, m) inputs at t.
            after: (…, m) inputs at t + dt; not looked at when inputs are held.
            dt: [s].

        Returns:
            The full state (…, s) at t + dt.
        """
        size = len(self.state_channels) + self.internal_size
        body, memory = state[..., :size], state[..., size:]
        memory, segment = self.transmit(memory, before, after, dt)
        u0, um, u1 = segment.unbind(-2)
        # The derivative of the parabola through the three: its Simpson integral is exactly u1 - u0.
        d0, dm, d1 = (4 * um - 3 * u0 - u1) / dt, (u1 - u0) / dt, (3 * u1 - 4 * um + u0) / dt
        k1 = self.derivative(body, u0, d0)
        k2 = self.derivative(body + dt / 2 * k1, um, dm)
        k3 = self.derivative(body + dt / 2 * k2, um, dm)
        k4 = self.derivative(body + dt * k3, u1, d1)
        body = self.project(body + dt / 6 * (k1 + 2 * (k2 + k3) + k4))
        return torch.cat([body, memory], dim=-1) if memory.shape[-1] else body

    def simulate(self, state: Tensor, inputs: Tensor, dt: float) -> Tensor:
        """Free run.

        Args:
            state: (…, s) state proper at the first input sample, where all has been steady before.
            inputs: (…, N, m).
            dt: [s].

        Returns:
            The state proper (…, N, s) at the input samples, the first as given.
        """
        full, states = self.initial(state, inputs[..., 0, :], dt), [state]
        for k in range(1, inputs.shape[-2]):
            full = self.step(full, inputs[..., k - 1, :], inputs[..., k, :], dt)
            states.append(full[..., : state.shape[-1]])
        return torch.stack(states, dim=-2)
