"""Forces of the air on a body, and its own motion."""

from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor

from registry.core import EFFECTS
from registry.dynamics import LoadEffect, Motion, WindEffect, constant, tensor, vector

_HUMMINGBIRD = "RotorPy, Hummingbird vehicle file"


@EFFECTS.register("linear_drag")
@dataclass(frozen=True)
class LinearDrag(LoadEffect):
    """Drag in proportion to the velocity through the air, axis by axis."""

    d_x: Any = constant(0.0, "along body x", "kg/s", low=0, high=10, typical=0.4)
    d_y: Any = constant(0.0, "along body y", "kg/s", low=0, high=10, typical=0.4)
    d_z: Any = constant(0.0, "along body z", "kg/s", low=0, high=10, typical=0.4)
    equation: ClassVar[str] = "F = −D v_b"
    needs: ClassVar[tuple[str, ...]] = ("velocity", "attitude")
    systems: ClassVar[tuple[str, ...]] = ("quadrotor", "helicopter")
    manoeuvre: ClassVar[str] = (
        "fly along each body axis at several steady speeds, back and forth and at both high and low thrust: this drag "
        "grows with the speed alone, not with its square or with the rotor speeds"
    )

    def load(self, motion: Motion) -> tuple[Tensor, Tensor]:
        """Force (…, 3) [N], body frame; no torque."""
        v = motion.air_velocity
        return -vector((self.d_x, self.d_y, self.d_z), v) * v, tensor((0.0, 0.0, 0.0), v)


@EFFECTS.register("parasitic_drag")
@dataclass(frozen=True)
class ParasiticDrag(LoadEffect):
    """Drag of the frame, in proportion to the square of the velocity through the air."""

    c_x: Any = constant(0.0, "along body x", "kg/m", low=0, high=0.5, typical=0.005, source=_HUMMINGBIRD)
    c_y: Any = constant(0.0, "along body y", "kg/m", low=0, high=0.5, typical=0.005, source=_HUMMINGBIRD)
    c_z: Any = constant(0.0, "along body z", "kg/m", low=0, high=0.5, typical=0.01, source=_HUMMINGBIRD)
    equation: ClassVar[str] = "F = −C ‖v_b‖ v_b"
    needs: ClassVar[tuple[str, ...]] = ("velocity", "attitude")
    systems: ClassVar[tuple[str, ...]] = ("quadrotor", "helicopter")
    manoeuvre: ClassVar[str] = (
        "fly along each body axis at several steady speeds up to the fastest: at low speed this drag cannot be told "
        "from one that is linear in the velocity"
    )

    def load(self, motion: Motion) -> tuple[Tensor, Tensor]:
        """Force (…, 3) [N], body frame; no torque."""
        v = motion.air_velocity
        # This norm has a gradient (zero) at rest, where that of a square root is infinite.
        speed = torch.linalg.vector_norm(v, dim=-1, keepdim=True)
        return -vector((self.c_x, self.c_y, self.c_z), v) * speed * v, tensor((0.0, 0.0, 0.0), v)


@EFFECTS.register("wind")
@dataclass(frozen=True)
class Wind(WindEffect):
    """Horizontal wind, felt through drag and whatever else depends on the velocity through the air."""

    w_x: Any = constant(0.0, "along world x", "m/s", low=-30, high=30, typical=1.0)
    w_y: Any = constant(0.0, "along world y", "m/s", low=-30, high=30, typical=1.0)
    equation: ClassVar[str] = "v_b = Rᵀ(v − w)"
    needs: ClassVar[tuple[str, ...]] = ("velocity", "attitude")
    requires: ClassVar[tuple[str, ...]] = ("rotor_drag", "linear_drag", "parasitic_drag")
    systems: ClassVar[tuple[str, ...]] = ("quadrotor", "helicopter")
    manoeuvre: ClassVar[str] = (
        "hover and fly the same lines at several headings: the force of the wind stays with the world, that of tilted "
        "rotors or of a biased attitude turns with the body"
    )

    def wind(self, like: Tensor) -> Tensor:
        """Velocity of the air (…, 3) [m/s], world frame."""
        return vector((self.w_x, self.w_y, 0.0), like)
