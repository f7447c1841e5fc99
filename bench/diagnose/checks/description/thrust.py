"""Whether what is logged of the rotors carries the vehicle's weight, and moves it."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.ndimage import uniform_filter1d

from bench.diagnose.checks.description.conventions import ROTORS
from bench.diagnose.checks.description.mistake import Mistake, lines
from bench.diagnose.checks.description.recorded import Flight, Reading, Recorded
from bench.diagnose.checks.description.relations import boxed, felt, followed
from bench.diagnose.logs.consistency import correlation
from bench.diagnose.settings import LIFTING, TURNING
from registry.datasets.reading.rotations import rotate
from registry.units import to_si

Array = np.ndarray

PER_RPM = to_si("rpm")[1] ** -2
"""Of a thrust coefficient given for revolutions a minute to one for rad/s."""


_OTHER_UNITS = (
    ("mass", "g", 1e-3),
    ("thrust_coefficient", "mN s^2", 1e-3),
    ("thrust_coefficient", "uN s^2", 1e-6),
)
"""Constant, a unit in which people state it, and its factor to SI."""


@dataclass(frozen=True)
class _Force:
    """Of one flight: what acts along body z for a kilogram, and what drives it."""

    name: str
    needed: Array
    """(K,) [m/s²]."""
    driving: Array
    """(K, m) as logged, SI, through the lag that fits best."""
    correlation: float
    """Of the two; given the speed along body z where that hides it."""


def thrust(recorded: Recorded) -> list[Mistake]:
    """Inputs that carry some other weight, or that do not move the vehicle."""
    reading = recorded.reading
    if reading.drive not in ROTORS or reading.drive not in reading.signals:
        return []
    forces = [f for f in (_force(flight, reading) for flight in recorded.flights) if f is not None]
    for flight in recorded.flights:
        flight.forget()
    if not forces:
        return []
    deaf = _deaf(forces, reading, recorded.rate)
    if deaf is not None:
        return [deaf]
    stated = recorded.stated
    if not {"mass", "thrust_coefficient"} <= set(stated):
        absent = [n for n in ("mass", "thrust_coefficient") if n not in stated]
        detail = f"{' and '.join(absent)} are not stated in [physics]: no weight can be compared with the thrust."
        return [Mistake("not stated", reading.drive, (), detail, (), False)]
    return _weight(recorded, forces) or _arms(recorded)


def _arms(recorded: Recorded) -> list[Mistake]:
    """Rotors whose places are stated in mm or cm: so far out for an inertia and a mass that nothing is built so."""
    reading, stated = recorded.reading, recorded.stated
    if not reading.positions or not {"mass", "inertia"} <= set(stated):
        return []
    inertia = np.asarray(stated["inertia"], dtype=float)
    about = np.diagonal(inertia) if inertia.ndim == 2 else inertia
    gyration = float(np.sqrt(about[:2].mean() / float(stated["mass"])))
    arm = float(np.mean([np.hypot(p[0], p[1]) for p in reading.positions]))
    for unit, factor in (("mm", 1e-3), ("cm", 1e-2)):
        if 1 / LIFTING.far < gyration / max(arm * factor, 1e-12) / LIFTING.gyration < LIFTING.far:
            positions = tuple(tuple(float(f"{x * factor:.6g}") for x in p) for p in reading.positions)
            after = replace(reading, positions=positions)
            detail = (
                f"rotors {arm:.4g} m from the axis do not go with mass and inertia, whose radius of gyration is "
                f"{gyration:.2g} m: rotor_positions look like ones in {unit}."
            )
            names = tuple(f.name for f in recorded.flights)
            return [Mistake("unit", reading.drive, names, detail, lines(reading, after), reading=after)]
    return []


def _force(flight: Flight, reading: Reading) -> _Force | None:
    x = flight.signals(reading, ("attitude", "velocity", "position", "specific_force", reading.drive))
    if "attitude" in x and ("velocity" in x or "position" in x):
        values, inside = felt(flight, x)
    elif "specific_force" in x:
        values, inside = boxed(flight, x["specific_force"]), flight.valid.copy()
    else:
        return None
    if inside.sum() < 0.5 * flight.rate:
        return None
    needed, best = values[inside, 2], None
    climb = np.zeros((len(needed), 0))
    if "attitude" in x and "velocity" in x:
        climb = rotate(x["attitude"] * [-1.0, -1.0, -1.0, 1.0], x["velocity"])[inside, 2:]
    for lag in TURNING.lags:
        driving = boxed(flight, followed(x[reading.drive], lag, flight.rate))[inside]
        level = (driving**2).sum(axis=1)
        plain, given = _correlation(level, needed), _correlation(level, needed, climb)
        r = given if abs(given) > LIFTING.hidden * abs(plain) else plain
        if best is None or abs(r) > abs(best.correlation):
            best = _Force(flight.name, needed, driving, r)
    return best


def _correlation(a: Array, b: Array, beside: Array | None = None) -> float:
    """Of two signals (K,), given others (K, n): rotors that lose thrust in climb are driven harder just then."""
    if beside is not None and beside.shape[1]:
        given = np.column_stack([np.ones(len(a)), beside])
        both = np.column_stack([a, b])
        a, b = (both - given @ np.linalg.lstsq(given, both, rcond=None)[0]).T
    return correlation(a, b)


def _deaf(forces: Sequence[_Force], reading: Reading, rate: float) -> Mistake | None:
    length = max(1, round(LIFTING.calm * rate))
    # Noise of a differentiated velocity hardly lasts that long.
    moved = [f for f in forces if uniform_filter1d(f.needed, length).std() > LIFTING.moves * abs(f.needed.mean())]
    if len(moved) < max(1, len(forces) / 2) or np.median([abs(f.correlation) for f in moved]) > LIFTING.deaf:
        return None
    r, size = (float(np.median(v)) for v in zip(*((f.correlation, f.needed.std()) for f in moved), strict=True))
    detail = (
        f"{reading.drive} does not move the thrust: the force along body z varies by {size:.2g} m/s² (1σ), "
        f"and its correlation with the sum of squares is {r:.2f} in {len(moved)} recordings: are these the "
        "columns of the rotors?"
    )
    return Mistake("no effect", reading.drive, tuple(f.name for f in moved), detail)


def _weight(recorded: Recorded, forces: Sequence[_Force]) -> list[Mistake]:
    reading, stated = recorded.reading, recorded.stated
    mass, k_f = float(stated["mass"]), float(stated["thrust_coefficient"])
    maps = {k: float(stated[k]) for k in ("pwm_gain", "pwm_offset") if k in stated}
    if reading.drive == "pwm" and len(maps) < 2:
        gain, offset, r = _map(forces, mass, k_f)
        detail = (
            "pwm_gain and pwm_offset are not stated in [physics], and no other vehicle's will do: the flights' own are "
            f"estimated below (correlation {r:.2f})."
        )
        return [Mistake("not stated", "pwm", (), detail, _map_lines(gain, offset), False)]

    def carried(f: _Force) -> Array:
        speed = np.maximum(maps["pwm_gain"] * f.driving + maps["pwm_offset"], 0) if maps else f.driving
        return np.asarray(k_f / mass * (speed**2).sum(axis=1))

    if reading.drive != "pwm":
        maps = {}
    ratio = float(np.median([np.median(f.needed) / max(float(np.median(carried(f))), 1e-12) for f in forces]))
    names = tuple(f.name for f in forces)
    flat = [carried(f).std() / max(carried(f).mean(), 1e-12) / (f.needed.std() / abs(f.needed.mean())) for f in forces]
    moved = [
        f.needed.std() > LIFTING.moves * abs(f.needed.mean()) and abs(f.correlation) > LIFTING.fits for f in forces
    ]
    hardly = sum(moved) > len(forces) / 2 and float(np.median(np.array(flat)[moved])) < LIFTING.flat
    if 1 / LIFTING.far < ratio < LIFTING.far and not hardly:
        return []
    what = f"the thrust that {reading.drive} gives with the stated constants is {1 / ratio:.3g} times what is needed"
    if 1 / LIFTING.far < ratio < LIFTING.far:
        what = f"{reading.drive} hardly moves the thrust with the stated pwm_gain and pwm_offset"
    found = _unit_of_constant(ratio, stated)
    if found is None and reading.drive != "pwm":
        found = _unit(reading, ratio, stated)
    if found is not None:
        said, mend, after = found
        return [Mistake("unit", reading.drive, names, f"{what}: {said}.", mend, reading=after)]
    gain, offset, r = _map(forces, mass, k_f)
    detail = (
        f"{what}: {_range(forces)}. A map to rotor speeds is estimated from these flights (correlation {r:.2f}); it is "
        "no more certain than mass and thrust_coefficient are."
    )
    signal = reading.signals[reading.drive]
    columns = f'pwm = {{columns = {json.dumps(list(signal.columns))}, unit = "pwm"}}'
    renamed = () if reading.drive == "pwm" else ('input = "pwm"', columns)
    return [Mistake("input scale", reading.drive, names, detail, (*renamed, *_map_lines(gain, offset)))]


def _unit_of_constant(ratio: float, stated: Mapping[str, Any]) -> tuple[str, tuple[str, ...], Reading | None] | None:
    """What is said and the line, if a constant in another unit makes thrust and weight equal."""
    for name, unit, factor in _OTHER_UNITS:
        times = ratio * factor if name == "mass" else ratio / factor
        if 1 / LIFTING.near < times < LIFTING.near:
            said = (
                f"{name} = {float(stated[name]):.4g} looks like one in {unit}; in SI it would be {1 / times:.2f} times"
            )
            return said, (f"{name} = {float(stated[name]) * factor:.4g}",), None
    return None


def _unit(
    reading: Reading, ratio: float, stated: Mapping[str, Any]
) -> tuple[str, tuple[str, ...], Reading | None] | None:
    """What is said, the lines, and the reading, if another unit makes thrust and weight equal."""
    signal = reading.signals[reading.drive]
    for unit in ("rpm", "rad/s"):
        factor = (to_si(unit)[1] / to_si(signal.unit)[1]) ** 2
        if unit != signal.unit and 1 / LIFTING.near < ratio / factor < LIFTING.near:
            after = reading.with_signal(reading.drive, unit=unit)
            return f"in {unit} it would be {factor / ratio:.2f} times", lines(reading, after), after
    if 1 / LIFTING.near < ratio / PER_RPM < LIFTING.near:
        constants = [n for n in ("thrust_coefficient", "torque_coefficient") if n in stated]
        mend = tuple(f"{n} = {float(stated[n]) * PER_RPM:.4g}" for n in constants)
        said = f"a coefficient for rpm², turned into one for (rad/s)², would give {PER_RPM / ratio:.2f} times"
        return said, mend, None
    return None


def _map(forces: Sequence[_Force], mass: float, k_f: float) -> tuple[float, float, float]:
    """Gain and offset of rotor speed over input that carry the weight, and their correlation."""
    count = forces[0].driving.shape[1]
    speed = np.concatenate([np.sqrt(np.maximum(f.needed, 0) * mass / k_f / count) for f in forces])
    level = np.concatenate([np.sqrt((f.driving**2).mean(axis=1)) for f in forces])
    r = correlation(level, speed)
    gain = r * float(speed.std() / max(level.std(), 1e-300))
    if r < LIFTING.fits or gain * level.mean() > 1.2 * speed.mean():
        return float(speed.mean() / max(level.mean(), 1e-300)), 0.0, r
    return gain, float(speed.mean() - gain * level.mean()), r


def _map_lines(gain: float, offset: float) -> tuple[str, ...]:
    return f"pwm_gain = {gain:.4g}", f"pwm_offset = {offset:.4g}"


def _range(forces: Sequence[_Force]) -> str:
    low, high = (float(g(np.concatenate([f.driving.ravel() for f in forces]))) for g in (np.min, np.max))
    kind = "normalised commands" if high < 1.6 else "counts of a driver" if high > 900 else "another scale"
    return f"values from {low:.3g} to {high:.4g} look like {kind}"
