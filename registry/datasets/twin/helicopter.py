"""Simulated helicopter flights outdoors: a pilot on the sticks, gusts that nobody records."""

from dataclasses import replace

import numpy as np
import scipy  # its parts are imported when they are used: scipy.signal takes longer than all else here
import torch
from torch import Tensor

from registry.datasets.twin.quadrotor import euler_zyx, quaternion_zyx
from registry.datasets.twin.reference import DT, REGIMES, Legs, doublets, pad, path
from registry.dynamics import cross, rotation_matrix
from registry.effects.actuation import InputDelay
from registry.effects.air import Wind
from registry.physics.helicopter import Helicopter

DELAY = 0.035
"""From the pilot's sticks to the swashplate servos [s]: chosen for the twin."""
TRUTH = Helicopter(effects=(InputDelay(delay=DELAY), Wind()), input_hold="previous")
"""The simple model is this without the delay and the wind."""
MEAN_WIND, GUST, GUST_TIME = 2.0, 1.2, 2.5
"""Largest steady wind and 1σ of the gusts [m/s], and their correlation time [s]: chosen for the twin."""
NOISE = {"velocity": 0.03, "attitude": np.deg2rad(0.2), "body_rates": 0.006}
"""1σ, white: [m/s], [rad], [rad/s]: chosen for the twin."""
SOFTNESS = 0.08
"""Time constant of the pilot's hands [s]."""

_LEGS = {  # x and y, z, yaw
    "hover": (Legs(-0.5, 0.5, 0.4, 0.5, 0.5, 2), Legs(9.7, 10.3, 0.3, 0.4, 0.4, 2), Legs(-0.4, 0.4, 0.3, 0.5, 0.5, 3)),
    "slight": (Legs(-12, 12, 3, 1.2, 1.2, 1), Legs(8, 14, 1, 0.8, 0.8, 1), Legs(-2, 2, 0.6, 1, 1, 2)),
    "moderate": (Legs(-25, 25, 7, 2.5, 2.5, 1), Legs(7, 20, 2.5, 2, 2, 1), Legs(-4, 4, 1.2, 2, 2, 1.5)),
    "aggressive": (Legs(-30, 30, 10, 4, 4, 0.5), Legs(5, 25, 4, 3.5, 3.5, 0.5), Legs(-6, 6, 2, 3, 3, 1)),
}
_DOUBLET = {"hover": 0.08, "slight": 0.2, "moderate": 0.4, "aggressive": 0.7}  # of full stick


def reference(rng: np.random.Generator, regime: str, samples: int) -> np.ndarray:
    """Reference (samples, 18) of one flight: x, y, z, yaw with two derivatives each, stick doublets, wind x and y."""
    flat, high, yaw = _LEGS[regime]
    paths = [path(rng, legs, samples) for legs in (flat, flat, high, yaw)]
    size = _DOUBLET[regime]
    shakes = [doublets(rng, samples, size, (0.3, 0.9), 2.5)[:, None] for _ in range(4)]
    keep = np.exp(-DT / GUST_TIME)  # first-order Gauss-Markov, the horizontal gust of Dryden's form
    white = rng.normal(0, GUST * np.sqrt(1 - keep**2), (samples, 2))
    gusts = rng.uniform(-MEAN_WIND, MEAN_WIND, 2) + scipy.signal.lfilter([1.0], [1.0, -keep], white, axis=0)
    return np.concatenate([*paths, *shakes, gusts], axis=1)


def sticks(state: Tensor, wanted: Tensor) -> Tensor:
    """The pilot: sticks (B, 4) asked for at the state (B, 19) and `reference` rows (B, 18)."""
    px, vx, ax, py, vy, ay, pz, vz, az, yaw, yaw_rate, _ = wanted[..., :12].unbind(-1)
    goal, speed, ahead = (torch.stack(c, dim=-1) for c in ((px, py, pz), (vx, vy, vz), (ax, ay, az)))
    position, velocity, attitude = state[..., :3], state[..., 3:6], state[..., 6:10]
    rotation = rotation_matrix(attitude)
    back = 0.5 * (goal - position).clamp(-4, 4) + 0.9 * (speed - velocity).clamp(-4, 4)
    lift = (ahead + back).clamp(-6, 6) + wanted.new_tensor((0.0, 0.0, TRUTH.gravity))
    up = rotation[..., :, 2]
    climb = (velocity * up).sum(-1)
    collective = ((lift * up).sum(-1) - TRUTH.gravity + TRUTH.inflow_damping * climb) / TRUTH.collective_gain
    tilt = cross(up, lift / lift.square().sum(-1, keepdim=True).sqrt())
    tilt = (rotation * tilt.unsqueeze(-1)).sum(-2)  # body frame
    heading = torch.stack([torch.cos(yaw), torch.sin(yaw)], dim=-1)
    forward = rotation[..., :2, 0]
    off = (forward[..., 0] * heading[..., 1] - forward[..., 1] * heading[..., 0]).clamp(-0.5, 0.5)
    cyclic = 2.5 * tilt[..., :2] * (TRUTH.flapping_lag / TRUTH.cyclic_gain)
    rudder = (TRUTH.yaw_damping * (yaw_rate + 1.5 * off) - TRUTH.torque_coupling * collective) / TRUTH.tail_gain
    asked = torch.cat([cyclic, rudder.unsqueeze(-1), collective.unsqueeze(-1)], dim=-1)
    return (asked + wanted[..., 12:16]).clamp(-1, 1)


def fly(references: list[np.ndarray]) -> list[np.ndarray]:
    """Truth of each flight (N_i, 23): state (19), sticks (4); flights run side by side."""
    wanted, proper = torch.from_numpy(pad(references)), len(TRUTH.state_channels)
    steps, count = wanted.shape[:2]
    state = torch.zeros(count, proper, dtype=torch.float64)
    state[:, :3] = wanted[0][:, [0, 3, 6]]
    state[:, 8], state[:, 9] = torch.sin(wanted[0, :, 9] / 2), torch.cos(wanted[0, :, 9] / 2)
    stick = torch.zeros(count, 4, dtype=torch.float64)
    full = TRUTH.initial(state, stick, DT)
    out = torch.empty(steps, count, proper + 4, dtype=torch.float64)
    delay = TRUTH.effects[0]
    for k in range(steps):
        stick = stick + (DT / SOFTNESS) * (sticks(full[:, :proper], wanted[k]) - stick)
        out[k] = torch.cat([full[:, :proper], stick], dim=-1)
        model = replace(TRUTH, effects=(delay, Wind(w_x=wanted[k, :, 16], w_y=wanted[k, :, 17])))
        full = model.step(full, stick, stick, DT)
    truth = out.numpy()
    return [truth[: len(r), i] for i, r in enumerate(references)]


def euler_rates(euler: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """Time derivatives (N, 3) of Euler ZYX angles (N, 3) at body rates (N, 3)."""
    (roll, pitch, _), (p, q, r) = euler.T, rates.T
    turn = np.sin(roll) * q + np.cos(roll) * r
    return np.stack([p + np.tan(pitch) * turn, np.cos(roll) * q - np.sin(roll) * r, turn / np.cos(pitch)], axis=1)


def measure(rng: np.random.Generator, truth: np.ndarray) -> np.ndarray:
    """What is recorded of one flight (N, 17): sticks (4), velocity (3), attitude xyzw (4), body rates (3), Euler
    rates (3). Velocity, attitude and body rates have white noise; the Euler rates are computed from the last two.
    """
    n = len(truth)
    velocity = truth[:, 3:6] + rng.normal(0, NOISE["velocity"], (n, 3))
    euler = euler_zyx(truth[:, 6:10]) + rng.normal(0, NOISE["attitude"], (n, 3))
    rates = truth[:, 10:13] + rng.normal(0, NOISE["body_rates"], (n, 3))
    return np.concatenate([truth[:, 19:23], velocity, quaternion_zyx(euler), rates, euler_rates(euler, rates)], axis=1)


def flights(seed: int, lengths: list[int]) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Recorded (len, 17) and true (len, 23) samples of every flight; each draws from a generator of its own."""
    rngs = [np.random.default_rng([seed, 2, i]) for i in range(len(lengths))]
    wanted = [reference(g, REGIMES[i % 4], n) for i, (g, n) in enumerate(zip(rngs, lengths, strict=True))]
    truth = fly(wanted)
    return [measure(g, t) for g, t in zip(rngs, truth, strict=True)], truth
