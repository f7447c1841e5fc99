"""Sensors whose axes are turned against those of the body by a few degrees: body rates tell it of the attitude.

With the attitude measured about one set of axes and the rates about another, turned by a small vector θ against it,
ω' − ω = θ × ω, which a regression of three numbers finds. Which of the two are the body's axes the rotors tell: their
thrust is along body z, and what they do about x and y shows a turn of the rates about z.
"""

import numpy as np

from bench.diagnose.checks.description.mistake import Mistake, lines
from bench.diagnose.checks.description.recorded import Flight, Recorded
from bench.diagnose.checks.description.relations import boxed, felt, kicks
from bench.diagnose.logs.consistency import slope
from bench.diagnose.settings import MOUNTING
from registry.datasets.reading.rotations import rotate

Array = np.ndarray


def mounting(recorded: Recorded) -> list[Mistake]:
    """The turn between the axes of attitude and body rates, where it is sure, with the lines that take it back."""
    reading = recorded.reading
    if not {"attitude", "body_rates"} <= set(reading.signals):
        return []
    turns = [t for f in recorded.flights for part in _parts(f) if (t := _turn(part, recorded)) is not None]
    for flight in recorded.flights:
        flight.forget()
    if len(turns) < MOUNTING.parts:
        return []
    turn = np.median(turns, axis=0)
    error = np.std(turns, axis=0) / np.sqrt(len(turns))
    size = float(np.linalg.norm(turn))
    if size < np.radians(MOUNTING.least) or size < MOUNTING.significant * float(np.linalg.norm(error)):
        return []
    by_rotors = _by_rotors(recorded, turn)
    of = np.isfinite(by_rotors)
    apart = [float(np.linalg.norm((by_rotors - t)[of])) for t in (turn, 0 * turn)]
    told, imu = min(apart) < MOUNTING.near * float(np.linalg.norm(turn[of])), apart[0] <= apart[1]
    names = [n for n in ("body_rates", "specific_force") if n in reading.signals] if imu else ["attitude"]
    degrees = tuple(round(float(d), 2) for d in np.degrees(turn if imu else -turn))
    changed = reading
    for name in names:
        before = reading.signals[name].turned or (0.0, 0.0, 0.0)
        changed = changed.with_signal(name, turned=tuple(round(b + d, 2) for b, d in zip(before, degrees, strict=True)))
    whose = "and nothing tells which are the body's; here as if those of attitude were"
    if told:
        whose = f"and the rotors act about those of {'attitude' if imu else 'body_rates'}"
    detail = (
        f"the axes of body_rates are turned by {np.degrees(size):.1f} deg against those of attitude, {whose}. Torques "
        "and forces across the others' axes would be sought where there are none."
    )
    flights = tuple(f.name for f in recorded.flights)
    mend = lines(reading, changed)
    return [Mistake("mounting", names[0], flights, detail, mend=mend, stops=told, reading=changed)]


def _parts(flight: Flight) -> list[Flight]:
    """A flight in stretches, of which each tells the turn for itself."""
    size = round(MOUNTING.stretch * flight.rate)
    out = []
    for first in range(0, len(flight) - size + 1, size):
        part = slice(first, first + size)
        out.append(
            Flight(flight.name, flight.rate, {n: v[part] for n, v in flight.columns.items()}, flight.valid[part])
        )
    return out


def _turn(flight: Flight, recorded: Recorded) -> Array | None:
    """θ (3,) [rad] of ω' − ω = θ × ω, with ω' by the attitude and ω as measured; None: little moves."""
    x = flight.signals(recorded.reading, ("attitude", "body_rates"))
    told, rates = boxed(flight, slope(x["attitude"], True, 1 / flight.rate)), boxed(flight, x["body_rates"])
    inside = flight.valid.copy()
    half = round(MOUNTING.ends * flight.rate)
    inside[:half] = inside[-half:] = False
    if inside.sum() < MOUNTING.few:
        return None
    told, rates = (v[inside] - v[inside].mean(axis=0) for v in (told, rates))
    if np.sort(rates.std(axis=0))[1] < MOUNTING.moves:
        return None  # about one axis alone nothing tells of a turn about it
    p, q, r = rates.T
    zero = np.zeros_like(p)
    cross = np.stack([[zero, r, -q], [-r, zero, p], [q, -p, zero]]).transpose(2, 0, 1)  # of θ: θ × ω
    own = np.concatenate([np.eye(3)[i] * rates[:, i : i + 1] for i in range(3)]).reshape(3, -1, 3).transpose(1, 2, 0)
    columns = np.concatenate([cross, own], axis=2).reshape(-1, 6)  # a scale of each axis is no turn
    found: Array = np.linalg.lstsq(columns, (told - rates).reshape(-1), rcond=None)[0]
    return found[:3]


def _by_rotors(recorded: Recorded, turn: Array) -> Array:
    """The turn (3,) [rad] of the body rates against the axes about which the rotors act; NaN about what is not told.

    Thrust is along body z: where force leans from the z of the attitude, beside what drags, the attitude is turned and
    not the rates. About z the arms of rotors tell, if their speeds were measured.
    """
    reading, found = recorded.reading, np.full(3, np.nan)
    leans, rates, given = [], [], []
    stated = bool(reading.positions) and reading.drive == "rotor_speed" and "rotor_speed" in reading.signals
    arms = np.array([(p[1], -p[0]) for p in reading.positions]) if stated else np.empty((0, 2))
    for flight in recorded.flights:
        x = flight.signals(reading, ("attitude", "velocity", "body_rates", reading.drive))
        if "velocity" in x:
            force, inside = felt(flight, x)
            along = rotate(x["attitude"] * [-1.0, -1.0, -1.0, 1.0], x["velocity"])
            leans.append(np.column_stack([force, along[:, :2]])[inside])
        if stated and (seen := kicks(flight, x["body_rates"], x[reading.drive] ** 2, MOUNTING.burst)) is not None:
            rates.append(seen[0][:, :2])
            given.append(seen[1] @ arms)
    if leans:
        force_and_way = np.concatenate(leans)
        lean = np.linalg.lstsq(force_and_way[:, 2:], force_and_way[:, :2], rcond=None)[0][0]
        found[:2] = turn[:2] - [-lean[1], lean[0]]
    if rates:
        answer = np.linalg.lstsq(np.concatenate(given), np.concatenate(rates), rcond=None)[0].T
        if (np.diag(answer) > 0).all():
            across = answer / np.diag(answer)
            found[2] = (across[0, 1] - across[1, 0]) / 2
    return found
