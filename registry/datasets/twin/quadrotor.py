"""Simulated Pelican flights: a pilot in a 5 m cube, and what the motion capture would have recorded."""

from dataclasses import replace

import numpy as np
import scipy  # its parts are imported when they are used: scipy.signal takes longer than all else here
import torch
from torch import Tensor

from registry.datasets.twin.reference import DT, REGIMES, Legs, doublets, pad, path, slow_error
from registry.dynamics import cross, rotation_matrix
from registry.effects.actuation import MotorLag
from registry.effects.rotor import GroundEffect, RotorDrag, RotorGyroscopicTorque, RotorReactionTorque
from registry.physics.quadrotor import Quadrotor

COUNT = 6.0
"""One count of the motor controllers' integer scale [rad/s]: chosen so that hover is at 83 counts, where the
published histograms have it (their scale is not given in rad/s)."""
ACCURACY = (0.005, np.deg2rad(0.1))
"""Of position [m] and Euler angles [rad]: bounds of the whole error, nearly all of it slow."""
JITTER = (0.0004, np.deg2rad(0.005))
"""1σ of the white part of the error [m], [rad]. The published ±5 mm and ±0.1° cannot be white: differentiated twice
they would give accelerations of some 25 m/s² and 9 rad/s², where the published histograms have 5 and .8."""
SAFE = 1.2
"""The pilot plays only where half a second of flight keeps x and y within this [m]."""
STEEPEST = 0.6
"""Tangent of the tilt that the pilot asks for, per axis."""
QUICKEST = 2.2
"""Body rate with which the autopilot corrects tilt [rad/s]; the pilot's own doublets come on top."""
AUTHORITY = (0.07, 0.07, 0.009)
"""Largest torque over thrust [m]: leaves every rotor some thrust."""
SLOWEST, FASTEST = 120.0, 830.0
"""Rotor speeds the controllers can command [rad/s]."""

TRUTH = Quadrotor(
    effects=(
        MotorLag.typical(),
        RotorDrag.typical(),
        GroundEffect.typical(),
        RotorGyroscopicTorque.typical(),
        RotorReactionTorque.typical(),
    ),
    input_hold="previous",
)
"""Commands in; the simple motion model is this without its effects."""
BY_ROTOR_SPEED = replace(
    TRUTH, effects=tuple(e for e in TRUTH.effects if not isinstance(e, MotorLag)), input_hold="linear"
)
"""The same from the rotors on, whose speeds are recorded."""


def _legs(regime: str, rng: np.random.Generator) -> tuple[Legs, Legs, Legs, Legs]:
    """How x, y, z and yaw travel."""
    low_flight = regime in ("hover", "slight") and rng.random() < 0.4  # close to the ground
    if regime == "hover":
        x, y, z = rng.uniform(-1, 1), rng.uniform(-1, 1), 0.3 if low_flight else rng.uniform(0.6, 2.0)
        still_x, still_y = (Legs(c - 0.15, c + 0.15, 0.15, 0.4, 0.4, 2.0) for c in (x, y))
        return still_x, still_y, Legs(z - 0.08, z + 0.08, 0.15, 0.4, 0.4, 2.0), Legs(-0.3, 0.3, 0.2, 0.5, 0.5, 3.0)
    if regime == "slight":
        flat = Legs(-1.6, 1.6, 0.8, 1.0, 1.0, 1.0)
        return flat, flat, Legs(0.2, 0.9 if low_flight else 2.5, 0.6, 1.0, 1.0, 1.0), Legs(-2, 2, 0.6, 1, 1, 2.0)
    if regime == "moderate":
        flat = Legs(-1.7, 1.7, 2.2, 2.8, 2.8, 0.5)
        return flat, flat, Legs(0.4, 3.8, 2.2, 4.0, 3.5, 0.7), Legs(-4, 4, 1.6, 3, 3, 1.5)
    # Fast climbs and drops leave little thrust to steer with: they are not mixed with fast turns.
    yaw = Legs(-6, 6, 3.3, 4, 4, 1.5)
    if rng.random() < 0.4:
        flat = Legs(-1.2, 1.2, 1.2, 1.2, 1.2, 1.0)
        return flat, flat, Legs(0.7, 4.45, 6.0, 12.0, 7.3, 0.7), yaw
    flat = Legs(-1.5, 1.5, 3.8, 4.0, 4.0, 0.5)
    return flat, flat, Legs(0.5, 4.0, 2.0, 2.5, 2.5, 0.7), yaw


_DOUBLET = {"hover": 0.15, "slight": 0.5, "moderate": 1.4, "aggressive": 3.2}  # rad/s


def reference(rng: np.random.Generator, regime: str, samples: int) -> np.ndarray:
    """Reference (samples, 14) of one flight: x, y, z, yaw with two derivatives each, roll and pitch doublets."""
    paths = [path(rng, legs, samples) for legs in _legs(regime, rng)]
    shakes = [doublets(rng, samples, _DOUBLET[regime], (0.35, 0.6), 2.5)[:, None] for _ in range(2)]
    return np.concatenate([*paths, *shakes], axis=1)


def _mixer() -> Tensor:
    """(4, 4): thrust and body torques to the squares of the rotor speeds."""
    arms = np.array(TRUTH.rotor_positions)
    k_f, k_m = TRUTH.thrust_coefficient, TRUTH.torque_coefficient
    loads = [np.full(4, k_f), k_f * arms[:, 1], -k_f * arms[:, 0], k_m * np.array(TRUTH.rotor_directions)]
    return torch.from_numpy(np.linalg.inv(np.stack(loads)))


def command(state: Tensor, wanted: Tensor, mixer: Tensor) -> Tensor:
    """The pilot and the autopilot: rotor commands (B, 4) [rad/s] at the state (B, 13) for `reference` rows (B, 14)."""
    px, vx, ax, py, vy, ay, pz, vz, az, yaw, yaw_rate, _, roll_shake, pitch_shake = wanted.unbind(-1)
    goal, speed, ahead = (torch.stack(c, dim=-1) for c in ((px, py, pz), (vx, vy, vz), (ax, ay, az)))
    position, velocity, attitude, rates = state.split([3, 3, 4, 3], dim=-1)
    rotation = rotation_matrix(attitude)
    back = 4.0 * (goal - position).clamp(-1.5, 1.5) + 4.0 * (speed - velocity).clamp(-2.0, 2.0)
    lift = ahead + back + wanted.new_tensor((0.0, 0.0, TRUTH.gravity))
    vertical = lift[..., 2:].clamp(min=1.0)
    steepest = STEEPEST * vertical
    lift = torch.cat([torch.minimum(torch.maximum(lift[..., :2], -steepest), steepest), vertical], dim=-1)
    up = rotation[..., :, 2]
    thrust = TRUTH.mass * (lift * up).sum(-1)
    tilt = cross(up, lift / lift.square().sum(-1, keepdim=True).sqrt())  # world, sine of the angle to turn
    tilt = (rotation * tilt.unsqueeze(-1)).sum(-2)
    heading = torch.stack([torch.cos(yaw), torch.sin(yaw)], dim=-1)
    forward = rotation[..., :2, 0]
    off = (forward[..., 0] * heading[..., 1] - forward[..., 1] * heading[..., 0]).clamp(-0.5, 0.5)
    # Nobody shakes the vehicle when it runs towards a wall or falls.
    safe = ((position + 0.5 * velocity)[..., :2].abs() < SAFE).all(-1) & (lift[..., 2] > 6) & (position[..., 2] > 0.2)
    shaken = torch.stack([roll_shake, pitch_shake], dim=-1) * safe.unsqueeze(-1)
    level = torch.where((shaken != 0).any(-1, keepdim=True), 2.0, 7.0) * tilt[..., :2]
    level = level.clamp(-QUICKEST, QUICKEST) + shaken
    target = torch.cat([level, (yaw_rate + 3.0 * off).unsqueeze(-1)], dim=-1)
    gain = wanted.new_tensor((18.0, 18.0, 8.0))
    inertia = wanted.new_tensor(TRUTH.inertia)
    torque = inertia * gain * (target - rates) + cross(rates, inertia * rates)
    thrust = thrust.clamp(2.0, 23.0)
    bound = wanted.new_tensor(AUTHORITY) * thrust.unsqueeze(-1)
    torque = torch.minimum(torch.maximum(torque, -bound), bound)
    load = torch.cat([thrust.unsqueeze(-1), torque], dim=-1)
    squares = (mixer * load.unsqueeze(-2)).sum(-1)
    return (squares.clamp(SLOWEST**2, FASTEST**2).sqrt() / COUNT).round() * COUNT


def fly(references: list[np.ndarray]) -> list[np.ndarray]:
    """Truth of each flight (N_i, 21): state (13), rotor speeds (4), commands (4); flights run side by side."""
    wanted, mixer, proper = torch.from_numpy(pad(references)), _mixer(), len(TRUTH.state_channels)
    steps, flights = wanted.shape[:2]
    hover = np.sqrt(TRUTH.mass * TRUTH.gravity / (4 * TRUTH.thrust_coefficient))
    state = torch.zeros(flights, proper, dtype=torch.float64)
    state[:, :3], state[:, 8:10] = (
        wanted[0][:, [0, 3, 6]],
        torch.stack([torch.sin(wanted[0, :, 9] / 2), torch.cos(wanted[0, :, 9] / 2)], dim=-1),
    )
    full = TRUTH.initial(state, torch.full((flights, 4), hover, dtype=torch.float64), DT)
    out = torch.empty(steps, flights, proper + 8, dtype=torch.float64)
    for k in range(steps):
        order = command(full[:, :proper], wanted[k], mixer)
        out[k] = torch.cat([full, order], dim=-1)
        full = TRUTH.step(full, order, order, DT)
    truth = out.numpy()
    return [truth[: len(r), i] for i, r in enumerate(references)]


def euler_zyx(quaternion: np.ndarray) -> np.ndarray:
    """Roll, pitch and unwrapped yaw (N, 3) [rad] of quaternions xyzw (N, 4)."""
    x, y, z, w = quaternion.T
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2 * (w * y - z * x), -1, 1))
    yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return np.stack([roll, pitch, np.unwrap(yaw)], axis=1)


def quaternion_zyx(euler: np.ndarray) -> np.ndarray:
    """Quaternions xyzw (N, 4) of roll, pitch, yaw (N, 3) [rad]."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(euler.T / 2), np.sin(euler.T / 2)
    parts = [sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy]
    return np.stack([*parts, cr * cp * cy + sr * sp * sy], axis=1)


def body_rates(euler: np.ndarray, euler_rates: np.ndarray) -> np.ndarray:
    """Body rates (N, 3) of Euler ZYX angles and their time derivatives (N, 3).

    The matrix printed with the published data turns body rates into Euler rates; this is its inverse.
    """
    (roll, pitch, _), (d_roll, d_pitch, d_yaw) = euler.T, euler_rates.T
    q = np.cos(roll) * d_pitch + np.sin(roll) * np.cos(pitch) * d_yaw
    r = -np.sin(roll) * d_pitch + np.cos(roll) * np.cos(pitch) * d_yaw
    return np.stack([d_roll - np.sin(pitch) * d_yaw, q, r], axis=1)


def smooth(signal: np.ndarray) -> np.ndarray:
    """Local quadratic over 5 samples (N, c), equal weights: our reading of the published "local regression"."""
    return scipy.signal.savgol_filter(signal, 5, 2, axis=0)


def measure(rng: np.random.Generator, truth: np.ndarray) -> np.ndarray:
    """What is recorded of one flight (N − 1, 24).

    Rotor speeds (4), position (3), velocity (3), attitude xyzw (4), body rates (3), Euler rates (3), commands (4).
    As the authors of the published set did: everything smoothed, then differentiated; the difference of samples
    k−1 and k is filed under k.
    """
    n, readings = len(truth), []
    for clean, bound, jitter in zip((truth[:, :3], euler_zyx(truth[:, 6:10])), ACCURACY, JITTER, strict=True):
        error = slow_error(rng, n, bound - 3 * jitter, 3) + rng.normal(0, jitter, (n, 3))
        readings.append(smooth(clean + np.clip(error, -bound, bound)))
    position, euler = readings
    speeds = smooth(np.round(truth[:, 13:17] / COUNT) * COUNT)
    velocity, euler_rates = np.diff(position, axis=0) / DT, np.diff(euler, axis=0) / DT
    rates = body_rates(euler[1:], euler_rates)
    columns = [speeds[1:], position[1:], velocity, quaternion_zyx(euler[1:]), rates, euler_rates, truth[1:, 17:21]]
    return np.concatenate(columns, axis=1)


def flights(seed: int, lengths: list[int]) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Recorded (len, 24) and true (len, 21) samples of every flight; each draws from a generator of its own."""
    rngs = [np.random.default_rng([seed, 1, i]) for i in range(len(lengths))]
    wanted = [reference(g, REGIMES[i % 4], n + 1) for i, (g, n) in enumerate(zip(rngs, lengths, strict=True))]
    truth = fly(wanted)
    return [measure(g, t) for g, t in zip(rngs, truth, strict=True)], [t[1:] for t in truth]
