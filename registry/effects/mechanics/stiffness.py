"""Forces on a moving mass that go with its position, and the joint that the drive works through."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor
from typing_extensions import override

from registry.core import EFFECTS
from registry.dynamics import InputEffect, constant, tensor
from registry.effects.mechanics.friction import ForceEffect, scaled

_TURN = 2 * math.pi
_RIGID = 1e-9
"""T = 1/ω [s] up to which a joint does not bend at all, so that rounding errors of zero are zero."""


@EFFECTS.register("linear_stiffness")
@dataclass(frozen=True)
class LinearStiffness(ForceEffect):
    """A spring that pulls back to zero, such as a cable or a hose that bends, or the field of a magnet nearby."""

    k: Any = constant(0.0, "k", "N/m", typical=100.0, measure="force/displacement", share=0.2)
    equation: ClassVar[str] = "F = −k q"
    needs: ClassVar[tuple[str, ...]] = ("displacement",)
    systems: ClassVar[tuple[str, ...]] = ("mass_on_rail",)
    manoeuvre: ClassVar[str] = "travel slowly from one end to the other, and rest at several places"

    @override
    def force(self, displacement: Tensor, speed: Tensor) -> Tensor:
        return -scaled(self.k, displacement) * displacement


@EFFECTS.register("cubic_stiffness")
@dataclass(frozen=True)
class CubicStiffness(ForceEffect):
    """A spring that hardens (or softens) with its deflection."""

    k_3: Any = constant(
        0.0, "k₃", "N/m^3", typical=3.4, source="least squares on silverbox", measure="force/displacement^3", share=0.1
    )
    equation: ClassVar[str] = "F = −k₃ q³"
    needs: ClassVar[tuple[str, ...]] = ("displacement",)
    systems: ClassVar[tuple[str, ...]] = ("oscillator", "mass_on_rail")
    manoeuvre: ClassVar[str] = "swing with small and with large amplitude"

    @override
    def force(self, displacement: Tensor, speed: Tensor) -> Tensor:
        return -scaled(self.k_3, displacement) * displacement**3


@EFFECTS.register("gravity_torque")
@dataclass(frozen=True)
class GravityTorque(ForceEffect):
    """Torque of the weight of an arm, or of a disc whose centre of gravity is not on its axis."""

    a: Any = constant(0.0, "sine part", "N", typical=2.0, measure="force", share=0.2)
    b: Any = constant(0.0, "cosine part", "N", typical=1.0, measure="force", share=0.1)
    equation: ClassVar[str] = "M = a sin q + b cos q"
    needs: ClassVar[tuple[str, ...]] = ("displacement",)
    systems: ClassVar[tuple[str, ...]] = ("mass_on_rail",)
    acts_in: ClassVar[str] = "a class of your own that turns: its mass in kg m^2"
    manoeuvre: ClassVar[str] = "turn slowly through as much of a turn as is allowed, and rest at several angles"

    @classmethod
    @override
    def suits(cls, kind: Any) -> bool:
        turns: bool = getattr(kind, "turns", bool)()
        return super().suits(kind) and turns

    @override
    def force(self, displacement: Tensor, speed: Tensor) -> Tensor:
        a, b = scaled(self.a, displacement), scaled(self.b, displacement)
        return a * torch.sin(displacement) + b * torch.cos(displacement)


_PERIODS = 48
"""Periods of cogging in a turn, or along the way, that are tried, at most."""


@EFFECTS.register("cogging")
@dataclass(frozen=True)
class Cogging(ForceEffect):
    """Force of a motor's magnets, periodic in the position."""

    a: Any = constant(0.0, "sine part", "N", typical=2.0, measure="force", share=0.05)
    b: Any = constant(0.0, "cosine part", "N", typical=1.0, measure="force", share=0.03)
    pitch: Any = constant(
        0.02, "λ: travel of a period", "m", low=1e-9, typical=0.02, measure="displacement", share=0.08
    )
    equation: ClassVar[str] = "F = a sin(2π q/λ) + b cos(2π q/λ)"
    needs: ClassVar[tuple[str, ...]] = ("displacement",)
    systems: ClassVar[tuple[str, ...]] = ("mass_on_rail",)
    screen: ClassVar[dict[str, tuple[float, ...]]] = {"pitch": (0.02, 0.03, 0.04, 0.06, 0.08, 0.12, 0.16)}
    manoeuvre: ClassVar[str] = "travel slowly and evenly over many periods of the magnets"

    @classmethod
    @override
    def grid(cls, sizes: Mapping[str, float]) -> dict[str, tuple[float, ...]]:
        """Pitches that fit a whole number of times into the travel, or into one turn of what turns further.

        Whatever the pitch, the next of them is a quarter of a period off at either end at most, so that it is felt.
        One period a turn is the torque of a weight, and fewer than three of the travel are a slow curve.
        """
        turn, travel = sizes.get("turn", math.inf), sizes.get("travel", 0.0)
        if not travel:
            return super().grid(sizes)
        way, fewest = (turn, 2) if travel > turn else (travel, 3)
        return {"pitch": tuple(way / n for n in range(fewest, _PERIODS + 1))}

    @override
    def force(self, displacement: Tensor, speed: Tensor) -> Tensor:
        phase = 2 * math.pi * displacement / scaled(self.pitch, displacement)
        return scaled(self.a, phase) * torch.sin(phase) + scaled(self.b, phase) * torch.cos(phase)


@EFFECTS.register("joint_elasticity")
@dataclass(frozen=True)
class JointElasticity(InputEffect):
    """A spring and damper between motor and load: the drive reaches the load through a resonance.

    The resonance is that of the motor against the load; what the load's own friction gives back to the motor is left
    out. The motor's inertia is part of the mass.
    """

    resonance_period: Any = constant(
        0.0, "2π T: one swing of the resonance", "s", low=0, high=_TURN, typical=0.01 * _TURN
    )
    damping: Any = constant(0.1, "ζ: damping ratio", "1", low=1e-3, high=0.9, typical=0.1)
    equation: ClassVar[str] = "T² d²F/dt² + 2 ζ T dF/dt + F = u, solved exactly"
    systems: ClassVar[tuple[str, ...]] = ("mass_on_rail", "oscillator")
    screen: ClassVar[dict[str, tuple[float, ...]]] = {
        "resonance_period": tuple(_TURN * t for t in (0.002, 0.005, 0.01, 0.03)),
        "damping": (0.05, 0.3),
    }
    manoeuvre: ClassVar[str] = "start and stop abruptly, or sweep the drive through the resonance"

    @property
    @override
    def fastest(self) -> float:
        return float(self.resonance_period)

    def memory_size(self, inputs: int, dt: float) -> int:
        """Each input's F and T dF/dt."""
        return 2 * inputs

    def steady(self, inputs: Tensor, dt: float) -> Tensor:
        """The force equals the drive (…, m) and does not change."""
        return torch.cat([inputs, torch.zeros_like(inputs)], dim=-1)

    def act(self, memory: Tensor, segment: Tensor, dt: float, held: bool) -> tuple[Tensor, Tensor]:
        """Exact for a drive that is linear over each half step; see `InputEffect.act`."""
        period, zeta = scaled(self.resonance_period, segment) / _TURN, scaled(self.damping, segment)
        force, slope = memory.chunk(2, dim=-1)
        time = dt / 2 / period.clamp(min=_RIGID)  # in units of T
        root = (1 - zeta * zeta).sqrt()
        decay, cosine, sine = torch.exp(-zeta * time), torch.cos(root * time), torch.sin(root * time) / root
        first = torch.where(period > _RIGID, force, segment[..., 0, :])
        out = [first]
        for start, end in ((segment[..., 0, :], segment[..., 1, :]), (segment[..., 1, :], segment[..., 2, :])):
            ramp = (end - start) / (dt / 2) * period  # the rise in T, which the force follows 2 ζ later
            deviation, rate = force - start + 2 * zeta * ramp, slope - ramp
            force = end - 2 * zeta * ramp + decay * (deviation * cosine + (rate + zeta * deviation) * sine)
            slope = ramp + decay * (rate * cosine - (deviation + zeta * rate) * sine)
            out.append(force)
        return torch.cat([force, slope], dim=-1), torch.stack(out, dim=-2)

    @override
    def over(self, memory: Tensor, segments: Tensor, dt: float, held: bool) -> tuple[Tensor, Tensor]:
        """The same of a whole recording at once; see `InputEffect.over`.

        z = F − i (T dF/dt + ζ F) / √(1 − ζ²) only turns and shrinks beside what follows a ramp.
        """
        swing, zeta = (tensor(p, segments).unsqueeze(-1).unsqueeze(-1) for p in (self.resonance_period, self.damping))
        period = swing / _TURN
        root, time = (1 - zeta * zeta).sqrt(), dt / 2 / period.clamp(min=_RIGID)

        def turning(force: Tensor, slope: Tensor) -> Tensor:
            return torch.complex(force, -(slope + zeta * force) / root)

        start, end = (segments[..., half, :].flatten(-3, -2) for half in ((0, 1), (1, 2)))  # (…, 2 K, m)
        ramp = (end - start) / (dt / 2) * period
        turn = torch.polar(torch.exp(-zeta * time), root * time)
        added = turning(end - 2 * zeta * ramp, ramp) - turn * turning(start - 2 * zeta * ramp, ramp)
        begun = (x.unsqueeze(-2).expand(*added.shape[:-2], 1, -1) for x in memory.chunk(2, dim=-1))
        path, reach = torch.cat([turning(*begun), added], dim=-2), 1
        while reach < path.shape[-2]:  # each sum reaches twice as far back with every round
            path = torch.cat([path[..., :reach, :], path[..., reach:, :] + turn * path[..., :-reach, :]], dim=-2)
            turn, reach = turn * turn, 2 * reach
        force = path.real
        slope = -root * path.imag - zeta * force
        begin = torch.where(period > _RIGID, force[..., :-1:2, :], segments[..., 0, :])
        out = torch.stack([begin, force[..., 1::2, :], force[..., 2::2, :]], dim=-2)
        return torch.cat([force, slope], dim=-1)[..., ::2, :], out
