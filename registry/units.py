"""Units of every signal: SI inside, other units only at the border (files, reports)."""

import math
from dataclasses import dataclass

from registry.errors import BenchError, near

_TO_SI: dict[str, tuple[str, float]] = {
    "1": ("1", 1.0),
    "%": ("1", 0.01),
    "s": ("s", 1.0),
    "ms": ("s", 1e-3),
    "us": ("s", 1e-6),
    "m": ("m", 1.0),
    "cm": ("m", 1e-2),
    "mm": ("m", 1e-3),
    "m/s": ("m/s", 1.0),
    "cm/s": ("m/s", 1e-2),
    "mm/s": ("m/s", 1e-3),
    "km/h": ("m/s", 1 / 3.6),
    "m/s^2": ("m/s^2", 1.0),
    "g": ("m/s^2", 9.80665),
    "rad": ("rad", 1.0),
    "deg": ("rad", math.pi / 180),
    "rad/s": ("rad/s", 1.0),
    "deg/s": ("rad/s", math.pi / 180),
    "rpm": ("rad/s", math.pi / 30),
    "kg": ("kg", 1.0),
    "N": ("N", 1.0),
    "N m": ("N m", 1.0),
    "V": ("V", 1.0),
    "mV": ("V", 1e-3),
    "A": ("A", 1.0),
    "pwm": ("pwm", 1.0),  # raw counts of a driver: a scale of their own
}


def to_si(unit: str) -> tuple[str, float]:
    """The SI unit of ``unit`` and the factor that converts a value to it.

    Raises:
        BenchError: a unit that is not in the table.
    """
    if unit not in _TO_SI:
        raise BenchError(f"Unknown unit {unit!r}: {near(unit, _TO_SI)}")
    return _TO_SI[unit]


def exponents(unit: str) -> dict[str, int]:
    """The SI symbols of a compound unit and their powers: "N m s^2", "kg/rad", "1/s".

    Raises:
        BenchError: a symbol that is not in the table, or not of SI, or a power that is not a whole number.
    """
    found: dict[str, int] = {}
    for place, part in enumerate(unit.split("/")):
        for factor in part.split() or [""]:
            symbol, caret, power = factor.partition("^")
            if to_si(symbol)[0] != symbol or not (power.isdecimal() if caret else not power):
                raise BenchError(f"The unit {unit!r} must be of SI, such as N m s^2 or kg/rad, not {factor!r}.")
            if symbol != "1":
                found[symbol] = found.get(symbol, 0) + (-1 if place else 1) * int(power or 1)
    return found


def display(si_unit: str, signal: str = "") -> tuple[str, float]:
    """The unit a report shows, as the paper does, and the factor from SI: rad/s → deg/s (not of rotors), rad → deg."""
    if signal.startswith("rotor"):
        return si_unit, 1.0
    return {"rad/s": ("deg/s", 180 / math.pi), "rad": ("deg", 180 / math.pi)}.get(si_unit, (si_unit, 1.0))


@dataclass(frozen=True)
class Signal:
    """A group of channels: SI unit and the names of its axes (empty: as many as the data have)."""

    unit: str
    axes: tuple[str, ...] = ()
    about: str = ""


SIGNALS: dict[str, Signal] = {
    "position": Signal("m", ("x", "y", "z"), "world frame, z up"),
    "velocity": Signal("m/s", ("x", "y", "z"), "world frame"),
    "attitude": Signal("1", ("qx", "qy", "qz", "qw"), "unit quaternion, body to world"),
    "body_rates": Signal("rad/s", ("p", "q", "r"), "body frame: x forward, y left, z up"),
    "euler_rates": Signal("rad/s", ("roll", "pitch", "yaw"), "time derivative of the Euler ZYX angles"),
    "specific_force": Signal("m/s^2", ("x", "y", "z"), "accelerometer, body frame"),
    "rotor_speed": Signal("rad/s", (), "measured, one a rotor"),
    "rotor_command": Signal("rad/s", (), "commanded, one a rotor"),
    "motor_count": Signal("pwm", (), "measured rotor speed in its controller's integer scale"),
    "pwm": Signal("pwm", (), "raw motor command"),
    "elevon": Signal("pwm", (), "raw servo command"),
    "pilot": Signal("1", ("aileron", "elevator", "rudder", "collective"), "pilot sticks, -1 to 1"),
    "battery": Signal("V", (), "supply voltage"),
    "force": Signal("N", (), "force on the driven part"),
    "voltage": Signal("V", (), "drive voltage"),
    "level": Signal("V", ("h",), "liquid level of the (lower) tank, as its sensor gives it"),
    "upper_level": Signal("V", ("h",), "liquid level of the upper tank"),
    "displacement": Signal("m", ("q",), "position along the one axis of motion"),
    "speed": Signal("m/s", ("q",), "its time derivative"),
    "angle": Signal("rad", ("theta",), "of a pendulum, from hanging at rest"),
    "angle_rate": Signal("rad/s", ("theta",), "its time derivative"),
    "van_der_pol": Signal("1", ("x", "y"), "states of the Van der Pol oscillator"),
    "lorenz": Signal("1", ("x", "y", "z"), "states of the Lorenz system"),
    "wind": Signal("m/s", ("x", "y", "z"), "world frame"),
}
