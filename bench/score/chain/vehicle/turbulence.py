"""Gusts of the Dryden model, low altitude: MIL-F-8785C, section 3.7.3, as rational filters of white noise."""

import numpy as np
from scipy.interpolate import interp1d
from scipy.linalg import expm, solve_continuous_lyapunov

Array = np.ndarray
FOOT = 0.3048
STEP = 0.01
"""At which gusts are drawn; straight lines between [s]."""


def scales(height: float, wind: float) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Lengths (L_u, L_v, L_w) [m] and intensities (σ_u, σ_v, σ_w) [m/s] below 1000 feet.

    Args:
        height: over ground [m]; the model begins at 10 feet.
        wind: mean wind at 20 feet [m/s].
    """
    h = max(height / FOOT, 10.0)
    shape = 0.177 + 0.000823 * h
    horizontal, vertical = h / shape**1.2 * FOOT, h * FOOT
    across = 0.1 * wind
    along = across / shape**0.4
    return (horizontal, horizontal, vertical), (along, along, across)


def _filter(length: float, airspeed: float, second_order: bool) -> tuple[Array, Array]:
    """State matrix and output row of a gust filter whose output has unit variance under white noise on its last state.

    1/(1 + T s) along the wind, (1 + √3 T s)/(1 + T s)² across it, T = L/V.
    """
    time = length / airspeed
    if not second_order:
        a, c = np.array([[-1 / time]]), np.array([1.0])
    else:
        a, c = np.array([[0.0, 1.0], [-1 / time**2, -2 / time]]), np.array([1.0, np.sqrt(3) * time])
    drive = np.zeros_like(a)
    drive[-1, -1] = 1.0
    variance = c @ solve_continuous_lyapunov(a, -drive) @ c
    return a, c / np.sqrt(variance)


def _series(rng: np.random.Generator, a: Array, c: Array, samples: int, flights: int, dt: float) -> Array:
    """A stationary series (samples, flights) of the filter, exact at the samples."""
    n = len(a)
    drive = np.zeros_like(a)
    drive[-1, -1] = 1.0
    everlasting = solve_continuous_lyapunov(a, -drive)
    keep = expm(a * dt)
    kick = np.linalg.cholesky(everlasting - keep @ everlasting @ keep.T + 1e-15 * np.eye(n) * everlasting.max())
    state = np.linalg.cholesky(everlasting) @ rng.normal(size=(n, flights))
    noise, out = rng.normal(size=(samples, n, flights)), np.empty((samples, flights))
    for k in range(samples):
        out[k] = c @ state
        state = keep @ state + kick @ noise[k]
    return out


def gusts(rng: np.random.Generator, height: float, wind: float, seconds: float, flights: int, dt: float) -> Array:
    """Gusts (steps + 1, 3, flights) [m/s] along the mean wind, across it, and up.

    The vehicle flies slowly: the field is carried past it by the mean wind.
    """
    lengths, sigmas = scales(height, wind)
    samples = int(np.ceil(seconds / STEP)) + 2
    parts = []
    for axis, (length, sigma) in enumerate(zip(lengths, sigmas, strict=True)):
        a, c = _filter(length, max(wind, 1.0), axis > 0)
        parts.append(sigma * _series(rng, a, c, samples, flights, STEP))
    coarse = np.stack(parts, axis=1)
    fine = np.arange(round(seconds / dt) + 1) * dt
    return np.asarray(interp1d(np.arange(samples) * STEP, coarse, axis=0)(fine))
