"""Cascaded tanks: two tanks that overflow."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pandas as pd
from typing_extensions import override

from registry.contracts import Dataset, Finding, RecordingSet, Split
from registry.core import DATASETS
from registry.datasets.locate import locate
from registry.datasets.signals import recording
from registry.errors import BenchError

RATE = 0.25
SAMPLES = 1024
CEILING = 10.0
"""Highest reading of the level sensor [V]."""
_PARTS = {"estimation": ("uEst", "yEst"), "validation": ("uVal", "yVal")}


@DATASETS.register("cascaded_tanks")
@dataclass(frozen=True)
class CascadedTanks(Dataset):
    """Pump voltage [V] to the level of the lower of two tanks [V], every 4 s, two recordings of 68 minutes.

    The upper level is not measured. Overflow of the tanks is hidden in both recordings.
    """

    source: ClassVar[str] = (
        "M. Schoukens, P. Mattsson, T. Wigren, J.-P. Noël, Cascaded tanks benchmark combining soft and hard "
        "nonlinearities (2016); https://github.com/forgi86/sysid-neural-structures-fitting, MIT"
    )
    system: ClassVar[str] = "tanks"
    inputs: ClassVar[tuple[str, ...]] = ("voltage",)
    input_hold: ClassVar[str] = "previous"
    initial_window: ClassVar[int] = 5

    @override
    def read(self) -> RecordingSet:
        (file, *_) = locate(
            "cascaded_tanks",
            "dataBenchmark.csv",
            "https://github.com/forgi86/sysid-neural-structures-fitting (commit 886c969)",
            "it has SHA-256 ef2388ed822f3aef4aa80d6b0f2b466dd80b361786b3eafc7a2957c31ea323a7",
        )
        columns = [c for pair in _PARTS.values() for c in pair]
        try:
            table = pd.read_csv(file, usecols=columns, dtype=float)[columns].to_numpy()
        except (OSError, ValueError) as error:
            raise BenchError(f"{file} is damaged or not the published file ({error}): download it again.") from error
        if len(table) != SAMPLES or not ((table >= 0) & (table <= CEILING)).all():
            raise BenchError(f"{file} does not hold {SAMPLES} samples from 0 to {CEILING:.0f} V: download it again.")
        recordings, findings = [], []
        for i, name in enumerate(_PARTS):
            drive, level = table[:, 2 * i : 2 * i + 1], table[:, 2 * i + 1 : 2 * i + 2]
            full = int((level >= CEILING - 0.01).sum())
            if full:
                detail = (
                    f"samples within 10 mV of the sensor's ceiling of {CEILING:.0f} V, kept: there the tank overflows"
                )
                findings.append(Finding(name, "saturated", full, detail))
            valid = np.ones(len(level), dtype=bool)
            recordings.append(recording(name, RATE, {"voltage": drive}, {"level": level}, valid))
        return RecordingSet(tuple(recordings), tuple(findings))

    def split(self, names: Sequence[str]) -> Split:
        """As published: the validation recording tests."""
        return Split(tuple(n for n in names if n == "estimation"), (), tuple(n for n in names if n == "validation"))
