"""Flights: pilot, motors, body and air together, a thousand steps a second."""

from dataclasses import dataclass, fields

import numpy as np

from bench.score.chain.pilot import Pilot, gains
from bench.score.chain.vehicle.airframe import Airframe
from bench.score.chain.vehicle.body import Body, Moment, W, moments
from bench.score.chain.vehicle.motors import Motors

Array = np.ndarray
DT = 0.001
"""Of the integration [s]."""
BEFORE = 3.0
"""Flown before the log begins [s]."""
GYROSCOPE = 0.02
"""1σ of the body rates that the pilot feels [rad/s]: it makes rotor speeds restless between samples."""


@dataclass(frozen=True)
class Truth:
    """What happened, at every step from the beginning of the log; flights along the last axis."""

    state: Array
    """(N, size, B)."""
    speed: Array
    """(N, 4, B) [rad/s]."""
    spin: Array
    """Its time derivative (N, 4, B)."""
    command: Array
    """Held at each step (N, 4, B) [rad/s]."""
    wind: Array
    """(N, 3, B) [m/s]."""
    felt: Array
    """Specific force, body frame (N, 3, B) [m/s²]."""

    def exchanged(self, these: Array, other: "Truth") -> "Truth":
        """With the flights that a mask (B,) is true of as ``other`` has them."""
        return Truth(*(np.where(these, getattr(other, f.name), getattr(self, f.name)) for f in fields(self)))


def fly(
    rng: np.random.Generator, body: Body, craft: Airframe, motors: Motors, period: float, wanted: Array, wind: Array
) -> Truth:
    """Fly the paths ``wanted`` (11, steps + 1, B) through ``wind`` (steps + 1, 3, B).

    Args:
        rng: draws the noise of the pilot's gyroscope.
        body: what really flies.
        craft: what the pilot was tuned with, beside the rotors' inertia, without which yaw would not be flown.
        motors: between commands and rotor speeds.
        period: between the pilot's ticks, whole steps [s].
        wanted: rows as `paths.path` gives them.
        wind: at every step.
    """
    steps, flights = wanted.shape[1] - 1, wanted.shape[2]
    every, skipped, late = round(period / DT), round(BEFORE / DT), round(motors.delay / DT)
    inertia = body.effects.get("rotor_reaction_torque", {}).get("rotor_inertia", 0.0)
    lead = inertia / (2 * craft.drag * craft.hover)
    pilot = Pilot(craft, gains(motors.slowest, period, lead), period, flights)
    state = np.zeros((body.size, flights))
    state[0:3] = wanted[0:3, 0]
    state[6], state[9] = np.cos(wanted[9, 0] / 2), np.sin(wanted[9, 0] / 2)
    speed = np.full((4, flights), craft.hover)
    held = [speed] * (late + 1)
    noise = rng.normal(0, GYROSCOPE, (steps // every + 1, 3, flights))
    kept: list[tuple[Array, ...]] = []
    for k in range(steps):
        if k % every == 0:
            held.append(pilot.command(state, state[W] + noise[k // every], wanted[:, k]))
        else:
            held.append(held[-1])
        command = held[-1 - late]
        speeds, spins = motors.step(speed, command, DT)
        t, blows = (k - skipped) * DT, (wind[k], (wind[k] + wind[k + 1]) / 2, wind[k + 1])
        if k >= skipped:
            kept.append((state, speeds[0], spins[0], held[-1], wind[k]))
        state = body.step(state, moments(t, speeds, spins, blows, DT), DT)
        speed = speeds[2]
    states, turning, spin, commands, air = (np.stack(part) for part in zip(*kept, strict=True))
    return Truth(states, turning, spin, commands, air, _felt(body, states, turning, spin, air))


def _felt(body: Body, states: Array, speed: Array, spin: Array, wind: Array) -> Array:
    """Specific force at every step (N, 3, B), all of them at once."""
    count, _, flights = states.shape

    def flat(x: Array) -> Array:
        return np.moveaxis(x, 0, 1).reshape(x.shape[1], -1)

    t = np.repeat(np.arange(count) * DT, flights)
    whole = Body(body.craft, body.effects, np.tile(body.charge, count))
    felt = whole.specific_force(flat(states), Moment(t, flat(speed), flat(spin), flat(wind)))
    return np.moveaxis(felt.reshape(3, count, flights), 1, 0)
