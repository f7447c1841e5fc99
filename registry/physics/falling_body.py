"""Bodies that fall: along one axis, or thrown in space."""

from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor

from registry.contracts import Channel
from registry.core import PHYSICS
from registry.dynamics import constant, tensor
from registry.physics.state_space import Mechanical


@PHYSICS.register("falling_body")
@dataclass(frozen=True)
class FallingBody(Mechanical):
    """A point mass in free fall along the vertical; displacement and speed are upwards."""

    mass: Any = constant(1.0, "m", "kg", low=1e-6, source="chosen")
    gravity: Any = constant(9.81, "gravitational acceleration", "m/s^2", low=0, uncertainty=0.001)

    state_channels: ClassVar[tuple[Channel, ...]] = (Channel("displacement.q", "m"), Channel("speed.q", "m/s"))
    input_signals: ClassVar[tuple[str, ...]] = ()
    alike: ClassVar[tuple[str, ...]] = ()
    equation: ClassVar[str] = "d²q/dt² = −g"

    def own_force(self, state: Tensor, inputs: Tensor) -> Tensor:
        """The weight, along the last of n axes (…, n) [N]; see `Mechanical.own_force`."""
        n = len(self.state_channels) // 2
        weight = (tensor(self.mass, state) * tensor(self.gravity, state)).expand(state.shape[:-1]).unsqueeze(-1)
        return torch.cat([torch.zeros_like(state[..., : n - 1]), -weight], dim=-1)


@PHYSICS.register("projectile")
@dataclass(frozen=True)
class Projectile(FallingBody):
    """A point mass in free flight through space: position and velocity in the world frame, z up."""

    state_channels: ClassVar[tuple[Channel, ...]] = (
        *(Channel(f"position.{axis}", "m") for axis in "xyz"),
        *(Channel(f"velocity.{axis}", "m/s") for axis in "xyz"),
    )
    alike: ClassVar[tuple[str, ...]] = ()
    equation: ClassVar[str] = "d²p/dt² = −g e3"
