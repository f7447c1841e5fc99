"""A mass on a spring with a damper."""

from dataclasses import dataclass
from typing import Any, ClassVar

from torch import Tensor

from registry.contracts import Channel
from registry.core import PHYSICS
from registry.dynamics import constant, tensor
from registry.physics.state_space import Mechanical


@PHYSICS.register("oscillator")
@dataclass(frozen=True)
class Oscillator(Mechanical):
    """Linear mass, damper and spring, driven by a force."""

    mass: Any = constant(1.0, "m", "kg", low=1e-6, source="chosen")
    damping: Any = constant(0.5, "d", "N s/m", low=0, source="chosen")
    stiffness: Any = constant(100.0, "k", "N/m", low=0, source="chosen")

    state_channels: ClassVar[tuple[Channel, ...]] = (Channel("displacement.q", "m"), Channel("speed.q", "m/s"))
    input_signals: ClassVar[tuple[str, ...]] = ("force",)
    alike: ClassVar[tuple[str, ...]] = ()
    equation: ClassVar[str] = "m d²q/dt² + d dq/dt + k q = u"

    def own_force(self, state: Tensor, inputs: Tensor) -> Tensor:
        """Drive, damper and spring (…, 1) [N]; see `Mechanical.own_force`."""
        q, v = state[..., :1], state[..., 1:]
        damper, spring = tensor(self.damping, state).unsqueeze(-1) * v, tensor(self.stiffness, state).unsqueeze(-1) * q
        return inputs - damper - spring
