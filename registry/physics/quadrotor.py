"""The simple quadrotor: rigid body, thrust and reaction torque that go with the square of rotor speed."""

from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor

from registry.core import PHYSICS
from registry.dynamics import Motion, constant, tensor
from registry.physics.rigid_body import RigidBody

_ROTORS = "RotorS simulator, Pelican vehicle file"
_CHOSEN = "chosen for the simulated twin"


@PHYSICS.register("quadrotor")
@dataclass(frozen=True)
class Quadrotor(RigidBody):
    """Rigid body driven by four rotor speeds: thrust k_f ω², torque r × T and s k_m ω², gravity."""

    mass: Any = constant(1.0, "mass", "kg", low=0, source=_ROTORS)
    inertia: Any = constant((0.01, 0.01, 0.02), "principal moments of inertia", "kg m^2", source=_ROTORS)
    thrust_coefficient: Any = constant(9.9865e-6, "k_f: thrust over ω²", "N s^2", low=0, source=_ROTORS)
    torque_coefficient: Any = constant(1.5978e-7, "k_m: reaction torque over ω²", "N m s^2", low=0, source=_ROTORS)
    rotor_positions: Any = constant(
        ((0.21, 0.0, 0.0), (0.0, 0.21, 0.0), (-0.21, 0.0, 0.0), (0.0, -0.21, 0.0)),
        "hubs, from the centre of gravity",
        "m",
        source=_ROTORS,
    )
    rotor_directions: Any = constant(
        (1.0, -1.0, 1.0, -1.0), "s: sign of each rotor's reaction torque about body z", "1", uncertainty=0.0
    )
    rotor_radius: Any = constant(0.127, "rotor radius", "m", low=0, source=_CHOSEN)

    input_signals: ClassVar[tuple[str, ...]] = ("rotor_speed", "rotor_command")
    equation: ClassVar[str] = (
        "m dv/dt = R Σ k_f ω_i² e3 − m g e3;  J dω_b/dt = Σ r_i × T_i e3 + s_i k_m ω_i² e3 − ω_b × J ω_b"
    )

    def rotor_thrust(self, rotor_speed: Tensor) -> Tensor:
        """T_i = k_f ω_i² (…, rotors) [N] at rotor speeds (…, rotors) [rad/s]."""
        return tensor(self.thrust_coefficient, rotor_speed).unsqueeze(-1) * rotor_speed * rotor_speed

    def own_load(self, motion: Motion, internal: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Force and torque of the rotors, body frame; see `RigidBody.own_load`."""
        speed = motion.inputs
        thrust = self.rotor_thrust(speed)
        x, y, _ = tensor(self.rotor_positions, speed).unbind(-1)
        signs = tensor(self.rotor_directions, speed)
        reaction = signs * tensor(self.torque_coefficient, speed).unsqueeze(-1) * speed * speed
        total = thrust.sum(-1)
        none = torch.zeros_like(total)
        force = torch.stack([none, none, total], dim=-1)
        torque = torch.stack([(y * thrust).sum(-1), -(x * thrust).sum(-1), reaction.sum(-1)], dim=-1)
        return force, torque, internal
