"""What a diagnosis says about a rigid body: forces and torques, airspeed and height, rather than its states."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from torch import Tensor

from registry.contracts import Channel
from registry.dynamics import Axis, Description, Quantity, Signals, per_second, rotation_matrix, tensor

POSITION, VELOCITY, ATTITUDE, BODY_RATES = slice(0, 3), slice(3, 6), slice(6, 10), slice(10, 13)
"""Places in the state of every rigid body."""
OF_PLACE = ("position", "time", "constant")
"""Signals that a force along an axis of the world may follow."""
MIX = np.array([[1, 1, 1, 1], [1, 1, -1, -1], [1, -1, -1, 1], [1, -1, 1, -1]]) / 4
"""Of four rotors: sum and differences, so that thrust, roll, pitch and yaw are not mixed."""


class Vehicle(Description):
    """Of a `RigidBody`."""

    @property
    def located(self) -> tuple[str, ...]:
        """Velocity and body rates: a pose only sums up what its rates do wrong."""
        return "velocity", "body_rates"

    @property
    def turning(self) -> tuple[str, str]:
        """Attitude and body rates."""
        return "attitude", "body_rates"

    @property
    def moving(self) -> tuple[str, str]:
        """Position and velocity."""
        return "position", "velocity"

    def signals(self, state: Tensor) -> Signals:
        """Velocity and body rates about the body's axes, position, and which way is down; of states (…, s)."""
        rotation = rotation_matrix(state[..., ATTITUDE])
        v = (rotation * state[..., VELOCITY].unsqueeze(-1)).sum(-2).numpy()
        w, p, down = state[..., BODY_RATES].numpy(), state[..., POSITION].numpy(), rotation[..., 2, :].numpy()
        return {
            "velocity": {f"v_{a}": v[..., i] for i, a in enumerate("xyz")},
            "body_rates": {n: w[..., i] for i, n in enumerate("pqr")},
            "position": {a: p[..., i] for i, a in enumerate("xyz")},
            "attitude": {f"R_z{a}": down[..., i] for i, a in enumerate("xy")},
        }

    def curved(self, signals: Signals) -> tuple[str, ...]:
        """The position: what is near a place, such as a wall, acts there alone."""
        return ("position",)

    def laws(self, signals: Signals) -> Signals:
        """|v| v, the drag of a bluff body."""
        velocity = signals["velocity"]
        speed = np.linalg.norm(np.stack(list(velocity.values())), axis=0)
        return {"velocity": {f"|v| {k}": speed * v for k, v in velocity.items()}}

    def mixing(self, drives: int) -> np.ndarray | None:
        """`MIX` of four channels; None of any other number."""
        return MIX if drives == len(MIX) else None

    def axes(self, state: Tensor, channels: Sequence[int]) -> list[Axis]:
        """Forces along the axes of body and world, and torques, per unit of mass and inertia; see `Description.axes`.

        An accelerometer feels a force about the body's axes.
        """
        every = self.model.measured_channels
        rotation = rotation_matrix(state[..., ATTITUDE]).numpy()
        felt = [i for i, c in enumerate(every) if c.group == "specific_force"]
        none = np.zeros((*state.shape[:-1], len(every)))
        found = []
        for i, a in enumerate("xyz"):
            full = none.copy()
            full[..., VELOCITY], full[..., felt] = rotation[..., :, i], np.eye(3)[i]
            found.append(Axis(f"force {a}", full[..., list(channels)]))
            full[..., VELOCITY], full[..., felt] = np.eye(3)[i], rotation[..., i, :]
            found.append(Axis(f"world force {a}", full[..., list(channels)], OF_PLACE))
        for i, a in enumerate("xyz"):
            full = none.copy()
            full[..., BODY_RATES.start + i] = 1.0
            found.append(Axis(f"torque {a}", full[..., list(channels)]))
        return found

    def conditions(
        self, states: Tensor, inputs: Tensor, dt: float, measured: Sequence[bool], drives: Sequence[Channel]
    ) -> list[Quantity]:
        """Airspeed, place, thrust, turning and change of the inputs (L, N); see `Description.conditions`."""
        model, slopes = self.model, np.zeros(inputs.shape)
        acting = inputs.shape[-1] - len(model.extras)
        slopes[..., :acting] = np.gradient(inputs[..., :acting].numpy(), dt, axis=1)
        motion = model.unloaded(model.project(states), inputs, states.new_tensor(slopes))[0]
        unit = "rad/s" if motion.thrust.shape[-1] else drives[0].unit if drives else "1"
        air, position = motion.air_velocity.numpy(), motion.position.numpy()
        height, radius = position[..., 2] - float(model.ground_z), getattr(model, "rotor_radius", None)
        rows = [
            ("airspeed", "m/s", np.linalg.norm(air, axis=-1)),
            ("forward airspeed", "m/s", air[..., 0]),
            ("leftward airspeed", "m/s", air[..., 1]),
            ("climb rate", "m/s", motion.velocity[..., 2].numpy()),
            ("height over ground", "rotor radii", height / float(radius))
            if radius
            else ("height over ground", "m", height),
            ("position x", "m", position[..., 0]),
            ("position y", "m", position[..., 1]),
            ("total thrust", "N", motion.total_thrust.numpy()),
            ("rate of turn", "rad/s", motion.body_rates.norm(dim=-1).numpy()),
            *((f"body rates {a}", "rad/s", motion.body_rates[..., i].numpy()) for i, a in enumerate("pqr")),
            ("change of inputs", per_second(unit), motion.input_rates.abs().mean(-1).numpy()),
        ]
        return [Quantity(*row) for row in rows]

    def residuals(self, state: Tensor, inputs: Tensor, rates: Mapping[int, np.ndarray]) -> list[Quantity]:
        """Force [N] = m Rᵀ dv/dt and torque [N m] = J dω/dt (J,), body frame, where their states were measured.

        See `Description.residuals`.
        """
        model = self.model
        motion = model.unloaded(model.project(state), inputs)[0]
        constants = motion.model
        found: list[Quantity] = []
        if all(c in rates for c in range(VELOCITY.start, ATTITUDE.stop)):
            world = np.stack([rates[c] for c in range(VELOCITY.start, VELOCITY.stop)], axis=-1)
            body = np.einsum("jki,jk->ji", motion.rotation.numpy(), world)
            force = tensor(constants.mass, state).unsqueeze(-1).numpy() * body
            found += [Quantity(f"force {a}", "N", force[:, i]) for i, a in enumerate("xyz")]
        if all(c in rates for c in range(BODY_RATES.start, BODY_RATES.stop)):
            spin = np.stack([rates[c] for c in range(BODY_RATES.start, BODY_RATES.stop)], axis=-1)
            torque = tensor(constants.inertia, state).numpy() * spin
            found += [Quantity(f"torque {a}", "N m", torque[:, i]) for i, a in enumerate("xyz")]
        return found
