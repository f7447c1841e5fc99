"""Effects that remember which way they came."""

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor
from typing_extensions import override

from registry.core import EFFECTS
from registry.dynamics import RateEffect, constant, tensor
from registry.effects.actuation import DriveEffect
from registry.effects.mechanics.friction import scaled

_BENCHMARK = "Noël and Schoukens, Hysteretic benchmark with a dynamic nonlinearity (2016)"


@EFFECTS.register("backlash")
@dataclass(frozen=True)
class Backlash(DriveEffect):
    """Play between drive and load, as of worn gears: after a reversal nothing moves until it is crossed."""

    width: Any = constant(0.0, "w: half of the play", "V", low=0, typical=0.2, measure="input", share=0.1)
    equation: ClassVar[str] = "u_k → max(u_k − w, min(u_k + w, what came out before))"
    screen: ClassVar[dict[str, tuple[float, ...]]] = {"width": (0.03, 0.1, 0.2, 0.4)}
    manoeuvre: ClassVar[str] = "reverse the drive many times, with small and with large amplitude"

    def memory_size(self, inputs: int, dt: float) -> int:
        """What came out last, one an input."""
        return inputs

    def steady(self, inputs: Tensor, dt: float) -> Tensor:
        """In the middle of the play (…, m)."""
        return inputs

    def act(self, memory: Tensor, segment: Tensor, dt: float, held: bool) -> tuple[Tensor, Tensor]:
        """The play operator at start, middle and end; see `InputEffect.act`."""
        width, out = scaled(self.width, segment), []
        for drive in segment.unbind(-2):
            memory = torch.maximum(drive - width, torch.minimum(drive + width, memory))
            out.append(memory)
        return memory, torch.stack(out, dim=-2)

    @override
    def over(self, memory: Tensor, segments: Tensor, dt: float, held: bool) -> tuple[Tensor, Tensor]:
        """The same of a whole recording at once; see `InputEffect.over`.

        To be held between two bounds and then between two others is to be held between two: bounds of each stretch of
        √K drives are made side by side, and the stretches joined one after another.
        """
        width = scaled(self.width, segments).unsqueeze(-1)
        drive = segments.flatten(-3, -2)  # (…, 3 K, m)
        length = max(1, math.isqrt(drive.shape[-2]))
        rest = -drive.shape[-2] % length
        drive = torch.cat([drive, drive[..., -1:, :].expand(*drive.shape[:-2], rest, -1)], dim=-2)
        low, high = ((drive + side).unflatten(-2, (-1, length)) for side in (-width, width))
        lows, highs = [low[..., 0, :]], [high[..., 0, :]]
        for k in range(1, length):  # from the beginning of a stretch to after each of its drives
            lows.append(torch.maximum(low[..., k, :], torch.minimum(high[..., k, :], lows[-1])))
            highs.append(torch.maximum(low[..., k, :], torch.minimum(high[..., k, :], highs[-1])))
        low, high, out = torch.stack(lows, dim=-2), torch.stack(highs, dim=-2), list[Tensor]()
        for s in range(low.shape[-3]):
            before = (out[-1][..., -1:, :] if out else memory.unsqueeze(-2)).expand(low[..., s, :, :].shape)
            out.append(torch.maximum(low[..., s, :, :], torch.minimum(high[..., s, :, :], before)))
        path = torch.cat(out, dim=-2)[..., : 3 * segments.shape[-3], :].unflatten(-2, (-1, 3))
        return torch.cat([memory.expand(path[..., 0, 0, :].shape).unsqueeze(-2), path[..., 2, :]], dim=-2), path


@EFFECTS.register("bouc_wen")
@dataclass(frozen=True)
class BoucWen(RateEffect):
    """A hysteretic force beside the spring (Bouc and Wen), with a path z of its own that starts at zero.

    As of the benchmark, whose z is α times this one, with ν = 1; so β is one over a path whatever ν is. Of β, γ and δ
    only β^ν γ and β^ν δ show: γ is kept.
    """

    alpha: Any = constant(
        0.0,
        "α: stiffness at small amplitude",
        "N/m",
        low=0,
        typical=5e4,
        source=_BENCHMARK,
        measure="force/displacement",
        share=0.3,
    )
    beta: Any = constant(
        0.0,
        "β: sets the height of the loop",
        "1/m",
        low=0,
        typical=1e3,
        source=_BENCHMARK,
        measure="1/displacement",
        share=2.0,
    )
    gamma: Any = constant(0.8, "γ: shape", "1", low=0, high=10, typical=0.8, source=_BENCHMARK, uncertainty=0.0)
    delta: Any = constant(-1.1, "δ: shape", "1", low=-10, high=10, typical=-1.1, source=_BENCHMARK)
    nu: Any = constant(1.0, "ν: sharpness of the knee", "1", low=1, high=4, typical=1.0, source=_BENCHMARK)
    equation: ClassVar[str] = "F = −α z;  dz/dt = dq/dt − β^ν (γ |dq/dt| |z|^(ν−1) z + δ dq/dt |z|^ν)"
    needs: ClassVar[tuple[str, ...]] = ("displacement", "speed")
    systems: ClassVar[tuple[str, ...]] = ("oscillator",)
    internal_size: ClassVar[int] = 1
    screen: ClassVar[dict[str, tuple[float, ...]]] = {
        "beta": (0.7, 2.0, 6.0),
        "delta": (-1.0, 0.5),
        "nu": (1.0, 2.0),
    }
    manoeuvre: ClassVar[str] = "swing slowly with several amplitudes, and reverse"

    def rate(self, model: Any, state: Tensor, inputs: Tensor) -> Tensor:
        """What z adds to dx/dt and dz/dt (…, 3); see `RateEffect.rate`."""
        z = state[..., 2]
        speed = model.speed(state)[..., 0]
        alpha, beta, gamma, delta, nu = (tensor(p, z) for p in (self.alpha, self.beta, self.gamma, self.delta, self.nu))
        # Never zero: there, powers of |β z| have no gradient.
        size = ((beta * z) ** 2 + 1e-12).sqrt()
        loop = gamma * speed.abs() * size ** (nu - 1) * beta * z + delta * speed * size**nu
        own = speed - loop
        return torch.cat([model.push(-(alpha * z).unsqueeze(-1)), own.unsqueeze(-1)], dim=-1)
