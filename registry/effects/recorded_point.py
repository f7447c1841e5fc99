"""Position and velocity of a point that is not the centre of gravity."""

from dataclasses import dataclass
from typing import Any, ClassVar

from torch import Tensor

from registry.core import EFFECTS
from registry.dynamics import PointEffect, constant, vector

_SOURCE = "markers on top of a small vehicle"


@EFFECTS.register("recorded_point")
@dataclass(frozen=True)
class RecordedPoint(PointEffect):
    """Markers or sensors whose position and velocity are recorded are not at the centre of gravity.

    The recorded point goes round the centre of gravity where the body turns, as accelerometers do that are off centre
    (V. Klein and E. A. Morelli, Aircraft System Identification, AIAA 2006, section 10.4).
    """

    x: Any = constant(0.0, "of the point, along body x", "m", low=-0.5, high=0.5, typical=0.01, source=_SOURCE)
    y: Any = constant(0.0, "of the point, along body y", "m", low=-0.5, high=0.5, typical=0.01, source=_SOURCE)
    z: Any = constant(0.0, "of the point, along body z", "m", low=-0.5, high=0.5, typical=0.02, source=_SOURCE)
    equation: ClassVar[str] = "v = v_cg + R (ω × r),  dv/dt = dv_cg/dt + R (dω/dt × r + ω × (ω × r)),  r = (x, y, z)"
    needs: ClassVar[tuple[str, ...]] = ("velocity", "attitude", "body_rates")
    systems: ClassVar[tuple[str, ...]] = ("quadrotor", "helicopter")
    manoeuvre: ClassVar[str] = (
        "give doublets in roll, pitch and yaw about hover: this acceleration follows that of the body rates, no other "
        "force does"
    )

    def arm(self, like: Tensor) -> Tensor:
        """From the centre of gravity (…, 3) [m], body frame."""
        return vector((self.x, self.y, self.z), like)
