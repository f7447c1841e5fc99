"""What a human checks first of a log: whether dataset.toml reads it as it was written."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from bench.diagnose.checks.clocks import clocks
from bench.diagnose.checks.conventions import conventions
from bench.diagnose.checks.mistake import Mistake
from bench.diagnose.checks.mounting import mounting
from bench.diagnose.checks.recorded import Recorded, flying, of_folder, of_subject
from bench.diagnose.checks.thrust import thrust
from bench.diagnose.logs.subject import Subject
from bench.diagnose.result import DataProblem
from bench.diagnose.settings import SPIKING
from registry.datasets.folder.dataset import Folder

SLOW, SLOWER = 60.0, 20.0
"""Rates [Hz] from which body rates are looked at, and at which a small rotorcraft always turns too fast."""


def check(recorded: Recorded, carried: bool) -> list[Mistake]:
    """Everything that these recordings say against the way they are read; `Mistake.stops` tells what spoils the rest.

    Args:
        recorded: from `of_folder` or `of_subject`.
        carried: whether the vehicle is carried by rotors along its z axis; see `flying`.
    """
    if not recorded.flights:
        return []
    found = conventions(recorded, carried)
    if found and found[-1].reading is not None:
        recorded = replace(recorded, reading=found[-1].reading)
    found += pace(recorded) if carried else []
    # Clocks are told apart only once signs and axes are right.
    late = clocks(recorded, carried)
    found += late or mounting(recorded)
    return found + (thrust(recorded) if carried else [])


def check_folder(folder: str | Path) -> list[Mistake]:
    """`check` of a folder with a dataset.toml.

    Raises:
        BenchError: the folder cannot be read.
    """
    source = Folder(path=str(folder))
    return check(of_folder(source), flying(source.system))


def check_subject(subject: Subject) -> tuple[list[DataProblem], list[DataProblem]]:
    """`check` of what is diagnosed: what stops it, and what goes into the notes."""
    stopping: list[DataProblem] = []
    minor: list[DataProblem] = []
    for m in check(of_subject(subject), flying(subject.system)):
        lines = f" dataset.toml should have: {'; '.join(m.mend)}" if m.mend else ""
        where = m.recordings[0] if m.recordings else subject.logs[0].name
        (stopping if m.stops else minor).append(DataProblem(where, m.signal, m.kind, None, m.detail + lines))
    return stopping, minor


def pace(recorded: Recorded) -> list[Mistake]:
    """A log that is too slow for rotations, and what it is still good for."""
    if recorded.rate > SLOW or "body_rates" not in recorded.reading.signals:
        return []
    missed = []
    for flight in recorded.flights:
        rates = flight.signals(recorded.reading, ("body_rates",))["body_rates"][:, :2][flight.valid]
        between = rates[1:-1] - (rates[2:] + rates[:-2]) / 2
        if len(between) > 10:
            size = np.sqrt(np.mean((rates - rates.mean(axis=0)) ** 2))
            missed.append(float(np.sqrt(np.mean(between**2)) / max(float(size), 1e-12)))
    if not missed or (np.median(missed) < SPIKING.missed and recorded.rate > SLOWER):
        return []
    detail = (
        f"{recorded.rate:g} Hz is too slow for rotations: {np.median(missed):.0%} of the body rates cannot be told "
        "from the samples before and after. Forces can still be judged with measured attitude (drag, mass, thrust, "
        "battery, wind), torques and motor lag cannot; log rates and rotors at 100 Hz or more for those."
    )
    return [Mistake("slow log", "body_rates", tuple(f.name for f in recorded.flights), detail, (), False)]
