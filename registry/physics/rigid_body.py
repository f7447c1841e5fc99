"""A rigid body that flies: the equations of motion that every aircraft model shares."""

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor

from registry.contracts import Channel
from registry.dynamics import HubEffect, LoadEffect, ModelEffect, Motion, PhysicsModel, WindEffect, constant, tensor
from registry.units import SIGNALS

_POSE = ("position", "velocity", "attitude", "body_rates")


def cross(a: Tensor, b: Tensor) -> Tensor:
    """a × b over the last dimension (…, 3), with broadcasting."""
    ax, ay, az = a.unbind(-1)
    bx, by, bz = b.unbind(-1)
    return torch.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], dim=-1)


def rotation_matrix(quaternion: Tensor) -> Tensor:
    """Body-to-world rotation (…, 3, 3) of a quaternion xyzw (…, 4) of any length but zero."""
    x, y, z, w = quaternion.unbind(-1)
    s = 2 / (quaternion * quaternion).sum(-1)
    xx, yy, zz, xy, xz, yz = x * x * s, y * y * s, z * z * s, x * y * s, x * z * s, y * z * s
    wx, wy, wz = w * x * s, w * y * s, w * z * s
    rows = [1 - yy - zz, xy - wz, xz + wy, xy + wz, 1 - xx - zz, yz - wx, xz - wy, yz + wx, 1 - xx - yy]
    return torch.stack(rows, dim=-1).unflatten(-1, (3, 3))


def quaternion_rate(quaternion: Tensor, body_rates: Tensor) -> Tensor:
    """Time derivative (…, 4) of a quaternion xyzw (…, 4) at body rates (…, 3): half of q ⊗ (ω, 0)."""
    x, y, z, w = quaternion.unbind(-1)
    p, q, r = body_rates.unbind(-1)
    rows = [w * p + y * r - z * q, w * q + z * p - x * r, w * r + x * q - y * p, -x * p - y * q - z * r]
    return 0.5 * torch.stack(rows, dim=-1)


@dataclass(frozen=True)
class RigidBody(PhysicsModel):
    """Six degrees of freedom: m dv/dt = R F − m g e3, J dω/dt = τ − ω × Jω, dq/dt = q ⊗ (ω, 0)/2."""

    mass: Any = constant(1.0, "mass", "kg", low=0)
    inertia: Any = constant((1.0, 1.0, 1.0), "principal moments of inertia", "kg m^2")
    gravity: Any = constant(9.81, "gravitational acceleration", "m/s^2", low=0, uncertainty=0.001)
    ground_z: Any = constant(0.0, "height of the ground", "m", uncertainty=0.0)

    state_channels: ClassVar[tuple[Channel, ...]] = tuple(
        Channel(f"{s}.{axis}", SIGNALS[s].unit) for s in _POSE for axis in SIGNALS[s].axes
    )

    @abstractmethod
    def own_load(self, motion: Motion, internal: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """What acts on the body without gravity and without effects.

        Args:
            motion: the motion now.
            internal: (…, s − 13) states beyond position, velocity, attitude and body rates.

        Returns:
            Force (…, 3) [N] and torque (…, 3) [N m] in the body frame, and the derivative of ``internal``.
        """

    def derivative(self, state: Tensor, inputs: Tensor, input_rates: Tensor | None = None) -> Tensor:
        """Time derivative (…, s) of the state (…, s); see `PhysicsModel.derivative`."""
        model: Any = self
        for effect in self.effects:
            if isinstance(effect, ModelEffect):
                model = effect.adapt(model)
        position, velocity, attitude, rates, internal = state.split([3, 3, 4, 3, state.shape[-1] - 13], dim=-1)
        rotation = rotation_matrix(attitude)
        through_air = velocity
        for effect in self.effects:
            if isinstance(effect, WindEffect):
                through_air = through_air - effect.wind(state)
        air = (rotation * through_air.unsqueeze(-1)).sum(-2)
        slopes = torch.zeros_like(inputs) if input_rates is None else input_rates
        motion = Motion(model, position, velocity, rotation, rates, air, inputs, slopes)
        force, torque, internal_rate = model.own_load(motion, internal)
        for effect in self.effects:
            if isinstance(effect, HubEffect):
                hub = effect.hub_force(motion)
                force = force + hub.sum(-2)
                torque = torque + cross(tensor(model.rotor_positions, state), hub).sum(-2)
            elif isinstance(effect, LoadEffect):
                more_force, more_torque = effect.load(motion)
                force, torque = force + more_force, torque + more_torque
        inertia = tensor(model.inertia, state)
        acceleration = (rotation * force.unsqueeze(-2)).sum(-1) / tensor(model.mass, state).unsqueeze(-1)
        weight = tensor((0.0, 0.0, 1.0), state) * tensor(model.gravity, state).unsqueeze(-1)
        spin = (torque - cross(rates, inertia * rates)) / inertia
        return torch.cat(
            [velocity, acceleration - weight, quaternion_rate(attitude, rates), spin, internal_rate], dim=-1
        )

    def project(self, state: Tensor) -> Tensor:
        """The state (…, s) with its quaternion at unit length."""
        q = state[..., 6:10]
        return torch.cat([state[..., :6], q / (q * q).sum(-1, keepdim=True).sqrt(), state[..., 10:]], dim=-1)
