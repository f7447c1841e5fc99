"""The simple quadrotor: rigid body, thrust and reaction torque that go with the square of rotor speed."""

from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import torch
from torch import Tensor

from registry.core import PHYSICS
from registry.dynamics import Motion, Parameter, constant, tensor, vector
from registry.errors import BenchError, near
from registry.physics.quadrotor_pilot import QuadrotorPilot
from registry.physics.rigid_body import RigidBody

_ROTORS = "RotorS simulator, Pelican vehicle file"
_CHOSEN = "chosen for the simulated twin"
_PWM = "gym-pybullet-drones, Crazyflie 2: 0.2685 rpm a count + 4070.3 rpm"


@PHYSICS.register("quadrotor")
@dataclass(frozen=True)
class Quadrotor(RigidBody):
    """Rigid body driven by rotor speeds, four or another number: thrust k_f ω², torque r × T and s k_m ω², gravity.

    Driven by raw motor commands (``drive`` is pwm), the rotor speeds are ω = a u + b, not below zero.
    """

    mass: Any = constant(1.0, "mass", "kg", low=1e-6, source=_ROTORS)
    inertia: Any = constant((0.01, 0.01, 0.02), "principal moments of inertia", "kg m^2", low=1e-9, source=_ROTORS)
    thrust_coefficient: Any = constant(9.9865e-6, "k_f: thrust over ω²", "N s^2", low=0, source=_ROTORS)
    torque_coefficient: Any = constant(1.5978e-7, "k_m: reaction torque over ω²", "N m s^2", low=0, source=_ROTORS)
    rotor_positions: Any = constant(
        ((0.21, 0.0, 0.0), (0.0, 0.21, 0.0), (-0.21, 0.0, 0.0), (0.0, -0.21, 0.0)),
        "hubs, from the centre of gravity: forward, left, up",
        "m",
        source=_ROTORS,
    )
    rotor_directions: Any = constant(
        (1.0, -1.0, 1.0, -1.0),
        "s: sign of each rotor's reaction torque about body z, up: +1 of one that turns clockwise seen from above",
        "1",
        uncertainty=0.0,
        source=_ROTORS,
    )
    rotor_radius: Any = constant(0.127, "rotor radius", "m", low=0, source=_CHOSEN)

    air_density: Any = constant(1.2, "density of the air", "kg/m^3", low=0, uncertainty=0.0)
    pwm_gain: Any = constant(
        0.028117, "a: rotor speed over motor command", "rad/s/pwm", low=0, uncertainty=0.2, source=_PWM
    )
    pwm_offset: Any = constant(
        426.24, "b: rotor speed to which the commands add", "rad/s", uncertainty=0.2, source=_PWM
    )
    drive: str = field(
        default="rotor_speed",
        kw_only=True,
        metadata={"help": "the driving signal", "choices": ("rotor_speed", "rotor_command", "pwm")},
    )

    input_signals: ClassVar[tuple[str, ...]] = ("rotor_speed", "rotor_command", "pwm")
    rough: ClassVar[dict[str, float]] = {
        "mass": 0.03,
        "inertia": 0.3,
        "thrust_coefficient": 0.2,
        "torque_coefficient": 0.2,
        "rotor_positions": 0.03,
        "pwm_gain": 0.2,
        "pwm_offset": 0.2,
    }
    equation: ClassVar[str] = (
        "m dv/dt = R Σ k_f ω_i² e3 − m g e3;  J dω_b/dt = Σ r_i × T_i e3 + s_i k_m ω_i² e3 − ω_b × J ω_b"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.drive not in self.input_signals:
            raise BenchError(f"drive = {self.drive!r}: {near(self.drive, self.input_signals)}")

    def parameters(self) -> list[Parameter]:
        """The constants, in order; those of the motor commands are fixed when none drive."""
        listed = super().parameters()
        if self.drive == "pwm":
            return listed
        return [replace(p, uncertainty=0.0) if p.name.startswith("pwm") else p for p in listed]

    def pilot(self) -> QuadrotorPilot:
        """Position and yaw by the inverse of the model's own rotors."""
        return QuadrotorPilot(self)

    @property
    def drive_acts_at_once(self) -> bool:
        """Measured rotor speeds do; commands act through motors."""
        return self.drive == "rotor_speed" and self.input_hold == "linear"

    def actuate(self, driving: Tensor, rates: Tensor) -> tuple[Tensor, Tensor]:
        """Rotor speeds (…, rotors) [rad/s] and their time derivative, from the driving signal and its own."""
        if self.drive != "pwm":
            return driving, rates
        gain, offset = (tensor(c, driving).unsqueeze(-1) for c in (self.pwm_gain, self.pwm_offset))
        return (gain * driving + offset).clamp(min=0), gain * rates

    def rotor_thrust(self, inputs: Tensor) -> Tensor:
        """T_i = k_f ω_i² (…, rotors) [N] at rotor speeds (…, rotors) [rad/s]."""
        return tensor(self.thrust_coefficient, inputs).unsqueeze(-1) * inputs * inputs

    def loads(self, thrust: Tensor, speed: Tensor) -> tuple[Tensor, Tensor]:
        """Total thrust (…) [N] and torque (…, 3) [N m], body frame, of rotor thrusts and speeds (…, rotors)."""
        x, y, _ = tensor(self.rotor_positions, speed).unbind(-1)
        signs = tensor(self.rotor_directions, speed)
        reaction = signs * tensor(self.torque_coefficient, speed).unsqueeze(-1) * speed * speed
        torque = vector(((y * thrust).sum(-1), -(x * thrust).sum(-1), reaction.sum(-1)), speed)
        return thrust.sum(-1), torque

    def own_load(self, motion: Motion, internal: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Force and torque of the rotors, body frame; see `RigidBody.own_load`."""
        total, torque = self.loads(motion.thrust, motion.inputs)
        none = torch.zeros_like(total)
        return torch.stack([none, none, total], dim=-1), torque, internal
