"""What lies between a command and the input that acts."""

import math
from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor
from typing_extensions import override

from registry.core import EFFECTS, finite, option
from registry.dynamics import InputEffect, Parameter, constant, tensor
from registry.equations.lag import lagged
from registry.errors import BenchError
from registry.model_file import constants_of

LONGEST_DELAY = 0.2
"""Upper bound of a vehicle's delay [s]: it sets the length of the memory."""
_FURTHER = 1.4
"""From one delay that is tried to the next, beyond those of a vehicle."""


class DriveEffect(InputEffect):
    """What an actuator makes of the given input before it acts, in any system that is driven through one.

    Several channels share its parameters; thresholds have the unit of the input.
    """

    systems: ClassVar[tuple[str, ...]] = ("mass_on_rail", "oscillator", "tanks")

    @classmethod
    @override
    def suits(cls, kind: Any) -> bool:
        return bool(kind.input_signals) and kind.through_actuator


class FirstOrderLag(InputEffect):
    """What follows the input with a time constant, solved exactly."""

    @property
    @abstractmethod
    def times(self) -> tuple[Any, Any]:
        """Time constants when rising and when falling [s]."""

    def memory_size(self, inputs: int, dt: float) -> int:
        """One output an input."""
        return inputs

    def steady(self, inputs: Tensor, dt: float) -> Tensor:
        """The outputs (…, m) equal the commands."""
        return inputs

    def act(self, memory: Tensor, segment: Tensor, dt: float, held: bool) -> tuple[Tensor, Tensor]:
        """Exact for a command that is linear over each half step; see `InputEffect.act`."""
        up, down = (tensor(t, segment).unsqueeze(-1) for t in self.times)
        half, speed, out = dt / 2, memory, [memory]
        for start, end in ((segment[..., 0, :], segment[..., 1, :]), (segment[..., 1, :], segment[..., 2, :])):
            tau = torch.where((start + end) / 2 > speed, up, down)
            lagging = tau * ((end - start) / half)  # how far behind a ramp the lag settles
            speed = end - lagging + (speed - start + lagging) * torch.exp(-half / tau.clamp(min=1e-9))
            out.append(speed)
        first = torch.where(torch.maximum(up, down) > 0, memory, segment[..., 0, :])
        return speed, torch.stack([first, *out[1:]], dim=-2)

    def over(self, memory: Tensor, segments: Tensor, dt: float, held: bool) -> tuple[Tensor, Tensor]:
        """`act` step after step without its overhead; see `InputEffect.over`."""
        up, down = (tensor(t, segments).unsqueeze(-1) for t in self.times)
        if segments.device.type != "cpu" or any(x.requires_grad for x in (memory, segments, up, down)):
            return super().over(memory, segments, dt, held)
        shape = np.broadcast_shapes(memory.shape, up.shape, down.shape)
        path = torch.from_numpy(lagged(memory.expand(shape), segments, up.expand(shape), down.expand(shape), dt / 2))
        memories = path[::2].movedim(0, -2).contiguous()
        out = segments.new_empty(*shape[:-1], segments.shape[-3], 3, shape[-1])
        lags = (torch.maximum(up, down) > 0).unsqueeze(-2)
        out[..., 0, :] = torch.where(lags, memories[..., :-1, :], segments[..., 0, :])
        out[..., 1, :] = path[1::2].movedim(0, -2)
        out[..., 2, :] = memories[..., 1:, :]
        return memories, out


@EFFECTS.register("motor_lag")
@dataclass(frozen=True)
class MotorLag(FirstOrderLag):
    """First-order lag of a motor (or servo), with its own time constant in each direction."""

    tau_up: Any = constant(
        0.0, "time constant when rising", "s", low=0, high=0.5, typical=0.0125, source="RotorS, Pelican"
    )
    tau_down: Any = constant(
        0.0, "time constant when falling", "s", low=0, high=0.5, typical=0.025, source="RotorS, Pelican"
    )
    equation: ClassVar[str] = "dω/dt = (ω_cmd − ω)/τ, solved exactly"
    needs: ClassVar[tuple[str, ...]] = ("rotor_command",)
    screen: ClassVar[dict[str, tuple[float, ...]]] = {
        "tau_up": (0.005, 0.0125, 0.025, 0.05, 0.1),
        "tau_down": (0.005, 0.0125, 0.025, 0.05, 0.1),
    }
    manoeuvre: ClassVar[str] = (
        "give steps up and down of the command, logged at 200 Hz or more: a lag answers at once and settles "
        "exponentially, a delay answers late and whole"
    )

    @property
    @override
    def times(self) -> tuple[Any, Any]:
        return self.tau_up, self.tau_down


@EFFECTS.register("actuator_lag")
@dataclass(frozen=True)
class ActuatorLag(FirstOrderLag, DriveEffect):
    """First-order lag of an actuator, such as of an amplifier, a valve or the current of a motor."""

    tau: Any = constant(
        0.0,
        "τ: time constant",
        "s",
        low=0,
        typical=0.03,
        source="MuJoCo's filter",
        measure="time_scale",
        share=0.3,
    )
    equation: ClassVar[str] = "dx/dt = (u − x)/τ, and x drives, solved exactly"
    screen: ClassVar[dict[str, tuple[float, ...]]] = {"tau": (0.03, 0.08, 0.2, 0.5, 1.2)}
    manoeuvre: ClassVar[str] = (
        "give steps of the drive, logged at ten samples a time constant or more: a lag answers at once and settles "
        "exponentially, a delay answers late and whole, a joint rings"
    )

    @property
    @override
    def times(self) -> tuple[Any, Any]:
        return self.tau, self.tau


@EFFECTS.register("input_delay")
@dataclass(frozen=True)
class InputDelay(InputEffect):
    """Transport delay of the input, any fraction of a sample.

    Between samples the delayed input is interpolated; of held inputs this is the mean over a step.
    """

    delay: Any = constant(0.0, "T_d", "s", low=0, typical=0.02, source="order of magnitude for radio and controllers")
    longest: float = option(LONGEST_DELAY, "upper bound of the delay, which sets the length of the memory", unit="s")
    equation: ClassVar[str] = "u(t) → u(t − T_d)"
    screen: ClassVar[dict[str, tuple[float, ...]]] = {"delay": (0.005, 0.01, 0.02, 0.03, 0.045, 0.07, 0.1, 0.15)}
    manoeuvre: ClassVar[str] = (
        "give sharp doublets on every input, logged at 200 Hz or more: a delay shifts the whole answer, up and down "
        "alike, a lag rounds it off; then compare the clocks of inputs and outputs"
    )

    @classmethod
    @override
    def suits(cls, kind: Any) -> bool:
        return super().suits(kind) and (bool(cls.systems) or "tanks" not in kind.systems())

    @override
    def parameters(self) -> list[Parameter]:
        (delay,) = super().parameters()
        return [replace(delay, high=self.longest, typical=delay.typical * self.longest / type(self).longest)]

    @classmethod
    @override
    def grid(cls, sizes: Mapping[str, float]) -> dict[str, tuple[float, ...]]:
        """`screen` of a vehicle; of a machine of another speed in what stands for a second, up to `longest`."""
        tried = [sizes.get("second", 1.0) * v for v in InputDelay.screen["delay"]]
        while _FURTHER * tried[-1] < sizes.get("longest_delay", 0.0):
            tried.append(_FURTHER * tried[-1])
        return {"delay": tuple(tried)}

    @override
    def sized(self, sizes: Mapping[str, float], fitted: bool = True) -> "InputDelay":
        longest = sizes.get("longest_delay", self.longest)
        return replace(self, longest=longest, delay=self.delay * longest / self.longest if fitted else self.delay)

    @override
    def options(self) -> dict[str, Any]:
        return {} if self.longest == type(self).longest else {"longest": self.longest}

    @classmethod
    @override
    def from_options(cls, where: str, given: dict[str, Any]) -> "InputDelay":
        """As a file has it.

        Raises:
            BenchError: a key is unknown, or a value is not finite or out of its bounds.
        """
        longest = given.get("longest", cls.longest)
        if not finite(longest) or not longest > 0:
            raise BenchError(f"{where}: longest must be a positive number [s], not {longest!r}.")
        made = cls(longest=float(longest))
        own = {key: value for key, value in given.items() if key != "longest"}
        return replace(made, **constants_of(where, made.parameters(), own))

    def memory_size(self, inputs: int, dt: float) -> int:
        """The samples that the longest delay reaches back to."""
        return inputs * (math.ceil(self.longest / dt - 1e-9) + 1)

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

    def over(self, memory: Tensor, segments: Tensor, dt: float, held: bool) -> tuple[Tensor, Tensor]:
        """Look a whole recording up at once; see `InputEffect.over`."""
        windows = self._past(memory, segments, dt).unfold(-2, self.memory_size(1, dt), 1)
        memories = windows.flip(-1).transpose(-1, -2)  # (…, K + 1, slots, m)
        return memories.flatten(-2), self.transmitted(memory, segments, dt, held)

    def _past(self, memory: Tensor, segments: Tensor, dt: float) -> Tensor:
        """The samples (…, slots + K, m); the one k steps before the start of step i is slots + i − k."""
        before = memory.unflatten(-1, (self.memory_size(1, dt), segments.shape[-1])).flip(-2)
        return torch.cat([before, segments[..., 0, :]], dim=-2)

    def transmitted(self, memory: Tensor, segments: Tensor, dt: float, held: bool) -> Tensor:
        """Look a whole recording up at once; see `InputEffect.transmitted`."""
        steps, m, slots = segments.shape[-3], segments.shape[-1], self.memory_size(1, dt)
        ends, past = segments[..., 2, :], self._past(memory, segments, dt)
        moments = tensor((0.0, 0.0, 0.0) if held else (0.0, 0.5, 1.0), segments)
        age = tensor(self.delay, segments).unsqueeze(-1) / dt + 1 - moments  # (…, 3)
        whole = age.floor().clamp(0, slots)
        part = (age - whole).unsqueeze(-2).unsqueeze(-1)
        at = torch.arange(steps, device=segments.device).unsqueeze(-1)

        def aged(steps_back: Tensor) -> Tensor:
            index = (at - steps_back.long().unsqueeze(-2) + 1 + slots).clamp(0, past.shape[-2] - 1)  # (…, K, 3)
            index = index.expand(*segments.shape[:-3], steps, 3).flatten(-2).unsqueeze(-1)
            looked_up = past.expand(*segments.shape[:-3], *past.shape[-2:]).gather(
                -2, index.expand(*index.shape[:-1], m)
            )
            now = (steps_back == 0).unsqueeze(-2).unsqueeze(-1)
            return torch.where(now, ends.unsqueeze(-2), looked_up.unflatten(-2, (steps, 3)))

        return (1 - part) * aged(whole) + part * aged(whole + 1)
