"""What the air that crosses a rotor does to its blades: lift, loss of lift, and a moment at the hub."""

from dataclasses import dataclass
from math import pi
from typing import Any, ClassVar

import torch
from torch import Tensor

from registry.core import EFFECTS
from registry.dynamics import HubEffect, LoadEffect, Motion, ThrustEffect, constant, tensor

_HUMMINGBIRD = "RotorPy, Hummingbird vehicle file"


@EFFECTS.register("blade_flapping")
@dataclass(frozen=True)
class BladeFlapping(LoadEffect):
    """Moment at the hubs of rotors whose blades flap in the air that crosses them.

    The sign is RotorPy's: a positive coefficient turns the nose down in forward flight, a negative one up, as the
    flap-back of real blades does.
    """

    k_flap: Any = constant(
        0.0,
        "moment over rotor speed and velocity",
        "kg m/rad",
        low=-1e-4,
        high=1e-4,
        typical=1e-6,
        source="order of magnitude",
    )
    equation: ClassVar[str] = "τ = −k_flap Σ ω_i (v_i × e3),  v_i = v_b + ω_b × r_i"
    needs: ClassVar[tuple[str, ...]] = ("velocity", "attitude", "body_rates")
    systems: ClassVar[tuple[str, ...]] = ("quadrotor",)
    manoeuvre: ClassVar[str] = (
        "fly forward and sideways at several steady speeds and brake: this moment follows the velocity, that of a "
        "displaced centre of gravity the thrust, and damping the rates, which are zero in steady flight"
    )

    def load(self, motion: Motion) -> tuple[Tensor, Tensor]:
        """No force; torque (…, 3) [N m], body frame."""
        weight = tensor(self.k_flap, motion.inputs).unsqueeze(-1) * motion.inputs
        x, y, _ = (weight.unsqueeze(-1) * motion.hub_velocity).sum(-2).unbind(-1)
        torque = torch.stack([-y, x, torch.zeros_like(x)], dim=-1)  # −(v × e3)
        return tensor((0.0, 0.0, 0.0), torque), torque


@EFFECTS.register("translational_lift")
@dataclass(frozen=True)
class TranslationalLift(HubEffect):
    """More thrust in flight across the rotor disc, where the rotor meets air that it has not yet set in motion."""

    k_h: Any = constant(
        0.0, "lift over velocity squared", "kg/m", low=0, high=0.05, typical=3.4e-3, source=_HUMMINGBIRD
    )
    equation: ClassVar[str] = "F_z,i = +k_h (v_x,i² + v_y,i²) at hub i,  v_i = v_b + ω_b × r_i"
    needs: ClassVar[tuple[str, ...]] = ("velocity", "attitude")
    systems: ClassVar[tuple[str, ...]] = ("quadrotor",)
    manoeuvre: ClassVar[str] = (
        "fly level, well over the ground, at several steady speeds with hover between: this lift grows with the speed "
        "and is gone in hover, where a wrong thrust or mass stays"
    )

    def hub_force(self, motion: Motion) -> Tensor:
        """Forces (…, rotors, 3) [N], body frame."""
        vx, vy, _ = motion.hub_velocity.unbind(-1)
        lift = tensor(self.k_h, vx).unsqueeze(-1) * (vx * vx + vy * vy)
        return lift.unsqueeze(-1) * tensor((0.0, 0.0, 1.0), lift)


@EFFECTS.register("inflow_thrust_loss")
@dataclass(frozen=True)
class InflowThrustLoss(HubEffect):
    """Less thrust in climb, where air that comes from above lowers the angle at which the blades meet it."""

    k_z: Any = constant(
        0.0, "loss over rotor speed and climb rate", "kg/rad", low=0, high=3e-3, typical=2.3e-4, source=_HUMMINGBIRD
    )
    equation: ClassVar[str] = "F_z,i = −k_z ω_i v_z,i at hub i,  v_i = v_b + ω_b × r_i"
    needs: ClassVar[tuple[str, ...]] = ("velocity", "attitude")
    systems: ClassVar[tuple[str, ...]] = ("quadrotor",)
    manoeuvre: ClassVar[str] = (
        "climb and descend at several steady rates: the loss stays as long as the climb does, where the error of a "
        "delay passes and damping of the rotation does not show"
    )

    def hub_force(self, motion: Motion) -> Tensor:
        """Forces (…, rotors, 3) [N], body frame."""
        loss = tensor(self.k_z, motion.inputs).unsqueeze(-1) * motion.inputs * motion.hub_velocity[..., 2]
        return loss.unsqueeze(-1) * tensor((0.0, 0.0, -1.0), loss)


@EFFECTS.register("vortex_ring_state")
@dataclass(frozen=True)
class VortexRingState(ThrustEffect):
    """Less thrust in a descent about as fast as the rotors' own downwash, into which they sink."""

    a: Any = constant(0.0, "strength", "1", low=0, high=2, typical=0.3, source="order of magnitude")
    equation: ClassVar[str] = (
        "T_i → T_i (1 − a x exp(−((x − 1)/0.35)²)),  x = −v_z/v_h in descent,  v_h = √(Σ T_i / (2ρπR_p² · rotors))"
    )
    needs: ClassVar[tuple[str, ...]] = ("velocity", "attitude")
    systems: ClassVar[tuple[str, ...]] = ("quadrotor",)
    manoeuvre: ClassVar[str] = (
        "descend straight down in calm air at several steady rates, from slow to faster than the downwash: the loss "
        "comes and goes again, where the effect of the inflow grows with the rate"
    )

    def thrust_factor(self, motion: Motion) -> Tensor:
        """One factor (…, 1) for all rotors."""
        total, model = motion.total_thrust, motion.model
        radius, density = tensor(model.rotor_radius, total), tensor(model.air_density, total)
        discs = 2 * pi * motion.thrust.shape[-1] * density * radius * radius
        # Without any thrust the square root would have no gradient.
        downwash = (total.clamp(min=1e-6) / discs).sqrt()
        sink = (-motion.air_velocity[..., 2] / downwash).clamp(min=0)
        bump = sink * torch.exp(-((sink - 1) / 0.35).square())
        return (1 - tensor(self.a, bump) * bump).unsqueeze(-1)
