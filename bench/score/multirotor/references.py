"""Where the pilot wants to fly: random smooth paths, one generator a flight."""

import numpy as np

Array = np.ndarray


def _waves(rng: np.random.Generator, t: Array, speed: float, slow: float, fast: float) -> Array:
    """Position and two derivatives (3, N) of three sines between ``slow`` and ``fast`` [rad/s], peak ``speed``."""
    out = np.zeros((3, len(t)))
    for low, high, share in ((slow, (slow * fast) ** 0.5, 0.55), ((slow * fast) ** 0.5, fast, 0.3), (fast, fast, 0.15)):
        w, phase = rng.uniform(low, high) * rng.uniform(0.9, 1.1), rng.uniform(0, 2 * np.pi)
        a = share * speed * rng.uniform(0.7, 1.2) / w
        s, c = np.sin(w * t + phase), np.cos(w * t + phase)
        out += a * np.array([s, w * c, -w * w * s])
    return out


def _legs(
    rng: np.random.Generator, t: Array, low: float, high: float, quick: float, rest: tuple[float, float]
) -> Array:
    """Position and two derivatives (3, N) of jumps between set-points, through four equal lags of rate ``quick``."""
    dt = t[1] - t[0]
    target, filled, goal = np.empty(len(t)), 0, rng.uniform(low, high)
    start = goal
    while filled < len(t):
        hold = max(1, round(rng.uniform(*rest) / dt))
        target[filled : filled + hold] = goal
        filled, goal = filled + hold, rng.uniform(low, high)
    stages, keep = [target], np.exp(-quick * dt)
    for _ in range(4):
        out, value = np.empty(len(t)), start
        for k, x in enumerate(stages[-1].tolist()):
            value = x + (value - x) * keep
            out[k] = value
        stages.append(out)
    _, _, b, c, d = stages
    return np.array([d, quick * (c - d), quick**2 * (b - 2 * c + d)])


def _heights(rng: np.random.Generator, t: Array, low: float, high: float, quick: float) -> Array:
    """Height and two derivatives (3, N): quintic legs up to the speed ``quick``, a third to just over ``low``."""
    out, now, height = np.zeros((3, len(t))), rng.uniform(0.0, 2.0), rng.uniform(low, high)
    out[0] = height
    while now < t[-1]:
        target = low * rng.uniform(1, 1.3) if rng.random() < 0.35 else rng.uniform(low, high)
        rise, pace = target - height, quick * rng.uniform(0.6, 1.0)
        length = max(0.8, 1.9 * abs(rise) / pace, (6.0 * abs(rise) / quick) ** 0.5)
        s = np.clip((t - now) / length, 0, 1)
        out[0] += rise * s**3 * (10 - 15 * s + 6 * s**2)
        out[1] += rise / length * 30 * s**2 * (1 - s) ** 2
        out[2] += rise / length**2 * 60 * s * (1 - s) * (1 - 2 * s)
        now, height = now + length + rng.uniform(0.3, 1.5), target
    return out


def reference(rng: np.random.Generator, style: str, seconds: float, dt: float, lowest: float) -> Array:
    """Position, velocity, acceleration, yaw and yaw rate (N, 11) for ``seconds``, never below ``lowest`` [m]."""
    t = np.arange(round(seconds / dt) + 1) * dt
    if style == "hover":
        x, y = (_waves(rng, t, 0.04, 0.4, 1.5) for _ in range(2))
        z = _waves(rng, t, 0.03, 0.4, 1.5)
        z[0] += rng.uniform(1.0, 2.0)
        yaw = _waves(rng, t, 0.03, 0.3, 1.0)
    elif style == "gentle":
        x, y = (_waves(rng, t, rng.uniform(0.3, 0.8), 0.4, 1.5) for _ in range(2))
        z = _heights(rng, t, lowest, 2.0, 0.6)
        yaw = _waves(rng, t, 0.4, 0.3, 1.0)
    else:
        if rng.random() < 0.5:
            x, y = (_waves(rng, t, rng.uniform(1.8, 3.5), 0.6, 3.5) for _ in range(2))
        else:
            x, y = (_legs(rng, t, -3.0, 3.0, rng.uniform(2.0, 2.7), (1.2, 3.0)) for _ in range(2))
        z = _heights(rng, t, lowest, 7.0, 3.5)
        yaw = _waves(rng, t, 1.6, 0.5, 2.5)
    return np.stack([x[0], y[0], z[0], x[1], y[1], z[1], x[2], y[2], z[2], yaw[0], yaw[1]], axis=1)
