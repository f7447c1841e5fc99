"""Forces of the air on a body, and its own motion."""

from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor

from registry.core import EFFECTS
from registry.dynamics import LoadEffect, Motion, WindEffect, constant, tensor


@EFFECTS.register("linear_drag")
@dataclass(frozen=True)
class LinearDrag(LoadEffect):
    """Drag in proportion to the velocity through the air, axis by axis."""

    d_x: Any = constant(0.0, "along body x", "kg/s", low=0, typical=0.4)
    d_y: Any = constant(0.0, "along body y", "kg/s", low=0, typical=0.4)
    d_z: Any = constant(0.0, "along body z", "kg/s", low=0, typical=0.4)
    equation: ClassVar[str] = "F = −D v_b"
    needs: ClassVar[tuple[str, ...]] = ("velocity", "attitude")
    systems: ClassVar[tuple[str, ...]] = ("quadrotor", "helicopter")

    def load(self, motion: Motion) -> tuple[Tensor, Tensor]:
        """Force (…, 3) [N], body frame; no torque."""
        v = motion.air_velocity
        force = -torch.stack([tensor(d, v).expand(v.shape[:-1]) for d in (self.d_x, self.d_y, self.d_z)], dim=-1) * v
        return force, torch.zeros_like(force)


@EFFECTS.register("wind")
@dataclass(frozen=True)
class Wind(WindEffect):
    """Horizontal wind, felt through drag."""

    w_x: Any = constant(0.0, "along world x", "m/s", typical=1.0)
    w_y: Any = constant(0.0, "along world y", "m/s", typical=1.0)
    equation: ClassVar[str] = "v_b = Rᵀ(v − w)"
    needs: ClassVar[tuple[str, ...]] = ("velocity", "attitude")
    requires: ClassVar[tuple[str, ...]] = ("rotor_drag", "linear_drag")
    systems: ClassVar[tuple[str, ...]] = ("quadrotor", "helicopter")

    def wind(self, like: Tensor) -> Tensor:
        """Velocity of the air (…, 3) [m/s], world frame."""
        x, y = torch.broadcast_tensors(tensor(self.w_x, like), tensor(self.w_y, like))
        return torch.stack([x, y, torch.zeros_like(x)], dim=-1)
