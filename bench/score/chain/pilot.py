"""A cascade of PID loops: position, velocity, attitude, body rates, mixer. Sampled; it feels a noisy gyroscope."""

from dataclasses import dataclass

import numpy as np

from bench.score.chain.vehicle.airframe import GRAVITY, Airframe
from bench.score.chain.vehicle.body import P, Q, V, cross, rotation

Array = np.ndarray
TILT = np.deg2rad(50)
"""Steepest thrust that is asked for, from the vertical."""


@dataclass(frozen=True)
class Gains:
    """Of the loops [1/s], each slower than the one inside."""

    rate: float
    attitude: float
    velocity: float
    """Horizontal, as is the next."""
    position: float
    climb: float
    """Of the vertical velocity: thrust needs no turn of the body."""
    height: float
    yaw: float
    yaw_share: float
    """Of the gains of its rate that yaw bears, against roll and pitch; no gain itself."""


def gains(lag: float, period: float, lead: float = 0.0) -> Gains:
    """What motors of time constant ``lag`` and a controller of ``period`` bear with a margin [s].

    Args:
        lag: of the motors [s].
        period: of the controller [s].
        lead: of the torque in yaw, which the rotors' own reaction is ahead of their drag, J_r / (2 k_m ω) [s]. A loop
            that was tuned without it swings between the ends of what motors can do.
    """
    rate = min(1 / (1.6 * (lag + 1.2 * period)), 28.0)
    attitude, yaw_share = rate / 2.4, 1 / (1 + lead * rate)
    return Gains(
        rate=rate,
        attitude=attitude,
        velocity=attitude / 2.6,
        position=attitude / 6,
        climb=rate / 3,
        height=rate / 9,
        yaw=attitude / 3 * yaw_share,
        yaw_share=yaw_share,
    )


class Pilot:
    """The controller of several flights at a time; it keeps its integrals.

    Args:
        craft: whose constants it was tuned with.
        tuned: gains.
        period: between its ticks [s].
        flights: how many.
    """

    def __init__(self, craft: Airframe, tuned: Gains, period: float, flights: int) -> None:
        self.craft, self.tuned, self.period = craft, tuned, period
        x, y = np.array(craft.hubs).T
        turns = np.array(craft.turns, dtype=float)
        mixing = np.stack([np.full(4, 1.0), y, -x, turns * craft.drag / craft.thrust])
        self.unmix = np.linalg.inv(mixing)
        self.inertia = np.array(craft.inertia)[:, None]
        self.greatest = craft.power * craft.mass * GRAVITY / 4
        self.place = np.array([[tuned.position], [tuned.position], [tuned.height]])
        self.pace = np.array([[tuned.velocity], [tuned.velocity], [tuned.climb]])
        shares = np.array([[1.0], [1.0], [tuned.yaw_share]])
        self.turning = tuned.rate * np.array([[1.0], [1.0], [0.6]]) * shares
        self.trimming = 0.8 * tuned.rate * shares
        self.drift = np.zeros((3, flights))
        self.trim = np.zeros((3, flights))

    def command(self, state: Array, felt: Array, wanted: Array) -> Array:
        """Rotor speeds (4, B) [rad/s] for a state, body rates as ``felt`` (3, B) and ``wanted`` (11, B)."""
        slip = wanted[3:6] + self.place * (wanted[0:3] - state[P]) - state[V]
        self.drift = np.clip(self.drift + 0.3 * self.pace * self.period * slip, -4, 4)
        push = wanted[6:9] + self.pace * slip + self.drift
        push[2] += GRAVITY
        push[2] = np.maximum(push[2], 0.3 * GRAVITY)
        level = np.sqrt((push[:2] ** 2).sum(0))
        push[:2] *= np.minimum(1, np.tan(TILT) * push[2] / np.maximum(level, 1e-9))
        turn = rotation(state[Q])
        lift = self.craft.mass * push[2] / np.maximum(turn[2, 2], 0.4)
        turning = self._turning(turn, push, wanted)
        error = turning - felt
        self.trim = np.clip(self.trim + self.trimming * self.period * error, -25, 25)
        torque = self.inertia * (self.turning * error + self.trim)
        torque += cross(felt, self.inertia * felt)
        thrust = self._mixed(lift, torque)
        return np.asarray(np.sqrt(thrust / self.craft.thrust))

    def _turning(self, turn: Array, push: Array, wanted: Array) -> Array:
        """Body rates (3, B) that turn the thrust to ``push`` and the nose to the wanted yaw."""
        k = self.tuned
        up = push / np.sqrt((push**2).sum(0))
        tilt = (turn * cross(turn[:, 2], up)[:, None]).sum(0)  # sine of the angle, body frame
        nose = np.arctan2(turn[1, 0], turn[0, 0])
        left = (wanted[9] - nose + np.pi) % (2 * np.pi) - np.pi
        out = k.attitude * tilt
        out[2] = k.yaw * np.clip(left, -1, 1) + wanted[10]
        return np.asarray(out)

    def _mixed(self, lift: Array, torque: Array) -> Array:
        """Thrusts (4, B) within what rotors can do: yaw gives way first."""
        least, greatest = 0.03 * self.greatest, self.greatest
        lift = np.clip(lift, 4.4 * least, 3.6 * greatest)
        roll = self.unmix[:, :3] @ np.concatenate([lift[None], torque[:2]])
        twist = self.unmix[:, 3:] @ torque[2:]
        room = np.minimum(roll - least, greatest - roll).min(0)
        share = np.clip(room / np.maximum(np.abs(twist).max(0), 1e-12), 0.1, 1)
        return np.asarray(np.clip(roll + share * twist, least, greatest))
