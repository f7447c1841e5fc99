"""Recordings of a cart on a spring that carries something nobody measures: plain numpy, no code shared."""

import numpy as np
from swinging import FINE, RATE, recorded, smooth

from bench.diagnose.logs.subject import Subject
from registry.physics.oscillator import Oscillator

MASS, DAMPING, STIFFNESS = 2.0, 1.0, 20.0
"""Of the cart [kg], its damper [N s/m] and its spring [N/m]."""
LENGTH, HUNG, GRAVITY = 0.35, 0.3, 9.81
"""Of the pendulum under it [m], its bob [kg], and [m/s²]: it swings at .843 Hz with the cart held."""
SLOSH, SLOSH_DAMPING, SLOSHING = 1.6, 0.06, 0.4
"""Of a mass of liquid in a tank on the cart: how often it swings with the cart held [Hz], ζ, and its mass [kg]."""
SHAFT, SHAFT_DAMPING, SHAFT_SHARE = 7.5, 0.05, 0.3
"""Of a shaft between motor and cart: how often it swings [Hz], ζ, and what its swing takes of the force."""
CREEP, CREEPING = 0.4, 12.0
"""Time constant [s] and stiffness [N/m] of a spring with a damper in series, between cart and wall."""


def frequency_of(kind: str) -> float:
    """Of what is hidden [Hz]."""
    if kind in ("slosh", "shaft"):
        return SLOSH if kind == "slosh" else SHAFT
    return (GRAVITY / LENGTH) ** 0.5 / 2 / np.pi


def _rates(kind: str, x: np.ndarray, force: float) -> np.ndarray:
    """d/dt of cart position and speed, and of two hidden states, under a force on the cart."""
    q, v, a, b = x
    push = force - DAMPING * v - STIFFNESS * q
    if kind == "pendulum":  # Lagrange: angle a from below, its rate b, friction of the pivot
        s, c = np.sin(a), np.cos(a)
        pivot = 0.004 * b
        matrix = np.array([[MASS + HUNG, HUNG * LENGTH * c], [HUNG * LENGTH * c, HUNG * LENGTH**2]])
        forces = np.array([push + HUNG * LENGTH * s * b * b, -HUNG * GRAVITY * LENGTH * s - pivot])
        dv, db = np.linalg.solve(matrix, forces)
        return np.array([v, dv, b, db])
    if kind == "slosh":  # place a and speed b of the liquid's mass
        w = 2 * np.pi * SLOSH
        between = SLOSHING * (w * w * (q - a) + 2 * SLOSH_DAMPING * w * (v - b))
        return np.array([v, (push - between) / MASS, b, between / SLOSHING])
    if kind == "shaft":  # what it is wound up by, and how fast over ω
        w = 2 * np.pi * SHAFT
        return np.array([v, (push - SHAFT_SHARE * b) / MASS, w * b, w * (force - a - 2 * SHAFT_DAMPING * b)])
    if kind == "creep":  # a: where the damper's end has crept to
        pull = CREEPING * (q - a)
        return np.array([v, (push - pull) / MASS, (q - a) / CREEP, 0.0])
    if kind == "cubic":
        return np.array([v, (push - 2000.0 * q**3) / MASS, 0.0, 0.0])
    return np.array([v, push / MASS, 0.0, 0.0])


def recording(kind: str, seed: int, seconds: float, noise: float = 1e-3) -> tuple[np.ndarray, np.ndarray]:
    """Drive (N,) and state (N, 2), every 10 ms.

    ``kind``: "pendulum", "slosh", "shaft", "creep"; without anything hidden "clean", "gust" (a force that wanders),
    "wave" (one of .8 Hz), "cubic" (a spring that hardens), "sampled" (a drive that is livelier than its samples).
    """
    rng, count = np.random.default_rng(seed), round(seconds * RATE * FINE)
    dt = 1 / RATE / FINE
    drive = smooth(smooth(rng.normal(size=count), 0.03), 0.03) * 8
    if kind == "sampled":
        drive = smooth(rng.normal(size=count), 0.125) * 8
    other = np.zeros(count)
    if kind == "gust":
        share = 1 / (rng.uniform(0.3, 3) * RATE * FINE)
        other = smooth(rng.normal(size=count), share) * 0.5 / (share / 2) ** 0.5
    if kind == "wave":
        other = 0.15 * np.cos(2 * np.pi * 0.8 * np.arange(count) * dt + rng.uniform(-np.pi, np.pi))
    x, out = rng.normal(size=4) * [0.02, 0.05, 0.05, 0.15], np.empty((count, 2))
    for k in range(count):
        out[k] = x[:2]
        force = drive[k] + other[k]
        k1 = _rates(kind, x, force)
        k2 = _rates(kind, x + dt / 2 * k1, force)
        x = x + dt * _rates(kind, x + dt / 2 * k2, force)
    spread = np.random.default_rng(seed + 10**6).normal(size=out[::FINE].shape)
    return drive[::FINE], out[::FINE] + noise * out.std(0) * spread


def subject(kind: str, number: int, recordings: int = 6, seconds: float = 20.0, noise: float = 1e-3) -> Subject:
    """Recordings of a set of that number, the last third of them held out."""
    model = Oscillator(mass=MASS, damping=DAMPING, stiffness=STIFFNESS)
    return recorded("cart", model, [recording(kind, 1000 * number + i, seconds, noise) for i in range(recordings)])
