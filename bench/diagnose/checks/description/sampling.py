"""Whether a log has enough samples a second, its drive enough levels, and its battery volts that can be."""

from dataclasses import replace

import numpy as np

from bench.diagnose.checks.description.mistake import Mistake, line
from bench.diagnose.checks.description.recorded import Recorded
from bench.diagnose.settings import SPIKING

SLOW, SLOWER = 60.0, 20.0
"""Rates [Hz] from which body rates are looked at, and at which a small rotorcraft always turns too fast."""
VOLTS = 100.0
"""More than any battery of a rotorcraft has [V]."""


def slow_logs(recorded: Recorded) -> list[Mistake]:
    """A log that is too slow for rotations, and what it is still good for."""
    if recorded.rate > SLOW or "body_rates" not in recorded.reading.signals:
        return []
    missed: list[float] = []
    for flight in recorded.flights:
        rates = flight.signals(recorded.reading, ("body_rates",))["body_rates"][:, :2][flight.valid]
        missed += _between_samples(rates)
    if not missed or (np.median(missed) < SPIKING.missed and recorded.rate > SLOWER):
        return []
    detail = (
        f"{recorded.rate:g} Hz is too slow for rotations: {np.median(missed):.0%} of the body rates cannot be told "
        "from the samples before and after. Forces can still be judged with measured attitude (drag, mass, thrust, "
        "battery, wind), torques and motor lag cannot; log rates and rotors at 100 Hz or more for those."
    )
    return [Mistake("slow log", "body_rates", tuple(f.name for f in recorded.flights), detail, (), False)]


def _between_samples(x: np.ndarray) -> list[float]:
    """Share (rms) of what signals (N, c) vary that the samples before and after do not tell; none of few samples."""
    if len(x) <= 12:
        return []
    between = x[1:-1] - (x[2:] + x[:-2]) / 2
    size = float(np.sqrt(np.mean((x - x.mean(axis=0)) ** 2)))
    return [float(np.sqrt(np.mean(between**2))) / max(size, 1e-12)]


def aliased_drive(recorded: Recorded) -> list[Mistake]:
    """Rotors whose differences, which turn the vehicle, come and go between two samples: what acted is not told."""
    drive = recorded.reading.drive
    if drive not in recorded.reading.signals:
        return []
    shares: list[float] = []
    for flight in recorded.flights:
        u = flight.signals(recorded.reading, (drive,))[drive][flight.valid]
        shares += _between_samples(u - u.mean(axis=1, keepdims=True))
    if not shares or np.median(shares) < SPIKING.aliased:
        return []
    detail = (
        f"What the rotors do against each other differs from the samples before and after by {np.median(shares):.2g} "
        f"times what it varies in all (noise: 1.2): it is noise, or the controller acts faster than {recorded.rate:g} "
        "Hz show. Inertia, torques and motor lag can hardly be told from it; log the rotors at the controller's rate."
    )
    return [Mistake("slow log", drive, tuple(f.name for f in recorded.flights), detail, (), False)]


def millivolts(recorded: Recorded) -> list[Mistake]:
    """A battery whose columns are in mV and are read as V."""
    signal = recorded.reading.signals.get("battery")
    if signal is None or signal.unit != "V":
        return []
    volts = [f.signals(recorded.reading, ("battery",))["battery"][f.valid] for f in recorded.flights]
    middle = float(np.median(np.concatenate(volts)))
    if not middle > VOLTS:
        return []
    detail = f"The battery is read as {middle:.5g} V: its columns look like mV."
    mend = line("battery", replace(signal, unit="mV"))
    return [Mistake("unit", "battery", tuple(f.name for f in recorded.flights), detail, (mend,))]


def two_levels(recorded: Recorded) -> list[Mistake]:
    """A drive that takes two values only: through two points lies any curve."""
    drive = recorded.reading.drive
    if drive not in recorded.reading.signals:
        return []
    u = np.concatenate([f.signals(recorded.reading, (drive,))[drive][f.valid] for f in recorded.flights])
    levels = [np.unique(column[np.isfinite(column)]) for column in u.T]
    if any(len(level) != 2 for level in levels):
        return []
    detail = (
        f"{drive} takes two values only, {levels[0][0]:.4g} and {levels[0][1]:.4g}: its gain and a constant beside it, "
        "a dead zone, a limit between them and a curve do the same there, and what is named of these may be another "
        "one. Record three levels or more."
    )
    return [Mistake("two levels", drive, tuple(f.name for f in recorded.flights), detail, (), False)]
