"""The moment that turns a flat body broadside to the air it flies through."""

from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor

from registry.core import EFFECTS
from registry.dynamics import LoadEffect, Motion, constant, tensor, vector


@EFFECTS.register("munk_moment")
@dataclass(frozen=True)
class MunkMoment(LoadEffect):
    """Moment of a body that climbs or sinks as it flies forward or sideways: flat bodies turn broadside.

    In an ideal fluid it is v × (A v), A the added mass, and m_x = A_z − A_y, m_y = A_z − A_x (M. M. Munk, NACA
    report 184, 1924). Flapping blades add to the same terms: they flap back less the more air comes down on them. What
    an ideal fluid says about yaw, (m_x − m_y) v_x v_y, is left out: in recorded flights of a quadrotor it is not there.
    """

    m_x: Any = constant(0.0, "about body x", "kg", low=-1, high=1, typical=5e-4, source="a disc of .05 m: 8/3 ρ r³")
    m_y: Any = constant(0.0, "about body y", "kg", low=-1, high=1, typical=5e-4, source="a disc of .05 m: 8/3 ρ r³")
    equation: ClassVar[str] = "τ = (−m_x v_y v_z, m_y v_x v_z, 0),  v in the body frame"
    needs: ClassVar[tuple[str, ...]] = ("velocity", "attitude", "body_rates")
    systems: ClassVar[tuple[str, ...]] = ("quadrotor",)
    manoeuvre: ClassVar[str] = (
        "climb and sink steadily while flying forward and sideways: this moment changes its sign with the climb, where "
        "that of flapping blades goes with the speed alone"
    )

    def load(self, motion: Motion) -> tuple[Tensor, Tensor]:
        """No force; torque (…, 3) [N m], body frame."""
        x, y, z = motion.air_velocity.unbind(-1)
        torque = vector((self.m_x, self.m_y, 0.0), x) * torch.stack([-y * z, x * z, torch.zeros_like(z)], dim=-1)
        return tensor((0.0, 0.0, 0.0), torque), torque
