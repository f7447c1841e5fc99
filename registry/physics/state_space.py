"""Systems of which an effect adds to dx/dt: any of them, and those that move by forces."""

import re
from abc import abstractmethod
from collections.abc import Set
from dataclasses import fields
from functools import cache
from typing import Any, ClassVar

import torch
from torch import Tensor
from typing_extensions import override

from registry.dynamics import ModelEffect, PhysicsModel, RateEffect, tensor
from registry.terms.unit_algebra import product
from registry.units import bare, exponents


class StateSpace(PhysicsModel):
    """dx/dt = own rate + what the effects add."""

    through_actuator: ClassVar[bool] = True

    def __post_init__(self) -> None:
        rest = (name for name in self.extras if name not in self.disturbances)
        object.__setattr__(self, "extras", (*self.disturbances, *rest))
        super().__post_init__()

    @abstractmethod
    def own_rate(self, state: Tensor, inputs: Tensor) -> Tensor:
        """dx/dt (…, s) without effects, at the state proper (…, s), the driving inputs and the disturbances (…, m)."""

    def acting(self, inputs: Tensor) -> Tensor:
        """The driving inputs and the disturbances within the inputs (…, m), which hold all extras."""
        return inputs[..., : inputs.shape[-1] - len(self.extras) + len(self.disturbances)]

    def driven_by(self, more: Tensor, state: Tensor, acting: Tensor) -> Tensor:
        """What is added to dx/dt (…, s) where so much (…, n) of every channel drives it beside what acts (…, m)."""
        count = more.shape[-1]
        driven = acting[..., :count] + more
        if self.disturbances:
            driven = torch.cat([driven, acting[..., count:].expand(*driven.shape[:-1], -1)], dim=-1)
        return self.own_rate(state, driven) - self.own_rate(state, acting)

    @override
    def effect_unit(self, unit: str) -> str:
        """In volts is what stands for the drive, whatever its unit: 1/V is 1/N of a force; in rad a joint's path."""
        if (joints := self.joints()) and self.state_channels[joints[0]].unit == "m/s":
            unit = re.sub(r"\brad\b", "m", unit)
        drive = next(iter(type(self).input_signals), "")
        its = type(self).signal(drive)
        if its is None or not re.search(r"\bV\b", unit):
            return unit
        return product(*((its.unit if symbol == "V" else symbol, power) for symbol, power in exponents(unit).items()))

    @override
    def equation_names(self) -> dict[str, str]:
        """See `PhysicsModel.equation_names`; a pose of any name is known by its rate, which is another state itself."""
        groups = [c.group for c in self.state_channels]
        moves = {g for g, rate in zip(groups, _rate_of(type(self)), strict=True) if rate is None}
        return {g: name for g, name in super().equation_names().items() if g in moves or not moves}

    @classmethod
    def joints(cls) -> tuple[int, ...]:
        """Of every driving channel the place of the rate that it drives, where each drives one; else none.

        Those are states that are the rate of another one: by the names of their axes where every channel has that of
        one, else, where they are as many as channels, in the order of the states that they are the rates of.
        """
        rates = [place for place in _rate_of(cls) if place is not None]
        drive = next((cls.signal(name) for name in cls.input_signals), None)
        axes = () if drive is None else drive.axes
        moved = {cls.state_channels[r].axis: r for r in rates}
        named = bool(axes) and set(axes) <= set(moved)
        driven = [moved[a] for a in axes] if named else rates if len(axes) == len(rates) else []
        return tuple(driven) if len({cls.state_channels[r].unit for r in driven}) == 1 else ()

    @classmethod
    @override
    def also_measured(cls, measured: Set[str]) -> set[str]:
        """To an effect the rates of joints are "angle_rate", whatever the class calls them."""
        return {"angle_rate"} if measured & {cls.state_channels[j].group for j in cls.joints()} else set()

    @override
    def followed(self, state: Tensor, inputs: Tensor) -> dict[str, Tensor]:
        """See `PhysicsModel.followed`; and the rates of joints, each in the unit of its own."""
        joints = {"joint_rate": state[..., list(self.joints())]} if self.joints() else {}
        return super().followed(state, inputs) | joints

    def derivative(self, state: Tensor, inputs: Tensor, input_rates: Tensor | None = None) -> Tensor:
        """Time derivative (…, s) of the state (…, s); see `PhysicsModel.derivative`."""
        model: Any = self
        for effect in self.effects:
            if isinstance(effect, ModelEffect):
                model = effect.adapt(model)
        size = at = len(self.state_channels)
        proper, acting = state[..., :size], self.acting(inputs)
        rate, own = model.own_rate(proper, acting), []
        for effect in self.effects:
            if isinstance(effect, RateEffect):
                seen = torch.cat([proper, state[..., at : at + effect.internal_size]], dim=-1)
                added = effect.rate(model, seen, inputs if effect.sees_extras else acting)
                rate = rate + added[..., :size]
                own.append(added[..., size:])
                at += effect.internal_size
        return torch.cat([rate, *own], dim=-1)


@cache
def _rate_of(kind: type[StateSpace]) -> tuple[int | None, ...]:
    """Of each state the place of another one that is its rate at all states and inputs, found by trying three."""
    generator, plain = torch.Generator().manual_seed(0), kind()
    state = 0.5 + torch.rand(3, len(kind.state_channels), generator=generator, dtype=torch.float64)
    acting = torch.full((3, plain.driving_channels + len(kind.disturbances)), 0.5, dtype=torch.float64)
    with torch.no_grad():
        rate = plain.own_rate(state, acting)
    same: list[list[bool]] = (rate[:, :, None] == state[:, None, :]).all(dim=0).tolist()
    return tuple(row.index(True) if any(row) else None for row in same)


class Mechanical(StateSpace):
    """A mass that forces move. The state is n coordinates, then their n velocities."""

    mass: Any

    alike: ClassVar[tuple[str, ...]] = ("mass_on_rail", "oscillator")

    @classmethod
    @override
    def joints(cls) -> tuple[int, ...]:
        """None: friction is a force along the path."""
        return ()

    @classmethod
    @override
    def lacking(cls) -> str:
        if "mass" in {f.name for f in fields(cls)}:
            return ""
        return (
            "derives from Mechanical, and so needs a constant called mass, such as "
            'mass: Any = constant(1.0, "m", "kg"); of a shaft it is the moment of inertia, in kg m^2.'
        )

    @classmethod
    @override
    def also_measured(cls, measured: Set[str]) -> set[str]:
        """To an effect the coordinates are "displacement" and their rates "speed", whatever the class calls them."""
        groups = [c.group for c in cls.state_channels]
        half = len(groups) // 2
        roles = {"displacement": groups[:half], "speed": groups[half:]}
        return {role for role, its in roles.items() if measured & set(its)}

    @classmethod
    def turns(cls) -> bool:
        """Whether it is a shaft or an arm: its mass is a moment of inertia."""
        return any(f.name == "mass" and f.metadata.get("unit") == "kg m^2" for f in fields(cls))

    @override
    def effect_unit(self, unit: str) -> str:
        """Of what turns: torques in N m, inertia in kg m^2 and paths in rad, where a mass on a rail has N, kg and m."""
        if self.turns():
            turning = {"N": "N m", "kg": "kg m^2", "m": "rad"}
            unit = re.sub(r"\b(N|kg|m)\b", lambda of: turning[of[0]], bare(unit))
            unit = re.sub(r"/(\S+ .+)", r"/(\1)", unit)
        return super().effect_unit(unit)

    @abstractmethod
    def own_force(self, state: Tensor, inputs: Tensor) -> Tensor:
        """Forces (…, n) [N] without effects, at the state proper (…, 2n) and the driving inputs (…, m)."""

    def lever(self, like: Tensor) -> Tensor:
        """Metres of path over the unit of the coordinates, () or of batch shape."""
        return like.new_ones(())

    def displacement(self, state: Tensor) -> Tensor:
        """Path (…, n) [m] at the state (…, 2n + own states of an effect)."""
        return state[..., : len(self.state_channels) // 2] * self.lever(state).unsqueeze(-1)

    def speed(self, state: Tensor) -> Tensor:
        """Velocity (…, n) [m/s] along the path."""
        size = len(self.state_channels)
        return state[..., size // 2 : size] * self.lever(state).unsqueeze(-1)

    @override
    def followed(self, state: Tensor, inputs: Tensor) -> dict[str, Tensor]:
        """See `PhysicsModel.followed`; path and speed in metres, and the force of the model itself [N]."""
        all_of = super().followed(state, inputs)
        own = {"displacement": self.displacement(state), "speed": self.speed(state)}
        return all_of | own | {"force": self.own_force(state, self.acting(inputs))}

    def push(self, force: Tensor) -> Tensor:
        """What forces (…, n) [N] along the path add to dx/dt (…, 2n)."""
        inertia = (tensor(self.mass, force) * self.lever(force)).unsqueeze(-1)
        return torch.cat([torch.zeros_like(force), force / inertia], dim=-1)

    def own_rate(self, state: Tensor, inputs: Tensor) -> Tensor:
        """Velocities, and accelerations by the own forces (…, 2n); see `StateSpace.own_rate`."""
        velocity = state[..., state.shape[-1] // 2 :]
        return torch.cat([velocity, torch.zeros_like(velocity)], dim=-1) + self.push(self.own_force(state, inputs))
