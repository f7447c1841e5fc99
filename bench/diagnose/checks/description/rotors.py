"""Which rotor is which, and which way it turns: bursts of the body rates against those of the torques."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench.diagnose.checks.description.recorded import Flight, Reading
from bench.diagnose.checks.description.relations import Relation, Signals, calmed, followed, kicks
from bench.diagnose.regression.least_squares import bounded
from bench.diagnose.settings import SAMPLING, TURNING

Array = np.ndarray


@dataclass(frozen=True)
class Pace:
    """How quickly bodies answer rotors, and over what time it shows best."""

    lag: float
    """Of first order, with which rotors follow what is logged of them [s]."""
    tilt: float
    """Time over which roll and pitch are compared [s]."""
    yaw: float
    """The same of yaw [s]."""


def torque(drive: str, pace: Pace) -> Relation:
    """Body rates against rotors.

    Moments of inertia and coefficients need not be known: each axis has a gain of its own, which is positive. About
    yaw two add up, the drag of the rotors and what it takes to speed them up; both have the rotor's direction.
    """

    def compare(flight: Flight, reading: Reading, x: Signals) -> tuple[Array, Array] | None:
        if len(reading.positions) != x[drive].shape[1]:
            return None
        acting = followed(x[drive] ** 2, pace.lag, flight.rate)
        tilt, yaw = (kicks(flight, x["body_rates"], acting, b) for b in (pace.tilt, pace.yaw))
        if tilt is None or yaw is None:
            return None
        count = min(len(tilt[0]), len(yaw[0]))
        measured, impulse, _ = (v[:count] for v in tilt)
        hubs = np.array(reading.positions)
        said = np.zeros((count, 3))
        said[:, 0], said[:, 1] = impulse @ hubs[:, 1], -impulse @ hubs[:, 0]
        turned, impulse, spin = (v[:count] for v in yaw)
        measured = np.column_stack([measured[:, :2], turned[:, 2]])
        if reading.directions:
            signs = np.array(reading.directions)
            about = np.column_stack([impulse @ signs, spin @ signs])
            scale = np.maximum(about.std(axis=0), 1e-300)
            unit = about / scale
            gram = unit.T @ unit + 1e-9 * np.eye(2)
            said[:, 2] = unit @ bounded(gram, unit.T @ measured[:, 2], np.zeros(2), np.full(2, np.inf))
            late = max(1, round(TURNING.late * flight.rate))
            moved = (kicks(flight, np.roll(x["body_rates"], k, axis=0), acting, pace.yaw) for k in (-late, late))
            if any(_turns_round(unit, measured[:, 2], m[0][:count, 2]) for m in moved if m is not None):
                measured[:, 2] = said[:, 2] = 0.0
        return _sized(measured), _sized(said)

    return Relation("torque", ("body_rates", drive), (), ("roll", "pitch", "yaw"), compare, firm=False)


def _turns_round(acting: Array, now: Array, later: Array) -> bool:
    """Whether what signals (K, 2) tell of a rate (K,) is told with the other sign of the rate a moment later.

    Yaw that swings as fast as its control allows does so: late by a moment, a log shows its torque with the wrong sign.
    """
    first, second = (acting @ np.linalg.lstsq(acting, y, rcond=None)[0] for y in (now, later))
    return bool(first @ second < -TURNING.turned * np.linalg.norm(first) * np.linalg.norm(second))


def _sized(x: Array) -> Array:
    """Columns over their size, so that the gain of an axis does not count; what stands still stays zero."""
    x = calmed(x)
    size = x.std(axis=0)
    return np.asarray((x - x.mean(axis=0)) / np.where(size > 0, size, 1.0))


def pace_of(flights: Sequence[Flight], reading: Reading) -> Pace:
    """The pace that explains most, whichever rotor is which: each has free gains."""
    left = np.zeros((len(TURNING.lags), len(TURNING.bursts), 2))
    for flight in flights[: TURNING.recordings]:
        x = flight.signals(reading, ("body_rates", reading.drive))
        for i, lag in enumerate(TURNING.lags):
            acting = followed(x[reading.drive] ** 2, lag, flight.rate)
            for j, burst in enumerate(TURNING.bursts):
                found = kicks(flight, x["body_rates"], acting, burst)
                if found is not None:
                    rates, impulse, spin = (calmed(v[:: SAMPLING.stride]) for v in found)
                    left[i, j, 0] += _unexplained(rates[:, :2], impulse)
                    left[i, j, 1] += _unexplained(rates[:, 2:], np.column_stack([impulse, spin]))
    at, tilt = divmod(int(left[..., 0].argmin()), len(TURNING.bursts))
    return Pace(TURNING.lags[at], TURNING.bursts[tilt], TURNING.bursts[int(left[at, :, 1].argmin())])


def _unexplained(y: Array, x: Array) -> float:
    x = x / np.maximum(x.std(axis=0), 1e-300)
    miss = y - x @ np.linalg.lstsq(x, y, rcond=None)[0]
    return float((miss**2).sum() / max((y**2).sum(), 1e-300))
