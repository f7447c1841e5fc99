"""Tanks, an oscillator and a pendulum on a cart with something hidden: equations written here, solved by scipy.

Drives are straight lines between samples, so that nothing but what is hidden happens between them; those of
"undersampled" sets are livelier than that.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.integrate import solve_ivp

from bench.score.case import Columns
from bench.score.unknown.condition import UnknownCase

Array = np.ndarray
GRAVITY = 9.81
NOISE = {"low": 0.001, "medium": 0.003, "high": 0.01}
"""1σ of white noise over each state's standard deviation."""
FINE = 5
"""Steps between two samples at which what nobody logs is drawn."""
OFF = 0.005
"""Relative 1σ by which true constants differ from the stated ones."""


@dataclass(frozen=True)
class Machine:
    """A system: stated constants, signals, how it is driven and how it moves."""

    constants: dict[str, float]
    states: tuple[str, ...]
    units: tuple[str, ...]
    drive: str
    drive_unit: str
    rate: Callable[[dict[str, float], Array, float], Array]
    """dx/dt of the nominal model, from constants, state and drive."""
    driven: Callable[[np.random.Generator, Array], Array]
    """The drive at times (N,)."""
    start: Callable[[np.random.Generator], Array]
    gust: float
    """1σ of the random disturbance of "blown" sets, along the first moving state [unit/s]."""
    moving: int
    """Place of the state whose rate a hidden push changes."""
    hertz: float
    """Of the log."""


def _sines(rng: np.random.Generator, t: Array, size: float, low: float, high: float) -> Array:
    """Five sines between two frequencies [Hz], of about one standard deviation ``size``."""
    edges = np.geomspace(low, high, 6)
    out = np.zeros(len(t))
    for a, b in pairwise(edges):
        turn = 2 * np.pi * rng.uniform(a, b)
        out += size * np.sqrt(2 / 5) * rng.uniform(0.6, 1.4) * np.sin(turn * t + rng.uniform(-np.pi, np.pi))
    return out


def _steps(rng: np.random.Generator, t: Array, low: float, high: float, hold: float) -> Array:
    """Levels drawn between two values, each held for about ``hold`` [s], with ramps between them."""
    at = np.cumsum(rng.uniform(0.5, 1.5, int(t[-1] / hold) + 4) * hold)
    return np.interp(t, at, rng.uniform(low, high, len(at)))


def _spring(c: dict[str, float], x: Array, u: float) -> Array:
    return np.array([x[1], (u - c["damping"] * x[1] - c["stiffness"] * x[0]) / c["mass"]])


def _levels(c: dict[str, float], x: Array, u: float) -> Array:
    upper, lower = (c[k] * np.sqrt(max(h, 0.0)) for k, h in zip(("upper_outflow", "lower_outflow"), x, strict=True))
    return np.array([c["pump_gain"] * u - upper, upper - lower])


def _pendulum(c: dict[str, float], x: Array, u: float) -> Array:
    """From Lagrange's equations, as a linear system in both accelerations."""
    heavy, light, rod = c["cart_mass"], c["bob_mass"], c["length"]
    s, k = np.sin(x[1]), np.cos(x[1])
    inertia = np.array([[heavy + light, light * rod * k], [light * rod * k, light * rod**2]])
    load = np.array(
        [
            u - c["friction"] * x[2] + light * rod * x[3] ** 2 * s,
            -light * GRAVITY * rod * s - c["damping"] * light * rod**2 * x[3],
        ]
    )
    return np.concatenate([x[2:], np.linalg.solve(inertia, load)])


MACHINES = {
    "oscillator": Machine(
        constants={"mass": 1.0, "damping": 0.5, "stiffness": 100.0},
        states=("displacement", "speed"),
        units=("m", "m/s"),
        drive="force",
        drive_unit="N",
        rate=_spring,
        driven=lambda rng, t: _sines(rng, t, 12.0, 0.3, 2.6),
        start=lambda rng: rng.normal(size=2) * [0.1, 0.5],
        gust=2.0,
        moving=1,
        hertz=100.0,
    ),
    "tanks": Machine(
        constants={
            "upper_outflow": 0.06,
            "lower_outflow": 0.06,
            "pump_gain": 0.04,
            "upper_linear": 0.0,
            "lower_linear": 0.0,
        },
        states=("upper_level", "level"),
        units=("V", "V"),
        drive="voltage",
        drive_unit="V",
        rate=_levels,
        driven=lambda rng, t: _steps(rng, t, 0.5, 4.5, 90.0),
        start=lambda rng: rng.uniform(2.0, 6.0, 2),
        gust=0.01,
        moving=0,
        hertz=0.5,
    ),
    "cart": Machine(
        constants={"cart_mass": 2.0, "bob_mass": 0.02, "length": 0.25, "friction": 6.0, "damping": 0.6},
        states=("place", "tilt", "pace", "tilt_rate"),
        units=("m", "rad", "m/s", "rad/s"),
        drive="push",
        drive_unit="N",
        rate=_pendulum,
        driven=lambda rng, t: _sines(rng, t, 5.0, 0.1, 1.2),
        start=lambda rng: rng.normal(size=4) * [0.2, 0.1, 0.2, 0.3],
        gust=0.5,
        moving=2,
        hertz=50.0,
    ),
}
CHANNELS = {
    "oscillator": ("displacement.q", "speed.q"),
    "tanks": ("upper_level.h", "level.h"),
    "cart": ("place.x", "tilt.theta", "pace.x", "tilt_rate.theta"),
}


def constants(case: UnknownCase) -> dict[str, float]:
    """The true ones, near those stated."""
    rng = np.random.default_rng([case.flight_seed, 1])
    return {k: v * (1 + OFF * float(rng.normal())) for k, v in MACHINES[case.system].constants.items()}


def logs(case: UnknownCase) -> list[Columns]:
    """Run ``case`` and log it: a dictionary of columns a recording."""
    return [_log(case, i) for i in range(case.recordings)]


def _log(case: UnknownCase, number: int) -> Columns:
    machine, true = MACHINES[case.system], constants(case)
    rng = np.random.default_rng([case.flight_seed, 3, number])
    dt = 1 / machine.hertz
    t = np.arange(round(case.seconds / dt)) * dt
    fine = np.arange((len(t) - 1) * FINE + 1) * dt / FINE
    logged = machine.driven(rng, t)
    acting = np.interp(fine, t, logged)
    if case.condition == "undersampled":
        acting = logged.std() * _between(rng, len(fine), 0.15)
        if case.system == "tanks":
            acting = np.maximum(acting + 2.75, 0.0)
        logged = acting[::FINE]
    blown = machine.gust * _between(rng, len(fine), dt / FINE / 0.5) if case.condition == "blown" else 0 * fine
    phase = float(rng.uniform(-np.pi, np.pi))
    state, extra = machine.start(rng), 2 * (case.condition in ("load", "slosh"))

    def rate(now: float, x: np.ndarray) -> np.ndarray:
        drive, push = float(np.interp(now, fine, acting)), float(np.interp(now, fine, blown))
        return _rate(case, true, x, now, u=drive, blow=push, phase=phase)

    start = np.concatenate([state, np.zeros(extra)])
    run = solve_ivp(rate, (0, t[-1]), start, t_eval=t, max_step=dt, rtol=1e-7, atol=1e-9)
    x = run.y[: len(machine.states)].T
    noise = np.random.default_rng([case.flight_seed, 4, case.seed, number]).normal(size=x.shape)
    x = x + noise * NOISE[case.noise] * x.std(0)
    return {"t": t, machine.drive: logged} | {name: x[:, i] for i, name in enumerate(machine.states)}


def _between(rng: np.random.Generator, count: int, share: float) -> Array:
    """White noise through a first-order low-pass filter, of unit size."""
    out, now, keep = np.empty(count), rng.normal(), 1 - share
    kicks = rng.normal(size=count) * np.sqrt(1 - keep**2)
    for k in range(count):
        out[k] = now = keep * now + kicks[k]
    return out


def _rate(
    case: UnknownCase, true: dict[str, float], x: Array, t: float, *, u: float, blow: float, phase: float
) -> Array:
    """dx/dt with what is hidden."""
    machine, names = MACHINES[case.system], CHANNELS[case.system]
    size = len(names)
    own = x[:size]
    followed = dict(zip(names, own, strict=True)) | {machine.drive: u, "time": t}
    pushed = {name: 0.0 for name in names}
    for term in case.terms:
        pushed[term.axis] += float(term.at({k: np.asarray(v) for k, v in followed.items()}))
    frequency, strength, zeta = case.swing
    turn, main = 2 * np.pi * frequency, machine.moving
    if case.condition == "periodic":
        pushed[names[main]] += strength * np.cos(turn * t + phase)
    pushed[names[main]] += blow
    out = machine.rate(true, own, u)
    if case.system == "cart":  # a force on the cart moves the bob too
        inertia = true["cart_mass"] + true["bob_mass"] * np.sin(own[1]) ** 2
        out = machine.rate(true, own, u + pushed.pop("pace.x") * inertia)
    out = out + np.array([pushed.get(name, 0.0) for name in names])
    if len(x) == size:
        return out
    # A second mass that hangs on the first by a spring: as long as it is held it swings at ``frequency``.
    z, w = x[size:]
    pull = -(turn**2) * z - 2 * zeta * turn * w
    if case.system == "tanks":
        out[main] -= strength * w
        return np.concatenate([out, [w, pull + u - 2.75]])
    if case.system == "cart":
        out = machine.rate(true, own, u - strength * true["cart_mass"] * pull)
    else:
        out[main] -= strength * pull
    return np.concatenate([out, [w, pull - out[main]]])
