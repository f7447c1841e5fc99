"""Where the pilot is asked to fly: way-points, circles, figures of eight, sums of sines, each with a yaw of its own."""

from dataclasses import dataclass, replace

import numpy as np

Array = np.ndarray
AGILE = 6.0
"""Bandwidth of an attitude loop that can follow any of the manners [1/s]."""
KINDS = ("sines", "waypoints", "circle", "lemniscate")


@dataclass(frozen=True)
class Manner:
    """How a vehicle is flown."""

    speed: float
    """Horizontal, about the greatest [m/s]."""
    acceleration: float
    """About the greatest [m/s²]."""
    climb: float
    """[m/s]."""
    yaw: float
    """Amplitude of the yaw rate [rad/s]."""


MANNERS = {
    "gentle": Manner(0.9, 1.2, 0.5, 0.4),
    "brisk": Manner(2.5, 3.5, 1.2, 1.0),
    "aggressive": Manner(4.5, 7.0, 2.2, 1.8),
}


def eased(manner: Manner, bandwidth: float) -> Manner:
    """What a vehicle can follow whose attitude loop has this bandwidth [1/s]: slow ones are asked for less."""
    return replace(manner, acceleration=manner.acceleration * min(1.0, bandwidth / AGILE))


def path(rng: np.random.Generator, kind: str, manner: Manner, lowest: float, seconds: float, dt: float) -> Array:
    """Position (3), velocity (3), acceleration (3), yaw and yaw rate as rows (11, N) from a start at rest."""
    t = np.arange(round(seconds / dt) + 1) * dt
    x, y = {"sines": _sines, "waypoints": _waypoints, "circle": _circle, "lemniscate": _lemniscate}[kind](
        rng, manner, t
    )
    z = _heights(rng, manner, lowest, t)
    begin = _ramp(t, 2.0)
    xyz = np.stack([_faded(x, begin), _faded(y, begin), z], axis=1)  # (3 derivatives, 3 axes, N)
    return np.concatenate([xyz.reshape(9, -1), _yaw(rng, manner, t)])


def _ramp(t: Array, length: float) -> Array:
    """A smooth step from 0 to 1 over ``length`` and two derivatives (3, N)."""
    s = np.clip(t / length, 0, 1)
    return np.stack(
        [s**3 * (10 - 15 * s + 6 * s**2), 30 * s**2 * (1 - s) ** 2 / length, 60 * s * (1 - s) * (1 - 2 * s) / length**2]
    )


def _faded(wave: Array, begin: Array) -> Array:
    """``wave`` from its first point on, times ``begin``, with the derivatives of the product."""
    (f, f1, f2), (g, g1, g2) = wave, begin
    f = f - f[0]
    return np.stack([f * g, f1 * g + f * g1, f2 * g + 2 * f1 * g1 + f * g2])


def _sine(amplitude: float, rate: float, phase: float, t: Array) -> Array:
    s, c = np.sin(rate * t + phase), np.cos(rate * t + phase)
    return amplitude * np.stack([s, rate * c, -(rate**2) * s])


def _sines(rng: np.random.Generator, manner: Manner, t: Array) -> tuple[Array, Array]:
    def axis() -> Array:
        shares = rng.dirichlet(np.full(4, 3.0))
        top = manner.acceleration / manner.speed
        rates = top * np.array([0.25, 0.5, 0.9, 1.5]) * rng.uniform(0.8, 1.2, 4)
        pieces = zip(shares, rates, strict=True)
        return np.sum([_sine(s * manner.speed / r, r, rng.uniform(0, 2 * np.pi), t) for s, r in pieces], axis=0)

    return axis(), axis()


def _circle(rng: np.random.Generator, manner: Manner, t: Array) -> tuple[Array, Array]:
    """Round and round, faster and slower."""
    speed, acceleration = manner.speed * rng.uniform(0.7, 1), manner.acceleration * rng.uniform(0.5, 0.8)
    radius, way = speed**2 / acceleration, rng.choice([-1.0, 1.0])
    rate = speed / radius
    wobble = _sine(0.15 * rate / 0.5, 0.5 * rng.uniform(0.7, 1.3), rng.uniform(0, 2 * np.pi), t)
    angle = way * (rate * t + wobble[0]) + rng.uniform(0, 2 * np.pi)
    turn, slew = way * (rate + wobble[1]), way * wobble[2]
    c, s = np.cos(angle), np.sin(angle)
    x = np.stack([c, -turn * s, -slew * s - turn**2 * c])
    y = np.stack([s, turn * c, slew * c - turn**2 * s])
    return radius * x, radius * y


def _lemniscate(rng: np.random.Generator, manner: Manner, t: Array) -> tuple[Array, Array]:
    speed, acceleration = manner.speed * rng.uniform(0.7, 1), manner.acceleration * rng.uniform(0.6, 1)
    rate = acceleration / speed / 1.6
    size, heading = speed / rate / 1.2, rng.uniform(0, 2 * np.pi)
    along, across = _sine(size, rate, 0.0, t), _sine(size / 2, 2 * rate, 0.0, t)
    c, s = np.cos(heading), np.sin(heading)
    return c * along - s * across, s * along + c * across


def _waypoints(rng: np.random.Generator, manner: Manner, t: Array) -> tuple[Array, Array]:
    """Hops of quintic profile with rests between."""
    out, now, here = np.zeros((2, 3, len(t))), 0.5, np.zeros(2)
    while now < t[-1]:
        target = rng.uniform(-1, 1, 2) * manner.speed * 0.9
        far = float(np.linalg.norm(target - here))
        pace = rng.uniform(0.6, 1.0)
        length = max(1.88 * far / (manner.speed * pace), np.sqrt(5.8 * far / (manner.acceleration * pace)), 0.4)
        hop = _ramp(t - now, length)
        out += (target - here)[:, None, None] * hop
        now, here = now + length + rng.uniform(0.0, 0.8), target
    return out[0], out[1]


def _heights(rng: np.random.Generator, manner: Manner, lowest: float, t: Array) -> Array:
    """Climbs and descents (3, N), a third of them down to just over ``lowest`` and along there for a while."""
    out, now, here = np.zeros((3, len(t))), rng.uniform(0.5, 2.0), lowest + rng.uniform(0.5, 1.5)
    out[0] = here
    while now < t[-1]:
        low = rng.random() < 1 / 3
        target = lowest * rng.uniform(1.0, 1.3) if low else lowest + rng.uniform(0.3, 1.0) * 2.5 * manner.climb
        pace = manner.climb * rng.uniform(0.6, 1.0)
        far = abs(target - here)
        length = max(1.88 * far / pace, np.sqrt(5.8 * far / (3 * manner.climb)), 0.6)
        out += (target - here) * _ramp(t - now, length)
        now, here = now + length + rng.uniform(0.2, 1.8 if low else 0.8), target
    return out


def _yaw(rng: np.random.Generator, manner: Manner, t: Array) -> Array:
    """Yaw and its rate (2, N): still, swinging, or turning on and on."""
    kind = rng.integers(3)
    start = rng.uniform(-np.pi, np.pi)
    if kind == 0:
        wave = np.zeros((3, len(t)))
    elif kind == 1:
        rates = rng.uniform(0.5, 2.5, 2)
        wave = np.sum([_sine(manner.yaw / 2 / r, r, rng.uniform(0, 2 * np.pi), t) for r in rates], axis=0)
    else:
        pace = 0.5 * manner.yaw * rng.choice([-1, 1])
        wave = np.stack([pace * t, np.full(len(t), pace), np.zeros(len(t))])
    wave = _faded(wave, _ramp(t, 2.0))
    return np.stack([start + wave[0], wave[1]])
