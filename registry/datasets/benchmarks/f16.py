"""F-16 ground vibration: a shaker under the wing of an aircraft whose payload rattles in its mount."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
from typing_extensions import override

from registry.contracts import Dataset, Recording, RecordingSet, Split
from registry.core import DATASETS
from registry.datasets.locate import locate
from registry.datasets.reading.matlab import read_v5
from registry.datasets.signals import recording
from registry.errors import BenchError
from registry.units import Signal

ACCELERATION = Signal("m/s^2", ("1", "2", "3"), "at the excitation, and on both sides of the payload's mount")


@DATASETS.register("f16")
@dataclass(frozen=True)
class F16(Dataset):
    """Shaker force to three accelerations at the wing of an F-16, 400 Hz, multisines and sine sweeps at seven levels.

    Records of random odd multisines ("SpecialOdd…") hold several realizations and are left out.
    """

    source: ClassVar[str] = (
        "J.-P. Noël, M. Schoukens, F-16 aircraft benchmark based on ground vibration test data, Workshop on Nonlinear "
        "System Identification Benchmarks, Brussels 2017; https://data.4tu.nl (12954911)"
    )
    inputs: ClassVar[tuple[str, ...]] = ("force",)
    targets: ClassVar[tuple[str, ...]] = ("acceleration",)
    initial_window: ClassVar[int] = 50

    @override
    def read(self) -> RecordingSet:
        files = locate(
            "f16",
            "F16Data_*.mat",
            "https://www.nonlinearbenchmark.org/benchmarks/f-16-gvt",
            "each holds Force, Acceleration and Fs",
        )
        return RecordingSet(tuple(map(_read, (f for f in files if "SpecialOdd" not in f.stem))), ())

    def split(self, names: Sequence[str]) -> Split:
        """The records called validation test, as the benchmark has it."""
        test = tuple(n for n in names if n.lower().endswith("validation"))
        return Split(tuple(n for n in names if n not in test), (), test)


def _read(path: Path) -> Recording:
    data = read_v5(path, ["Force", "Acceleration", "Fs"])
    force, acceleration = data["Force"].reshape(-1, 1), data["Acceleration"]
    if acceleration.ndim != 2 or acceleration.shape != (3, len(force)) or not np.isfinite(acceleration).all():
        raise BenchError(f"{path}: Acceleration is not three rows as long as Force: download it again.")
    name, rate = path.stem.removeprefix("F16Data_"), float(data["Fs"].reshape(-1)[0])
    signals = {"force": force}, {"acceleration": acceleration.T}
    return recording(name, rate, *signals, np.isfinite(force[:, 0]), {"acceleration": ACCELERATION})
