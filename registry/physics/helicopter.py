"""A simple model helicopter: rigid body, one main rotor with a tilting disc, a tail rotor."""

from dataclasses import dataclass
from typing import Any, ClassVar

from torch import Tensor

from registry.contracts import Channel
from registry.core import PHYSICS
from registry.dynamics import Motion, constant, joined, tensor, vector
from registry.physics.rigid_body import RigidBody

_CHOSEN = "chosen for the simulated twin: no measured aircraft"


@PHYSICS.register("helicopter")
@dataclass(frozen=True)
class Helicopter(RigidBody):
    """Pilot sticks through swashplate lag and rotor flapping to the motion of a model helicopter.

    Sticks (aileron, elevator, rudder, collective) run from −1 to 1: right roll, nose down, nose left, climb.
    The disc tilt (forward, left) is the direction of the thrust relative to the body's z axis [rad].
    """

    mass: Any = constant(8.0, "mass", "kg", low=1e-6, source=_CHOSEN)
    inertia: Any = constant((0.2, 0.35, 0.3), "principal moments of inertia", "kg m^2", low=1e-9, source=_CHOSEN)
    servo_lag: Any = constant(0.04, "τ_s: time constant of swashplate and tail servos", "s", low=1e-3, source=_CHOSEN)
    flapping_lag: Any = constant(0.1, "τ_f: time constant of the rotor disc", "s", low=1e-3, source=_CHOSEN)
    cyclic_gain: Any = constant(0.2, "A: disc tilt at full cyclic stick", "rad", source=_CHOSEN)
    flapback: Any = constant(0.002, "disc tilt away from the wind over airspeed", "s/m", low=0, source=_CHOSEN)
    hub_stiffness: Any = constant(45.0, "K: moment of a tilted disc at the hub", "N m", low=0, source=_CHOSEN)
    hub_height: Any = constant(0.23, "h: hub over the centre of gravity", "m", source=_CHOSEN)
    collective_gain: Any = constant(9.0, "thrust over mass at full collective", "m/s^2", source=_CHOSEN)
    inflow_damping: Any = constant(0.8, "thrust over mass lost to climb rate", "1/s", low=0, source=_CHOSEN)
    drag: Any = constant((0.05, 0.15, 0.1), "D/m, axis by axis", "1/s", source=_CHOSEN)
    tail_gain: Any = constant(9.0, "yaw acceleration at full rudder", "rad/s^2", source=_CHOSEN)
    yaw_damping: Any = constant(3.0, "yaw acceleration over yaw rate, with the yaw gyro", "1/s", low=0, source=_CHOSEN)
    torque_coupling: Any = constant(1.5, "yaw acceleration at full collective", "rad/s^2", source=_CHOSEN)

    state_channels: ClassVar[tuple[Channel, ...]] = (
        *RigidBody.state_channels,
        *(Channel(f"swashplate.{a}", "1") for a in ("aileron", "elevator", "rudder", "collective")),
        *(Channel(f"disc_tilt.{a}", "rad") for a in ("forward", "left")),
    )
    input_signals: ClassVar[tuple[str, ...]] = ("pilot",)
    provides: ClassVar[tuple[str, ...]] = ("linear_drag",)
    equation: ClassVar[str] = (
        "dδ/dt = (u − δ)/τ_s;  da/dt = −q − (a − A δ_ele + k_v v_x)/τ_f;  db/dt = p − (b + A δ_ail + k_v v_y)/τ_f;  "
        "T = m (g + Z_δ δ_col − Z_w v_z);  F = T (a, b, 1) − m D v_b;  τ = (K + h T)(−b, a, 0) + J_z N e3, "
        "N = N_δ δ_rud − N_r r + N_c δ_col"
    )

    def own_load(self, motion: Motion, internal: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Force and torque of both rotors and the air, body frame; see `RigidBody.own_load`."""

        def c(value: Any) -> Tensor:
            return tensor(value, internal)

        servo, (forward, left) = internal[..., :4], internal[..., 4:].unbind(-1)
        aileron, elevator, rudder, collective = servo.unbind(-1)
        p, q, r = motion.body_rates.unbind(-1)
        vx, vy, vz = motion.air_velocity.unbind(-1)
        thrust = c(self.mass) * (c(self.gravity) + c(self.collective_gain) * collective - c(self.inflow_damping) * vz)
        drag = c(self.mass).unsqueeze(-1) * c(self.drag) * motion.air_velocity
        force = vector((thrust * forward, thrust * left, thrust), internal) - drag
        stiffness = c(self.hub_stiffness) + c(self.hub_height) * thrust
        yaw = c(self.tail_gain) * rudder - c(self.yaw_damping) * r + c(self.torque_coupling) * collective
        torque = vector((-stiffness * left, stiffness * forward, c(self.inertia)[..., 2] * yaw), internal)
        servo_rate = (motion.inputs - servo) / c(self.servo_lag).unsqueeze(-1)
        gain, lag, back = c(self.cyclic_gain), c(self.flapping_lag), c(self.flapback)
        forward_rate = -q - (forward - gain * elevator + back * vx) / lag
        left_rate = p - (left + gain * aileron + back * vy) / lag
        return force, torque, joined([servo_rate, vector((forward_rate, left_rate), internal)])
