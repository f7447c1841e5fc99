"""What rotors do beyond thrust and torque that go with the square of their speed."""

from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor

from registry.core import EFFECTS
from registry.dynamics import HubEffect, LoadEffect, Motion, constant, tensor

_INERTIA = constant(
    0.0,
    "J_r: moment of inertia of one rotor about its axis",
    "kg m^2",
    low=0,
    high=1e-3,
    typical=4e-5,
    source="order of magnitude for a 10-inch propeller",
)


@EFFECTS.register("rotor_drag")
@dataclass(frozen=True)
class RotorDrag(HubEffect):
    """Drag of a spinning rotor against the air that crosses it, in proportion to its speed."""

    k_d: Any = constant(
        0.0, "drag over rotor speed and velocity", "kg/rad", low=0, high=2e-3, typical=8.1e-5, source="RotorS, Pelican"
    )
    equation: ClassVar[str] = "F_i = −k_d ω_i v_⊥,i at hub i,  v_i = v_b + ω_b × r_i"
    needs: ClassVar[tuple[str, ...]] = ("velocity", "attitude")
    systems: ClassVar[tuple[str, ...]] = ("quadrotor",)
    manoeuvre: ClassVar[str] = (
        "fly sideways at several steady speeds, each during a strong climb and during a descent, so that the rotor "
        "speeds differ at the same velocity (drag of the body does not follow them), and back and forth, against wind"
    )

    def hub_force(self, motion: Motion) -> Tensor:
        """Forces (…, rotors, 3) [N], body frame."""
        velocity = motion.hub_velocity
        in_plane = velocity * tensor((1.0, 1.0, 0.0), velocity)
        return -(tensor(self.k_d, velocity).unsqueeze(-1) * motion.inputs).unsqueeze(-1) * in_plane


@EFFECTS.register("ground_effect")
@dataclass(frozen=True)
class GroundEffect(HubEffect):
    """More thrust near the ground, whose presence slows the air under the rotor."""

    c: Any = constant(
        0.0, "strength; 1 is Cheeseman and Bennett's", "1", low=0, high=50, typical=1.0, source="Cheeseman-Bennett"
    )
    equation: ClassVar[str] = "T_i → T_i / (1 − c (R_p / 4h)²),  h ≥ 1.2 R_p √c / 4 the height of the hub"
    needs: ClassVar[tuple[str, ...]] = ("position", "attitude")
    systems: ClassVar[tuple[str, ...]] = ("quadrotor",)
    screen: ClassVar[dict[str, tuple[float, ...]]] = {"c": (0.5, 1.0, 2.0, 5.0, 12.0, 30.0)}
    manoeuvre: ClassVar[str] = (
        "hover at several heights from one to ten rotor radii, slowly and with one load, so that the thrust that is "
        "missing or left over changes with height alone"
    )

    def hub_force(self, motion: Motion) -> Tensor:
        """Forces (…, rotors, 3) [N], body frame: what the ground adds to the thrust."""
        model, up = motion.model, tensor((0.0, 0.0, 1.0), motion.thrust)
        thrust = motion.thrust
        arms = tensor(model.rotor_positions, thrust)
        rise = (motion.rotation[..., 2, :].unsqueeze(-2) * arms).sum(-1)  # of the hubs over the centre, (…, rotors)
        height = motion.position[..., 2:] + rise - tensor(model.ground_z, thrust).unsqueeze(-1)
        # With y = c (R/4h)² the clamp of h reads y ≤ 1/1.44, which needs no square root of c at zero.
        c = tensor(self.c, thrust).unsqueeze(-1)
        nearness = c * (tensor(model.rotor_radius, thrust).unsqueeze(-1) / (4 * height.clamp(min=1e-3))).square()
        nearness = nearness.clamp(max=1 / 1.44)
        return (thrust * nearness / (1 - nearness)).unsqueeze(-1) * up


@EFFECTS.register("rotor_gyroscopic_torque")
@dataclass(frozen=True)
class RotorGyroscopicTorque(LoadEffect):
    """Torque that turns a spinning rotor's axis."""

    rotor_inertia: Any = _INERTIA
    equation: ClassVar[str] = "τ = +J_r Σ s_i ω_i (ω_b × e3)"
    needs: ClassVar[tuple[str, ...]] = ("body_rates",)
    systems: ClassVar[tuple[str, ...]] = ("quadrotor",)
    manoeuvre: ClassVar[str] = (
        "roll and pitch fast while the yaw rate is driven up and down, so that the two pairs of rotors turn at "
        "different speeds while the yaw rate is zero (products of inertia follow the rates alone)"
    )

    def load(self, motion: Motion) -> tuple[Tensor, Tensor]:
        """No force; torque (…, 3) [N m], body frame."""
        speed = (tensor(motion.model.rotor_directions, motion.inputs) * motion.inputs).sum(-1)
        p, q, r = motion.body_rates.unbind(-1)
        torque = torch.stack([q, -p, torch.zeros_like(r)], dim=-1)  # ω_b × e3
        torque = (tensor(self.rotor_inertia, speed) * speed).unsqueeze(-1) * torque
        return torch.zeros_like(torque), torque


@EFFECTS.register("rotor_reaction_torque")
@dataclass(frozen=True)
class RotorReactionTorque(LoadEffect):
    """Torque on the body when its rotors speed up or slow down.

    Held inputs jump between steps, where this torque is an impulse that is not seen: give measured
    rotor speeds (linear), or commands through `motor_lag`.
    """

    rotor_inertia: Any = _INERTIA
    equation: ClassVar[str] = "τ_z = +J_r Σ s_i dω_i/dt"
    needs: ClassVar[tuple[str, ...]] = ("rotor_speed", "body_rates")
    systems: ClassVar[tuple[str, ...]] = ("quadrotor",)
    manoeuvre: ClassVar[str] = (
        "give sharp yaw doublets, then hold the same yaw command: the torque shows while the rotor speeds change and "
        "is gone when they are steady, where a wrong yaw effectiveness stays"
    )

    def load(self, motion: Motion) -> tuple[Tensor, Tensor]:
        """No force; torque (…, 3) [N m], body frame."""
        spin_up = (tensor(motion.model.rotor_directions, motion.inputs) * motion.input_rates).sum(-1)
        yaw = tensor(self.rotor_inertia, spin_up) * spin_up
        torque = torch.stack([torch.zeros_like(yaw), torch.zeros_like(yaw), yaw], dim=-1)
        return torch.zeros_like(torque), torque
