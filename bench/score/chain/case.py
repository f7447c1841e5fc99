"""A case of the second chain: a specimen, what is hidden in it, how it is flown, logged and described."""

import hashlib
import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from bench.diagnose.logs.load import load
from bench.diagnose.logs.subject import Subject
from bench.score.case import of_changed
from bench.score.chain import flight, folder, oracle, paths, pilot, point, recorder
from bench.score.chain.condition import ChainCase
from bench.score.chain.vehicle import turbulence
from bench.score.chain.vehicle.airframe import AIRFRAMES, Airframe, specimen
from bench.score.chain.vehicle.body import Body, Effects, P
from bench.score.chain.vehicle.motors import Motors
from bench.score.logs import as_case, written_once
from registry.core import EFFECTS
from registry.dynamics import PhysicsModel

UNCERTAINTY = {"mass": 0.01, "inertia": 0.02, "thrust_coefficient": 0.02, "torque_coefficient": 0.02}
"""Relative 1σ, as written in dataset.toml, of constants that are stated well."""
ROUGH = {"inertia": (0.10, 0.30), "thrust_coefficient": (0.10, 0.25), "torque_coefficient": (0.10, 0.25)}
"""By how much constants are off, at least and at most, that are stated roughly: nothing is written about it."""
SCALES = 0.03
"""By how much mass and arms are off then, at most."""
HEIGHT = 5.0
"""At which turbulence is taken [m]."""
RADII = 3.0
"""Of a rotor, over the ground, that paths come down to."""
STRAYED, TRIES = 10.0, 8
"""From its path, from which a vehicle is lost [m], and how often another path is tried then, at most."""


def built(case: ChainCase) -> Airframe:
    """The specimen, without what is hidden."""
    return specimen(np.random.default_rng([case.flight_seed, 0]), case.vehicle)


def constants(craft: Airframe) -> dict[str, Any]:
    """Those of the base model, SI."""
    return {
        "mass": craft.mass,
        "inertia": list(craft.inertia),
        "thrust_coefficient": craft.thrust,
        "torque_coefficient": craft.drag,
        "rotor_positions": [[x, y, 0.0] for x, y in craft.hubs],
        "rotor_directions": list(craft.turns),
        "rotor_radius": craft.radius,
    }


def stated(case: ChainCase) -> dict[str, Any]:
    """The constants that the user is given, SI."""
    rng, true = np.random.default_rng([case.flight_seed, 1]), constants(built(case))

    def off(name: str, count: int) -> np.ndarray:
        if case.rough:
            low, high = ROUGH.get(name, (0.0, SCALES))
            return np.asarray(1 + rng.uniform(low, high, count) * rng.choice([-1.0, 1.0], count))
        return np.asarray(1 + UNCERTAINTY.get(name, 0.0) * np.clip(rng.normal(size=count), -2, 2))

    out = dict(true)
    for name in ("mass", "thrust_coefficient", "torque_coefficient"):
        out[name] = float(true[name] * off(name, 1)[0])
    out["inertia"] = [float(x) for x in true["inertia"] * off("inertia", 3)]
    arm = off("rotor_positions", 1)[0]
    out["rotor_positions"] = [[float(x * arm) for x in hub] for hub in true["rotor_positions"]]
    return out


def changed_constants(case: ChainCase) -> dict[str, list[dict[str, float]]]:
    """See `bench.score.case.changed_constants`."""
    return of_changed(case, constants(built(case)))


def acting(case: ChainCase) -> Effects:
    """Hidden and known effects together."""
    return {**case.known, **case.effects}


def body(case: ChainCase) -> Body:
    """The true vehicle."""
    charge = np.random.default_rng([case.flight_seed, 2]).uniform(-0.06, 0.1, case.recordings)
    return Body(built(case), acting(case), charge)


def motors(case: ChainCase) -> Motors:
    """Between commands and rotor speeds."""
    hidden = acting(case)
    if e := hidden.get("motor_lag"):
        up, down = e["tau_up"], e["tau_down"]
    else:
        up, down = (0.0, 0.0) if "input_delay" in hidden else case.lag
    return Motors(up, down, hidden.get("input_delay", {}).get("delay", 0.0))


def _flown(case: ChainCase, vessel: Body) -> flight.Truth:
    """The flights, each flown anew on another path where the vehicle is lost.

    What is hidden may turn a vehicle over that its pilot cannot right any more. It falls for the rest of the flight,
    through the ground if need be, at speeds that no log of a flight holds.
    """
    truth, strayed = _tried(case, vessel, ())
    for again in range(1, TRIES):
        lost = strayed > STRAYED
        if not lost.any():
            break
        other, by = _tried(case, vessel, (again,))
        less = lost & (by < strayed)
        truth, strayed = truth.exchanged(less, other), np.where(less, by, strayed)
    return truth


def _tried(case: ChainCase, vessel: Body, again: tuple[int, ...]) -> tuple[flight.Truth, np.ndarray]:
    """Flights, and how far each strayed from its path (B,) [m]; ``again`` draws other ones."""
    seconds, craft = case.seconds + flight.BEFORE + 0.1, vessel.craft
    drives, period = motors(case), 1 / case.control_hz
    manner = paths.eased(paths.MANNERS[case.style], pilot.gains(drives.slowest, period).attitude)
    lowest = RADII * craft.radius + 0.15
    asked = []
    for i in range(case.recordings):
        kind = paths.KINDS[i % len(paths.KINDS)]
        rng = np.random.default_rng([case.flight_seed, 3, i, *again])
        asked.append(paths.path(rng, kind, manner, lowest, seconds, flight.DT))
    wanted = np.stack(asked, axis=2)
    wind = np.zeros((wanted.shape[1], 3, case.recordings))
    if case.turbulence:
        rng = np.random.default_rng([case.flight_seed, 4, *again])
        wind += turbulence.gusts(rng, HEIGHT, case.turbulence, seconds, case.recordings, flight.DT)
    if e := acting(case).get("wind"):
        wind[:, 0] += e["w_x"]
        wind[:, 1] += e["w_y"]
    # The pilot was tuned on a vehicle that weighs and lifts what this one does.
    tuned = replace(craft, mass=vessel.mass, thrust=vessel.thrust_coefficient)
    rng = np.random.default_rng([case.flight_seed, 5, *again])
    truth = flight.fly(rng, vessel, tuned, motors=drives, period=period, wanted=wanted, wind=wind)
    aside = truth.state[:, P] - np.moveaxis(wanted[:3, -1 - len(truth.state) : -1], 1, 0)
    return truth, np.nan_to_num(np.sqrt((aside**2).sum(1)).max(0), nan=np.inf)


def logging(case: ChainCase) -> recorder.Logging:
    """How it is logged."""
    volts = "slope" in acting(case).get("battery_sag", {})
    return recorder.Logging(
        rate=case.log_hz,
        states=case.states,
        quality=case.noise,
        clock=case.clock,
        jitter=case.jitter,
        telemetry=case.telemetry,
        accelerometer=case.accelerometer,
        battery=volts,
    )


def write(case: ChainCase, path: Path) -> None:
    """Fly ``case`` and write ``path``: the logs, dataset.toml, model.toml where effects are known, and truth.json."""
    vessel = body(case)
    truth = _flown(case, vessel)
    rng, how = np.random.default_rng([case.flight_seed, 6, case.seed]), logging(case)
    observed = recorder.observe(rng, point.recorded(truth, point.arm(vessel.effects)), vessel, how)
    logs = recorder.record(rng, truth, vessel, how, observed)
    path.mkdir(parents=True, exist_ok=True)
    folder.write(path, case, stated(case), None if case.rough else UNCERTAINTY, logs)
    told = {"case": asdict(case), "constants": constants(vessel.craft)}
    told["shares"] = oracle.shares(truth, observed.states, vessel, case.effects) if case.effects else {}
    (path / "truth.json").write_text(json.dumps(told, indent=1), encoding="utf-8")


def _key(case: ChainCase) -> str:
    """Of everything that determines the folder, the code included."""
    code = hashlib.sha256(json.dumps(asdict(case), sort_keys=True).encode() + repr(AIRFRAMES).encode())
    for source in sorted(Path(__file__).parent.rglob("*.py")):
        if source.name != "suite.py":
            code.update(source.read_bytes())
    return code.hexdigest()[:20]


def kept(case: ChainCase, cache: Path) -> Path:
    """The folder of ``case`` in ``cache``, written on first use."""
    return written_once(Path(cache) / "chain" / _key(case), lambda path: write(case, path))


def measured(case: ChainCase, cache: Path) -> Subject:
    """What a user would bring to the diagnosis: the folder, read as any other."""
    found = load(kept(case, cache))
    return as_case(found, case.id, case.known)


def shares(case: ChainCase, cache: Path) -> dict[str, float]:
    """Of each hidden effect, see `oracle.shares`."""
    told = json.loads((kept(case, cache) / "truth.json").read_text(encoding="utf-8"))
    return {str(k): float(v) for k, v in told["shares"].items()}


def true_model(case: ChainCase, base: PhysicsModel) -> PhysicsModel:
    """``base`` with the true constants and the hidden effects."""
    true = constants(built(case))
    values = {k: _tuples(v) for k, v in true.items()}
    hidden = (EFFECTS.get(name)(**v) for name, v in case.effects.items())
    return replace(base, **values, effects=(*base.effects, *hidden))


def _tuples(value: Any) -> Any:
    return tuple(map(_tuples, value)) if isinstance(value, list) else float(value)
