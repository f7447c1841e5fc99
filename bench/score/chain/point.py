"""Another point of the body than its centre of gravity, whose motion is recorded."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from bench.score.chain.flight import DT, Truth
from bench.score.chain.vehicle.body import P, Q, V, W, cross, rotation

Array = np.ndarray


def arm(effects: Mapping[str, Mapping[str, float]]) -> Array | None:
    """Of the recorded point (3, 1) [m], from the centre of gravity along the body's axes; None: it is there."""
    found = effects.get("recorded_point")
    return None if found is None else np.array([[found[axis]] for axis in "xyz"])


def moved(state: Array, by: Array | None) -> Array:
    """States (size, B) with position and velocity of the point that lies ``by`` (3, 1) from theirs."""
    if by is None:
        return state
    turn, out = rotation(state[Q]), state.copy()
    out[P] += (turn * by).sum(1)
    out[V] += (turn * cross(state[W], np.broadcast_to(by, state[W].shape))).sum(1)
    return out


def recorded(truth: Truth, by: Array | None) -> Truth:
    """The flights as sensors at that point know them: its position, velocity and specific force."""
    if by is None:
        return truth
    count, _, flights = truth.state.shape

    def flat(x: Array) -> Array:
        return np.moveaxis(x, 0, 1).reshape(x.shape[1], -1)

    def back(x: Array) -> Array:
        return np.moveaxis(x.reshape(len(x), count, flights), 1, 0)

    rates, turning = flat(truth.state[:, W]), flat(np.gradient(truth.state[:, W], DT, axis=0))
    at = np.broadcast_to(by, rates.shape)
    felt = flat(truth.felt) + cross(turning, at) + cross(rates, cross(rates, at))
    return replace(truth, state=back(moved(flat(truth.state), by)), felt=back(felt))
