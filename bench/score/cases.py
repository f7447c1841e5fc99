"""The conditions under which a diagnosis is tried: a fractional design."""

from dataclasses import replace
from typing import Any

import numpy as np

from bench.score.case import Case, clean, fly, fly_and_faults, nominal, truth
from bench.score.multirotor.corrupt import KINDS
from bench.score.multirotor.strengths import TYPICAL, draw, drive, identity
from bench.score.trial import write_folder

__all__ = ["Case", "cases", "clean", "fly", "fly_and_faults", "nominal", "truth", "write_folder"]

DEVELOPMENT, REPORTED = 1, 9
"""Seeds: what is tuned on one is reported on the other."""

VEHICLES = ("hummingbird", "crazyflie")
NOISES = ("low", "medium", "high")
SECONDS = 20.0

GENTLE_TOO = (
    "battery_sag",
    "battery_sag_volts",
    "blade_flapping",
    "cog_offset",
    "ground_effect",
    "inflow_thrust_loss",
    "linear_drag",
    "mass",
    "rotor_drag",
    "rotor_misalignment",
    "thrust_scale",
    "torque_bias",
    "unequal_rotors",
    "wind",
)
"""Effects that gentle flights show; the others are flown aggressively only."""

PAIRS = (
    ("rotor_drag", "mass"),
    ("rotor_drag", "ground_effect"),
    ("rotor_drag", "cog_offset"),
    ("linear_drag", "battery_sag"),
    ("inflow_thrust_loss", "rotor_drag"),
    ("blade_flapping", "rotor_drag"),
    ("rotor_gyroscopic_torque", "rotational_damping"),
    ("thrust_scale", "linear_drag"),
    ("torque_bias", "inflow_thrust_loss"),
    ("unequal_rotors", "rotor_drag"),
    ("suspended_load", "rotor_drag"),
    ("translational_lift", "rotor_drag"),
    ("rotor_reaction_torque", "inertia_products"),
    ("motor_lag", "linear_drag"),
)
TRIPLES = (
    ("rotor_drag", "inflow_thrust_loss", "translational_lift"),
    ("rotor_drag", "ground_effect", "mass"),
    ("rotor_drag", "cog_offset", "battery_sag"),
    ("blade_flapping", "rotor_drag", "torque_bias"),
    ("linear_drag", "thrust_scale", "rotational_damping"),
    ("inflow_thrust_loss", "rotor_drag", "ground_effect"),
)
BALANCE = {
    "battery_sag": 1.5,
    "cog_offset": 0.15,
    "ground_effect": 1.5,
    "inflow_thrust_loss": 0.4,
    "rotational_damping": 0.5,
    "rotor_gyroscopic_torque": 2.5,
    "torque_bias": 0.5,
    "translational_lift": 2.0,
    "unequal_rotors": 0.35,
}
"""Factors on the strength beside other effects, so that none of them drowns the rest."""
UNKNOWN: tuple[tuple[str, tuple[str, ...], tuple[str, ...]], ...] = (
    ("rotor_drag", ("linear_drag",), ("velocity", "rotor_speed")),
    ("inflow_thrust_loss", ("linear_drag",), ("velocity", "rotor_speed")),
    ("ground_effect", (), ("position",)),
    ("suspended_load", (), ("velocity", "position", "time")),
    ("battery_sag", (), ("time", "battery")),
    ("vortex_ring_state", (), ("velocity",)),
    ("blade_flapping", (), ("velocity",)),
)
"""An effect that is taken out of the catalogue, what goes with it as much the same, and the signals that it follows."""
TIED: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("cog_offset", ("torque_bias", "unequal_rotors")),
    ("torque_bias", ("cog_offset", "unequal_rotors")),
    ("mass", ("thrust_scale", "unequal_rotors")),
    ("thrust_scale", ("mass", "unequal_rotors")),
)
"""Effects that hover does not tell apart."""


def cases(seed: int, quick: bool = False) -> list[Case]:
    """The whole suite, or a small part of each condition.

    Args:
        seed: `DEVELOPMENT` or `REPORTED`: nothing is shared between two seeds.
        quick: about a tenth, for continuous integration.
    """
    groups = (_singles, _several, _nothing, _unknown, _ties, _corrupted, _shifted)
    out: list[Case] = []
    for number, group in enumerate(groups):
        found = group(np.random.default_rng([seed, number]), 10_000 * seed + 1_000 * number)
        if quick:
            # A stride prime to the periods of the design keeps vehicles, styles and noise mixed.
            found = found[:: 7 if len(found) > 60 else 11]
            found = [replace(c, recordings=4, seconds=15.0) for c in found]
        out += [replace(c, id=f"{seed}-{c.id}") for c in found]
    return out


def _hidden(rng: np.random.Generator, keys: tuple[str, ...], vehicle: str, factor: float) -> dict[str, Any]:
    """The fields of a `Case` that say what is hidden; wind needs a drag to be felt through."""
    several = len(keys) > 1
    effects = {identity(k): draw(rng, k, vehicle, factor * (BALANCE.get(k, 1.0) if several else 1.0)) for k in keys}
    known = {"rotor_drag": draw(rng, "rotor_drag", vehicle, 1.0)} if "wind" in keys else {}
    return {"effects": effects, "known": known, "drive": drive(keys)}


def _singles(rng: np.random.Generator, first: int) -> list[Case]:
    out: list[Case] = []
    for row, key in enumerate(TYPICAL):
        calm = (1, 4) if row % 2 else (0, 5)  # a third of the columns: each vehicle, typical and strong
        for column, (vehicle, factor) in enumerate((v, f) for f in (1.0, 0.5, 2.0) for v in VEHICLES):
            style = "gentle" if key in GENTLE_TOO and column in calm else "aggressive"
            noise = NOISES[(row + column + column // 3) % 3]
            name = f"single-{key}-{vehicle}-{factor:g}-{style}-{noise}"
            fields = _hidden(rng, (key,), vehicle, factor)
            out.append(_case(name, vehicle, style, first + len(out), noise=noise, **fields))
    return out


def _several(rng: np.random.Generator, first: int) -> list[Case]:
    out: list[Case] = []
    for condition, sets in (("pair", PAIRS), ("triple", TRIPLES)):
        for row, keys in enumerate(sets):
            for vehicle in VEHICLES:
                noise = NOISES[(row + VEHICLES.index(vehicle)) % 2]
                name = f"{condition}-{'+'.join(keys)}-{vehicle}"
                fields = _hidden(rng, keys, vehicle, float(rng.uniform(0.7, 1.4)))
                out.append(_case(name, vehicle, "aggressive", first + len(out), condition, noise=noise, **fields))
    return out


def _nothing(rng: np.random.Generator, first: int) -> list[Case]:
    """75 sets of each kind, of few flights: what differs between sets of one flight is the noise."""
    out: list[Case] = []
    kinds = {
        "white": (("aggressive", "gentle", "hover"), ("none",)),
        "gentle": (("gentle",), ("savgol",)),
        "smoothing": (("aggressive", "gentle"), ("savgol_wide", "moving_average", "savgol")),
        "gusts": (("aggressive", "gentle"), ("savgol",)),
    }
    for number, (kind, (styles, smoothings)) in enumerate(kinds.items()):
        for i in range(75):
            vehicle, style = VEHICLES[i % 2], styles[i // 2 % len(styles)]
            smoothing = smoothings[i // (2 * len(styles)) % len(smoothings)]
            flight = first + 10 * number + i // 6 % 6
            gusts = {"effects": {"gusts": {"sigma": 0.5, "time": 1.0}}} if kind == "gusts" else {}
            drag = {"known": {"rotor_drag": dict(TYPICAL["rotor_drag"][i % 2])}} if kind == "gusts" else {}
            right = ("nothing", "unknown_effect") if kind == "gusts" else ("nothing",)
            out.append(
                _case(
                    f"nothing-{kind}-{i:02d}",
                    vehicle,
                    style,
                    flight,
                    "gusts" if kind == "gusts" else "nothing",
                    noise=NOISES[i % 3],
                    smoothing=smoothing,
                    seed=i,
                    verdicts=right,
                    follows=("velocity",) if gusts else (),
                    **gusts,
                    **drag,
                )
            )
    return out


def _unknown(rng: np.random.Generator, first: int) -> list[Case]:
    out: list[Case] = []
    for key, likes, follows in UNKNOWN:
        for factor in (1.0, 2.0):
            for vehicle in VEHICLES:
                fields = _hidden(rng, (key,), vehicle, factor)
                without = (key, *likes)
                name = f"unknown-{key}-{vehicle}-{factor:g}"
                out.append(_unknown_case(name, vehicle, first + len(out), follows, catalogue_without=without, **fields))
    for axis in range(3):
        for strength in (0.05, 0.1):
            for vehicle in VEHICLES:
                weight = 9.81 * (0.5 if vehicle == "hummingbird" else 0.044)
                there = {"axis": float(axis), "amplitude": strength * weight, "wavelength": float(rng.uniform(2, 4))}
                name = f"unknown-position_force_{'xyz'[axis]}-{vehicle}-{strength:g}"
                effects = {"position_force": there}
                out.append(_unknown_case(name, vehicle, first + len(out), ("position",), effects=effects))
    return out


def _unknown_case(name: str, vehicle: str, flight: int, follows: tuple[str, ...], **fields: Any) -> Case:
    return _case(
        name, vehicle, "aggressive", flight, "unknown", verdicts=("unknown_effect",), follows=follows, **fields
    )


def _ties(rng: np.random.Generator, first: int) -> list[Case]:
    out: list[Case] = []
    for key, others in TIED:
        for vehicle in VEHICLES:
            for factor in (1.0, 2.0):
                fields = _hidden(rng, (key,), vehicle, factor)
                if key == "torque_bias":  # neither an off-centre mass nor unequal thrust turns a hovering vehicle
                    fields["effects"]["torque_bias"]["t_z"] = 0.0
                name = f"tie-{key}-{vehicle}-{factor:g}"
                flight = first + len(out)
                out.append(_case(name, vehicle, "hover", flight, "tie", verdicts=("tie",), confounded=others, **fields))
    return out


def _corrupted(rng: np.random.Generator, first: int) -> list[Case]:
    out: list[Case] = []
    for kind in KINDS:
        for i in range(8):
            vehicle = VEHICLES[i % 2]
            # Half of them have an effect as well: a fault must not be explained by it, nor hidden.
            drag = {"effects": {"rotor_drag": dict(TYPICAL["rotor_drag"][i % 2])}} if i // 2 % 2 else {}
            out.append(
                _case(
                    f"corrupted-{kind}-{i}",
                    vehicle,
                    "aggressive",
                    first + i // 4,
                    "corrupted",
                    noise=NOISES[i % 3],
                    corruption=kind,
                    seed=len(out),
                    verdicts=("data_problem",),
                    **drag,
                )
            )
    return out


def _shifted(rng: np.random.Generator, first: int) -> list[Case]:
    return [
        _case(
            f"shifted-{i}",
            VEHICLES[i % 2],
            "aggressive",
            first + i // 6,
            "shifted",
            noise=NOISES[i % 3],
            corruption="time_shift",
            seed=i,
            verdicts=("named", "data_problem"),
        )
        for i in range(12)
    ]


def _case(name: str, vehicle: str, style: str, flight: int, condition: str = "single", **fields: Any) -> Case:
    return Case(
        id=name,
        vehicle=vehicle,
        style=style,
        condition=condition,
        flight_seed=flight,
        seconds=SECONDS,
        **fields,
    )
