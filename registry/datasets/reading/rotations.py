"""Attitude and its rates, over whole recordings: quaternions xyzw, body to world; Euler ZYX (roll, pitch, yaw)."""

import numpy as np

_STEEPEST = 1e-3
"""Smallest cosine of the pitch angle that Euler rates are divided by: they are singular at ±90°."""


def unit_quaternion(q: np.ndarray) -> np.ndarray:
    """Quaternions (N, 4) of unit length whose sign does not flip between samples.

    Raises:
        ValueError: a quaternion of length zero.
    """
    length = np.linalg.norm(q, axis=1, keepdims=True)
    if not (length > 0).all():
        raise ValueError("a quaternion of length zero")
    q = q / length
    flips = np.where((q[1:] * q[:-1]).sum(axis=1) < 0, -1.0, 1.0)
    return q * np.concatenate([[1.0], np.cumprod(flips)])[: len(q), None]


def quaternion_from_euler(euler: np.ndarray) -> np.ndarray:
    """Quaternions xyzw (N, 4) of roll, pitch, yaw (N, 3) [rad]."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(euler.T / 2), np.sin(euler.T / 2)
    x, y, z = sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy
    return unit_quaternion(np.stack([x, y, z, cr * cp * cy + sr * sp * sy], axis=1))


def euler_from_quaternion(q: np.ndarray) -> np.ndarray:
    """Roll, pitch, yaw (…, 3) [rad] of unit quaternions xyzw (…, 4)."""
    x, y, z, w = np.moveaxis(q, -1, 0)
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2 * (w * y - z * x), -1, 1))
    yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return np.stack([roll, pitch, yaw], axis=-1)


def rotate(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Vectors (N, 3) turned by unit quaternions xyzw (N, 4): body → world."""
    axis, w = q[:, :3], q[:, 3:]
    t = 2 * np.cross(axis, v)
    return v + w * t + np.cross(axis, t)


def euler_rates_from_body(euler: np.ndarray, body: np.ndarray) -> np.ndarray:
    """Time derivative (N, 3) [rad/s] of roll, pitch, yaw (N, 3) at body rates p, q, r (N, 3)."""
    roll, pitch, _ = euler.T
    p, q, r = body.T
    turn = np.sin(roll) * q + np.cos(roll) * r
    cosine = np.cos(pitch)
    yaw = turn / np.where(np.abs(cosine) < _STEEPEST, np.copysign(_STEEPEST, cosine), cosine)
    return np.stack([p + np.sin(pitch) * yaw, np.cos(roll) * q - np.sin(roll) * r, yaw], axis=1)


def body_rates_from_euler(euler: np.ndarray, euler_rates: np.ndarray) -> np.ndarray:
    """Body rates p, q, r (N, 3) [rad/s] of Euler angles (N, 3) and their time derivatives (N, 3)."""
    roll, pitch, _ = euler.T
    droll, dpitch, dyaw = euler_rates.T
    q = np.cos(roll) * dpitch + np.sin(roll) * np.cos(pitch) * dyaw
    r = np.cos(roll) * np.cos(pitch) * dyaw - np.sin(roll) * dpitch
    return np.stack([droll - np.sin(pitch) * dyaw, q, r], axis=1)
