"""Torques that come with no force, and torques that turn the body otherwise than the model says."""

from dataclasses import dataclass
from typing import Any, ClassVar

from torch import Tensor

from registry.core import EFFECTS
from registry.dynamics import LoadEffect, Motion, TorqueEffect, constant, tensor, vector

_MAGNITUDE = "order of magnitude"


@EFFECTS.register("rotational_damping")
@dataclass(frozen=True)
class RotationalDamping(LoadEffect):
    """Torque against the rotation of the body, in proportion to it."""

    d_x: Any = constant(0.0, "about body x", "N m s", low=0, high=0.5, typical=0.01, source=_MAGNITUDE)
    d_y: Any = constant(0.0, "about body y", "N m s", low=0, high=0.5, typical=0.01, source=_MAGNITUDE)
    d_z: Any = constant(0.0, "about body z", "N m s", low=0, high=0.5, typical=0.01, source=_MAGNITUDE)
    equation: ClassVar[str] = "τ = −d ω_b"
    needs: ClassVar[tuple[str, ...]] = ("body_rates",)
    systems: ClassVar[tuple[str, ...]] = ("quadrotor", "helicopter")
    manoeuvre: ClassVar[str] = (
        "hold steady rates about each axis, in hover and in climb, and log rates that are not smoothed: damping stays "
        "as long as the rate does, while smoothing only looks like it in fast changes"
    )

    def load(self, motion: Motion) -> tuple[Tensor, Tensor]:
        """No force; torque (…, 3) [N m], body frame."""
        rates = motion.body_rates
        return tensor((0.0, 0.0, 0.0), rates), -vector((self.d_x, self.d_y, self.d_z), rates) * rates


@EFFECTS.register("torque_scale")
@dataclass(frozen=True)
class TorqueScale(TorqueEffect):
    """Torques turn the body more, or less, than the model says: wrong moments of inertia or lever arms."""

    eps_x: Any = constant(0.0, "relative error about body x", "1", low=-0.5, high=0.5, typical=0.1)
    eps_y: Any = constant(0.0, "relative error about body y", "1", low=-0.5, high=0.5, typical=0.1)
    eps_z: Any = constant(0.0, "relative error about body z", "1", low=-0.5, high=0.5, typical=0.1)
    equation: ClassVar[str] = "τ → τ (1 + ε), axis by axis; τ the sum of all torques"
    needs: ClassVar[tuple[str, ...]] = ("body_rates",)
    systems: ClassVar[tuple[str, ...]] = ("quadrotor", "helicopter")
    manoeuvre: ClassVar[str] = (
        "give slow and fast doublets about each axis and log rates that are not smoothed: a wrong effectiveness is the "
        "same at every frequency, what smoothing takes away grows with it"
    )

    def net_torque(self, torque: Tensor) -> Tensor:
        """Torque (…, 3) [N m] that acts in place of the sum."""
        return torque * (1 + vector((self.eps_x, self.eps_y, self.eps_z), torque))


@EFFECTS.register("torque_bias")
@dataclass(frozen=True)
class TorqueBias(LoadEffect):
    """A constant torque in the body frame."""

    t_x: Any = constant(0.0, "about body x", "N m", low=-1, high=1, typical=0.01, source=_MAGNITUDE)
    t_y: Any = constant(0.0, "about body y", "N m", low=-1, high=1, typical=0.01, source=_MAGNITUDE)
    t_z: Any = constant(0.0, "about body z", "N m", low=-1, high=1, typical=0.01, source=_MAGNITUDE)
    equation: ClassVar[str] = "τ = (t_x, t_y, t_z)"
    needs: ClassVar[tuple[str, ...]] = ("body_rates",)
    systems: ClassVar[tuple[str, ...]] = ("quadrotor", "helicopter")
    manoeuvre: ClassVar[str] = (
        "climb and descend hard with little rotation: a constant torque does not grow with the thrust, that of a "
        "displaced centre of gravity or of unequal rotors does"
    )

    def load(self, motion: Motion) -> tuple[Tensor, Tensor]:
        """No force; torque (…, 3) [N m], body frame."""
        torque = vector((self.t_x, self.t_y, self.t_z), motion.body_rates)
        return tensor((0.0, 0.0, 0.0), torque), torque
