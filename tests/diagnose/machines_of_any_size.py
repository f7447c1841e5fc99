"""Recordings of a cart on a spring, or a shaft, with something hidden: plain numpy, no code shared."""

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np

from bench.diagnose.logs.subject import Subject, log_of
from registry.contracts import Channel, Recording
from registry.dynamics import PhysicsModel
from registry.physics.oscillator import Oscillator

RATE, FINE, SAMPLES = 100.0, 10, 900
MASS, DAMPING, STIFFNESS = 2.0, 6.0, 300.0
LARGEST = 25.0
"""Of the drive [N]."""
LOOP = {"alpha": 150.0, "beta": 18.0, "delta": 0.8}
"""Of the hysteresis, with γ = .8 and ν = 1."""
Array = np.ndarray


def dead_zone(u: Array) -> Array:
    """Nothing below 4 N."""
    return np.sign(u) * np.maximum(np.abs(u) - 4.0, 0.0)


def saturation(u: Array) -> Array:
    """No more than 12.5 N."""
    return np.clip(u, -12.5, 12.5)


def square(u: Array) -> Array:
    """With the square of the drive, as much as the drive itself at 17.5 N."""
    return u * np.abs(u) / 17.5


def backlash(u: Array) -> Array:
    """Half a play of 3 N."""
    out, now = np.empty_like(u), u[0]
    for i, x in enumerate(u):
        out[i] = now = max(x - 3.0, min(x + 3.0, now))
    return out


def lag(u: Array) -> Array:
    """Behind it by a time constant of 40 ms."""
    keeps = np.exp(-1 / RATE / FINE / 0.04)
    out, now = np.empty_like(u), u[0]
    out[0] = now
    for i, (before, after) in enumerate(pairwise(u), start=1):
        out[i] = now = keeps * now + (1 - keeps) * (before + after) / 2
    return out


def recording(seed: int, drive: Callable[[Array], Array], loop: bool, noise: float) -> tuple[Array, Array]:
    """Drive (N,) [N], straight between samples, and state (N, 2) [m], [m/s] of a cart, by Heun's method."""
    rng = np.random.default_rng(seed)
    t = np.arange(SAMPLES) / RATE
    u = np.sin(2 * np.pi * np.geomspace(0.3, 3.0, 8) * t[:, None] + rng.uniform(0, 2 * np.pi, 8)).sum(1)
    u *= LARGEST / np.abs(u).max()
    acting = drive(np.interp(np.arange((SAMPLES - 1) * FINE + 1) / FINE, np.arange(SAMPLES), u))
    x, h, out = np.array([*rng.normal(size=2) * (0.02, 0.2), 0.0]), 1 / RATE / FINE, []

    def rate(x: Array, force: float) -> Array:
        q, v, z = x
        own = LOOP["beta"] * (0.8 * abs(v) * z + LOOP["delta"] * v * abs(z))
        push = force - DAMPING * v - STIFFNESS * q - (LOOP["alpha"] * z if loop else 0.0)
        return np.array([v, push / MASS, v - own])

    for before, after in pairwise(acting):
        out.append(x)
        slope = rate(x, before)
        x = x + h / 2 * (slope + rate(x + h * slope, after))
    path = np.array([*out, x])[::FINE, :2]
    return u, path + rng.normal(size=path.shape) * noise * path.std(0)


def delay(u: Array) -> Array:
    """Behind it by a dead time of 90 ms."""
    at = np.arange(len(u)) / RATE / FINE
    return np.asarray(np.interp(at - 0.09, at, u))


def cart(
    drive: Callable[[Array], Array],
    loop: bool = False,
    length: float = 1.0,
    force: float = 1.0,
    noise: float = 2e-3,
    time: float = 1.0,
) -> Subject:
    """Four recordings, the last one held out, of a cart as large, as strong and as slow by these factors."""
    inertia, resistance, spring = (c * force / length for c in (MASS, DAMPING, STIFFNESS))
    model = Oscillator(inertia * time**2, resistance * time, spring)
    runs = [recording(seed, drive, loop, noise) for seed in range(4)]
    runs = [(force * u, length * x / np.array([1.0, time])) for u, x in runs]
    return recorded(model, runs, Channel("force", "N"), RATE / time)


def recorded(
    model: PhysicsModel, runs: list[tuple[Array, Array]], drive: Channel, rate: float = RATE, **more: Any
) -> Subject:
    """A subject of drives (N,) and states (N, s), the last of them held out."""
    logs = []
    for i, (u, x) in enumerate(runs):
        channels = model.state_channels[: x.shape[1]]
        made = Recording(f"run_{i}", rate, u[:, None], x, (drive,), channels, np.ones(len(x), bool))
        logs.append(log_of(made, model, drive.name))
    names = tuple(log.name for log in logs)
    signals = (*(c.group for c in logs[0].recording.channels[1:]), drive.name)
    return Subject("machine", model, tuple(logs), names[:-1], names[-1:], signals=signals, **more)
