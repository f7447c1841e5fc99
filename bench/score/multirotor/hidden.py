"""A multirotor with the effects that RotorPy lacks, each from its textbook formula.

RotorPy's own (rotor and parasitic drag, flapping, translational lift, inflow, products of inertia) are its
parameters; lag and delay of the motors are `flights.Motors`; gusts and wind are the air that it flies through.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bench.score.multirotor.flights import Array, Moment, Motors, Rotorcraft
from bench.score.multirotor.strengths import TYPICAL, identity

Effects = Mapping[str, Mapping[str, float]]
"""Effect id → parameters, SI."""

_ROTORPY = {
    "rotor_drag": {"k_d": "k_d"},
    "parasitic_drag": {"c_x": "c_Dx", "c_y": "c_Dy", "c_z": "c_Dz"},
    "blade_flapping": {"k_flap": "k_flap"},
    "translational_lift": {"k_h": "k_h"},
    "inflow_thrust_loss": {"k_z": "k_z"},
    "inertia_products": {"J_xy": "Ixy", "J_xz": "Ixz", "J_yz": "Iyz"},
}
"""Effects that RotorPy has: their parameters and RotorPy's names for them."""
_OFF = ("k_d", "k_z", "k_h", "k_flap", "c_Dx", "c_Dy", "c_Dz", "Ixy", "Ixz", "Iyz")
"""What RotorPy's vehicle files may switch on and the base model has not."""

KNOWN = frozenset((*map(identity, TYPICAL), "gusts", "position_force", "worn_rotors"))
"""All effects that a flight may have. Gusts and wind are in the air, lag and delay in the motors; `position_force` and
`gusts` are in nobody's catalogue."""


@dataclass(frozen=True)
class Surroundings:
    """What effects need to know beside RotorPy's vehicle file."""

    rotor_radius: float
    """[m]."""
    reference_voltage: float = 3.7
    """Of one cell, where thrust is k_f ω² [V]."""
    discharge: float = 0.006
    """Of one cell in flight [V/s]."""
    resistance: float = 0.12
    """Drop of one cell's voltage for hover power [V]."""
    ground_z: float = 0.0
    air_density: float = 1.2


class HiddenMultirotor(Rotorcraft):
    """RotorPy's multirotor with ``effects`` and without whatever aerodynamics its vehicle file has.

    Args:
        parameters: RotorPy's vehicle file, with the true base constants.
        effects: see `KNOWN`.
        around: ground, air, rotors, battery.
        charge: start voltage of each flight (B,) over `Surroundings.reference_voltage` [V].
    """

    def __init__(self, parameters: dict[str, object], effects: Effects, around: Surroundings, charge: Array) -> None:
        unknown = set(effects) - KNOWN
        if unknown:
            raise ValueError(f"No such hidden effect: {', '.join(sorted(unknown))}. Add it to TYPICAL in strengths.py.")
        values: dict[str, object] = {**parameters, **dict.fromkeys(_OFF, 0.0)}
        for name, names in _ROTORPY.items():
            values.update({names[key]: value for key, value in effects.get(name, {}).items()})
        values["mass"] = parameters["mass"] + effects.get("mass", {}).get("delta", 0.0)  # type: ignore[operator]
        values["k_eta"] = parameters["k_eta"] * (1 + effects.get("thrust_scale", {}).get("eps", 0.0))  # type: ignore[operator]
        super().__init__(values)
        if e := effects.get("cog_offset"):
            self.arms = self.arms - np.array([e["x"], e["y"], 0.0])[:, None, None]
        self.effects, self.around, self.charge = effects, around, charge
        worn = effects.get("worn_rotors", {})
        self._worn = np.array([[worn.get(f"eps_{i}", 0.0)] for i in (1, 2, 3, 4)])
        self.own_states = 4 if "suspended_load" in effects else 0
        self._hover_power = 4 * (self.mass * self.g / 4 / self.k_eta) ** 1.5

    def voltage(self, t: Array, speed: Array, charge: Array | None = None) -> Array:
        """Of one cell (B,) [V] at times (B,) and rotor speeds (4, B): it empties, and drops with the power drawn."""
        charge = self.charge if charge is None else charge
        around = self.around
        power = (speed**3).sum(0) / self._hover_power
        return np.asarray(
            around.reference_voltage + charge - around.discharge * t - around.resistance * (power - 1), dtype=float
        )

    def thrust(self, now: Moment) -> Array:
        """Of each rotor (4, B) [N]."""
        thrust, has = super().thrust(now), self.effects
        if e := has.get("unequal_rotors"):
            thrust = thrust * (1 + np.array([[e[f"eps_{i}"]] for i in (1, 2, 3, 4)]))
        thrust = thrust * (1 + self._worn)
        if e := has.get("battery_sag"):
            sag = (
                e["slope"] * (self.voltage(now.t, now.speed) - self.around.reference_voltage)
                if "slope" in e
                else -e["rate"] * now.t
            )
            thrust = thrust * (1 + sag)
        if e := has.get("vortex_ring_state"):
            area = np.pi * self.around.rotor_radius**2
            induced = np.sqrt(np.maximum(thrust.sum(0), 1e-9) / (2 * self.around.air_density * 4 * area))
            x = np.maximum(-now.air[2] / induced, 0.0)
            thrust = thrust * (1 - e["a"] * x * np.exp(-(((x - 1) / 0.35) ** 2)))
        if e := has.get("ground_effect"):
            radius = self.around.rotor_radius
            rise = (now.rotation[2][:, None] * self.arms).sum(0)
            height = np.maximum(now.state[2] + rise - self.around.ground_z, 1.2 * radius * np.sqrt(e["c"]) / 4)
            thrust = thrust / (1 - e["c"] * (radius / (4 * height)) ** 2)
        return np.asarray(thrust)

    def wrench(self, now: Moment) -> tuple[Array, Array]:
        """Force (3, B) [N] and torque (3, B) [N m], body frame."""
        force, torque = super().wrench(now)
        torque[2] += (self.signs * self.k_m * self._worn * now.speed**2).sum(0)
        has, rates = self.effects, now.state[10:13]
        if e := has.get("linear_drag"):
            force -= np.array([[e["d_x"]], [e["d_y"]], [e["d_z"]]]) * now.air
        if e := has.get("rotor_misalignment"):
            total = self.thrust(now).sum(0)
            force[0] += e["a_y"] * total
            force[1] -= e["a_x"] * total
        if e := has.get("rotor_gyroscopic_torque"):
            spin = e["rotor_inertia"] * (self.signs * now.speed).sum(0)
            torque[0] += spin * rates[1]
            torque[1] -= spin * rates[0]
        if e := has.get("rotor_reaction_torque"):
            torque[2] += e["rotor_inertia"] * (self.signs * now.spin).sum(0)
        if e := has.get("rotational_damping"):
            torque -= np.array([[e["d_x"]], [e["d_y"]], [e["d_z"]]]) * rates
        if e := has.get("torque_bias"):
            torque += np.array([[e["t_x"]], [e["t_y"]], [e["t_z"]]])
        if e := has.get("munk_moment"):
            torque[0] -= e["m_x"] * now.air[1] * now.air[2]
            torque[1] += e["m_y"] * now.air[0] * now.air[2]
        if e := has.get("torque_scale"):
            torque *= 1 + np.array([[e["eps_x"]], [e["eps_y"]], [e["eps_z"]]])
        return force, torque

    def world_force(self, now: Moment) -> Array | float:
        """Of a swinging load, and of something at a place [N], world frame."""
        has = self.effects
        if not has.keys() & {"suspended_load", "position_force"}:
            return 0.0
        force = np.zeros((3, now.state.shape[1]))
        if e := has.get("suspended_load"):
            force[:2] += e["m_l"] * self.g * now.state[13:15]
        if e := has.get("position_force"):
            axis = int(e["axis"])
            force[axis] += e["amplitude"] * np.sin(2 * np.pi * now.state[axis] / e["wavelength"])
        return force

    def own_rates(self, now: Moment, acceleration: Array) -> Array:
        """Of the pendulum angles and their rates (4, B): θ̈ = −(g/l)(1 + m_l/m)θ − a/l − 2ζω θ̇.

        a is what the body would have without the load: the load's own pull is the (1 + m_l/m).
        """
        e = self.effects["suspended_load"]
        angle, swing = now.state[13:15], now.state[15:17]
        ratio, stiffness = e["m_l"] / self.mass, self.g / e["l"] * (1 + e["m_l"] / self.mass)
        pulled = acceleration[:2] - ratio * self.g * angle
        back = -stiffness * angle - pulled / e["l"] - 2 * e["zeta"] * np.sqrt(stiffness) * swing
        return np.concatenate([swing, back])


def motors(effects: Effects, drive: str, lag: float) -> Motors:
    """Of a log driven by ``drive``: measured rotor speeds have the vehicle's own ``lag`` [s] before them."""
    if drive == "rotor_speed":
        return Motors(lag, lag)
    slow, late = effects.get("motor_lag", {}), effects.get("input_delay", {})
    return Motors(slow.get("tau_up", 0.0), slow.get("tau_down", 0.0), late.get("delay", 0.0))


def wind(rng: np.random.Generator, effects: Effects, samples: int, flights: int, dt: float) -> Array:
    """Wind (samples, 3, flights) [m/s], world frame: constant, and Ornstein-Uhlenbeck gusts of zero mean."""
    out = np.zeros((samples, 3, flights))
    if e := effects.get("wind"):
        out[:, 0], out[:, 1] = e["w_x"], e["w_y"]
    if e := effects.get("gusts"):
        keep = np.exp(-dt / e["time"])
        kicks = rng.normal(0, e["sigma"] * np.sqrt(1 - keep**2), out.shape)
        gust = rng.normal(0, e["sigma"], out.shape[1:])
        for k in range(samples):
            gust = keep * gust + kicks[k]
            out[k] += gust
    return out
