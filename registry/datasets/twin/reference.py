"""What the simulated pilots try to fly: random references, one generator a flight."""

from dataclasses import dataclass

import numpy as np

DT = 0.01
"""Sampling period of the twins [s]: 100 Hz, as the published recordings."""
REGIMES = ("hover", "slight", "moderate", "aggressive")


@dataclass(frozen=True)
class Legs:
    """How one coordinate travels from set-point to set-point: bang, cruise, bang, rest."""

    low: float
    high: float
    """Where set-points lie [m or rad]."""
    speed: float
    """Fastest leg [m/s or rad/s]."""
    rise: float
    fall: float
    """Largest acceleration up and down [m/s² or rad/s²]."""
    rest: float
    """Mean rest between legs [s]."""


def path(rng: np.random.Generator, legs: Legs, samples: int) -> np.ndarray:
    """Position, velocity and acceleration (samples, 3) of one coordinate that travels by ``legs``."""
    start = position = rng.uniform(legs.low, legs.high)
    pulses: list[np.ndarray] = [np.zeros(100)]
    length = 100
    while length < samples:
        target = rng.uniform(legs.low, legs.high)
        distance, sign = abs(target - position), np.sign(target - position)
        first, second = (legs.rise, legs.fall) if sign > 0 else (legs.fall, legs.rise)
        per_speed = 0.5 / first + 0.5 / second  # speeding up and slowing down takes v² of this
        speed = min(legs.speed * rng.uniform(0.5, 1.0), np.sqrt(distance / per_speed))
        n_first, n_second = (max(1, round(speed / a / DT)) for a in (first, second))
        cruise = max(0, round((distance / speed - speed * per_speed) / DT)) if speed > 0 else 0
        rest = round(rng.exponential(legs.rest) / DT)
        speed *= sign
        pulses += [
            np.full(n_first, speed / (n_first * DT)),
            np.zeros(cruise),
            np.full(n_second, -speed / (n_second * DT)),
            np.zeros(rest),
        ]
        position += speed * DT * (n_first / 2 + cruise + n_second / 2)
        length += n_first + cruise + n_second + rest
    jerk_limit = 15  # samples of moving mean: an attitude cannot jump
    acceleration = np.convolve(np.concatenate(pulses), np.full(jerk_limit, 1 / jerk_limit))[:samples]
    velocity = np.cumsum(acceleration) * DT
    return np.stack([start + np.cumsum(velocity) * DT, velocity, acceleration], axis=1)


def doublets(
    rng: np.random.Generator, samples: int, amplitude: float, period: tuple[float, float], pause: float
) -> np.ndarray:
    """Single sine periods (samples,) of random size and length [s], ``pause`` [s] apart in the mean."""
    signal, at = np.zeros(samples), round((1 + rng.exponential(pause)) / DT)
    while at < samples:
        n = round(rng.uniform(*period) / DT)
        wave = amplitude * rng.uniform(0.5, 1.0) * rng.choice((-1.0, 1.0)) * np.sin(2 * np.pi * np.arange(n) / n)
        signal[at : at + n] = wave[: samples - at]
        at += n + round((0.3 + rng.exponential(pause)) / DT)
    return signal


def slow_error(rng: np.random.Generator, samples: int, bound: float, channels: int) -> np.ndarray:
    """A wandering error (samples, channels) within ±``bound``: sines of 8 to 60 s."""
    weight = rng.dirichlet(np.ones(3), channels)
    omega = 2 * np.pi / rng.uniform(8, 60, (channels, 3))
    phase = rng.uniform(0, 2 * np.pi, (channels, 3))
    t = np.arange(samples)[:, None, None] * DT
    return bound * (weight * np.sin(omega * t + phase)).sum(-1)


def pad(arrays: list[np.ndarray]) -> np.ndarray:
    """Flights (N_i, c) of different length as one (N_max, flights, c): the last sample is repeated."""
    longest = max(len(a) for a in arrays)
    return np.stack([np.concatenate([a, np.repeat(a[-1:], longest - len(a), axis=0)]) for a in arrays], axis=1)
