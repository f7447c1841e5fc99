"""The logger: samples at its own rate, with a clock that is even, uneven but told, or uneven and not told."""

from dataclasses import dataclass, replace

import numpy as np

from bench.score.chain import sensors
from bench.score.chain.flight import DT, Truth
from bench.score.chain.sensors import CUTOFF, QUALITIES, TICK, Estimate
from bench.score.chain.vehicle.body import Body

Array = np.ndarray
CLOCKS = ("even", "stamped", "hidden")
"""Samples at even times; at uneven ones, filed with those times; at uneven ones, filed as if they were even."""


@dataclass(frozen=True)
class Logging:
    """How a flight is logged."""

    rate: float
    """[Hz]."""
    states: str
    """"capture" (motion capture) or "estimator"."""
    quality: str
    """Of `sensors.QUALITIES`."""
    clock: str
    """Of `CLOCKS`."""
    jitter: float
    """Greatest displacement of a sample, in sampling periods; below .2, so that no reader takes it for a gap."""
    telemetry: float
    """By which rotor speeds arrive late [s]."""
    accelerometer: bool
    battery: bool


@dataclass(frozen=True)
class Observed:
    """What the sensors and the estimator say, each on an even grid; flights along the last axis."""

    states: Estimate
    felt: Array | None
    """Specific force (N, 3, B) at every `TICK`."""
    volts: Array | None
    """Of a battery cell, at every step (N, B)."""


def observe(rng: np.random.Generator, truth: Truth, body: Body, how: Logging) -> Observed:
    """What is known of the flights on board or in the laboratory, before it is sampled for the log."""
    quality, cut = QUALITIES[how.quality], CUTOFF[how.quality]
    gyroscope, feels = sensors.inertial(rng, truth, quality)
    if how.states == "capture":
        states = sensors.capture(rng, truth, quality)
    else:
        states = sensors.estimator(rng, truth, quality, gyroscope, feels)
        states = replace(states, rates=sensors.low_pass(states.rates, cut))
    volts = np.stack([body.volts(k * DT, x) for k, x in enumerate(truth.speed)]) if how.battery else None
    return Observed(states, sensors.low_pass(feels, cut) if how.accelerometer else None, volts)


def record(
    rng: np.random.Generator, truth: Truth, body: Body, how: Logging, observed: Observed
) -> list[dict[str, Array]]:
    """The columns of each flight's log.

    Returns:
        t (N,), position (N, 3), attitude xyzw (N, 4), velocity (N, 3) in the world frame, body_rates (N, 3),
        rotor_speed (N, 4), rotor_command (N, 4); battery (N,) and specific_force (N, 3) where they are logged.
    """
    quality, states, felt, volts = QUALITIES[how.quality], observed.states, observed.felt, observed.volts
    end, margin = (len(truth.state) - 1) * DT, 0.02
    grid = np.arange(int((end - 2 * margin) * how.rate)) / how.rate
    logs = []
    for i in range(truth.state.shape[2]):
        moved = rng.uniform(-how.jitter, how.jitter, len(grid)) / how.rate if how.clock != "even" else 0.0
        when = margin + grid + moved
        at, late = _Reader(states.period, when), _Reader(DT, when - how.telemetry)
        hover = body.craft.hover
        quaternion = at(states.attitude[..., i])
        quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
        held = truth.command[np.floor(when / DT + 1e-6).astype(int), :, i]
        log = {
            "t": grid + (moved if how.clock == "stamped" else 0.0),
            "position": at(states.position[..., i]),
            "attitude": quaternion[:, [1, 2, 3, 0]],
            "velocity": at(states.velocity[..., i]),
            "body_rates": at(states.rates[..., i]),
            "rotor_speed": late(truth.speed[..., i]) + rng.normal(0, quality.rotor * hover, (len(grid), 4)),
            "rotor_command": held,
        }
        if volts is not None:
            log["battery"] = _Reader(DT, when)(volts[:, None, i])[:, 0] + rng.normal(0, quality.battery, len(grid))
        if felt is not None:
            log["specific_force"] = _Reader(TICK, when)(felt[..., i])
        log["t"] = log["t"] - log["t"][0]
        logs.append(log)
    return logs


class _Reader:
    """Straight lines between samples (N, c) of one period, read at other times."""

    def __init__(self, period: float, when: Array) -> None:
        self.whole = np.floor(when / period + 1e-9).astype(int)
        self.part = (when / period - self.whole)[:, None]

    def __call__(self, series: Array) -> Array:
        first = np.clip(self.whole, 0, len(series) - 2)
        return np.asarray(series[first] * (1 - self.part) + series[first + 1] * self.part)
