"""How much of a forecast's error each hidden effect makes: the true vehicle flown on without it, from true states."""

from collections.abc import Collection, Mapping

import numpy as np

from bench.score.chain.body import Body, Moment
from bench.score.chain.flight import DT, Truth

Array = np.ndarray
HORIZON, APART = 0.5, 0.5
"""Of a forecast, and between the starts of two [s]."""
_IN_AIR, _IN_MOTORS = "wind", ("motor_lag", "input_delay")


def shares(truth: Truth, body: Body, hidden: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
    """(E²_without it − E²_true) / (E²_without all that is hidden − E²_true), E² in units of each output's variance.

    Constants are the true ones: what they do is no effect. The true model does not know the gusts.
    """
    least = squared(truth, body, hidden, ())
    whole = squared(truth, body, hidden, tuple(hidden)) - least
    return {name: (squared(truth, body, hidden, (name,)) - least) / whole for name in hidden}


def squared(truth: Truth, body: Body, hidden: Mapping[str, Mapping[str, float]], removed: Collection[str]) -> float:
    """Mean square of the errors of velocity and body rates over forecasts that do without ``removed``."""
    steps = round(HORIZON / DT)
    starts = np.arange(0, len(truth.state) - steps - 1, round(APART / DT))
    k, b = (x.ravel() for x in np.meshgrid(starts, np.arange(truth.state.shape[2]), indexing="ij"))
    left = {name: values for name, values in body.effects.items() if name not in removed}
    model = Body(body.craft, left, body.charge[b])
    blown = body.effects.get(_IN_AIR, {}) if _IN_AIR not in removed else {}
    wind = np.array([[blown.get("w_x", 0.0)], [blown.get("w_y", 0.0)], [0.0]]) + np.zeros((3, len(k)))
    # Without lag and delay the rotors would turn as commanded.
    speeds = truth.command if any(name in removed for name in _IN_MOTORS) else truth.speed
    state = truth.state[k, : model.size, b].T
    scale = truth.state[:, [3, 4, 5, 10, 11, 12]].std(axis=(0, 2))[:, None]
    total = 0.0
    for j in range(steps):
        first, last = speeds[k + j, :, b].T, speeds[k + j + 1, :, b].T
        middle, spin = (first + last) / 2, (last - first) / DT
        moments = tuple(Moment((k + j) * DT + i * DT / 2, w, spin, wind) for i, w in enumerate((first, middle, last)))
        state = model.step(state, moments, DT)
        error = (state - truth.state[k + j + 1, : model.size, b].T)[[3, 4, 5, 10, 11, 12]] / scale
        total += float((error**2).mean())
    return total / steps
