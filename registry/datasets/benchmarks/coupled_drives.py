"""Coupled electric drives: two motors on one belt, whose speed is counted without its sign."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from typing_extensions import override

from registry.contracts import Dataset, RecordingSet, Split
from registry.core import DATASETS
from registry.datasets.locate import locate
from registry.datasets.reading.matlab import read_v5
from registry.datasets.signals import recording
from registry.errors import BenchError
from registry.units import Signal

RATE = 50.0
SAMPLES, TRAINED = 500, 400
LEVELS = {"low": ("u11", "z11"), "high": ("u12", "z12")}
"""Amplitudes of the drive, and the variables of input and output."""
SPEED = Signal("1", ("",), "magnitude of the pulley's speed, as its pulse counter gives it")


@DATASETS.register("coupled_drives")
@dataclass(frozen=True)
class CoupledDrives(Dataset):
    """Drive voltage to the magnitude of the belt's speed, 50 Hz, two experiments of 10 s; their last fifth tests."""

    source: ClassVar[str] = (
        "T. Wigren, M. Schoukens, Coupled Electric Drives Data Set and Reference Models, Uppsala University, technical "
        "report 2017-024; parts as in the package nonlinear_benchmarks"
    )
    inputs: ClassVar[tuple[str, ...]] = ("voltage",)
    targets: ClassVar[tuple[str, ...]] = ("pulley_speed",)
    initial_window: ClassVar[int] = 4

    @override
    def read(self) -> RecordingSet:
        (file, *_) = locate(
            "coupled_drives",
            "DATAUNIF.[mM][aA][tT]",
            "https://www.nonlinearbenchmark.org/benchmarks/coupled-electric-drives",
            "it holds u11, z11, u12 and z12",
        )
        data = read_v5(file, [name for pair in LEVELS.values() for name in pair])
        made = []
        for level, (drive, response) in LEVELS.items():
            u, y = data[drive].reshape(-1, 1), data[response].reshape(-1, 1)
            if len(u) != SAMPLES or len(y) != SAMPLES or not np.isfinite([u, y]).all():
                raise BenchError(f"{file}: {drive} and {response} are not {SAMPLES} samples each: download it again.")
            for part, at in (("train", slice(TRAINED)), ("test", slice(TRAINED, SAMPLES))):
                signals = {"voltage": u[at]}, {"pulley_speed": y[at]}
                valid = np.ones(len(u[at]), dtype=bool)
                made.append(recording(f"{level}_{part}", RATE, *signals, valid, {"pulley_speed": SPEED}))
        return RecordingSet(tuple(made), ())

    def split(self, names: Sequence[str]) -> Split:
        """As the benchmark has it: the first 400 samples of both experiments train, the last 100 test."""
        return Split(tuple(n for n in names if n.endswith("train")), (), tuple(n for n in names if n.endswith("test")))
