"""A force, torque or rate that swings at one frequency and follows no measured signal."""

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor

from registry.core import EFFECTS, finite, option
from registry.dynamics import InternalEffect, Motion, PhysicsModel, RateEffect
from registry.effects.learned_term import LearnedTerm
from registry.errors import BenchError, near
from registry.terms import signals


@EFFECTS.register("periodic_term")
@dataclass(frozen=True)
class PeriodicTerm(InternalEffect, RateEffect):
    """What swings at one frequency; its amplitude and phase differ from recording to recording.

    Its own states are the wave and its quadrature. What was measured before tells them, as a radio finds the phase of
    its carrier; without a past they are zero.
    """

    axis: str = option("world_force_z", "along which it acts: of the body or the world, or a state's rate of change")
    frequency: float = option(1.0, "of the wave [Hz]")

    equation: ClassVar[str] = "F = A cos(2π f t + φ), A and φ of each recording, from its past"
    learned: ClassVar[bool] = True
    needs: ClassVar[tuple[str, ...]] = ("velocity",)
    manoeuvre: ClassVar[str] = "record on, at rest as well: it swings whatever the system does"
    internal_size: ClassVar[int] = 2

    def constants(self) -> tuple[LearnedTerm, ...]:
        """A unit along the same axis that does not swing."""
        return (LearnedTerm(self.axis, (), "constant", (1.0,)),)

    def load(self, motion: Motion, acceleration: Tensor) -> tuple[Tensor, Tensor]:
        """Force (…, 3) [N] and torque (…, 3) [N m], body frame; see `InternalEffect.load`."""
        assert motion.internal is not None
        return signals.load_along(self.axis, motion.internal[..., 0], motion)

    def internal_rate(self, motion: Motion, acceleration: Tensor) -> Tensor:
        """Time derivative (…, 2) of the wave and its quadrature; see `InternalEffect.internal_rate`."""
        assert motion.internal is not None
        return self._turning(motion.internal)

    def rate(self, model: Any, state: Tensor, inputs: Tensor) -> Tensor:
        """What it adds to dx/dt, and the derivative of its own states (…, s + 2); see `RateEffect.rate`."""
        proper, own = state[..., :-2], state[..., -2:]
        return torch.cat(
            [signals.rate_along(self.axis, own[..., 0], model, proper, inputs), self._turning(own)], dim=-1
        )

    def _turning(self, own: Tensor) -> Tensor:
        return 2 * math.pi * self.frequency * torch.stack([own[..., 1], -own[..., 0]], dim=-1)

    def misfit(self, model: PhysicsModel) -> str:
        """Why it cannot act in a model: an axis that this has not; empty: it can."""
        axes = signals.axes_of(type(model))
        return (
            ""
            if self.axis in axes
            else f"{type(model).system_name()} has no axis {self.axis!r}: {near(self.axis, axes)}"
        )

    def options(self) -> dict[str, Any]:
        """What a file has of it."""
        return {"axis": self.axis, "frequency": self.frequency}

    @classmethod
    def from_options(cls, where: str, given: dict[str, Any]) -> "PeriodicTerm":
        """The term of a file's table.

        Raises:
            BenchError: something is missing, unknown or of the wrong kind.
        """
        for key in given:
            if key not in ("axis", "frequency"):
                raise BenchError(f"{where}: unknown key {key!r}: {near(key, ('axis', 'frequency'))}")
        axis, frequency = given.get("axis"), given.get("frequency")
        if not isinstance(axis, str):
            raise BenchError(f'{where}: axis must be a text, such as axis = "world_force_z".')
        if not isinstance(frequency, int | float) or not finite(frequency) or not frequency > 0:
            raise BenchError(f"{where}: frequency must be a positive number [Hz], not {frequency!r}.")
        return cls(axis, float(frequency))
