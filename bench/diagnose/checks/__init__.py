"""Checks of a log that a human makes first: how dataset.toml reads it, before any physics is blamed."""

from dataclasses import replace
from pathlib import Path

from bench.diagnose.checks.clocks import clocks
from bench.diagnose.checks.conventions import conventions
from bench.diagnose.checks.mistake import Mistake
from bench.diagnose.checks.pace import pace
from bench.diagnose.checks.recorded import Recorded, flying, of_folder, of_subject
from bench.diagnose.checks.thrust import thrust

__all__ = ["Mistake", "Recorded", "check", "check_folder", "flying", "of_folder", "of_subject"]


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
    found += clocks(recorded, carried)
    return found + (thrust(recorded) if carried else [])


def check_folder(folder: str | Path) -> list[Mistake]:
    """`check` of a folder with a dataset.toml.

    Raises:
        BenchError: the folder cannot be read.
    """
    from registry.datasets.folder_description import describe

    return check(of_folder(folder), flying(describe(Path(folder)).system))
