"""One condition under which a diagnosis is tried: its flights, its logs and what is true of them."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache as once
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from bench.score.multirotor.corrupt import KINDS, Fault, time_shift
from bench.score.multirotor.measure import LEVELS, SMOOTHINGS, measure
from registry.atomic_io import replacing
from registry.core import EFFECTS
from registry.dynamics import PhysicsModel
from registry.errors import not_installed

try:
    from bench.score.multirotor import flights, hidden, references
except ModuleNotFoundError as error:
    raise not_installed("Scoring", "rotorpy==3.0.0") from error

Columns = dict[str, np.ndarray]


@dataclass(frozen=True)
class Vehicle:
    """A vehicle file of RotorPy, and what it leaves open."""

    module: str
    around: hidden.Surroundings
    lowest: float
    """Of the references [m]."""
    gains: tuple[float, float]
    """Of the attitude loop (proportional, derivative)."""
    yaw_gains: tuple[float, float]
    """Of the yaw loop where rotors react: a stiff one, sampled, can feed the reaction torque back into itself."""


VEHICLES = {
    "hummingbird": Vehicle("hummingbird_params", hidden.Surroundings(0.10), 0.16, (544.0, 46.64), (6.0, 3.0)),
    "crazyflie": Vehicle("crazyfliebrushless_params", hidden.Surroundings(0.0275), 0.11, (150.0, 22.0), (150.0, 22.0)),
}
"""Two vehicles. Of the second, RotorPy gives no rotor radius, and gains that are for motors without lag."""
SLOW_GAINS = (80.0, 15.0)
"""Of the attitude loop where commands are held at 100 Hz and may be late."""
CLEARANCE = 0.2
"""More height for vehicles whose motors are late [m]."""
OUTSIDE = ("position_force", "gusts")
"""What no catalogue has."""
UNCERTAINTY = {"mass": 0.01, "inertia": 0.02, "thrust_coefficient": 0.02, "torque_coefficient": 0.02}
"""Relative 1σ of the nominal constants; the true ones are drawn within it."""


@dataclass(frozen=True)
class Case:
    """One set of logs and what is true of it."""

    id: str
    vehicle: str = "hummingbird"
    style: str = "aggressive"
    effects: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Hidden effects, with true parameters (SI), beyond the base model."""
    known: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Effects that fly along and are in the base model that is diagnosed."""
    condition: str = "single"
    noise: str = "medium"
    """Of `measure.LEVELS`."""
    smoothing: str = "savgol"
    """Of `measure.SMOOTHINGS`."""
    corruption: str = ""
    catalogue_without: tuple[str, ...] = ()
    """Effects that the diagnosis must do without."""
    drive: str = "rotor_speed"
    recordings: int = 6
    seconds: float = 25.0
    flight_seed: int = 0
    """Draws true constants, references and gusts: cases that share it share flights."""
    seed: int = 0
    """Draws noise and corruption."""
    verdicts: tuple[str, ...] = ("named",)
    """Right answers; where one is "named", the names must be those of `names`."""
    confounded: tuple[str, ...] = ()
    """Effects that these flights cannot tell from the true one: a tie may hold them."""
    follows: tuple[str, ...] = ()
    """Signals that an unknown effect depends on: one of them should be said."""

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Parameters that no flight can tell, as effect.parameter: their error is not asked for."""
        return ()

    @property
    def names(self) -> tuple[str, ...]:
        """Effects to be named: those hidden ones that the catalogue has; a shifted clock is a delay."""
        if self.corruption == "time_shift":
            return ("input_delay",)
        return tuple(e for e in self.effects if e not in (*self.catalogue_without, *OUTSIDE))


@once
def _rotorpy(vehicle: str) -> dict[str, Any]:
    module = import_module(f"rotorpy.vehicles.{VEHICLES[vehicle].module}")
    return dict(module.quad_params)


def nominal_parameters(case: Case) -> dict[str, Any]:
    """RotorPy's vehicle file as it is."""
    return dict(_rotorpy(case.vehicle))


def surroundings(case: Case) -> hidden.Surroundings:
    """Rotors, battery, ground and air of ``case``."""
    return VEHICLES[case.vehicle].around


def parameters(case: Case) -> dict[str, Any]:
    """RotorPy's vehicle file with the true base constants of ``case``."""
    out = _rotorpy(case.vehicle)
    rng = np.random.default_rng([case.flight_seed, 0, list(VEHICLES).index(case.vehicle)])
    draws = iter(rng.normal(size=6))

    def off(key: str) -> float:
        return 1 + UNCERTAINTY[key] * float(np.clip(next(draws), -2, 2))

    true = {"mass": out["mass"] * off("mass")}
    true |= {key: out[key] * off("inertia") for key in ("Ixx", "Iyy", "Izz")}
    true |= {"k_eta": out["k_eta"] * off("thrust_coefficient"), "k_m": out["k_m"] * off("torque_coefficient")}
    return out | true


def _constants(p: Mapping[str, Any]) -> dict[str, Any]:
    """Those of RotorPy's parameters that are drawn, as a model names them; SI."""
    return {
        "mass": p["mass"],
        "inertia": [p["Ixx"], p["Iyy"], p["Izz"]],
        "thrust_coefficient": p["k_eta"],
        "torque_coefficient": p["k_m"],
    }


def changed_constants(case: Case) -> dict[str, list[dict[str, float]]]:
    """By hidden effect that is nothing but other base constants, what the model's calibration may say: true values.

    For each of these constants: that constant, or its ratio to another one where flights tell no more.
    """
    return of_changed(case, _constants(parameters(case)))


def of_changed(case: Case, base: Mapping[str, Any]) -> dict[str, list[dict[str, float]]]:
    """`changed_constants` of a vehicle with these constants without what is hidden; SI.

    A torque that is larger by a factor turns like a moment of inertia that is smaller by it, up to ω × I ω.
    """
    mass = base["mass"] + case.effects.get("mass", {}).get("delta", 0.0)
    thrust = base["thrust_coefficient"] * (1 + case.effects.get("thrust_scale", {}).get("eps", 0.0))
    scales = case.effects.get("torque_scale", {}).values()
    turned_by = (("thrust_coefficient", thrust),) * 2 + (("torque_coefficient", base["torque_coefficient"]),)
    inertia = [moment / (1 + scale) for moment, scale in zip(base["inertia"], scales, strict=False)]
    lifts = {"thrust_coefficient / mass": thrust / mass}
    out = {
        "mass": [{"mass": mass, **lifts}],
        "thrust_scale": [{"thrust_coefficient": thrust, **lifts}],
        "torque_scale": [
            {f"inertia[{i}]": moment, f"{name} / inertia[{i}]": value / moment}
            for i, (moment, (name, value)) in enumerate(zip(inertia, turned_by, strict=False))
        ],
    }
    return {effect: constants for effect, constants in out.items() if effect in case.effects}


def true_model(case: Case, base: PhysicsModel) -> PhysicsModel:
    """``base`` with the true constants and the hidden effects."""
    constants = _constants(parameters(case))
    constants["inertia"] = tuple(constants["inertia"])
    hidden = (EFFECTS.get(name)(**values) for name, values in case.effects.items())
    return replace(base, **constants, effects=(*base.effects, *hidden))


def nominal(case: Case) -> dict[str, Any]:
    """The constants that the user is given, as in `dataset.toml` [physics]; SI."""
    p = _rotorpy(case.vehicle)
    return _constants(p) | {
        "rotor_positions": [[float(x) for x in r] for r in p["rotor_pos"].values()],
        "rotor_directions": [int(s) for s in p["rotor_directions"]],
        "rotor_radius": VEHICLES[case.vehicle].around.rotor_radius,
    }


def all_effects(case: Case) -> dict[str, Mapping[str, float]]:
    """Hidden and known effects together."""
    return {**case.known, **case.effects}


def craft(case: Case, charge: np.ndarray) -> hidden.HiddenMultirotor:
    """The true vehicle; ``charge`` (B,) as in `hidden.HiddenMultirotor`."""
    return hidden.HiddenMultirotor(parameters(case), all_effects(case), VEHICLES[case.vehicle].around, charge)


def charges(case: Case) -> np.ndarray:
    """Voltage of a cell at the start of each recording (B,), over the reference [V]."""
    return np.random.default_rng([case.flight_seed, 1]).uniform(-0.05, 0.1, case.recordings)


def _flight_key(case: Case) -> str:
    """Of everything that determines the flights, the code that flies them included."""
    sources = [Path(str(m.__file__)).read_bytes() for m in (flights, hidden, references)]
    names = ("vehicle", "style", "drive", "recordings", "seconds", "flight_seed")
    what = {name: getattr(case, name) for name in names}
    what |= {"effects": all_effects(case), "rotorpy": version("rotorpy")}
    what["chosen"] = (repr(VEHICLES[case.vehicle]), SLOW_GAINS, CLEARANCE, UNCERTAINTY)
    digest = hashlib.sha256(json.dumps(what, sort_keys=True, default=dict).encode())
    for source in sources:
        digest.update(source)
    return digest.hexdigest()[:20]


def truth(case: Case, cache: Path) -> flights.Truth:
    """The true flights of ``case``, from ``cache`` where they have been flown before."""
    path = Path(cache) / f"{_flight_key(case)}.npz"
    if path.exists():
        with np.load(path, allow_pickle=False) as stored:
            return flights.Truth(*(stored[name] for name in ("state", "speed", "command", "wind")))
    flown = _fly(case)
    with replacing(path, flushed=False) as draft, draft.open("wb") as file:
        np.savez(file, **vars(flown))
    return flown


def _fly(case: Case) -> flights.Truth:
    vehicle, effects = VEHICLES[case.vehicle], all_effects(case)
    vessel = craft(case, charges(case))
    p = parameters(case)
    kp, kd = SLOW_GAINS if case.drive == "rotor_command" else vehicle.gains
    yaw = vehicle.yaw_gains if "rotor_reaction_torque" in effects else (kp, kd)
    p |= {"kp_att": np.array([kp, kp, yaw[0]]), "kd_att": np.array([kd, kd, yaw[1]])}
    # The pilot is trimmed, as an integrator would do: heavy vehicles do not sag into the ground.
    p |= {"mass": vessel.mass, "k_eta": vessel.k_eta}
    seconds = case.seconds + flights.WARM_UP
    lowest = vehicle.lowest + (CLEARANCE if case.drive == "rotor_command" else 0.0)
    wanted = [
        references.reference(np.random.default_rng([case.flight_seed, 2, i]), case.style, seconds, flights.STEP, lowest)
        for i in range(case.recordings)
    ]
    rng = np.random.default_rng([case.flight_seed, 3])
    air = hidden.wind(rng, effects, 2 * len(wanted[0]) - 1, case.recordings, flights.STEP / 2)
    motors = hidden.motors(effects, case.drive, p["tau_m"])
    every = flights.EVERY if case.drive == "rotor_command" else 1
    return flights.fly(vessel, flights.Pilot(p), motors, np.stack(wanted, axis=2), air, every)


def fly(case: Case, cache: Path) -> list[Columns]:
    """The logs of ``case``, one dict of columns a recording, with their faults; see `measure.measure`."""
    return fly_and_faults(case, cache)[0]


def fly_and_faults(case: Case, cache: Path) -> tuple[list[Columns], list[Fault]]:
    """The logs of ``case`` and what was spoilt in them."""
    logs = clean(case, truth(case, cache))
    if not case.corruption:
        return logs, []
    if case.corruption == "time_shift":
        pairs = [time_shift(log, i) for i, log in enumerate(logs)]
        return [p[0] for p in pairs], [p[1] for p in pairs]
    rng = np.random.default_rng([case.flight_seed, 5, case.seed])
    i = int(rng.integers(len(logs)))
    logs[i], fault = KINDS[case.corruption](rng, logs[i], i)
    return logs, [fault]


def clean(case: Case, flown: flights.Truth) -> list[Columns]:
    """What good sensors log of the flights ``flown``."""
    vessel, has_voltage = craft(case, charges(case)), "slope" in all_effects(case).get("battery_sag", {})
    logs = []
    for i in range(case.recordings):
        state, speed, command = (x[:, :, i] for x in (flown.state, flown.speed, flown.command))
        t = np.arange(len(state)) / flights.RATE
        volts = vessel.voltage(t, speed.T, vessel.charge[i]) if has_voltage else None
        rng = np.random.default_rng([case.flight_seed, 4, case.seed, i])
        noise, how = LEVELS[case.noise], SMOOTHINGS[case.smoothing]
        logs.append(measure(rng, state, speed, command=command, battery=volts, noise=noise, how=how, rate=flights.RATE))
    return logs
