"""A bob on a massless rod."""

from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor

from registry.contracts import Channel
from registry.core import PHYSICS
from registry.dynamics import constant, tensor
from registry.physics.state_space import Mechanical


@PHYSICS.register("pendulum")
@dataclass(frozen=True)
class Pendulum(Mechanical):
    """Plane pendulum without drive or damping. Effects push the bob along its path."""

    mass: Any = constant(1.0, "m: of the bob", "kg", low=1e-6, source="chosen")
    length: Any = constant(1.0, "l", "m", low=1e-6, source="chosen")
    gravity: Any = constant(9.81, "gravitational acceleration", "m/s^2", low=0, uncertainty=0.001)

    state_channels: ClassVar[tuple[Channel, ...]] = (
        Channel("angle.theta", "rad"),
        Channel("angle_rate.theta", "rad/s"),
    )
    input_signals: ClassVar[tuple[str, ...]] = ()
    alike: ClassVar[tuple[str, ...]] = ()
    equation: ClassVar[str] = "d²θ/dt² = −(g/l) sin θ"

    def lever(self, like: Tensor) -> Tensor:
        """The length [m]."""
        return tensor(self.length, like)

    def own_force(self, state: Tensor, inputs: Tensor) -> Tensor:
        """Weight along the path (…, 1) [N]; see `Mechanical.own_force`."""
        return (
            -tensor(self.mass, state).unsqueeze(-1)
            * tensor(self.gravity, state).unsqueeze(-1)
            * torch.sin(state[..., :1])
        )
