"""Units of every signal: SI inside, other units only at the border (files, reports).

A signal that no physics model knows is kept in the unit that its data state.
"""

import math
import re
from dataclasses import dataclass
from functools import cache
from typing import Any

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


def is_listed(unit: str) -> bool:
    """Whether `to_si` knows a unit; others belong to signals that are kept in the unit of their data."""
    return unit in _TO_SI


def conversion(unit: str, wanted: str) -> tuple[float, float]:
    """Factor and offset from ``unit`` to ``wanted``: a value x becomes factor · x + offset.

    Units of the table convert exactly as it says; all others as Pint knows them.

    Raises:
        BenchError: one of the two is unknown, or they measure different things.
    """
    if unit == wanted:
        return 1.0, 0.0
    if unit in _TO_SI and _TO_SI[unit][0] == wanted:
        return _TO_SI[unit][1], 0.0
    for text in (unit, wanted):
        if not _PRODUCT.fullmatch(text):
            raise BenchError(f"The unit {text!r} cannot be converted: write it as a product of powers, such as m/s^2.")
    differ = f"{unit!r} does not measure what {wanted!r} does: state the unit of the data."
    try:
        if _root(unit) != _root(wanted):
            raise BenchError(differ)
        at_zero, at_one = (_units().Quantity(x, unit).to(wanted).magnitude for x in (0.0, 1.0))
    except BenchError:
        raise
    except Exception as error:  # parsers of units raise what they like
        raise BenchError(f"No conversion from {unit!r} to {wanted!r} is known: {error}") from error
    return float(at_one - at_zero), float(at_zero)


def measures(unit: str, wanted: str) -> bool:
    """Whether values in ``unit`` can be converted to ``wanted``."""
    try:
        conversion(unit, wanted)
    except BenchError:
        return False
    return True


_UNIT = re.compile(r"[\w%°µΩ·*/^().,\-− ²³]{1,24}")


_PRODUCT = re.compile(r"[^\W\d]*[%°]?1?(?:\^?-?\d)?(?:[ /*·][^\W\d]*[%°]?1?(?:\^?-?\d)?)*")
"""No power of a power: Pint would compute it."""


def checked(unit: str) -> str:
    """A unit that is shown beside numbers, as it was given.

    Raises:
        BenchError: it is empty, longer than 24 characters or has signs that no unit has.
    """
    if not _UNIT.fullmatch(unit) or not unit.strip():
        raise BenchError(f'{unit!r} is no unit: write one such as "L/min", and "1" where there is none.')
    return unit


@cache
def _units() -> Any:
    """Pint's units, which take half a second to read."""
    import pint

    return pint.UnitRegistry()


_SPELT = {"rpm": "rpm", "°c": "degC", "sec": "s", "-": "1", "none": "1", "volt": "V", "volts": "V", "nm": "N m"}
_SIGNS = (
    ("°", "deg"),
    ("²", "^2"),
    ("·", " "),
    ("µ", "u"),
    ("μ", "u"),
    ("/sec", "/s"),
    ("**", "^"),
    ("m/s/s", "m/s^2"),
)


@cache
def unit_of(text: str) -> str:
    """The unit that a cell of a table names, as "m/s", "[deg]", "m/s²" or "RPM"; empty: it names none."""
    text = text.strip().strip("[]()").strip()
    text = _SPELT.get(text.lower(), text)
    for written, meant in _SIGNS:
        text = text.replace(written, meant)
    if text in _TO_SI:
        return text
    if len(text) > 24 or not text or text[0].isdigit() or not _PRODUCT.fullmatch(text):
        return ""
    try:
        _root(text)
    except Exception:  # parsers of units raise what they like
        return ""
    return text


def _root(unit: str) -> str:
    """The base units of a unit; angles count, so that Hz is not rad/s."""
    return str(_units().Quantity(1.0, unit).to_root_units().units)


def exponents(unit: str) -> dict[str, float]:
    """The SI symbols of a compound unit and their powers: "N m s^2", "kg/rad", "1/(N m)".

    Raises:
        BenchError: a symbol that is not in the table, or not of SI, or a power that is no positive number.
    """
    for factor in (factor for part in bare(unit).split("/") for factor in part.split() or [""]):
        symbol, caret, power = factor.partition("^")
        if to_si(symbol)[0] != symbol or not (re.fullmatch(r"\d+(\.\d+)?", power) if caret else not power):
            raise BenchError(f"The unit {unit!r} must be of SI, such as N m s^2 or kg/rad, not {factor!r}.")
    return powers_of(unit)


def bare(unit: str) -> str:
    """A unit without the brackets about all that is below its stroke."""
    return re.sub(r"/\(([^()/]*)\)", r"/\1", unit)


def powers_of(product: str) -> dict[str, float]:
    """The names in a product of powers, such as "N m s^2" or "force/displacement^3", and how often each is in it."""
    found: dict[str, float] = {}
    for place, part in enumerate(bare(product).split("/")):
        for factor in part.split():
            name, _, power = factor.partition("^")
            if name != "1":
                found[name] = found.get(name, 0) + (-1 if place else 1) * float(power or 1)
    return found


def display(si_unit: str, signal: str = "") -> tuple[str, float]:
    """The unit a report shows, as the paper does, and the factor from SI: rad/s → deg/s (not of rotors), rad → deg."""
    if signal.startswith("rotor"):
        return si_unit, 1.0
    return {"rad/s": ("deg/s", 180 / math.pi), "rad": ("deg", 180 / math.pi)}.get(si_unit, (si_unit, 1.0))


@dataclass(frozen=True)
class Signal:
    """A group of channels: its unit, SI, and the names of its axes (empty: as many as the data have)."""

    unit: str
    axes: tuple[str, ...] = ()
    about: str = ""


def channel_names(signal: str, axes: tuple[str, ...]) -> tuple[str, ...]:
    """The channels of a signal: "flow.inlet" of its axes, the signal's own name where it has one without a name."""
    return tuple(f"{signal}.{axis}" if axis else signal for axis in axes)


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
"""Those that the physics models and effects here know; data and models bring others (`PhysicsModel.signals`)."""
