"""A load that swings under the vehicle."""

from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor

from registry.core import EFFECTS
from registry.dynamics import InternalEffect, Motion, constant, tensor


@EFFECTS.register("suspended_load")
@dataclass(frozen=True)
class SuspendedLoad(InternalEffect):
    """A load on a rope, as a pendulum of small swings along each horizontal axis of the world.

    Its own states are the angles (x, y) [rad] and their time derivatives. On a taut rope it is carried: it moves up and
    down with the vehicle, whose `mass` is that without it. Simpler models have its weight in the `mass`, which is then
    as heavy sideways. Flights tell which.
    """

    m_l: Any = constant(0.0, "mass of the load", "kg", low=0, high=2, typical=0.1, source="order of magnitude")
    l: Any = constant(  # noqa: E741 - the symbol of the equation
        0.6, "length of the rope", "m", low=0.1, high=10, typical=0.6, source="swings at .5 to .8 Hz"
    )
    # More damping than air gives makes it a filter that also fits how a controller answers gusts.
    zeta: Any = constant(0.0, "ζ: damping ratio", "1", low=0, high=0.2, typical=0.02, source="order of magnitude")
    carried: Any = constant(
        1.0,
        "share of its weight that hangs on the vehicle; the rest is part of the mass",
        "1",
        low=-0.5,
        high=1.5,
        typical=1.0,
        uncertainty=0.5,
    )
    height: Any = constant(
        0.0,
        "where the rope is tied, along body z; it swings as if tied to the centre of gravity",
        "m",
        low=-1,
        high=1,
        typical=-0.02,
        source="below the frame",
    )
    equation: ClassVar[str] = (
        "θ̈ = −ω²θ − a/l − 2ζω θ̇,  ω² = (g/l)(1 + m_l/m);  F = m_l g θ,  F_z = −c P,  P = (a_z + g) m m_l/(m + m_l);  "
        "τ = h e_z × Rᵀ(F_x, F_y, −P),  a of the body without it,  c: carried,  h: height"
    )
    needs: ClassVar[tuple[str, ...]] = ("velocity", "attitude")
    systems: ClassVar[tuple[str, ...]] = ("quadrotor", "helicopter")
    screen: ClassVar[dict[str, tuple[float, ...]]] = {
        "carried": (1.0, 0.0),
        "l": (0.25, 0.4, 0.6, 0.9, 1.4, 2.2),
        "zeta": (0.1,),
    }
    manoeuvre: ClassVar[str] = (
        "stop sharply from forward and from sideways flight and hover for ten seconds, with two settings of the "
        "controller: the swing keeps its frequency, a mode of the controller does not"
    )
    internal_size: ClassVar[int] = 4

    def load(self, motion: Motion, acceleration: Tensor) -> tuple[Tensor, Tensor]:
        """The pull of the rope (…, 3) [N] and its torque (…, 3) [N m], body frame."""
        angle, _ = _swing(motion)
        m_l, carried, mass, gravity = (
            tensor(p, angle).unsqueeze(-1) for p in (self.m_l, self.carried, motion.model.mass, motion.model.gravity)
        )
        weight = (acceleration[..., 2:] + gravity) * mass * m_l / (mass + m_l)
        across = (motion.rotation[..., :2, :] * (m_l * gravity * angle).unsqueeze(-1)).sum(-2)
        down = weight * motion.rotation[..., 2, :]
        force, pull = across - carried * down, across - down
        height, zero = tensor(self.height, force), torch.zeros_like(force[..., 0])
        return force, torch.stack([-height * pull[..., 1], height * pull[..., 0], zero], dim=-1)

    def internal_rate(self, motion: Motion, acceleration: Tensor) -> Tensor:
        """Time derivative (…, 4) of angles and angular rates; see `InternalEffect.internal_rate`."""
        angle, rate = _swing(motion)
        m_l, length, zeta = (tensor(p, angle).unsqueeze(-1) for p in (self.m_l, self.l, self.zeta))
        mass, gravity = (tensor(p, angle).unsqueeze(-1) for p in (motion.model.mass, motion.model.gravity))
        stiffness = gravity / length * (1 + m_l / mass)
        pull = acceleration[..., :2] / length
        return torch.cat([rate, -stiffness * angle - pull - 2 * zeta * stiffness.sqrt() * rate], dim=-1)


def _swing(motion: Motion) -> tuple[Tensor, Tensor]:
    """Angles (…, 2) [rad] and their time derivatives (…, 2)."""
    assert motion.internal is not None
    angle, rate = motion.internal.split(2, dim=-1)
    return angle, rate
