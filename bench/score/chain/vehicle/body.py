"""Equations of motion of a rigid body with four rotors and of everything that may act on it besides.

Written from the table of effects alone. States of many flights stand side by side along the last axis: position (3),
velocity (3), attitude wxyz (4), body rates (3) and, with a load, its swing angles (2) and their rates (2).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bench.score.chain.strengths import TYPICAL, identity
from bench.score.chain.vehicle.airframe import AIR_DENSITY, GRAVITY, Airframe

Array = np.ndarray
Effects = Mapping[str, Mapping[str, float]]
"""Effect id → parameters, SI."""

P, V, Q, W, LOAD = slice(0, 3), slice(3, 6), slice(6, 10), slice(10, 13), slice(13, 17)
_BY_AXIS = {
    "linear_drag": ("d_x", "d_y", "d_z"),
    "parasitic_drag": ("c_x", "c_y", "c_z"),
    "rotational_damping": ("d_x", "d_y", "d_z"),
    "torque_bias": ("t_x", "t_y", "t_z"),
    "torque_scale": ("eps_x", "eps_y", "eps_z"),
    "unequal_rotors": ("eps_1", "eps_2", "eps_3", "eps_4"),
}
_HUB = ("rotor_drag", "inflow_thrust_loss", "translational_lift", "blade_flapping")
_AIRLESS = frozenset(
    (
        *("battery_sag", "cog_offset", "ground_effect", "inertia_products", "input_delay", "mass", "motor_lag"),
        *("recorded_point", "rotational_damping", "rotor_gyroscopic_torque", "rotor_reaction_torque"),
        *("suspended_load", "thrust_scale", "torque_bias", "torque_scale", "unequal_rotors", "wind"),
    )
)
"""Effects that do without the velocity through the air, which takes time to find; for any other it is there."""
CELL, DISCHARGE, RESISTANCE = 3.7, 0.005, 0.1
"""Of a battery cell: reference [V], loss of voltage in flight [V/s], drop at hover power [V]."""


def _quadratic(rows: list[dict[tuple[int, int], float]], n: int, m: int) -> Array:
    """The matrix (rows, n m) that makes bilinear forms of a flattened outer product."""
    out = np.zeros((len(rows), n * m))
    for k, row in enumerate(rows):
        for (i, j), value in row.items():
            out[k, i * m + j] += value
    return out


_ROTATION = _quadratic(
    [
        {(0, 0): 1, (1, 1): 1, (2, 2): -1, (3, 3): -1},
        {(1, 2): 2, (0, 3): -2},
        {(1, 3): 2, (0, 2): 2},
        {(1, 2): 2, (0, 3): 2},
        {(0, 0): 1, (1, 1): -1, (2, 2): 1, (3, 3): -1},
        {(2, 3): 2, (0, 1): -2},
        {(1, 3): 2, (0, 2): -2},
        {(2, 3): 2, (0, 1): 2},
        {(0, 0): 1, (1, 1): -1, (2, 2): -1, (3, 3): 1},
    ],
    4,
    4,
)
"""Body to world, row by row, of a quaternion wxyz."""
_TURNING = 0.5 * _quadratic(
    [
        {(1, 0): -1, (2, 1): -1, (3, 2): -1},
        {(0, 0): 1, (2, 2): 1, (3, 1): -1},
        {(0, 1): 1, (3, 0): 1, (1, 2): -1},
        {(0, 2): 1, (1, 1): 1, (2, 0): -1},
    ],
    4,
    3,
)
"""Time derivative of a quaternion wxyz that turns at body rates."""
_CROSS = _quadratic(
    [{(1, 2): 1, (2, 1): -1}, {(2, 0): 1, (0, 2): -1}, {(0, 1): 1, (1, 0): -1}],
    3,
    3,
)


total_of = np.add.reduce
"""As the method `sum`, which asks more questions first."""


def rotation(attitude: Array) -> Array:
    """Body to world (3, 3, B) of unit quaternions wxyz (4, B)."""
    outer = attitude[:, None] * attitude[None]
    return np.asarray((_ROTATION @ outer.reshape(16, -1)).reshape(3, 3, -1))


def cross(a: Array, b: Array) -> Array:
    """a × b of (3, B) each."""
    return np.asarray(_CROSS @ (a[:, None] * b[None]).reshape(9, -1))


@dataclass(frozen=True)
class Moment:
    """What acts on the body at one time."""

    t: float | Array
    speed: Array
    """Of the rotors (4, B) [rad/s]."""
    spin: Array
    """Its time derivative (4, B)."""
    wind: Array
    """World frame (3, B) [m/s]."""


Step = tuple[Moment, Moment, Moment]
"""What acts at the start, in the middle and at the end of a step."""


def moments(
    t: float | Array, speeds: Sequence[Array], spins: Sequence[Array], wind: Sequence[Array], dt: float
) -> Step:
    """Start, middle and end of the step from ``t``."""
    a, b, c = (Moment(t + i * dt / 2, speeds[i], spins[i], wind[i]) for i in range(3))
    return a, b, c


class Body:
    """A specimen with ``effects``.

    Args:
        craft: true base constants.
        effects: by id; wind, lag and delay lie in the air and in the motors and are passed over.
        charge: start voltage of a cell over `CELL` in each flight (B,) [V].

    Raises:
        ValueError: an effect that `TYPICAL` does not have.
    """

    def __init__(self, craft: Airframe, effects: Effects, charge: Array) -> None:
        if unknown := sorted(set(effects) - set(map(identity, TYPICAL))):
            raise ValueError(f"No such hidden effect: {', '.join(unknown)}. Add it to TYPICAL in strengths.py.")
        self.craft, self.effects, self.charge = craft, effects, charge
        self.mass = craft.mass + effects.get("mass", {}).get("delta", 0.0)
        self.thrust_coefficient = craft.thrust * (1 + effects.get("thrust_scale", {}).get("eps", 0.0))
        inertia = np.diag(craft.inertia)
        if e := effects.get("inertia_products"):
            for (i, j), name in {(0, 1): "J_xy", (0, 2): "J_xz", (1, 2): "J_yz"}.items():
                inertia[i, j] = inertia[j, i] = e[name]
        self.inertia, self.inverse = inertia, np.linalg.inv(inertia)
        centre = effects.get("cog_offset", {"x": 0.0, "y": 0.0})
        self.hubs = np.array(craft.hubs).T - np.array([[centre["x"]], [centre["y"]]])
        self.x, self.y = self.hubs[:, :, None]
        self.turns = np.array(craft.turns, dtype=float)[:, None]
        self.lever = np.concatenate([self.y.T, -self.x.T])
        """Roll and pitch torque of forces along body z at the hubs (2, 4)."""
        self.crossed = -self.inverse @ _CROSS @ np.kron(np.eye(3), inertia)
        """−J⁻¹ (ω × J ω) as a form of ω's outer product (3, 9)."""
        held = {n: names for n, names in _BY_AXIS.items() if n in effects}
        self.columns = {n: np.array([[effects[n][p]] for p in names]) for n, names in held.items()}
        """Parameters of effects that have one an axis or a rotor (c, 1)."""
        self.reaction = craft.drag * self.turns[:, 0]
        self.hover_power = 4 * craft.hover**3
        self.size = 17 if "suspended_load" in effects else 13
        self._hub = [n for n in _HUB if n in effects]
        self._body = not _AIRLESS.issuperset(effects)

    def volts(self, t: float | Array, speed: Array) -> Array:
        """Of one battery cell (B,) [V]."""
        drawn = (speed**3).sum(0) / self.hover_power
        return np.asarray(CELL + self.charge - DISCHARGE * np.asarray(t) - RESISTANCE * (drawn - 1))

    # ------------------------------------------------------------------------------------------------- forces

    def thrusts(self, state: Array, turn: Array, now: Moment, air: Array | None) -> Array:
        """Of each rotor along body z (4, B) [N]."""
        has = self.effects
        thrust = self.thrust_coefficient * (now.speed * now.speed)
        if "unequal_rotors" in has:
            thrust = thrust * (1 + self.columns["unequal_rotors"])
        if e := has.get("battery_sag"):
            gain = e["slope"] * (self.volts(now.t, now.speed) - CELL) if "slope" in e else -e["rate"] * now.t
            thrust = thrust * (1 + gain)
        if (e := has.get("vortex_ring_state")) and air is not None:
            disc = np.pi * self.craft.radius**2
            wash = np.sqrt(np.maximum(thrust.sum(0), 1e-9) / (8 * AIR_DENSITY * disc))
            sink = np.maximum(-air[2] / wash, 0)
            thrust = thrust * (1 - e["a"] * sink * np.exp(-(((sink - 1) / 0.35) ** 2)))
        if e := has.get("ground_effect"):
            height = state[2] + turn[2, 0] * self.x + turn[2, 1] * self.y
            least = 1.2 * self.craft.radius * np.sqrt(e["c"]) / 4
            thrust = thrust / (1 - e["c"] * (self.craft.radius / (4 * np.maximum(height, least))) ** 2)
        return np.asarray(thrust)

    def wrench(self, state: Array, turn: Array, now: Moment) -> tuple[Array, Array]:
        """Force (3, B) [N] and torque (3, B) [N m] in the body frame, gravity and the load's pull apart."""
        has, rates = self.effects, state[W]
        air = total_of(turn * (state[V] - now.wind)[:, None], 0) if self._body else None
        thrust = self.thrusts(state, turn, now, air)
        force, torque = np.zeros((3, state.shape[1])), np.empty((3, state.shape[1]))
        force[2] = total = total_of(thrust, 0)
        torque[:2] = self.lever @ thrust
        torque[2] = self.reaction @ (now.speed * now.speed)
        if self._hub and air is not None:
            self._at_hubs(force, torque, air, rates, now.speed)
        if "linear_drag" in has and air is not None:
            force -= self.columns["linear_drag"] * air
        if "parasitic_drag" in has and air is not None:
            force -= self.columns["parasitic_drag"] * np.sqrt(total_of(air * air, 0)) * air
        if e := has.get("rotor_misalignment"):
            force[0] += e["a_y"] * total
            force[1] -= e["a_x"] * total
        if e := has.get("rotor_gyroscopic_torque"):
            momentum = e["rotor_inertia"] * (self.turns * now.speed).sum(0)
            torque[0] += momentum * rates[1]
            torque[1] -= momentum * rates[0]
        if e := has.get("rotor_reaction_torque"):
            torque[2] += e["rotor_inertia"] * (self.turns * now.spin).sum(0)
        if "rotational_damping" in has:
            torque -= self.columns["rotational_damping"] * rates
        if "torque_bias" in has:
            torque += self.columns["torque_bias"]
        if (e := has.get("munk_moment")) and air is not None:
            torque[:2] += air[2] * np.stack([-e["m_x"] * air[1], e["m_y"] * air[0]])
        if "torque_scale" in has:
            torque *= 1 + self.columns["torque_scale"]
        return force, torque

    def _at_hubs(self, force: Array, torque: Array, air: Array, rates: Array, speed: Array) -> None:
        """Add what acts at each hub, whose velocity is v_b + ω × r."""
        has = self.effects
        vx, vy = air[0] - rates[2] * self.y, air[1] + rates[2] * self.x
        if e := has.get("rotor_drag"):
            fx, fy = -e["k_d"] * speed * vx, -e["k_d"] * speed * vy
            force[0] += total_of(fx, 0)
            force[1] += total_of(fy, 0)
            torque[2] += self.hubs[0] @ fy - self.hubs[1] @ fx
        if "inflow_thrust_loss" in has or "translational_lift" in has:
            lift = np.zeros_like(speed)
            if e := has.get("inflow_thrust_loss"):
                lift -= e["k_z"] * speed * (air[2] + rates[0] * self.y - rates[1] * self.x)
            if e := has.get("translational_lift"):
                lift += e["k_h"] * (vx**2 + vy**2)
            force[2] += total_of(lift, 0)
            torque[:2] += self.lever @ lift
        if e := has.get("blade_flapping"):
            torque[0] -= e["k_flap"] * total_of(speed * vy, 0)
            torque[1] += e["k_flap"] * total_of(speed * vx, 0)

    # -------------------------------------------------------------------------------------------------- motion

    def rates(self, state: Array, now: Moment) -> Array:
        """Time derivative of the state (size, B)."""
        turn, rates = rotation(state[Q]), state[W]
        force, torque = self.wrench(state, turn, now)
        out = np.empty_like(state)
        acceleration = total_of(turn * force, 1) / self.mass
        acceleration[2] -= GRAVITY
        if e := self.effects.get("suspended_load"):
            angle, swing = state[13:15], state[15:17]
            ratio = e["m_l"] / self.mass
            square = GRAVITY / e["l"] * (1 + ratio)
            out[13:15] = swing
            # The acceleration here is the body's without the load: the load's own pull is in the (1 + m_l/m).
            out[15:17] = -square * angle - acceleration[:2] / e["l"] - 2 * e["zeta"] * np.sqrt(square) * swing
            acceleration[:2] += ratio * GRAVITY * angle
            acceleration[2] -= ratio / (1 + ratio) * (acceleration[2] + GRAVITY)  # it hangs on a taut rope
        out[P], out[V] = state[V], acceleration
        out[Q] = _TURNING @ (state[Q][:, None] * rates[None]).reshape(12, -1)
        out[W] = self.inverse @ torque + self.crossed @ (rates[:, None] * rates[None]).reshape(9, -1)
        return out

    def step(self, state: Array, during: Step, dt: float) -> Array:
        """One step of the classical Runge–Kutta method, with what acts at its start, middle and end."""
        first, middle, last = during
        k1 = self.rates(state, first)
        k2 = self.rates(state + dt / 2 * k1, middle)
        k3 = self.rates(state + dt / 2 * k2, middle)
        k4 = self.rates(state + dt * k3, last)
        out = state + dt / 6 * (k1 + 2 * (k2 + k3) + k4)
        attitude = out[Q]
        attitude /= np.sqrt(total_of(attitude * attitude, 0))
        return np.asarray(out)

    def specific_force(self, state: Array, now: Moment) -> Array:
        """What an accelerometer at the centre of gravity feels, body frame (3, B) [m/s²]."""
        turn = rotation(state[Q])
        felt = self.rates(state, now)[V].copy()
        felt[2] += GRAVITY
        return np.asarray((turn * felt[:, None]).sum(0))
