"""How strong each effect is on each vehicle: what is typical, and what a case draws around it."""

import numpy as np

CRAZYFLIE, HUMMINGBIRD = "crazyflie", "hummingbird"

_SIGNED = (
    "blade_flapping",
    "cog_offset",
    "inertia_products",
    "rotor_misalignment",
    "thrust_scale",
    "torque_bias",
    "torque_scale",
    "unequal_rotors",
    "wind",
)
"""Effects whose parameters may have either sign."""

TYPICAL: dict[str, tuple[dict[str, float], dict[str, float]]] = {
    "rotor_drag": ({"k_d": 1.19e-4}, {"k_d": 5.09e-6}),
    "linear_drag": ({"d_x": 0.2, "d_y": 0.24, "d_z": 0.15}, {"d_x": 0.018, "d_y": 0.021, "d_z": 0.014}),
    "parasitic_drag": ({"c_x": 0.02, "c_y": 0.02, "c_z": 0.03}, {"c_x": 2e-3, "c_y": 2e-3, "c_z": 3e-3}),
    "blade_flapping": ({"k_flap": 1e-6}, {"k_flap": 3e-9}),
    "translational_lift": ({"k_h": 3.39e-3}, {"k_h": 1.11e-3}),
    "inflow_thrust_loss": ({"k_z": 2.32e-4}, {"k_z": 1.19e-5}),
    "vortex_ring_state": ({"a": 0.3}, {"a": 0.5}),
    "ground_effect": ({"c": 2.0}, {"c": 8.0}),
    "rotor_gyroscopic_torque": ({"rotor_inertia": 4e-5}, {"rotor_inertia": 1e-7}),
    "rotor_reaction_torque": ({"rotor_inertia": 4e-5}, {"rotor_inertia": 1e-7}),
    "motor_lag": ({"tau_up": 0.02, "tau_down": 0.03}, {"tau_up": 0.04, "tau_down": 0.06}),
    "input_delay": ({"delay": 0.02}, {"delay": 0.02}),
    "battery_sag": ({"rate": 3e-3}, {"rate": 3e-3}),
    "battery_sag_volts": ({"slope": 0.2}, {"slope": 0.25}),
    "wind": ({"w_x": 1.0, "w_y": 1.0}, {"w_x": 1.0, "w_y": 1.0}),
    "rotor_misalignment": ({"a_x": 0.02, "a_y": 0.02}, {"a_x": 0.02, "a_y": 0.02}),
    "unequal_rotors": (dict.fromkeys(("eps_1", "eps_2", "eps_3", "eps_4"), 0.03),) * 2,
    "cog_offset": ({"x": 0.0015, "y": 0.0015}, {"x": 0.0004, "y": 0.0004}),
    "rotational_damping": ({"d_x": 4e-3, "d_y": 4e-3, "d_z": 4e-3}, {"d_x": 4e-5, "d_y": 4e-5, "d_z": 4e-5}),
    "inertia_products": ({"J_xy": 2e-4, "J_xz": 2e-4, "J_yz": 2e-4}, {"J_xy": 2e-6, "J_xz": 2e-6, "J_yz": 2e-6}),
    "mass": ({"delta": 0.075}, {"delta": 0.0066}),
    "thrust_scale": ({"eps": 0.1}, {"eps": 0.1}),
    "torque_scale": ({"eps_x": 0.15, "eps_y": 0.15, "eps_z": 0.15},) * 2,
    "torque_bias": ({"t_x": 5e-3, "t_y": 5e-3, "t_z": 4e-3}, {"t_x": 4e-5, "t_y": 4e-5, "t_z": 3e-5}),
    "suspended_load": ({"m_l": 0.1, "l": 0.6, "zeta": 0.03}, {"m_l": 0.008, "l": 0.5, "zeta": 0.03}),
    "munk_moment": ({"m_x": 4e-3, "m_y": 4e-3}, {"m_x": 1.5e-5, "m_y": 1.5e-5}),
}
"""Parameters (SI) on the Hummingbird and on the Crazyflie."""

_KEPT = ("l", "zeta")
"""Parameters that a factor on the strength leaves alone."""
_COMMANDED = ("motor_lag", "input_delay")


def identity(key: str) -> str:
    """The effect's id; `TYPICAL` has battery_sag twice, with and without a voltage signal."""
    return "battery_sag" if key == "battery_sag_volts" else key


def drive(keys: tuple[str, ...]) -> str:
    """Which signal drives a log that shows these effects."""
    return "rotor_command" if set(keys) & set(_COMMANDED) else "rotor_speed"


def draw(rng: np.random.Generator, key: str, vehicle: str, factor: float) -> dict[str, float]:
    """Parameters of an effect: ``factor`` times the typical ones, somewhat varied, of either sign where it may be."""
    out = {}
    for name, value in TYPICAL[key][vehicle == CRAZYFLIE].items():
        spread = rng.uniform(0.8, 1.25)
        sign = rng.choice([-1.0, 1.0]) if key in _SIGNED else 1.0
        out[name] = float(value * spread * (1.0 if name in _KEPT else factor * sign))
    return out
