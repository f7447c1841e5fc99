"""What tanks, valves, amplifiers and process lines do beyond the simple model."""

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor
from typing_extensions import override

from registry.core import EFFECTS, option
from registry.dynamics import RateEffect, constant, tensor
from registry.effects.actuation import DriveEffect, InputDelay
from registry.effects.mechanics.friction import limited, scaled

LONGEST_LINE = 60.0
"""Upper bound of a transport delay [s]."""


@EFFECTS.register("overflow")
@dataclass(frozen=True)
class Overflow(RateEffect):
    """Both tanks overflow at their rims; a part of what leaves the upper one falls into the lower."""

    k: Any = constant(0.0, "k: outflow over the height above the rim", "1/s", low=0, high=0.6, typical=0.2)
    upper_rim: Any = constant(10.0, "H_1", "V", low=0, typical=8.0, measure="level", share=1.0)
    lower_rim: Any = constant(10.0, "H_2", "V", low=0, typical=9.0, measure="level", share=0.95)
    share: Any = constant(
        0.5, "c: part of the upper overflow that falls into the lower tank", "1", low=0, high=1, typical=0.5
    )
    equation: ClassVar[str] = "dh_1/dt = … − k (h_1 − H_1)⁺;  dh_2/dt = … + c k (h_1 − H_1)⁺ − k (h_2 − H_2)⁺"
    needs: ClassVar[tuple[str, ...]] = ("level",)
    systems: ClassVar[tuple[str, ...]] = ("tanks",)
    screen: ClassVar[dict[str, tuple[float, ...]]] = {
        "upper_rim": (0.5, 1.0, 2.0),
        "lower_rim": (0.9, 0.98),
        "share": (0.2, 0.8),
    }
    manoeuvre: ClassVar[str] = "pump until both tanks overflow for a while, and let them run empty"

    def rate(self, model: Any, state: Tensor, inputs: Tensor) -> Tensor:
        """What the overflow adds to dh/dt (…, 2) [V/s]; see `RateEffect.rate`."""
        k, upper_rim, lower_rim, share = (
            tensor(p, state) for p in (self.k, self.upper_rim, self.lower_rim, self.share)
        )
        upper, lower = state.unbind(-1)
        first, second = k * (upper - upper_rim).clamp(min=0), k * (lower - lower_rim).clamp(min=0)
        return torch.stack([-first, share * first - second], dim=-1)


@EFFECTS.register("transport_delay")
@dataclass(frozen=True)
class TransportDelay(InputDelay):
    """What enters a line comes out of it later, any fraction of a sample; as `input_delay`, but far longer."""

    delay: Any = constant(0.0, "T_d", "s", low=0, typical=8.0)
    longest: float = option(LONGEST_LINE, "upper bound of the delay, which sets the length of the memory", unit="s")
    equation: ClassVar[str] = "u(t) → u(t − T_d)"
    systems: ClassVar[tuple[str, ...]] = ("tanks",)
    manoeuvre: ClassVar[str] = "change the drive in steps, with long holds between"


class StaticInputEffect(DriveEffect):
    """An effect on the drive that has no memory."""

    def memory_size(self, inputs: int, dt: float) -> int:
        """None."""
        return 0

    def steady(self, inputs: Tensor, dt: float) -> Tensor:
        """Nothing (…, 0)."""
        return inputs[..., :0]

    def act(self, memory: Tensor, segment: Tensor, dt: float, held: bool) -> tuple[Tensor, Tensor]:
        """Sample by sample; see `InputEffect.act`."""
        return memory, self.characteristic(segment)

    @override
    def over(self, memory: Tensor, segments: Tensor, dt: float, held: bool) -> tuple[Tensor, Tensor]:
        """All samples at once; see `InputEffect.over`."""
        steps, inputs = segments.shape[-3], segments.shape[-1]
        out = self.characteristic(segments.transpose(-3, -2).flatten(-2)).unflatten(-1, (steps, inputs))
        return out.new_zeros(*out.shape[:-3], steps + 1, 0), out.transpose(-3, -2)

    @abstractmethod
    def characteristic(self, drive: Tensor) -> Tensor:
        """The drive (…, 3, m) that comes out of the one that goes in, each number by itself: the characteristic."""


@EFFECTS.register("dead_zone")
@dataclass(frozen=True)
class DeadZone(StaticInputEffect):
    """The drive does nothing until it exceeds a threshold, as of a valve with overlap."""

    width: Any = constant(0.0, "w: threshold", "V", low=0, typical=0.3, measure="input", share=0.1)
    equation: ClassVar[str] = "u → u − w sign u where |u| > w, else 0"
    screen: ClassVar[dict[str, tuple[float, ...]]] = {"width": (0.03, 0.1, 0.2, 0.4)}
    manoeuvre: ClassVar[str] = "drive with small amplitude about zero, and with large"

    @override
    def characteristic(self, drive: Tensor) -> Tensor:
        width = scaled(self.width, drive).unsqueeze(-1)
        return torch.sign(drive) * (drive.abs() - width).clamp(min=0)


@EFFECTS.register("saturation")
@dataclass(frozen=True)
class Saturation(StaticInputEffect):
    """The drive goes no further than a limit, as of an amplifier. The parameter is one over the limit."""

    inverse: Any = constant(0.0, "1/U: one over the limit", "1/V", low=0, typical=0.4, measure="1/input", share=1.5)
    equation: ClassVar[str] = "u → max(−U, min(U, u))"
    screen: ClassVar[dict[str, tuple[float, ...]]] = {"inverse": (1.1, 1.4, 2.0, 3.5)}
    manoeuvre: ClassVar[str] = "drive with amplitudes up to the largest that is allowed"

    @override
    def characteristic(self, drive: Tensor) -> Tensor:
        return limited(drive, scaled(self.inverse, drive).unsqueeze(-1))


@EFFECTS.register("curved_drive")
@dataclass(frozen=True)
class CurvedDrive(StaticInputEffect):
    """The drive acts along a curve: a propeller or a nozzle with the square (c = 1), beyond a threshold (c > 1)."""

    c: Any = constant(0.0, "c: part that goes with the square", "1", low=-0.5, high=3.0, typical=0.7)
    at: Any = constant(
        1.0, "U: drive at which nothing changes", "V", low=0, typical=5.0, uncertainty=0.0, measure="input", share=0.7
    )
    equation: ClassVar[str] = "u → u max(0, 1 − c + c |u| / U)"
    screen: ClassVar[dict[str, tuple[float, ...]]] = {"c": (-0.3, 0.5, 1.0, 1.7)}
    manoeuvre: ClassVar[str] = "hold the drive at several levels, from small to the largest"

    @override
    def characteristic(self, drive: Tensor) -> Tensor:
        c, at = (scaled(p, drive).unsqueeze(-1) for p in (self.c, self.at))
        return drive * (1 - c + c * drive.abs() / at.clamp(min=1e-12)).clamp(min=0)
