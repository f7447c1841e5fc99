"""How strong each hidden effect is: in units of the vehicle's own weight, inertia and hover speed."""

from collections.abc import Callable

import numpy as np

from bench.score.chain.vehicle.airframe import GRAVITY, Airframe

Values = dict[str, float]


def _axes(names: str, values: tuple[float, ...]) -> Values:
    return dict(zip(names.split(), values, strict=True))


def _inertial(c: Airframe, names: str, factors: tuple[float, float, float]) -> Values:
    return _axes(names, tuple(f * j for f, j in zip(factors, c.inertia, strict=True)))


TYPICAL: dict[str, Callable[[Airframe], Values]] = {
    "rotor_drag": lambda c: {"k_d": 0.35 * c.mass / (4 * c.hover)},
    "linear_drag": lambda c: _axes("d_x d_y d_z", (0.35 * c.mass, 0.42 * c.mass, 0.27 * c.mass)),
    "parasitic_drag": lambda c: _axes("c_x c_y c_z", (0.04 * c.mass, 0.05 * c.mass, 0.06 * c.mass)),
    "blade_flapping": lambda c: {"k_flap": 0.5 * c.inertia[0] / (4 * c.hover)},
    "translational_lift": lambda c: {"k_h": 0.004 * c.mass * GRAVITY / 4},
    "inflow_thrust_loss": lambda c: {"k_z": 0.6 * c.mass / (4 * c.hover)},
    "vortex_ring_state": lambda c: {"a": 0.5},
    "ground_effect": lambda c: {"c": 4.0},
    "rotor_gyroscopic_torque": lambda c: {"rotor_inertia": 0.006 * c.inertia[2]},
    "rotor_reaction_torque": lambda c: {"rotor_inertia": 0.006 * c.inertia[2]},
    "motor_lag": lambda c: {"tau_up": 0.025, "tau_down": 0.035},
    "input_delay": lambda c: {"delay": 0.02},
    "battery_sag": lambda c: {"rate": 3e-3},
    "battery_sag_volts": lambda c: {"slope": 0.22},
    "wind": lambda c: {"w_x": 1.2, "w_y": 1.2},
    "rotor_misalignment": lambda c: {"a_x": 0.02, "a_y": 0.02},
    "unequal_rotors": lambda c: dict.fromkeys(("eps_1", "eps_2", "eps_3", "eps_4"), 0.03),
    "cog_offset": lambda c: {"x": 0.012 * _arm(c), "y": 0.012 * _arm(c)},
    "rotational_damping": lambda c: _inertial(c, "d_x d_y d_z", (1.1, 1.1, 0.6)),
    "inertia_products": lambda c: dict.fromkeys(("J_xy", "J_xz", "J_yz"), 0.05 * c.inertia[0]),
    "mass": lambda c: {"delta": 0.15 * c.mass},
    "thrust_scale": lambda c: {"eps": 0.1},
    "torque_scale": lambda c: dict.fromkeys(("eps_x", "eps_y", "eps_z"), 0.15),
    "torque_bias": lambda c: _inertial(c, "t_x t_y t_z", (1.3, 1.3, 0.6)),
    "suspended_load": lambda c: {"m_l": 0.18 * c.mass, "l": 0.6, "zeta": 0.03},
    "munk_moment": lambda c: {"m_x": c.inertia[0], "m_y": c.inertia[1]},
    "recorded_point": lambda c: _axes("x y z", (0.1 * _arm(c), 0.1 * _arm(c), 0.4 * _arm(c))),
}
_SIGNED = {
    "blade_flapping",
    "cog_offset",
    "inertia_products",
    "recorded_point",
    "rotor_misalignment",
    "thrust_scale",
    "torque_bias",
    "torque_scale",
    "unequal_rotors",
    "wind",
}
_KEPT = ("l", "zeta")
"""Parameters that a factor on the strength leaves alone."""
BESIDE = {
    "battery_sag": 1.6,
    "cog_offset": 0.3,
    "inflow_thrust_loss": 0.5,
    "rotor_gyroscopic_torque": 2.0,
    "torque_bias": 0.5,
    "translational_lift": 2.0,
    "unequal_rotors": 0.4,
}
"""Factors on the strength beside other effects, so that none of them drowns the rest."""


def _arm(craft: Airframe) -> float:
    return float(np.sqrt((np.array(craft.hubs) ** 2).sum(1)).mean())


def identity(key: str) -> str:
    """The effect's id: battery_sag is twice in `TYPICAL`, with and without a logged voltage."""
    return "battery_sag" if key == "battery_sag_volts" else key


def draw(rng: np.random.Generator, key: str, craft: Airframe, factor: float) -> Values:
    """Parameters: ``factor`` times the typical ones, each varied by a fifth or so, of either sign where it may be."""
    out = {}
    for name, value in TYPICAL[key](craft).items():
        spread = np.exp(rng.uniform(-0.22, 0.22))
        sign = rng.choice([-1.0, 1.0]) if key in _SIGNED else 1.0
        out[name] = float(value * spread * (1.0 if name in _KEPT else factor * sign))
    if key == "input_delay":
        out["delay"] = round(out["delay"], 3)  # a whole number of the simulator's steps
    if key == "unequal_rotors":
        # What all four have in common is the thrust coefficient's.
        mean = sum(out.values()) / 4
        out = {name: value - mean for name, value in out.items()}
    return out
