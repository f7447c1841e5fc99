"""What lies between a command and the input that acts."""

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor

from registry.core import EFFECTS
from registry.dynamics import InputEffect, constant, tensor

LONGEST_DELAY = 0.2
"""Upper bound of a delay [s]: it sets the length of the memory."""


@EFFECTS.register("motor_lag")
@dataclass(frozen=True)
class MotorLag(InputEffect):
    """First-order lag of a motor (or servo), with its own time constant in each direction."""

    tau_up: Any = constant(0.0, "time constant when rising", "s", low=0, typical=0.0125, source="RotorS, Pelican")
    tau_down: Any = constant(0.0, "time constant when falling", "s", low=0, typical=0.025, source="RotorS, Pelican")
    equation: ClassVar[str] = "dω/dt = (ω_cmd − ω)/τ, solved exactly"
    needs: ClassVar[tuple[str, ...]] = ("rotor_command",)

    def memory_size(self, inputs: int, dt: float) -> int:
        """One speed an input."""
        return inputs

    def steady(self, inputs: Tensor, dt: float) -> Tensor:
        """The speeds (…, m) equal the commands."""
        return inputs

    def act(self, memory: Tensor, segment: Tensor, dt: float, held: bool) -> tuple[Tensor, Tensor]:
        """Exact for a command that is linear over each half step; see `InputEffect.act`."""
        up, down = (tensor(t, segment).unsqueeze(-1) for t in (self.tau_up, self.tau_down))
        half, speed, out = dt / 2, memory, [memory]
        for start, end in ((segment[..., 0, :], segment[..., 1, :]), (segment[..., 1, :], segment[..., 2, :])):
            tau = torch.where((start + end) / 2 > speed, up, down)
            lagging = tau * ((end - start) / half)  # how far behind a ramp the lag settles
            speed = end - lagging + (speed - start + lagging) * torch.exp(-half / tau.clamp(min=1e-9))
            out.append(speed)
        first = torch.where(torch.maximum(up, down) > 0, memory, segment[..., 0, :])
        return speed, torch.stack([first, *out[1:]], dim=-2)


@EFFECTS.register("input_delay")
@dataclass(frozen=True)
class InputDelay(InputEffect):
    """Transport delay of the input, any fraction of a sample.

    Between samples the delayed input is interpolated; of held inputs this is the mean over a step.
    """

    delay: Any = constant(0.0, "T_d", "s", low=0, high=LONGEST_DELAY, typical=0.02)
    equation: ClassVar[str] = "u(t) → u(t − T_d)"

    def memory_size(self, inputs: int, dt: float) -> int:
        """The samples that the longest delay reaches back to."""
        return inputs * (math.ceil(LONGEST_DELAY / dt - 1e-9) + 1)

    def steady(self, inputs: Tensor, dt: float) -> Tensor:
        """A past that equals the present (…, m)."""
        return inputs.repeat((1,) * (inputs.dim() - 1) + (self.memory_size(1, dt),))

    def act(self, memory: Tensor, segment: Tensor, dt: float, held: bool) -> tuple[Tensor, Tensor]:
        """Look the delayed input up in the past samples; see `InputEffect.act`."""
        m = segment.shape[-1]
        past = torch.cat([segment[..., 2, :], segment[..., 0, :], memory], dim=-1).unflatten(-1, (-1, m))
        count = past.shape[-2]  # samples at ages 0, 1, 2 … steps before the end of this one
        moments = tensor((0.0, 0.0, 0.0) if held else (0.0, 0.5, 1.0), segment)
        age = tensor(self.delay, segment).unsqueeze(-1) / dt + 1 - moments  # (…, 3)
        index = torch.arange(count, dtype=segment.dtype, device=segment.device)
        weight = (1 - (age.unsqueeze(-1) - index).abs()).clamp(min=0)  # (…, 3, count)
        delayed = (weight.unsqueeze(-1) * past.unsqueeze(-3)).sum(-2)
        return past[..., 1:-1, :].flatten(-2), delayed
