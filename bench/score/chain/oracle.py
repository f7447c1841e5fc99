"""How much of a forecast's error each hidden effect makes: the true vehicle flown on without it."""

from collections.abc import Collection, Mapping

import numpy as np

from bench.score.chain import point
from bench.score.chain.flight import DT, Truth
from bench.score.chain.sensors import Estimate
from bench.score.chain.vehicle.body import Body, P, Q, V, W, moments

Array = np.ndarray
HORIZON, APART = 0.5, 0.5
"""Of a forecast, and between the starts of two [s]."""
_IN_AIR, _IN_MOTORS = "wind", ("motor_lag", "input_delay")


def shares(truth: Truth, known: Estimate, body: Body, hidden: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
    """(E²_without it − E²_true) / E²_without all that is hidden, E² in units of each output's variance.

    Constants are the true ones: what they do is no effect. Forecasts begin where the sensors see the vehicle and know
    nothing of gusts, so that an effect that drowns in noise or in turbulence has a small share even if it is alone.
    """
    least = squared(truth, known, body, ())
    whole = squared(truth, known, body, tuple(hidden))
    return {name: (squared(truth, known, body, (name,)) - least) / whole for name in hidden}


def squared(truth: Truth, known: Estimate, body: Body, removed: Collection[str]) -> float:
    """Mean square of the errors of velocity and body rates over forecasts that do without ``removed``."""
    steps = round(HORIZON / DT)
    # Not at the very beginning, where filters settle.
    starts = np.arange(round(APART / DT), len(truth.state) - steps - 1, round(APART / DT))
    k, b = (x.ravel() for x in np.meshgrid(starts, np.arange(truth.state.shape[2]), indexing="ij"))
    left = {name: values for name, values in body.effects.items() if name not in removed}
    here, seen_at = (point.arm(effects) for effects in (left, body.effects))
    model = Body(body.craft, left, body.charge[b])
    blown = body.effects.get(_IN_AIR, {}) if _IN_AIR not in removed else {}
    wind = np.array([[blown.get("w_x", 0.0)], [blown.get("w_y", 0.0)], [0.0]]) + np.zeros((3, len(k)))
    # Without lag and delay the rotors would turn as commanded.
    speeds = truth.command if any(name in removed for name in _IN_MOTORS) else truth.speed
    state = truth.state[k, : model.size, b].T.copy()
    at = np.round(k * DT / known.period).astype(int)
    for rows, seen in ((P, known.position), (V, known.velocity), (Q, known.attitude), (W, known.rates)):
        state[rows] = seen[at, :, b].T
    state[Q] /= np.sqrt((state[Q] ** 2).sum(0))
    state = point.moved(state, None if here is None else -here)
    scale = truth.state[:, [3, 4, 5, 10, 11, 12]].std(axis=(0, 2))[:, None]
    total = 0.0
    for j in range(steps):
        first, last = speeds[k + j, :, b].T, speeds[k + j + 1, :, b].T
        middle, spin = (first + last) / 2, (last - first) / DT
        during = moments((k + j) * DT, (first, middle, last), [spin] * 3, [wind] * 3, DT)
        state = model.step(state, during, DT)
        ends = point.moved(truth.state[k + j + 1, : model.size, b].T, seen_at)
        error = (point.moved(state, here) - ends)[[3, 4, 5, 10, 11, 12]] / scale
        total += float((error**2).mean())
    return total / steps
