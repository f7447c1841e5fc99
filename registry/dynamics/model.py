"""Continuous-time models with effects, and their integrator."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Set
from dataclasses import dataclass, field, replace
from functools import cache
from typing import ClassVar

import torch
from torch import Tensor

from registry.contracts import Channel
from registry.core import EFFECTS, PHYSICS
from registry.dynamics.description import Description
from registry.dynamics.effects import Effect, InputEffect
from registry.dynamics.parameters import Parameter, parameters_of
from registry.dynamics.pilot import Pilot
from registry.dynamics.sticking import held, sticks
from registry.errors import BenchError
from registry.units import SIGNALS, Signal


def unsuited(name: str, effect: Effect | type[Effect], kind: type[PhysicsModel]) -> str:
    """That an effect does not act in a model of this class, and what to do where the class is one's own."""
    kinds = effect if isinstance(effect, type) else type(effect)
    if issubclass(kinds, InputEffect) and not kind.input_signals:
        return f"The effect {name} does not fit {kind.system_name()}: it acts on an input, and that has none."
    if effect.acts_in:
        return f"The effect {name} does not fit {kind.system_name()}: it is for {effect.acts_in}."
    return (
        f"The effect {name} does not fit {kind.system_name()}: it is for {', '.join(effect.systems)}, and for a class "
        f'of your own that says alike = ("{effect.systems[0]}",).'
    )


RATE_OF = {"position": "velocity", "attitude": "body_rates", "displacement": "speed", "angle": "angle_rate"}
"""Poses, and the signal that is their rate of change."""


Rates = Callable[[Tensor, Tensor, Tensor], Tensor]
"""State, inputs, their rates of change → rates of the state; see `PhysicsModel.derivative`."""


def runge_kutta(rates: Rates, state: Tensor, segment: Tensor, dt: float) -> Tensor:
    """The state (…, s) a time step later, by the 4th-order method.

    Args:
        rates: (…, s) at a state and inputs (…, m).
        state: at the start.
        segment: (…, 3, m) the inputs at start, middle and end.
        dt: [s].
    """
    u0, um, u1 = segment.unbind(-2)
    # The derivative of the parabola through the three: its Simpson integral is exactly u1 - u0.
    d0, dm, d1 = (4 * um - 3 * u0 - u1) / dt, (u1 - u0) / dt, (3 * u1 - 4 * um + u0) / dt
    k1 = rates(state, u0, d0)
    k2 = rates(state + dt / 2 * k1, um, dm)
    k3 = rates(state + dt / 2 * k2, um, dm)
    k4 = rates(state + dt * k3, u1, d1)
    return state + dt / 6 * (k1 + 2 * (k2 + k3) + k4)


def advanced(model: PhysicsModel, rates: Rates, state: Tensor, segment: Tensor, dt: float) -> Tensor:
    """The state (…, s) of a model a time step later, on its manifold.

    Args:
        model: whose dry frictions stop what moves within the step, and hold it.
        rates: its `PhysicsModel.derivative`.
        state: at the start, with the effects' own states.
        segment: (…, 3, m) what acts at start, middle and end.
        dt: [s].
    """
    if sticks(model):
        first = segment[..., 0, :]
        rates = held(model, state, first, dt, lambda of: runge_kutta(of.derivative, state, segment, dt)).derivative
    return model.project(runge_kutta(rates, state, segment, dt))


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
            "help": "the driving signal between samples: linear (measured) or previous (commands)",
            "choices": ("linear", "previous"),
        },
    )

    extras: tuple[str, ...] = field(
        default=(),
        kw_only=True,
        metadata={"help": "signals that follow the driving one in the inputs, such as battery or time"},
    )
    held_extras: tuple[str, ...] = field(
        default=(),
        kw_only=True,
        metadata={"help": "those of them that hold between samples, as a load that is switched; others are linear"},
    )

    state_channels: ClassVar[tuple[Channel, ...]]
    """The state proper."""
    input_signals: ClassVar[tuple[str, ...]]
    """Signals that can drive the model; the first is its own."""
    signals: ClassVar[Mapping[str, Signal]] = {}
    """Signals of its own, such as what drives it, where `registry.units.SIGNALS` does not have them."""
    disturbances: ClassVar[tuple[str, ...]] = ()
    """Signals of one channel each, in `signals`, that were measured and act beside the drive: the first `extras`."""
    equation: ClassVar[str]
    """As text."""
    provides: ClassVar[tuple[str, ...]] = ()
    """Ids of effects that the base model holds already."""
    rough: ClassVar[dict[str, float]] = {}
    """Relative 1σ of constants as vehicles of this kind have them where nobody says how well they are known."""
    vehicle: ClassVar[bool] = False
    """Whether it moves in seconds as vehicles do, however often it is logged."""
    needs_pilot: ClassVar[bool] = False
    """Whether it would fall, or run away, if somebody drove it open loop."""
    through_actuator: ClassVar[bool] = False
    """Whether what drives it passes an amplifier, a valve or gears, worn or at their limit (`DriveEffect`)."""
    broadcasts: ClassVar[bool] = False
    """Whether `derivative` takes states, inputs and constants of different leading dimensions, and broadcasts them."""
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
    def chooses_drive(cls) -> bool:
        """Whether its field ``drive`` says which signal drives it; of a class of one's own that may be a constant."""
        return getattr(cls, "drive", None) in cls.input_signals

    @classmethod
    def lacking(cls) -> str:
        """What a class of one's own must still be given, as a sentence goes on after its name; empty: nothing."""
        return ""

    @classmethod
    def system_name(cls) -> str:
        """The registered name, or that of the class."""
        return PHYSICS.name_of(cls) if PHYSICS.knows(cls) else cls.__name__

    @classmethod
    def signal(cls, name: str) -> Signal | None:
        """Unit and axes of a state or an input as the model means it; None: it does not look at it."""
        states = [c for c in cls.state_channels if c.group == name]
        if states:
            return Signal(states[0].unit, tuple(c.axis for c in states))
        return cls.signals.get(name) or (SIGNALS.get(name) if name in cls.input_signals else None)

    @classmethod
    def also_measured(cls, measured: Set[str]) -> set[str]:
        """Names by which effects know what was ``measured`` under names of the model's own."""
        return set()

    def effect_unit(self, unit: str) -> str:
        """The SI unit in which the model counts a parameter of an effect that is declared in ``unit``."""
        return unit

    def __post_init__(self) -> None:
        if self.input_hold not in ("linear", "previous"):
            raise BenchError(f"input_hold = {self.input_hold!r}: choose linear or previous.")
        if not self.effects:
            return
        ids = [EFFECTS.name_of(type(e)) for e in self.effects]
        for effect, label in zip(self.effects, ids, strict=True):
            if not effect.suits(type(self)):
                raise BenchError(unsuited(label, effect, type(self)))
            if why := effect.misfit(self):
                raise BenchError(f"The effect {label} does not fit: {why}")
            if not effect.met_by({*ids, *self.provides}):
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
        return list(parameters_of(self))

    def description(self) -> Description:
        """What a diagnosis says about such a system."""
        return Description(self)

    def pilot(self) -> Pilot | None:
        """Who steers the system by set-points; None: nobody is known."""
        return None

    def internal_rates(self, state: Tensor, inputs: Tensor, input_rates: Tensor) -> Callable[[Tensor], Tensor] | None:
        """Rates (…, i) of the effects' own states as a function of these (…, i), at all given instants at once.

        Args:
            state: (…, s) the state proper.
            inputs: (…, m) what acts then.
            input_rates: (…, m) its time derivative.

        Returns:
            None where only `derivative` tells.
        """
        return None

    def followed(self, state: Tensor, inputs: Tensor) -> dict[str, Tensor]:
        """Signals (…, n) that parameters of effects are measured in (`constant`), by name, SI: input and states.

        Args:
            state: (…, s) the state proper.
            inputs: (…, m) driving signal and extras.
        """
        driving = inputs[..., : inputs.shape[-1] - len(self.extras)]
        groups = [c.group for c in self.state_channels]
        own = {g: state[..., [i for i, of in enumerate(groups) if of == g]] for g in dict.fromkeys(groups)}
        return own | ({"input": driving} if driving.shape[-1] else {})

    def time_scale(self, state: Tensor, inputs: Tensor) -> float:
        """Time [s] in which the slowest of the states (…, s) varies as far as it does, by the model's rates.

        These have no noise, and not everything moves: a temperature has no speed, a shaft often no angle. 0: none does.
        """
        shape = torch.broadcast_shapes(state.shape[:-1], inputs.shape[:-1])
        state, inputs = state.expand(*shape, -1), inputs.expand(*shape, -1)
        rates = replace(self, effects=()).derivative(state, inputs)
        spread, slope = (x.flatten(0, -2).std(0).tolist() for x in (state, rates))
        return max((a / b for a, b in zip(spread, slope, strict=True) if a > 0 and 0 < b < math.inf), default=0.0)

    def input_effects(self) -> list[InputEffect]:
        """The effects between the given input and the acting one, in order."""
        return [e for e in self.effects if isinstance(e, InputEffect)]

    def equation_names(self) -> dict[str, str]:
        """By group of states, what its equation is called; not those that only say that a pose changes as its rate."""
        groups = dict.fromkeys(c.group for c in self.state_channels)
        return {g: g.replace("_", " ") for g in groups if RATE_OF.get(g) not in groups}

    @property
    def sensed_channels(self) -> tuple[Channel, ...]:
        """What sensors tell of the derivative of the state rather than of the state, such as an accelerometer."""
        return ()

    @property
    def measured_channels(self) -> tuple[Channel, ...]:
        """All that measurements can be compared with: the states, and after them what sensors tell of their rates."""
        return (*self.state_channels, *self.sensed_channels)

    def sensed(self, state: Tensor, rates: Tensor) -> Tensor:
        """What the sensors of `sensed_channels` show (…, f) at states (…, s) and their time derivative (…, s)."""
        return state[..., :0]

    @property
    def drive_acts_at_once(self) -> bool:
        """Whether the driving signal is what acts, so that any delay between it and the motion is one of the log."""
        return False

    @property
    def driving_channels(self) -> int:
        """Number of channels of the signal that drives it: as many as it has axes, else as there are rotors, or one."""
        if not self.input_signals:
            return 0
        known = self.signal(self.input_signals[0])
        return len(known.axes if known else ()) or len(getattr(self, "rotor_positions", ())) or 1

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

    def held_channels(self, inputs: int) -> list[int]:
        """Which of so many inputs hold between samples, as `input_hold` says of the drive, `held_extras` of extras."""
        drives = inputs - len(self.extras)
        held = list(range(drives)) if self.input_hold == "previous" else []
        return [*held, *(drives + i for i, name in enumerate(self.extras) if name in self.held_extras)]

    def between(self, before: Tensor, after: Tensor) -> Tensor:
        """Inputs (…, 3, m) at start, middle and end of a step, from those (…, m) before and after it."""
        held, lines = self.held_channels(before.shape[-1]), [before, (before + after) / 2, after]
        if len(held) == before.shape[-1]:
            lines = [before, before, before]
        elif held:
            holds = [c in held for c in range(before.shape[-1])]
            lines = [torch.stack([(before if h else x)[..., c] for c, h in enumerate(holds)], dim=-1) for x in lines]
        return torch.stack(lines, dim=-2)

    def transmit(self, memory: Tensor, before: Tensor, after: Tensor, dt: float) -> tuple[Tensor, Tensor]:
        """Pass one time step through the input effects.

        Args:
            memory: (…, size) their memories at t.
            before: (…, m) inputs at t.
            after: (…, m) inputs at t + dt; of what is held not looked at.
            dt: [s].

        Returns:
            The memories at t + dt and the segment (…, 3, m) of the inputs that act at its start, middle and end.
        """
        held, segment, effects = self.input_hold == "previous", self.between(before, after), self.input_effects()
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
            after: (…, m) inputs at t + dt.
            dt: [s].

        Returns:
            The full state (…, s) at t + dt.
        """
        size = len(self.state_channels) + self.internal_size
        body, memory = state[..., :size], state[..., size:]
        memory, segment = self.transmit(memory, before, after, dt)
        body = advanced(self, self.derivative, body, segment, dt)
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
