"""The cases of the second chain: every effect on every vehicle, sets of effects, and flights without any."""

from dataclasses import replace
from typing import Any

import numpy as np

from bench.score.chain.case import ChainCase
from bench.score.chain.recorder import CLOCKS
from bench.score.chain.strengths import BESIDE, TYPICAL, draw, identity
from bench.score.chain.vehicle.airframe import AIRFRAMES, specimen

DEVELOPMENT, REPORTED = 101, 117
"""Seeds: what is tuned on one is reported on the other."""
SECONDS = 20.0
VEHICLES = tuple(AIRFRAMES)
SLOWEST = {"survey": 0.045, "racer": 0.03, "nano": 0.06, "carrier": 0.06}
"""Time constant of a vehicle's motors, at most [s]."""
COMMANDED = ("motor_lag", "input_delay")
CONSTANTS = ("mass", "thrust_scale", "torque_scale", "inertia_products")
"""Effects that are nothing but a constant: hidden only where constants are stated well."""

PAIRS = (
    ("rotor_drag", "cog_offset"),
    ("rotor_drag", "ground_effect"),
    ("rotor_drag", "inflow_thrust_loss"),
    ("rotor_drag", "battery_sag_volts"),
    ("linear_drag", "battery_sag"),
    ("linear_drag", "rotor_misalignment"),
    ("parasitic_drag", "unequal_rotors"),
    ("blade_flapping", "rotor_drag"),
    ("blade_flapping", "rotational_damping"),
    ("rotor_reaction_torque", "rotor_drag"),
    ("rotor_gyroscopic_torque", "linear_drag"),
    ("rotor_reaction_torque", "inertia_products"),
    ("torque_bias", "inflow_thrust_loss"),
    ("translational_lift", "rotor_drag"),
    ("suspended_load", "linear_drag"),
    ("mass", "rotor_drag"),
    ("thrust_scale", "linear_drag"),
    ("motor_lag", "rotor_drag"),
    ("input_delay", "linear_drag"),
)
TRIPLES = (
    ("rotor_drag", "inflow_thrust_loss", "translational_lift"),
    ("rotor_drag", "cog_offset", "battery_sag_volts"),
    ("rotor_drag", "ground_effect", "rotor_misalignment"),
    ("blade_flapping", "rotor_drag", "torque_bias"),
    ("linear_drag", "unequal_rotors", "rotor_reaction_torque"),
    ("linear_drag", "thrust_scale", "rotational_damping"),
    ("rotor_drag", "inflow_thrust_loss", "cog_offset"),
    ("motor_lag", "rotor_drag", "torque_bias"),
)
BLOWN = ("rotor_drag", "linear_drag", "parasitic_drag")
"""Through which gusts are felt."""
NOTHING = {"calm": 160, "rough": 100, "turbulent": 60}
"""Sets without a hidden effect: constants stated well, roughly, and either in turbulence with a known drag."""


class _Deck:
    """Values in a shuffled order, each as often as any other."""

    def __init__(self, rng: np.random.Generator, values: tuple[Any, ...]) -> None:
        self.rng, self.values, self.left = rng, values, list[Any]()

    def draw(self) -> Any:
        if not self.left:
            self.left = [self.values[i] for i in self.rng.permutation(len(self.values))]
        return self.left.pop()


class _Conditions:
    """How the cases of one group are flown and logged."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng
        choices: dict[str, tuple[Any, ...]] = {
            "control_hz": (100, 250, 500),
            "log_hz": (50, 100, 100, 200, 200),
            "states": ("capture", "estimator"),
            "clock": CLOCKS,
            "accelerometer": (False, True),
            "noise": ("low", "medium", "high"),
            "style": ("aggressive", "brisk", "aggressive", "gentle"),
            "rough": (False, True),
        }
        self.decks = {name: _Deck(rng, values) for name, values in choices.items()}

    def draw(self, vehicle: str) -> dict[str, Any]:
        """Fields of a `ChainCase`."""
        rng, drawn = self.rng, {name: deck.draw() for name, deck in self.decks.items()}
        tau = float(np.exp(rng.uniform(np.log(0.005), np.log(SLOWEST[vehicle]))))
        drawn["lag"] = (round(tau, 4), round(tau * float(rng.choice([1.0, 1.0, 1.4])), 4))
        drawn["telemetry"] = round(float(rng.choice([0.0, 0.0, rng.uniform(0.002, 0.01)])), 4)
        drawn["jitter"] = round(float(rng.uniform(0.03, 0.15)), 3)
        return drawn


def cases(seed: int, quick: bool = False) -> list[ChainCase]:
    """The whole suite of the chain, or a small part of each condition.

    Args:
        seed: `DEVELOPMENT` or `REPORTED`: nothing is shared between two seeds.
        quick: about a tenth, for continuous integration.
    """
    out: list[ChainCase] = []
    for number, group in enumerate((_singles, _several, _nothing)):
        found = group(np.random.default_rng([seed, number]), 10_000 * seed + 1_000 * number)
        if quick:
            found = [replace(c, recordings=4, seconds=15.0) for c in found[::11]]
        out += [replace(c, id=f"{seed}-{c.id}") for c in found]
    return out


def _hidden(
    rng: np.random.Generator, keys: tuple[str, ...], vehicle: str, flight: int, factor: float
) -> dict[str, Any]:
    """The fields that say what is hidden; wind needs a drag to be felt through."""
    # Strengths go with the specimen, which the flight's seed draws.
    craft = specimen(np.random.default_rng([flight, 0]), vehicle)
    several = len(keys) > 1
    effects = {identity(k): draw(rng, k, craft, factor * (BESIDE.get(k, 1.0) if several else 1.0)) for k in keys}
    known = {"rotor_drag": draw(rng, "rotor_drag", craft, 1.0)} if "wind" in keys else {}
    drive = "rotor_command" if set(keys) & set(COMMANDED) else "rotor_speed"
    return {"effects": effects, "known": known, "drive": drive}


def _case(
    rng: np.random.Generator,
    conditions: _Conditions,
    keys: tuple[str, ...],
    vehicle: str,
    factor: float,
    flight: int,
    condition: str,
) -> ChainCase:
    drawn, hidden = conditions.draw(vehicle), _hidden(rng, keys, vehicle, flight, factor)
    if set(keys) & set(CONSTANTS):
        drawn["rough"] = False
    if set(keys) & set(COMMANDED):
        drawn |= {"log_hz": max(drawn["log_hz"], 100), "control_hz": min(drawn["control_hz"], 250), "telemetry": 0.0}
    if set(keys) & set(BLOWN) and rng.random() < 0.25:
        drawn["turbulence"] = round(float(rng.uniform(2.0, 6.0)), 1)
    name = f"{condition}-{'+'.join(keys)}-{vehicle}-{factor:g}"
    return _named(ChainCase(id=name, vehicle=vehicle, condition=condition, flight_seed=flight, **drawn, **hidden))


def _named(case: ChainCase) -> ChainCase:
    """The case with what it is like in its id, and of the suite's length."""
    words = [case.style, case.noise, case.states, f"{case.control_hz}c{case.log_hz}"]
    words += ["rough"] * case.rough + ["turbulent"] * bool(case.turbulence)
    return replace(case, id="-".join([case.id, *words]), seconds=SECONDS)


def _singles(rng: np.random.Generator, first: int) -> list[ChainCase]:
    out: list[ChainCase] = []
    conditions = _Conditions(rng)
    factors = (1.0, 0.5, 2.0, 1.0)
    for row, key in enumerate(TYPICAL):
        for column, vehicle in enumerate(VEHICLES):
            factor = factors[(row + column) % len(factors)]
            out.append(
                _case(
                    rng, conditions, (key,), vehicle=vehicle, factor=factor, flight=first + len(out), condition="single"
                )
            )
    return out


def _several(rng: np.random.Generator, first: int) -> list[ChainCase]:
    out: list[ChainCase] = []
    conditions = _Conditions(rng)
    for condition, sets in (("pair", PAIRS), ("triple", TRIPLES)):
        for row, keys in enumerate(sets):
            for vehicle in (VEHICLES[row % 4], VEHICLES[(row + 1 + row // 4) % 4]):
                factor = round(float(rng.uniform(0.7, 1.5)), 2)
                out.append(
                    _case(
                        rng,
                        conditions,
                        keys,
                        vehicle=vehicle,
                        factor=factor,
                        flight=first + len(out),
                        condition=condition,
                    )
                )
    return out


def _nothing(rng: np.random.Generator, first: int) -> list[ChainCase]:
    out: list[ChainCase] = []
    for kind, count in NOTHING.items():
        conditions = _Conditions(rng)
        for i in range(count):
            vehicle, flight = VEHICLES[i % 4], first + len(out)
            drawn = conditions.draw(vehicle)
            turbulent = kind == "turbulent"
            drawn["rough"] = drawn["rough"] if turbulent else kind == "rough"
            if turbulent:
                craft = specimen(np.random.default_rng([flight, 0]), vehicle)
                drawn["turbulence"] = round(float(rng.uniform(2.0, 6.0)), 1)
                drawn["known"] = {"rotor_drag": draw(rng, "rotor_drag", craft, 1.0)}
            made = ChainCase(
                id=f"nothing-{kind}-{i:03d}-{vehicle}",
                vehicle=vehicle,
                condition="gusts" if turbulent else "nothing",
                verdicts=("nothing", "unknown_effect") if turbulent else ("nothing",),
                follows=("velocity",) if turbulent else (),
                flight_seed=flight,
                **drawn,
            )
            out.append(_named(made))
    return out
