"""RotorPy's multirotor and its SE3 controller, many flights side by side.

RotorPy integrates one flight with `scipy.integrate.solve_ivp`, some 1.3 ms a step, nearly all of it overhead of small
arrays. Here the flights of one vehicle lie along the last axis, B of them, and the motors are solved exactly
between commands; what is integrated is RotorPy's own equation (Folk, Paulos, Kumar: RotorPy, 2023).
"""

from dataclasses import dataclass

import numpy as np
from rotorpy.controllers.quadrotor_control import SE3Control
from rotorpy.vehicles.multirotor import Multirotor

Array = np.ndarray

STEP = 0.005
"""Step of the integration [s]."""
RATE = 100.0
"""Of the log [Hz]."""
EVERY = round(1 / (RATE * STEP))
"""Integration steps a logged sample."""
WARM_UP = 3.0
"""Flown before the log begins [s]."""


def cross(a: Array, b: Array) -> Array:
    """Cross product of (3, …) and (3, …)."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def rotation(attitude: Array) -> Array:
    """Rotation matrices (3, 3, B), body to world, of quaternions xyzw (4, B), which need not be of unit length."""
    x, y, z, w = attitude / np.sqrt((attitude * attitude).sum(0))
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


@dataclass
class Moment:
    """What acts on B flights at one time; everything in the body frame unless said."""

    t: Array
    """Time in the log (B,) [s]."""
    state: Array
    """(n, B): position, velocity (world), attitude xyzw, body rates, then a vehicle's own states."""
    rotation: Array
    """(3, 3, B), body to world."""
    air: Array
    """Velocity through the air (3, B)."""
    hubs: Array
    """Velocity of the hubs through the air (3, 4, B)."""
    speed: Array
    """Rotor speeds (4, B)."""
    spin: Array
    """Their time derivatives (4, B)."""


class Rotorcraft(Multirotor):
    """RotorPy's `Multirotor`, evaluated for B flights at once."""

    own_states = 0
    """States of the vehicle beyond the 13 of a rigid body."""

    def __init__(self, parameters: dict[str, object]) -> None:
        super().__init__(parameters)
        self.arms: Array = self.rotor_geometry.T[:, :, None]  # (3, 4, 1)
        self.signs: Array = np.asarray(self.rotor_dir, dtype=float)[:, None]

    def thrust(self, now: Moment) -> Array:
        """k_f ω² of each rotor (4, B) [N]."""
        return np.asarray(self.k_eta * now.speed**2)

    def wrench(self, now: Moment) -> tuple[Array, Array]:
        """Force (3, B) [N] and torque (3, B) [N m]: RotorPy's `compute_body_wrench`."""
        thrust = self.thrust(now)
        hub = np.zeros((3, *thrust.shape))
        hub[:2] = -self.k_d * now.speed * now.hubs[:2]
        hub[2] = thrust - self.k_z * now.speed * now.hubs[2] + self.k_h * (now.hubs[0] ** 2 + now.hubs[1] ** 2)
        torque = cross(self.arms, hub).sum(1)
        torque[2] += (self.signs * self.k_m * now.speed**2).sum(0)
        torque[0] -= self.k_flap * (now.speed * now.hubs[1]).sum(0)  # −k ω v × e3
        torque[1] += self.k_flap * (now.speed * now.hubs[0]).sum(0)
        force = hub.sum(1)
        if self.c_Dx or self.c_Dy or self.c_Dz:
            drag = np.array([[self.c_Dx], [self.c_Dy], [self.c_Dz]])
            force -= drag * np.sqrt((now.air**2).sum(0)) * now.air
        return force, torque

    def own_rates(self, now: Moment, acceleration: Array) -> Array:
        """Derivatives of the vehicle's own states (k, B); ``acceleration`` (3, B) is the body's, world frame."""
        return np.empty((0, now.state.shape[1]))

    def world_force(self, now: Moment) -> Array | float:
        """Forces (3, B) [N] given in the world frame, beside gravity."""
        return 0.0

    def derivative(self, t: Array, state: Array, speed: Array, spin: Array, wind: Array) -> Array:
        """Time derivative (n, B) of the state; ``wind`` (3, B) in the world frame."""
        velocity, rates = state[3:6], state[10:13]
        turn = rotation(state[6:10])
        air = (turn * (velocity - wind)[:, None]).sum(0)
        now = Moment(
            t=t,
            state=state,
            rotation=turn,
            air=air,
            hubs=air[:, None] + cross(rates[:, None], self.arms),
            speed=speed,
            spin=spin,
        )
        force, torque = self.wrench(now)
        acceleration = ((turn * force).sum(1) + self.world_force(now)) / self.mass
        acceleration[2] -= self.g
        out = np.empty_like(state)
        out[0:3], out[3:6] = velocity, acceleration
        x, y, z, w = state[6:10]
        p, q, r = rates / 2
        out[6:10] = w * p + y * r - z * q, w * q + z * p - x * r, w * r + x * q - y * p, -x * p - y * q - z * r
        out[10:13] = self.inv_inertia @ (torque - cross(rates, self.inertia @ rates))
        if self.own_states:
            out[13:] = self.own_rates(now, acceleration)
        return out

    def step(
        self, t: Array, state: Array, speeds: list[Array], spins: list[Array], winds: list[Array], dt: float = STEP
    ) -> Array:
        """One step of Runge and Kutta's method; speeds, their rates and winds at its start, middle and end."""
        f, half = self.derivative, dt / 2
        a = f(t, state, speeds[0], spins[0], winds[0])
        b = f(t + half, state + half * a, speeds[1], spins[1], winds[1])
        c = f(t + half, state + half * b, speeds[1], spins[1], winds[1])
        d = f(t + dt, state + dt * c, speeds[2], spins[2], winds[2])
        out: Array = state + dt / 6 * (a + 2 * (b + c) + d)
        out[6:10] /= np.sqrt((out[6:10] ** 2).sum(0))
        return out


class Pilot(SE3Control):
    """RotorPy's `SE3Control`, evaluated for B flights at once."""

    def command(self, state: Array, wanted: Array) -> Array:
        """Rotor speeds (4, B) [rad/s] at states (≥ 13, B) for the references (11, B) of `references`."""
        goal, yaw, yaw_rate = wanted[:9], wanted[9], wanted[10]
        kp, kd = self.kp_pos[:, None], self.kd_pos[:, None]
        stiff, damp = (np.broadcast_to(g, 3)[:, None] for g in (self.kp_att, self.kd_att))
        force = goal[6:9] - kp * (state[0:3] - goal[0:3]) - kd * (state[3:6] - goal[3:6])
        force[2] += self.g
        force *= self.mass
        turn = rotation(state[6:10])
        up = force / np.sqrt((force**2).sum(0))
        left = cross(up, np.array([np.cos(yaw), np.sin(yaw), np.zeros_like(yaw)]))
        left /= np.sqrt((left**2).sum(0))
        aim = np.stack([cross(left, up), left, up], axis=1)
        skew = np.einsum("kib,kjb->ijb", aim, turn)
        skew = (skew - skew.transpose(1, 0, 2)) / 2
        error = np.array([-skew[1, 2], skew[0, 2], -skew[0, 1]])
        rates = state[10:13]
        off = rates.copy()
        off[2] -= yaw_rate
        torque = self.inertia @ (-stiff * error - damp * off) + cross(rates, self.inertia @ rates)
        load = np.concatenate([(force * turn[:, 2]).sum(0)[None], torque])
        squares = self.TM_to_f @ load / self.k_eta
        speeds = np.sign(squares) * np.sqrt(np.abs(squares))
        return np.clip(speeds, self.rotor_speed_min, self.rotor_speed_max)


@dataclass(frozen=True)
class Motors:
    """From commands, held, to rotor speeds: a delay, then a first-order lag that is solved exactly."""

    up: float
    """Time constant when rising [s]; 0: at once."""
    down: float
    delay: float = 0.0
    """[s]."""

    def turn(self, speed: Array, commands: tuple[Array, Array], dt: float = STEP) -> tuple[list[Array], list[Array]]:
        """Speeds (4, B) and their rates at start, middle and end of a step; the commands of its two halves."""
        if self.up == 0 and self.down == 0:
            mean = (commands[0] + commands[1]) / 2
            return [mean, mean, mean], [np.zeros_like(mean)] * 3
        speeds, spins = [speed], []
        for wanted in commands:
            tau = np.where(wanted > speed, self.up, self.down)
            spins.append((wanted - speed) / tau)
            speed = wanted + (speed - wanted) * np.exp(-dt / 2 / tau)
            speeds.append(speed)
        spins.append((wanted - speed) / tau)
        return speeds, spins

    def delayed(self, commands: list[Array], now: float, period: float, dt: float = STEP) -> tuple[Array, Array]:
        """Means over the two halves of the step that starts at ``now`` of ``commands``, given every ``period``."""

        def mean(start: float, end: float) -> Array:
            first, last = (int(np.floor(max(s, 0.0) / period + 1e-9)) for s in (start, end - 1e-9))
            if first == last:
                return commands[first]
            share = (last * period - start) / (end - start)
            return share * commands[first] + (1 - share) * commands[last]

        start, half = now - self.delay, dt / 2
        return mean(start, start + half), mean(start + half, start + dt)


@dataclass(frozen=True)
class Truth:
    """What really happened, at 100 Hz; the flights along the last axis."""

    state: Array
    """(N, n, B)."""
    speed: Array
    """Rotor speeds (N, 4, B)."""
    command: Array
    """Commands (N, 4, B) given at each sample."""
    wind: Array
    """Wind (N, 3, B), world frame."""


def fly(craft: Rotorcraft, pilot: Pilot, motors: Motors, wanted: Array, wind: Array, control_every: int) -> Truth:
    """Fly the references ``wanted`` (steps + 1, 11, B) through ``wind`` (2 · steps + 1, 3, B), at every half step.

    The pilot acts every ``control_every`` steps of `STEP` and his commands are held. The first `WARM_UP` seconds are
    flown but not logged; the log's time starts at zero after them.
    """
    steps, flights = len(wanted) - 1, wanted.shape[2]
    state = np.zeros((13 + craft.own_states, flights))
    state[0:3], state[3:6] = wanted[0, 0:3], wanted[0, 3:6]
    state[8], state[9] = np.sin(wanted[0, 9] / 2), np.cos(wanted[0, 9] / 2)
    speed = np.full((4, flights), np.sqrt(pilot.mass * craft.g / 4 / pilot.k_eta))
    log: list[tuple[Array, Array, Array, Array]] = []
    commands: list[Array] = []
    skipped = round(WARM_UP / STEP)
    for k in range(steps):
        now = k * STEP
        if k % control_every == 0:
            commands.append(pilot.command(state, wanted[k]))
        halves = motors.delayed(commands, now, control_every * STEP)
        speeds, spins = motors.turn(speed, halves)
        if k >= skipped and (k - skipped) % EVERY == 0:
            log.append((state, speeds[0], commands[-1], wind[2 * k]))
        t = np.full(flights, now - WARM_UP)
        state = craft.step(t, state, speeds, spins, [wind[2 * k], wind[2 * k + 1], wind[2 * k + 2]])
        speed = speeds[2]
    return Truth(*(np.stack(part) for part in zip(*log, strict=True)))
