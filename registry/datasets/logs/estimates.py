"""Constants of a vehicle that its flights tell: how a command becomes a rotor speed, and what lift goes with one."""

from collections.abc import Mapping, Sequence

import numpy as np

from registry.datasets.folder.constants import Constant
from registry.datasets.logs.series import Log
from registry.datasets.reading.ground import IDLE

_SURE = 0.5
"""Share of the variance of rotor speeds that a straight line of the commands must explain for it to be stated."""
Values = Mapping[str, np.ndarray]
"""Signals (N, c) of a recording."""


def motor_map(logs: Sequence[Log]) -> dict[str, Constant]:
    """ω = a u + b, fitted where rotor speeds and commands were both logged, if only for a few samples a second."""
    pairs = []
    for log in logs:
        speed, command = log.signals.get("rotor_speed"), log.signals.get("pwm")
        if speed is None or command is None or speed.values.shape[1] != command.values.shape[1]:
            return {}
        # The speed of a motor follows its command within some .05 s: what it was told then is the last word it had.
        before = np.searchsorted(command.t, speed.t, side="right") - 1
        there = before >= 0
        u, omega = command.values[before[there]], speed.values[there]
        turning = (u > 0) & (omega > 0)
        pairs.append(np.stack([u[turning], omega[turning]], axis=1))
    u, omega = np.concatenate(pairs).T if pairs else np.empty((2, 0))
    if len(u) < 10 or np.ptp(u) == 0 or np.ptp(omega) == 0:
        return {}
    gain, offset = np.polyfit(u, omega, 1)
    explained = 1 - np.var(omega - gain * u - offset) / np.var(omega)
    if explained < _SURE or gain <= 0:
        return {}
    origin = f"a line through {len(u)} logged rotor speeds, {explained:.0%} of whose variance it explains"
    return {"pwm_gain": Constant(_short(gain), origin), "pwm_offset": Constant(_short(offset), origin)}


def lift(parts: Sequence[Values], driver: str, constants: Mapping[str, Constant]) -> float:
    """Specific force along body z over Σ ω² [N s²/kg], medians: k_f of a vehicle of 1 kg; 0: it cannot be told."""
    if driver == "pwm" and not {"pwm_gain", "pwm_offset"} <= set(constants):
        return 0.0
    up, squares = [], []
    for x in parts:
        if "specific_force" not in x:
            return 0.0
        omega = x[driver]
        if driver == "pwm":
            omega = constants["pwm_gain"].value * omega + constants["pwm_offset"].value
        up.append(x["specific_force"][:, 2])
        squares.append((np.maximum(omega, 0) ** 2).sum(axis=1))
    force, square = np.concatenate(up), np.concatenate(squares)
    flying = square > IDLE**2 * np.quantile(square, 0.8)
    if not flying.any():
        return 0.0
    ratio = float(np.median(force[flying]) / np.median(square[flying]))
    return ratio if 0 < ratio < np.inf else 0.0


def rotor_coefficients(
    per_mass: float, torque_over_thrust: float, known: Mapping[str, Constant]
) -> tuple[dict[str, Constant], dict[str, str]]:
    """k_f and k_m as far as they can be told, and how the others follow from what is asked for.

    Args:
        per_mass: see `lift`.
        torque_over_thrust: k_m / k_f [m]; 0: not known.
        known: constants that are.

    Returns:
        Constants, and hints by the name of one that is still open.
    """
    found, hints = dict[str, Constant](), dict[str, str]()
    force = known.get("thrust_coefficient")
    if force is None and per_mass and "mass" in known:
        force = Constant(_short(per_mass * known["mass"].value), "mass × specific force over Σ ω², medians of the log")
        found["thrust_coefficient"] = force
    elif force is None and per_mass:
        hints["thrust_coefficient"] = f"by the flights {per_mass:.4g} × mass: specific force over Σ ω², medians"
    if torque_over_thrust and "torque_coefficient" not in known:
        ratio = f"{torque_over_thrust:.4g} m × thrust_coefficient, as CA_ROTOR*_KM have it"
        if force is not None:
            found["torque_coefficient"] = Constant(_short(torque_over_thrust * force.value), ratio)
        else:
            hints["torque_coefficient"] = ratio
    return found, hints


def _short(x: float) -> float:
    return float(f"{x:.5g}")
