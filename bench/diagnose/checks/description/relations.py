"""What signals must have to do with each other, whatever the vehicle lacks: turning, moving, tilting, weighing, thrust.

Every relation compares what one signal measures with what others say of it, axis by axis, as a misfit
Σ(m − s)² / Σ(m² + s²): 0 where they agree, 1 where they have nothing to do with each other or one is far larger,
2 where one is the negative of the other.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d

from bench.diagnose.checks.description.recorded import Flight, Reading
from bench.diagnose.logs.consistency import accumulated, change, integral, within
from bench.diagnose.logs.filters import lagged
from bench.diagnose.settings import SAMPLING
from registry.datasets.folder.conversion import GRAVITY
from registry.datasets.reading.cleaning import widen
from registry.datasets.reading.rotations import rotate

Array = np.ndarray
Signals = Mapping[str, Array]


@dataclass(frozen=True)
class Relation:
    """Signals that belong together."""

    name: str
    needs: tuple[str, ...]
    """All of these …"""
    either: tuple[str, ...]
    """… and one of these, where there are any."""
    axes: tuple[str, ...]
    compare: Callable[[Flight, Reading, Signals], tuple[Array, Array] | None]
    """Measured and said (N, axes)."""
    firm: bool = True
    """Whether nothing but a mistake of reading spoils it: torques are spoilt by more."""
    exact: bool = False
    """Whether not even the vehicle matters."""

    def uses(self, signals: Mapping[str, object]) -> bool:
        """Whether these signals are enough for it."""
        return all(n in signals for n in self.needs) and (not self.either or any(n in signals for n in self.either))


def misfit(measured: Array, said: Array) -> Array:
    """Of each axis (c,) of (N, c); the largest samples count no more than those that one in a hundred exceeds."""
    m, s = calmed(measured[:: SAMPLING.stride]), calmed(said[:: SAMPLING.stride])
    size = (m * m + s * s).sum(axis=0)
    out: Array = np.where(size > 0, ((m - s) ** 2).sum(axis=0) / np.where(size > 0, size, 1.0), 1.0)
    return out


def calmed(x: Array) -> Array:
    """Columns (N, c) of which the largest samples are brought in; see `SAMPLING.tail`."""
    ordered = np.sort(x, axis=0)
    count = int(SAMPLING.tail * len(x))
    return np.clip(x, ordered[count], ordered[-1 - count])


# ---------------------------------------------------------------------------------------------------- kinematics


def _turning(flight: Flight, reading: Reading, x: Signals) -> tuple[Array, Array] | None:
    return _changes(flight, change(x["attitude"], True), x["body_rates"])


def _moving(flight: Flight, reading: Reading, x: Signals) -> tuple[Array, Array] | None:
    return _changes(flight, np.diff(x["position"], axis=0), x["velocity"])


def _changes(flight: Flight, steps: Array, rate: Array) -> tuple[Array, Array] | None:
    length = max(2, round(SAMPLING.window * flight.rate))
    a, b = accumulated(steps), accumulated(integral(rate, 1 / flight.rate))
    inside = within(flight.valid, length)
    if inside.sum() < SAMPLING.few:
        return None
    return (a[length:] - a[:-length])[inside], (b[length:] - b[:-length])[inside]


# -------------------------------------------------------------------------------------------------- accelerations


def acceleration(flight: Flight, x: Signals) -> tuple[Array, Array]:
    """dv/dt (N, 3) in the world from velocity, else from position [m/s²], and where it can be trusted (N,)."""
    half = max(1, round(SAMPLING.half_width * flight.rate))
    dt = 1 / flight.rate
    if "velocity" in x:
        slope = _centred(x["velocity"], half, dt)
    else:
        slope = _centred(_centred(x["position"], half, dt), half, dt)
        half *= 2
    ends = np.zeros(len(flight), dtype=bool)
    ends[:half] = ends[-half:] = True
    return slope, ~widen(~flight.valid, half) & ~ends


def _centred(x: Array, half: int, dt: float) -> Array:
    out = np.zeros_like(x)
    out[half:-half] = (x[2 * half :] - x[: -2 * half]) / (2 * half * dt)
    return out


def boxed(flight: Flight, x: Array) -> Array:
    """The mean (N, c) over the time over which accelerations are taken."""
    half = max(1, round(SAMPLING.half_width * flight.rate))
    out: Array = uniform_filter1d(x, 2 * half + 1, axis=0)
    return out


def _tilting(flight: Flight, reading: Reading, x: Signals) -> tuple[Array, Array] | None:
    """Horizontal acceleration against that of a thrust along body z, which also carries the weight."""
    a, inside = acceleration(flight, x)
    up = boxed(flight, rotate(x["attitude"], np.broadcast_to([0.0, 0.0, 1.0], a.shape)))
    inside &= np.abs(up[:, 2]) > 0.3
    if inside.sum() < SAMPLING.few:
        return None
    pull = (a[:, 2] + GRAVITY[2])[inside]
    said = (pull / np.abs(up[inside, 2]))[:, None] * up[inside, :2]
    return _level(a[inside, :2]), _level(said)


def felt(flight: Flight, x: Signals) -> tuple[Array, Array]:
    """What an accelerometer feels (N, 3), body frame, by the motion [m/s²], and where it can be trusted (N,)."""
    a, inside = acceleration(flight, x)
    inverse = x["attitude"] * [-1.0, -1.0, -1.0, 1.0]
    return rotate(inverse, a + GRAVITY), inside


def _weighing(flight: Flight, reading: Reading, x: Signals) -> tuple[Array, Array] | None:
    said, inside = felt(flight, x)
    if inside.sum() < SAMPLING.few:
        return None
    measured = boxed(flight, x["specific_force"])[inside]
    said = said[inside]
    # A sensor that is not quite level shows the weight sideways; along z the weight itself is what counts.
    for axis in (0, 1):
        measured[:, axis], said[:, axis] = _level(measured[:, axis]), _level(said[:, axis])
    return measured, said


def _hanging(flight: Flight, reading: Reading, x: Signals) -> tuple[Array, Array] | None:
    """Without an attitude: in the mean, body z carries the weight."""
    measured = x["specific_force"][flight.valid, 2:]
    if len(measured) < SAMPLING.few:
        return None
    mean = np.full_like(measured, measured.mean())
    return mean, np.full_like(mean, GRAVITY[2])


def _level(x: Array) -> Array:
    return np.asarray(x - x.mean(axis=0))


# ---------------------------------------------------------------------------------------------- rotors and inputs


def followed(x: Array, lag: float, rate: float) -> Array:
    """``x`` (N, c) through a first-order lag [s]."""
    if lag == 0:
        return x
    return lagged(x, float(np.exp(-1 / (rate * lag))), before=x[0])


def bursts(x: Array, length: int) -> Array:
    """Change of the change (N − 2 length, c) over ``length`` samples."""
    return np.asarray(x[2 * length :] - 2 * x[length:-length] + x[: -2 * length])


def kicks(flight: Flight, rates: Array, thrusts: Array, burst: float) -> tuple[Array, Array, Array] | None:
    """What bodies and rotors do in bursts: (K, 3) of the rates, (K, m) of ∫ thrust, (K, m) of the root of the thrust.

    The change of the change over ``burst`` [s]; None where too little is valid.
    """
    length = max(1, round(burst * flight.rate))
    inside = within(flight.valid, 2 * length)
    if inside.sum() < SAMPLING.few:
        return None
    impulse = accumulated((thrusts[1:] + thrusts[:-1]) / 2 / flight.rate)
    spin = np.sqrt(np.maximum(thrusts, 0))
    return tuple(bursts(v, length)[inside] for v in (rates, impulse, spin))


def _lifting(flight: Flight, reading: Reading, x: Signals) -> tuple[Array, Array] | None:
    """Changes of what is felt along body z against those of the thrusts' sum, both over their size."""
    if "attitude" in x and ("velocity" in x or "position" in x):
        force, inside = felt(flight, x)
    else:
        force, inside = boxed(flight, x["specific_force"]), flight.valid.copy()
    if inside.sum() < SAMPLING.few:
        return None
    thrust = boxed(flight, (x[reading.drive] ** 2).sum(axis=1, keepdims=True))[inside]
    measured = force[inside, 2:]
    parts = [_level(v) for v in (measured, thrust)]
    parts = [p / max(float(p.std()), 1e-12) for p in parts]
    return parts[0], parts[1]


KINEMATIC = (
    Relation("turning", ("attitude", "body_rates"), (), ("p", "q", "r"), _turning, exact=True),
    Relation("moving", ("position", "velocity"), (), ("x", "y", "z"), _moving, exact=True),
)
"""True of every rigid body."""
CARRIED = (
    Relation("tilting", ("attitude",), ("velocity", "position"), ("x", "y"), _tilting),
    Relation("weighing", ("attitude", "specific_force"), ("velocity", "position"), ("x", "y", "z"), _weighing),
    Relation("hanging", ("specific_force",), (), ("z",), _hanging),
)
"""True of what rotors carry along body z."""


def lifting(drive: str) -> Relation:
    """Thrust against what is felt of it."""
    return Relation("lifting", (drive,), ("velocity", "position", "specific_force"), ("z",), _lifting, firm=False)
