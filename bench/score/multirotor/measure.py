"""What a log shows of a flight: noise of the sensors, then the smoothing that precedes differentiation."""

from dataclasses import dataclass

import numpy as np
from scipy.signal import savgol_filter

Array = np.ndarray


@dataclass(frozen=True)
class Noise:
    """1σ of white noise, before any smoothing."""

    position: float
    """[m]."""
    attitude: float
    """About each body axis [rad]."""
    velocity: float = 0.0
    """[m/s]; only where velocity is measured on its own."""
    rates: float = 0.0
    """[rad/s]; only where body rates are measured on their own."""
    rotor: float = 0.001
    """Of rotor speed, relative to hover."""
    battery: float = 0.005
    """[V]."""


LEVELS = {
    "low": Noise(0.0001, np.deg2rad(0.01), 0.005, 0.005),
    "medium": Noise(0.0004, np.deg2rad(0.03), 0.02, 0.02),
    "high": Noise(0.001, np.deg2rad(0.08), 0.05, 0.05),
}


@dataclass(frozen=True)
class Smoothing:
    """How position and attitude were smoothed, and velocity and rates got from them.

    ``kind`` "savgol": local polynomials of ``order`` over ``window`` samples, differentiated; "mean": the average
    of ``window`` samples, then central differences; "none": no filter, velocity and rates have sensors of their own.
    """

    kind: str
    window: int = 1
    order: int = 0


SMOOTHINGS = {
    "savgol": Smoothing("savgol", 9, 3),
    "savgol_wide": Smoothing("savgol", 15, 2),
    "moving_average": Smoothing("mean", 5),
    "none": Smoothing("none"),
}


def multiply(a: Array, b: Array) -> Array:
    """Product of quaternions xyzw (…, 4)."""
    av, aw, bv, bw = a[..., :3], a[..., 3:], b[..., :3], b[..., 3:]
    return np.concatenate([aw * bv + bw * av + np.cross(av, bv), aw * bw - (av * bv).sum(-1, keepdims=True)], axis=-1)


def continuous(quaternion: Array) -> Array:
    """The same attitudes (N, 4) without jumps of sign."""
    jumps = np.sign((quaternion[1:] * quaternion[:-1]).sum(1))
    return quaternion * np.concatenate([[1.0], np.cumprod(np.where(jumps == 0, 1, jumps))])[:, None]


def smooth(signal: Array, how: Smoothing, dt: float) -> tuple[Array, Array]:
    """The smoothed signal (N, c) and its derivative (N, c)."""
    if how.kind == "savgol":
        value, slope = (savgol_filter(signal, how.window, how.order, deriv=d, delta=dt, axis=0) for d in (0, 1))
        return value, slope
    half = how.window // 2
    padded = np.concatenate([np.repeat(signal[:1], half, 0), signal, np.repeat(signal[-1:], half, 0)])
    value = np.stack([np.convolve(c, np.full(how.window, 1 / how.window), "valid") for c in padded.T], axis=1)
    return value, np.gradient(value, dt, axis=0)


def measure(
    rng: np.random.Generator,
    state: Array,
    speed: Array,
    command: Array,
    battery: Array | None,
    noise: Noise,
    how: Smoothing,
    rate: float,
) -> dict[str, Array]:
    """The columns of one log.

    Args:
        rng: draws the noise.
        state: true position, velocity (world), attitude xyzw, body rates (N, ≥ 13).
        speed: true rotor speeds (N, 4) [rad/s].
        command: (N, 4) [rad/s].
        battery: true voltage (N,) [V], None where it is not logged.
        noise: of the sensors.
        how: the smoothing.
        rate: [Hz].

    Returns:
        t (N,), position (N, 3), attitude (N, 4), velocity (N, 3) in the world frame, body_rates (N, 3),
        rotor_speed (N, 4), rotor_command (N, 4), and battery (N,) where it is logged.
    """
    n = len(state)
    position = state[:, 0:3] + rng.normal(0, noise.position, (n, 3))
    wobble = np.concatenate([rng.normal(0, noise.attitude / 2, (n, 3)), np.ones((n, 1))], axis=1)
    attitude = continuous(multiply(state[:, 6:10], wobble))
    velocity = state[:, 3:6] + rng.normal(0, noise.velocity, (n, 3))
    rates = state[:, 10:13] + rng.normal(0, noise.rates, (n, 3))
    speed = speed + rng.normal(0, noise.rotor * np.sqrt((speed**2).mean()), (n, 4))
    if how.kind != "none":
        position, velocity = smooth(position, how, 1 / rate)
        attitude, turning = smooth(attitude / np.linalg.norm(attitude, axis=1, keepdims=True), how, 1 / rate)
        length = np.linalg.norm(attitude, axis=1, keepdims=True)
        attitude, turning = attitude / length, turning / length
        conjugate = attitude * np.array([-1.0, -1.0, -1.0, 1.0])
        rates = 2 * multiply(conjugate, turning)[:, :3]
    out = {
        "t": np.arange(n) / rate,
        "position": position,
        "attitude": attitude / np.linalg.norm(attitude, axis=1, keepdims=True),
        "velocity": velocity,
        "body_rates": rates,
        "rotor_speed": speed,
        "rotor_command": command,
    }
    if battery is not None:
        out["battery"] = battery + rng.normal(0, noise.battery, n)
    return out
