"""A rigid body that flies: the equations of motion that every aircraft model shares."""

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import torch
from torch import Tensor

from registry.contracts import Channel
from registry.dynamics import (
    HubEffect,
    InternalEffect,
    LoadEffect,
    ModelEffect,
    Motion,
    PhysicsModel,
    PointEffect,
    ThrustEffect,
    TorqueEffect,
    WindEffect,
    constant,
    cross,
    joined,
    quaternion_rate,
    rotation_matrix,
    tensor,
    total,
    turned,
    turned_back,
    vector,
)
from registry.physics.vehicle import ATTITUDE, VELOCITY, Vehicle
from registry.units import SIGNALS

_POSE = ("position", "velocity", "attitude", "body_rates")
_ACCELEROMETER = tuple(
    Channel(f"specific_force.{axis}", SIGNALS["specific_force"].unit) for axis in SIGNALS["specific_force"].axes
)


@dataclass(frozen=True)
class RigidBody(PhysicsModel):
    """Six degrees of freedom: m dv/dt = R F − m g e3, J dω/dt = τ − ω × Jω, dq/dt = q ⊗ (ω, 0)/2."""

    mass: Any = constant(1.0, "mass", "kg", low=1e-6)
    inertia: Any = constant((1.0, 1.0, 1.0), "principal moments of inertia", "kg m^2", low=1e-9)
    gravity: Any = constant(9.81, "gravitational acceleration", "m/s^2", low=0, uncertainty=0.001)
    ground_z: Any = constant(0.0, "height of the ground", "m", uncertainty=0.0)
    inertia_products: Any = constant(
        (0.0, 0.0, 0.0), "entries J_xy, J_xz, J_yz of the inertia matrix", "kg m^2", uncertainty=0.0
    )

    state_channels: ClassVar[tuple[Channel, ...]] = tuple(
        Channel(f"{s}.{axis}", SIGNALS[s].unit) for s in _POSE for axis in SIGNALS[s].axes
    )
    vehicle: ClassVar[bool] = True
    needs_pilot: ClassVar[bool] = True
    broadcasts: ClassVar[bool] = True

    @abstractmethod
    def own_load(self, motion: Motion, internal: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """What acts on the body without gravity and without effects.

        Args:
            motion: the motion now.
            internal: (…, s − 13) states beyond position, velocity, attitude and body rates.

        Returns:
            Force (…, 3) [N] and torque (…, 3) [N m] in the body frame, and the derivative of ``internal``.
        """

    def equation_names(self) -> dict[str, str]:
        """Forces move the velocity, and an accelerometer feels them; torques move the body rates."""
        return {"velocity": "forces", "body_rates": "torques", "specific_force": "accelerations"}

    def description(self) -> Vehicle:
        """In terms of forces and torques, airspeed and height."""
        return Vehicle(self)

    @property
    def sensed_channels(self) -> tuple[Channel, ...]:
        """An accelerometer at the point that is recorded, the centre of gravity unless a `PointEffect` says otherwise.

        It measures along the body's axes.
        """
        return _ACCELEROMETER

    def sensed(self, state: Tensor, rates: Tensor) -> Tensor:
        """Specific force (…, 3) [m/s²], body frame: Rᵀ(dv/dt + g e3)."""
        gravity = tensor(self.gravity, state).unsqueeze(-1) * tensor((0.0, 0.0, 1.0), state)
        return turned_back(rotation_matrix(state[..., ATTITUDE]), rates[..., VELOCITY] + gravity)

    def rotor_thrust(self, inputs: Tensor) -> Tensor:
        """Thrust (…, rotors) [N] along body z that effects may scale, at what acts (…, m); here of no rotor."""
        return inputs[..., :0]

    def actuate(self, driving: Tensor, rates: Tensor) -> tuple[Tensor, Tensor]:
        """What acts on the body (…, m) and its time derivative, from the driving signal and its own."""
        return driving, rates

    def derivative(self, state: Tensor, inputs: Tensor, input_rates: Tensor | None = None) -> Tensor:
        """Time derivative (…, s) of the state (…, s); see `PhysicsModel.derivative`."""
        motion, force, torque, own_rate, acceleration = self.unloaded(state, inputs, input_rates)
        own_rates, at = [own_rate], len(self.state_channels)
        swinging = [e for e in self.effects if isinstance(e, InternalEffect)]
        for effect in swinging:
            seen = replace(motion, internal=state[..., at : at + effect.internal_size])
            more_force, more_torque = effect.load(seen, acceleration)
            force, torque = force + more_force, torque + more_torque
            own_rates.append(effect.internal_rate(seen, acceleration))
            at += effect.internal_size
        if swinging:
            acceleration = self._acceleration(motion, force)
        for last in self.effects:
            if isinstance(last, TorqueEffect):
                torque = last.net_torque(torque)
        spin = motion.model.angular_acceleration(torque, motion.body_rates)
        turning = quaternion_rate(state[..., ATTITUDE], motion.body_rates)
        for arm in self._arms(state):
            about = cross(spin, arm) + cross(motion.body_rates, cross(motion.body_rates, arm))
            acceleration = acceleration + turned(motion.rotation, about)
        return joined([state[..., VELOCITY], acceleration, turning, spin, *own_rates])

    def _arms(self, like: Tensor) -> list[Tensor]:
        """Of every `PointEffect`: what it says the recorded point is away from the centre of gravity."""
        return [e.arm(like) for e in self.effects if isinstance(e, PointEffect)]

    def internal_rates(self, state: Tensor, inputs: Tensor, input_rates: Tensor) -> Callable[[Tensor], Tensor]:
        """Rates (…, i) of the effects' own states at any of these (…, i); see `PhysicsModel.internal_rates`."""
        seen, _, _, _, acceleration = self.unloaded(state, inputs, input_rates)
        effects = [e for e in self.effects if isinstance(e, InternalEffect)]

        def rate(own: Tensor) -> Tensor:
            rates, at = [], 0
            for effect in effects:
                size = effect.internal_size
                rates.append(effect.internal_rate(replace(seen, internal=own[..., at : at + size]), acceleration))
                at += size
            return torch.cat(rates, dim=-1)

        return rate

    def unloaded(
        self, state: Tensor, inputs: Tensor, input_rates: Tensor | None = None
    ) -> tuple[Motion, Tensor, Tensor, Tensor, Tensor]:
        """The motion and what acts without the effects that have states of their own.

        Args:
            state: (…, s), of which the effects' own states are not looked at.
            inputs: (…, m).
            input_rates: (…, m).

        Returns:
            The motion of the centre of gravity, force (…, 3) [N] and torque (…, 3) [N m] in the body frame, the
            derivative of the model's states beyond pose and velocities, and the acceleration (…, 3) [m/s²] in the world
            frame, gravity included.
        """
        position, velocity, attitude, rates, internal = state[..., : len(self.state_channels)].split(
            [3, 3, 4, 3, len(self.state_channels) - 13], dim=-1
        )
        rotation = rotation_matrix(attitude)
        for arm in self._arms(state):
            position = position - turned(rotation, arm)
            velocity = velocity - turned(rotation, cross(rates, arm))
        motion = self._motion(position, velocity, rotation, rates, inputs, input_rates)
        model = motion.model
        force, torque, internal_rate = model.own_load(motion, internal)
        for effect in self.effects:
            if isinstance(effect, HubEffect):
                hub = effect.hub_force(motion)
                force = force + total(hub, -2)
                torque = torque + total(cross(tensor(model.rotor_positions, state), hub), -2)
            elif isinstance(effect, LoadEffect):
                more_force, more_torque = effect.load(motion)
                force, torque = force + more_force, torque + more_torque
        return motion, force, torque, internal_rate, self._acceleration(motion, force)

    def _acceleration(self, motion: Motion, force: Tensor) -> Tensor:
        mass, gravity = (tensor(c, force).unsqueeze(-1) for c in (motion.model.mass, motion.model.gravity))
        weight = tensor((0.0, 0.0, 1.0), force) * gravity
        return turned(motion.rotation, force) / mass - weight

    def _motion(
        self,
        position: Tensor,
        velocity: Tensor,
        rotation: Tensor,
        rates: Tensor,
        inputs: Tensor,
        input_rates: Tensor | None,
    ) -> Motion:
        """What the effects see, with the model's constants, the air and the thrust as effects change them."""
        model: Any = self
        for effect in self.effects:
            if isinstance(effect, ModelEffect):
                # Without its effects, for the constants only: they need not be checked again at every instant.
                model = effect.adapt(replace(model, effects=()) if model is self else model)
        through_air = velocity
        for effect in self.effects:
            if isinstance(effect, WindEffect):
                through_air = through_air - effect.wind(velocity)
        air = turned_back(rotation, through_air)
        drives = inputs.shape[-1] - len(self.extras)
        extras = {name: inputs[..., drives + i] for i, name in enumerate(self.extras)}
        slopes = torch.zeros_like(inputs) if input_rates is None else input_rates
        acting, slopes = model.actuate(inputs[..., :drives], slopes[..., :drives])
        thrust = model.rotor_thrust(acting)
        motion = Motion(
            model=model,
            position=position,
            velocity=velocity,
            rotation=rotation,
            body_rates=rates,
            air_velocity=air,
            inputs=acting,
            input_rates=slopes,
            thrust=thrust,
            extras=extras,
        )
        for effect in self.effects:
            if isinstance(effect, ThrustEffect):
                motion = replace(motion, thrust=motion.thrust * effect.thrust_factor(motion))
        return motion

    def angular_acceleration(self, torque: Tensor, rates: Tensor) -> Tensor:
        """J⁻¹ (τ − ω × Jω) (…, 3) [rad/s²], body frame, at torque (…, 3) [N m] and body rates (…, 3)."""
        principal, products = tensor(self.inertia, torque), self.inertia_products
        if isinstance(products, tuple) and not any(isinstance(p, Tensor) or p for p in products):
            return (torque - cross(rates, principal * rates)) / principal
        xy, xz, yz = tensor(products, torque).unbind(-1) if isinstance(products, Tensor) else products
        xx, yy, zz = principal.unbind(-1)
        inertia = vector((xx, xy, xz, xy, yy, yz, xz, yz, zz), torque).unflatten(-1, (3, 3))
        torque = torque - cross(rates, turned(inertia, rates))
        # Cramer's rule: the cross products of the rows are the columns of J⁻¹ times its determinant.
        cofactors = cross(inertia[..., (1, 2, 0), :], inertia[..., (2, 0, 1), :])
        determinant = (inertia[..., 0, :] * cofactors[..., 0, :]).sum(-1, keepdim=True)
        return turned_back(cofactors, torque) / determinant

    def project(self, state: Tensor) -> Tensor:
        """The state (…, s) with its quaternion at unit length."""
        q = state[..., ATTITUDE]
        return torch.cat([state[..., :6], q / (q * q).sum(-1, keepdim=True).sqrt(), state[..., 10:]], dim=-1)
