"""The cases of the unknown: twelve kinds of effects at three levels of noise, and sets in which nothing is hidden."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from bench.score.case import Case, parameters
from bench.score.unknown.condition import EMPTY, SWINGS, UnknownCase
from bench.score.unknown.terms import Term

DEVELOPMENT, REPORTED = 201, 209
"""Seeds: what is tuned on one is reported on the other."""
NOISES = ("low", "medium", "high")
SETS = 100
"""Of each way in which nothing is hidden."""
SECONDS = {"hummingbird": 10.0, "crazyflie": 10.0, "oscillator": 10.0, "tanks": 600.0, "cart": 15.0}
"""Of a recording, of which there are six."""
DRAGS = ("linear_drag", "rotor_drag", "parasitic_drag", "wind")
FRICTIONS = ("coulomb_friction", "stribeck_friction", "viscous_friction", "quadratic_drag")
SPRINGS = ("cubic_stiffness", "bouc_wen", "cogging")
DRIVES = ("dead_zone", "saturation", "backlash")

Fields = dict[str, Any]
Drawn = Callable[[np.random.Generator, float], Fields]
"""The fields of a case, from a generator and a vehicle's weight [N] (1 for other systems)."""


def _sign(rng: np.random.Generator) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _vary(rng: np.random.Generator, value: float) -> float:
    """Within a fifth or so."""
    return float(value * np.exp(rng.uniform(-0.2, 0.2)))


def _term(
    axis: str,
    signals: str,
    form: str,
    *values: float,
    alike: tuple[str, ...] = (),
    instead: tuple[str, ...] = (),
    **more: Any,
) -> Fields:
    return {"terms": (Term(axis, tuple(signals.split(" * ")), form, values, alike, instead),), **more}


def _cart(signals: str, form: str, *values: float) -> Fields:
    # It is pushed as the motor pushes it, the bob with it: as an acceleration the same takes a second term.
    return _term("pace.x", signals, form, *values, alike=("tilt_rate.theta",), instead=("push",))


def _out_drag(rng: np.random.Generator, weight: float) -> Fields:
    d = {f"d_{a}": _vary(rng, f * weight / 9.81) for a, f in zip("xyz", (0.5, 0.3, 0.15), strict=True)}
    told = tuple(Term(f"force_{a}", (f"body_velocity.{a}",), "linear", (-d[f"d_{a}"],)) for a in "xyz")
    return {"effects": {"linear_drag": d}, "told": told, "catalogue_without": (*DRAGS, "inflow_thrust_loss")}


def _out_damping(rng: np.random.Generator, weight: float) -> Fields:
    d = {f"d_{a}": _vary(rng, f * 1.4e-5 * (weight / 0.43)) for a, f in zip("xyz", (2.0, 2.0, 2.0), strict=True)}
    told = tuple(
        Term(f"torque_{a}", (f"body_rates.{r}",), "linear", (-d[f"d_{a}"],), ("torque_z",))
        for a, r in zip("xy", "pq", strict=True)
    )
    without = ("rotational_damping", "blade_flapping", "inflow_thrust_loss", "rotor_drag", "rotor_gyroscopic_torque")
    return {"effects": {"rotational_damping": d}, "told": told, "catalogue_without": without}


def _sagging(rng: np.random.Generator, weight: float) -> Fields:
    rate = _vary(rng, 0.008)
    told = (Term("force_z", ("time", "thrust"), "linear", (-rate,)),)
    return {"effects": {"battery_sag": {"rate": rate}}, "told": told, "catalogue_without": ("battery_sag",)}


def _hanging(rng: np.random.Generator, weight: float) -> Fields:
    length, ratio = _vary(rng, 0.5), _vary(rng, 0.18)
    load = {"m_l": ratio * weight / 9.81, "l": length, "zeta": 0.03}
    held = float(np.sqrt(9.81 / length) / 2 / np.pi)
    return {
        "effects": {"suspended_load": load},
        "catalogue_without": ("suspended_load",),
        "frequencies": (held, held * float(np.sqrt(1 + ratio))),
    }


def _mode(rng: np.random.Generator, frequency: float, ratio: float, zeta: float, **more: Any) -> Fields:
    held, share = _vary(rng, frequency), _vary(rng, ratio)
    both = (held,) if "without_mass" in more else (held, held * float(np.sqrt(1 + share)))
    more.pop("without_mass", None)
    return {"swing": (held, share, zeta), "frequencies": both, **more}


def _pulsing(axis: str, frequency: float, size: float) -> Drawn:
    def drawn(rng: np.random.Generator, weight: float) -> Fields:
        often = _vary(rng, frequency)
        return {"swing": (often, _vary(rng, size), 0.0), "frequencies": (often,), "wave_axis": axis}

    return drawn


VARIANTS: tuple[tuple[str, str, Drawn], ...] = (
    (
        "spring",
        "hummingbird",
        lambda r, w: _term("world_force_x", "position.x", "affine", -_vary(r, 0.06) * w, 0.05 * w),
    ),
    ("spring", "crazyflie", lambda r, w: _term("world_force_y", "position.y", "linear", -_vary(r, 0.08) * w)),
    ("spring", "cart", lambda r, w: _cart("place.x", "linear", -_vary(r, 3.0))),
    ("spring", "cart", lambda r, w: _term("tilt_rate.theta", "tilt.theta", "cubic", -_vary(r, 200.0))),
    ("wall", "hummingbird", lambda r, w: _term("world_force_x", "position.x", "above", -_vary(r, 0.4) * w, 0.8)),
    ("wall", "crazyflie", lambda r, w: _term("world_force_z", "height", "above", -_vary(r, 0.4) * w, 4.0)),
    ("wall", "oscillator", lambda r, w: _term("speed.q", "displacement.q", "above", -_vary(r, 150), 0.15)),
    ("wall", "cart", lambda r, w: _cart("place.x", "below", _vary(r, 12.0), -0.25)),
    (
        "place_lift",
        "hummingbird",
        lambda r, w: _term("world_force_z", "position.x", "wave", 0.08 * w, _vary(r, 2.0), r.uniform(-3, 3)),
    ),
    ("place_lift", "crazyflie", lambda r, w: _term("world_force_z", "height", "exponential", 0.4 * w, _vary(r, 1.2))),
    ("place_lift", "cart", lambda r, w: _cart("place.x", "wave", 2.0, _vary(r, 8.0), r.uniform(-3, 3))),
    (
        "cross",
        "hummingbird",
        lambda r, w: _term("torque_y", "body_velocity.x * body_velocity.z", "linear", _sign(r) * _vary(r, 0.01)),
    ),
    (
        "cross",
        "crazyflie",
        lambda r, w: _term("force_z", "body_velocity.x * body_velocity.y", "linear", _sign(r) * _vary(r, 0.04) * w),
    ),
    ("cross", "oscillator", lambda r, w: _term("speed.q", "displacement.q * speed.q", "linear", -_vary(r, 4.0))),
    ("cross", "tanks", lambda r, w: _term("level.h", "upper_level.h * level.h", "linear", -_vary(r, 0.0012))),
    (
        "dead_zone",
        "hummingbird",
        lambda r, w: _term("force_x", "body_velocity.x", "dead_zone", -_vary(r, 0.15) * w, 1.0),
    ),
    ("dead_zone", "tanks", lambda r, w: _term("upper_level.h", "voltage", "saturation", -0.04, _vary(r, 2.4))),
    ("dead_zone", "oscillator", lambda r, w: _term("speed.q", "force", "saturation", -1.0, _vary(r, 4.0))),
    ("taken_out", "hummingbird", _out_drag),
    ("taken_out", "crazyflie", _out_damping),
    ("taken_out", "oscillator", lambda r, w: _term("speed.q", "displacement.q", "cubic", -_vary(r, 300.0))),
    ("taken_out", "oscillator", lambda r, w: _term("speed.q", "speed.q", "sign", -_vary(r, 1.5), 0.01)),
    ("taken_out", "tanks", lambda r, w: _term("level.h", "level.h", "above", -_vary(r, 0.05), 3.5)),
    ("periodic", "hummingbird", _pulsing("world_force_z", 0.8, 0.05)),
    ("periodic", "crazyflie", _pulsing("world_force_x", 1.4, 0.05)),
    ("periodic", "oscillator", _pulsing("speed.q", 0.7, 1.0)),
    ("periodic", "cart", _pulsing("pace.x", 0.9, 0.5)),
    ("drift", "hummingbird", lambda r, w: _term("world_force_x", "time", "linear", _sign(r) * _vary(r, 0.012) * w)),
    ("drift", "crazyflie", _sagging),
    ("drift", "oscillator", lambda r, w: _term("speed.q", "time", "linear", _sign(r) * _vary(r, 0.4))),
    ("load", "hummingbird", _hanging),
    ("load", "crazyflie", _hanging),
    ("load", "oscillator", lambda r, w: _mode(r, 1.1, 0.1, 0.03)),
    ("slosh", "cart", lambda r, w: _mode(r, 1.3, 0.15, 0.03)),
    ("slosh", "tanks", lambda r, w: _mode(r, 0.03, 0.004, 0.05, without_mass=True)),
    ("motors", "hummingbird", lambda r, w: _term("force_z", "thrust", "above", -_vary(r, 0.5), 1.1 * w)),
    ("motors", "crazyflie", lambda r, w: _term("force_z", "thrust", "above", -_vary(r, 0.5), 1.1 * w)),
    ("motors", "oscillator", lambda r, w: _term("speed.q", "force", "dead_zone", 1.0, _vary(r, 14.0))),
    ("twisted", "hummingbird", lambda r, w: {"twist": _sign(r) * _vary(r, 0.12)}),
    ("twisted", "crazyflie", lambda r, w: {"twist": _sign(r) * _vary(r, 0.12)}),
)
"""Kind, vehicle or system, and what is drawn; each stands three times in the suite, once a level of noise."""
WITHOUT = {
    "oscillator": (*FRICTIONS, *SPRINGS, *DRIVES, "joint_elasticity", "offset_force"),
    "tanks": ("overflow", *DRIVES),
    "cart": (),
    "place_lift": ("ground_effect",),
    "cross": ("munk_moment",),
}
"""Effects that are taken out of the catalogue, since they are what is hidden, or nearly: by system or kind."""


def cases(seed: int, quick: bool = False) -> list[Case]:
    """The whole suite, or one case of each kind.

    Args:
        seed: `DEVELOPMENT` or `REPORTED`: nothing is shared between two seeds.
        quick: few and short.
    """
    out = [*_hidden(seed), *_empty(seed)]
    if not quick:
        return list(out)
    first = {c.condition: c for c in reversed(out)}
    return [replace(c, recordings=4) for c in first.values()]


def _hidden(seed: int) -> Iterator[UnknownCase]:
    for row, (kind, who, drawn) in enumerate(VARIANTS):
        for column, noise in enumerate(NOISES):
            flight = 10_000 * seed + 10 * row + column
            made = _made(f"{seed}-{kind}-{row:02d}-{who}-{noise}", kind, who, noise=noise, flight_seed=flight)
            rng = np.random.default_rng([flight, 9])
            fields = drawn(rng, _weight(made))
            fields["catalogue_without"] = (
                *fields.get("catalogue_without", ()), *WITHOUT.get(who, ()), *WITHOUT.get(kind, ()),
            )  # fmt: skip
            yield replace(made, verdicts=("unknown_effect",), **fields)


def _empty(seed: int) -> Iterator[UnknownCase]:
    for number, kind in enumerate(EMPTY):
        machines = ("oscillator", "cart", "tanks")
        # RotorPy's motors are steered more often than they are logged: a crazyflie's speeds are undersampled.
        flying = ("crazyflie",) if kind == "undersampled" else ("hummingbird", "crazyflie")
        whose = (*flying, *machines)
        for i in range(SETS):
            who, flight = whose[i % len(whose)], 10_000 * seed + 1_000 * (number + 1) + i
            more: Fields = {"catalogue_without": WITHOUT.get(who, ())}
            if kind == "blown" and who in flying:
                drag = {"rotor_drag": {"k_d": 2e-4 if who == "hummingbird" else 1.2e-6}}
                more |= {"effects": {"gusts": {"sigma": 0.5, "time": 1.0}}, "known": drag}
            name = f"{seed}-{kind}-{i:03d}-{who}"
            yield replace(_made(name, kind, who, noise=NOISES[i // len(whose) % 3], flight_seed=flight), **more)


def _made(name: str, kind: str, who: str, **fields: Any) -> UnknownCase:
    flies = who in ("hummingbird", "crazyflie")
    return UnknownCase(
        id=name,
        condition=kind,
        vehicle=who,
        system="quadrotor" if flies else who,
        style="aggressive" if flies else "driven",
        # What follows nothing is told from its past: recordings hold many of its periods.
        seconds=SECONDS[who] * (2 if kind in SWINGS and not flies else 1),
        verdicts=("nothing", "unknown_effect") if kind == "blown" else ("nothing",),
        **fields,
    )


def _weight(case: UnknownCase) -> float:
    return float(parameters(case)["mass"] * 9.81) if case.system == "quadrotor" else 1.0
