"""A drive that acts with another strength than the model says."""

from dataclasses import dataclass
from typing import Any, ClassVar

from torch import Tensor
from typing_extensions import override

from registry.core import EFFECTS
from registry.dynamics import constant
from registry.effects.actuation import DriveEffect
from registry.effects.mechanics.friction import scaled
from registry.effects.process import MemorylessInputEffect


@EFFECTS.register("drive_gain")
@dataclass(frozen=True)
class DriveGain(MemorylessInputEffect):
    """All of the drive acts with a part of what the model takes it for, or with more.

    A torque that was computed from a motor's current, a gear, an amplifier: known masses, gravity, a spring or a stated
    friction show how strong the drive is. It is looked for in a drive that was measured too: noise hides a threshold,
    and no gain.
    """

    eps: Any = constant(0.0, "ε: relative error of the drive", "1", low=-0.95, high=3.0, typical=-0.3)
    equation: ClassVar[str] = "u → (1 + ε) u"
    systems: ClassVar[tuple[str, ...]] = DriveEffect.systems
    manoeuvre: ClassVar[str] = (
        "hold the drive against something known, a weight or a spring, and let the machine move without it: an inertia "
        "that is wrong as well slows what swings by itself, a drive does not"
    )

    @classmethod
    @override
    def suits(cls, kind: Any) -> bool:
        return DriveEffect.suits(kind)

    @override
    def characteristic(self, drive: Tensor) -> Tensor:
        return drive * (1 + scaled(self.eps, drive).unsqueeze(-1))
