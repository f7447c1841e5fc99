"""Which rotor is which, and which way it turns: bursts of the body rates against those of the torques."""

from collections.abc import Sequence

import numpy as np
from scipy.optimize import nnls

from bench.diagnose.checks.recorded import Flight, Reading
from bench.diagnose.checks.relations import LAGS, Relation, Signals, followed, kicks

Array = np.ndarray


def torque(drive: str, lag: float) -> Relation:
    """Body rates against rotors that follow what is logged of them with ``lag`` [s].

    Moments of inertia and coefficients need not be known: each axis has a gain of its own, which is positive. About
    yaw two add up, the drag of the rotors and what it takes to speed them up; both have the rotor's direction.
    """

    def compare(flight: Flight, reading: Reading, x: Signals) -> tuple[Array, Array] | None:
        if len(reading.positions) != x[drive].shape[1]:
            return None
        found = kicks(flight, x["body_rates"], followed(x[drive] ** 2, lag, flight.rate))
        if found is None:
            return None
        rates, impulse, spin = found
        hubs = np.array(reading.positions)
        said = np.zeros_like(rates)
        said[:, 0], said[:, 1] = impulse @ hubs[:, 1], -impulse @ hubs[:, 0]
        if reading.directions:
            signs = np.array(reading.directions)
            about = np.column_stack([impulse @ signs, spin @ signs])
            scale = np.maximum(about.std(axis=0), 1e-300)
            gains, _ = nnls(about / scale, rates[:, 2])
            said[:, 2] = about / scale @ gains
        return _sized(rates), _sized(said)

    return Relation("torque", ("body_rates", drive), (), ("roll", "pitch", "yaw"), compare, firm=False)


def _sized(x: Array) -> Array:
    """Columns over their size, so that the gain of an axis does not count; what stands still stays zero."""
    x = np.clip(x, *np.quantile(x, [0.01, 0.99], axis=0))
    size = x.std(axis=0)
    return np.asarray((x - x.mean(axis=0)) / np.where(size > 0, size, 1.0))


def lag_of(flights: Sequence[Flight], reading: Reading) -> float:
    """The lag with which rotors follow what is logged, whichever is which: each has a free gain [s]."""
    left = np.zeros(len(LAGS))
    for flight in flights:
        x = flight.signals(reading, ("body_rates", reading.drive))
        for i, lag in enumerate(LAGS):
            found = kicks(flight, x["body_rates"], followed(x[reading.drive] ** 2, lag, flight.rate))
            if found is not None:
                rates, impulse, _ = found
                gains = np.linalg.lstsq(impulse, rates[:, :2], rcond=None)[0]
                left[i] += ((rates[:, :2] - impulse @ gains) ** 2).sum() / max((rates[:, :2] ** 2).sum(), 1e-300)
    return LAGS[int(left.argmin())]
