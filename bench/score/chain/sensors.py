"""What is known of a flight on board or in the laboratory: motion capture, or the states of an estimator.

Both give position, velocity (world), attitude (wxyz) and body rates on an even grid, flights along the last axis.
"""

from dataclasses import dataclass

import numpy as np
from scipy.signal import butter, lfilter, savgol_filter

from bench.score.chain.flight import DT, Truth
from bench.score.chain.vehicle.airframe import GRAVITY
from bench.score.chain.vehicle.body import P, Q, V, W, rotation

Array = np.ndarray


@dataclass(frozen=True)
class Quality:
    """1σ of white noise, and of what stays through a flight."""

    position: float
    """Of motion capture [m]."""
    attitude: float
    """About each body axis [rad]."""
    window: int
    """Samples of the local cubic that differentiates motion capture."""
    gyroscope: float
    """A sample at `TICK` [rad/s]."""
    gyroscope_bias: float
    accelerometer: float
    """[m/s²]."""
    accelerometer_bias: float
    fix: float
    """Of the estimator's position [m]."""
    compass: float
    """Of its attitude reference [rad]."""
    rotor: float
    """Relative to hover."""
    battery: float
    """[V]."""


QUALITIES = {
    "low": Quality(
        position=1e-4,
        attitude=np.deg2rad(0.01),
        window=9,
        gyroscope=0.005,
        gyroscope_bias=0.001,
        accelerometer=0.05,
        accelerometer_bias=0.01,
        fix=1e-3,
        compass=np.deg2rad(0.1),
        rotor=0.0005,
        battery=0.003,
    ),
    "medium": Quality(
        position=4e-4,
        attitude=np.deg2rad(0.03),
        window=11,
        gyroscope=0.02,
        gyroscope_bias=0.003,
        accelerometer=0.15,
        accelerometer_bias=0.04,
        fix=5e-3,
        compass=np.deg2rad(0.3),
        rotor=0.0015,
        battery=0.006,
    ),
    "high": Quality(
        position=1e-3,
        attitude=np.deg2rad(0.08),
        window=15,
        gyroscope=0.05,
        gyroscope_bias=0.006,
        accelerometer=0.4,
        accelerometer_bias=0.1,
        fix=2e-2,
        compass=np.deg2rad(0.8),
        rotor=0.004,
        battery=0.012,
    ),
}
CAPTURE, TICK = 0.005, 0.002
"""Periods of motion capture and of the estimator [s]."""
FIX = 0.02
"""Between two position fixes of the estimator [s]."""
FOLLOW = 3.0
"""Bandwidth with which the estimator follows its position fixes [rad/s]."""
LEVEL = 0.5
"""And its attitude reference [rad/s]."""
CUTOFF = {"low": 90.0, "medium": 60.0, "high": 40.0}
"""Of the second-order low-pass before rates and specific force are logged [Hz]: it delays them by 2.5 to 5.6 ms."""


@dataclass(frozen=True)
class Estimate:
    """States on an even grid, (N, c, B) each."""

    period: float
    position: Array
    velocity: Array
    attitude: Array
    rates: Array


def product(a: Array, b: Array) -> Array:
    """Of quaternions wxyz (…, 4, B)."""
    aw, ax, ay, az = np.moveaxis(a, -2, 0)
    bw, bx, by, bz = np.moveaxis(b, -2, 0)
    return np.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        axis=-2,
    )


def small(angle: Array) -> Array:
    """The quaternion (…, 4, B) of a small rotation vector (…, 3, B)."""
    half = angle / 2
    real = np.sqrt(np.maximum(1 - (half**2).sum(-2, keepdims=True), 0))
    return np.concatenate([real, half], axis=-2)


def unit(quaternion: Array) -> Array:
    """At length one along the last axis but one."""
    return np.asarray(quaternion / np.sqrt((quaternion**2).sum(-2, keepdims=True)))


def capture(rng: np.random.Generator, truth: Truth, quality: Quality) -> Estimate:
    """Motion capture: white noise on the pose, velocity and rates from local cubics through it."""
    every = round(CAPTURE / DT)
    state = truth.state[::every]
    pose = state[:, P] + rng.normal(0, quality.position, state[:, P].shape)
    wobble = rng.normal(0, quality.attitude, state[:, P].shape)
    attitude = product(unit(state[:, Q]), small(wobble))
    jumps = np.sign((attitude[1:] * attitude[:-1]).sum(1))
    attitude[1:] *= np.cumprod(np.where(jumps == 0, 1, jumps), axis=0)[:, None]
    (position, velocity), (attitude, turning) = (
        [savgol_filter(x, quality.window, 3, deriv=d, delta=CAPTURE, axis=0) for d in (0, 1)] for x in (pose, attitude)
    )
    length = np.sqrt((attitude**2).sum(1, keepdims=True))
    attitude, turning = attitude / length, turning / length
    conjugate = attitude * np.array([1.0, -1.0, -1.0, -1.0])[:, None]
    return Estimate(CAPTURE, position, velocity, attitude, 2 * product(conjugate, turning)[:, 1:])


def inertial(rng: np.random.Generator, truth: Truth, quality: Quality) -> tuple[Array, Array]:
    """Gyroscope and accelerometer (N, 3, B) at every `TICK`, with white noise and a bias in each flight."""
    every = round(TICK / DT)
    out = []
    for true, noise, bias in (
        (truth.state[::every, W], quality.gyroscope, quality.gyroscope_bias),
        (truth.felt[::every], quality.accelerometer, quality.accelerometer_bias),
    ):
        out.append(true + rng.normal(0, noise, true.shape) + rng.normal(0, bias, true.shape[1:]))
    return out[0], out[1]


def low_pass(signal: Array, cutoff: float) -> Array:
    """Second-order Butterworth, causal, along the first axis; it starts settled."""
    b, a = butter(2, cutoff * 2 * TICK)
    return np.asarray(lfilter(b, a, signal - signal[:1], axis=0) + signal[:1])


def estimator(rng: np.random.Generator, truth: Truth, quality: Quality, gyroscope: Array, feels: Array) -> Estimate:
    """Constant-gain observers on inertial data: what flight controllers log as their state.

    Attitude follows the gyroscope and, slowly, a noisy reference, its bias estimated; velocity and position follow the
    accelerometer turned by that attitude and, slowly, position fixes. Their errors last for a second or so.
    """
    every, apart = round(TICK / DT), round(FIX / TICK)
    state = truth.state[::every]
    count, _, flights = state.shape
    reference = product(unit(state[:, Q]), small(rng.normal(0, quality.compass, (count, 3, flights))))
    fixes = state[:, P] + rng.normal(0, quality.fix, (count, 3, flights))
    attitude, position, velocity = (state[0, s].copy() for s in (Q, P, V))
    bias, felt_bias = np.zeros((3, flights)), np.zeros((3, flights))
    down = np.array([[0.0], [0.0], [GRAVITY]])
    sign = np.array([[1.0], [-1.0], [-1.0], [-1.0]])
    kept: list[tuple[Array, ...]] = []
    gain = TICK * LEVEL
    for k in range(count):
        kept.append((position, velocity, attitude))
        away = product(attitude * sign, reference[k])
        away = 2 * np.sign(away[:1]) * away[1:]
        bias = bias - gain * LEVEL / 4 * away
        attitude = unit(product(attitude, small(TICK * (gyroscope[k] - bias) + gain * away)))
        turn = rotation(attitude)
        push = (turn * (feels[k] - felt_bias)).sum(1) - down
        position = position + TICK * velocity + TICK**2 / 2 * push
        velocity = velocity + TICK * push
        if k % apart == apart - 1 and k + 1 < count:
            miss = fixes[k + 1] - position
            position = position + 2 * FOLLOW * FIX * miss
            velocity = velocity + 1.5 * FOLLOW**2 * FIX * miss
            felt_bias = felt_bias - 0.3 * FOLLOW**3 * FIX * (turn * miss[:, None]).sum(0)
    p, v, q = (np.stack(part) for part in zip(*kept, strict=True))
    return Estimate(TICK, p, v, q, gyroscope)
