"""A drive with a controller of its own, which follows a commanded angle."""

from dataclasses import dataclass
from typing import Any, ClassVar

from torch import Tensor

from registry.contracts import Channel
from registry.dynamics import constant, tensor
from registry.physics.state_space import Mechanical
from registry.units import Signal


@dataclass(frozen=True)
class Servo(Mechanical):
    """A position servo."""

    mass: Any = constant(0.005, "J", "kg m^2", low=1e-7, uncertainty=0.3)
    stiffness: Any = constant(1.0, "k_p", "N m/rad", low=0, uncertainty=0.3)
    damping: Any = constant(0.08, "k_v", "N m s/rad", low=0, uncertainty=0.3)

    state_channels: ClassVar[tuple[Channel, ...]] = (Channel("angle.q", "rad"), Channel("angle_rate.q", "rad/s"))
    input_signals: ClassVar[tuple[str, ...]] = ("command",)
    signals: ClassVar[dict[str, Signal]] = {"command": Signal("rad", ("",))}
    equation: ClassVar[str] = "J d²q/dt² = k_p (u − q) − k_v dq/dt"

    def own_force(self, state: Tensor, inputs: Tensor) -> Tensor:
        """Torque of the motor (…, 1) [N m]."""
        k, d = (tensor(v, state).unsqueeze(-1) for v in (self.stiffness, self.damping))
        return k * (inputs[..., :1] - state[..., :1]) - d * state[..., 1:]
