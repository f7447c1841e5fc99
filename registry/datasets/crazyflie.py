"""Constants of the Crazyflie 2, as nominal values for the data sets that flew one and state none."""

from typing import Any

import numpy as np

_ARM = 0.046 / 2**0.5

CONSTANTS: dict[str, Any] = {
    "mass": 0.027,
    "inertia": (1.43e-5, 1.43e-5, 2.89e-5),
    "thrust_coefficient": 3.16e-10 * (30 / np.pi) ** 2,
    "torque_coefficient": 7.94e-12 * (30 / np.pi) ** 2,
    "rotor_positions": ((_ARM, -_ARM, 0.0), (-_ARM, -_ARM, 0.0), (-_ARM, _ARM, 0.0), (_ARM, _ARM, 0.0)),
    "rotor_directions": (-1.0, 1.0, -1.0, 1.0),
    "rotor_radius": 0.0231348,
}
"""Bitcraze, Crazyflie 2.1: arm of 46 mm; gym-pybullet-drones, cf2x.urdf: mass, inertia, k_f and k_m per rpm², radius.
Motors 1–4: front-right, rear-right, rear-left, front-left."""

UNCERTAINTY: dict[str, float] = {
    "mass": 0.2,
    "inertia": 0.3,
    "thrust_coefficient": 0.2,
    "torque_coefficient": 0.5,
    "pwm_gain": 0.3,
    "pwm_offset": 1.0,
}
"""Relative 1σ: decks, markers and propellers differ from vehicle to vehicle, and the map from motor command to rotor
speed, taken at one voltage of the battery, is to be fitted."""
