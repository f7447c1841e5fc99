"""Wiener–Hammerstein: a diode between two linear filters."""

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

PARTS = {"estimation": slice(5_200, 105_200), "test": slice(105_200, 184_000)}
"""Of the 188,000 samples; before and after them the circuit rests."""
OUTPUT = Signal("V", ("",), "output of the circuit")


@DATASETS.register("wiener_hammerstein")
@dataclass(frozen=True)
class WienerHammerstein(Dataset):
    """Input to output voltage of an electronic Wiener–Hammerstein circuit, 51.2 kHz, 3.5 s in two parts."""

    source: ClassVar[str] = (
        "J. Schoukens, J. Suykens, L. Ljung, Wiener-Hammerstein benchmark, IFAC Symposium on System Identification "
        "2009; parts as in the package nonlinear_benchmarks"
    )
    inputs: ClassVar[tuple[str, ...]] = ("voltage",)
    targets: ClassVar[tuple[str, ...]] = ("output",)
    initial_window: ClassVar[int] = 50

    @override
    def read(self) -> RecordingSet:
        (file, *_) = locate(
            "wiener_hammerstein",
            "WienerHammerBenchMark.mat",
            "https://www.nonlinearbenchmark.org/benchmarks/wiener-hammerstein",
            "it holds uBenchMark, yBenchMark and fs",
        )
        data = read_v5(file, ["uBenchMark", "yBenchMark", "fs"])
        u, y = (data[name].reshape(-1, 1) for name in ("uBenchMark", "yBenchMark"))
        if len(u) != len(y) or len(u) < PARTS["test"].stop or not np.isfinite([u, y]).all():
            raise BenchError(f"{file} does not hold 188,000 samples of input and output: download it again.")
        rate, signals = float(data["fs"].reshape(-1)[0]), {"output": OUTPUT}
        return RecordingSet(
            tuple(
                recording(name, rate, {"voltage": u[part]}, {"output": y[part]}, np.ones(len(u[part]), bool), signals)
                for name, part in PARTS.items()
            ),
            (),
        )

    def split(self, names: Sequence[str]) -> Split:
        """As the benchmark has it."""
        return Split(tuple(n for n in names if n == "estimation"), (), tuple(n for n in names if n == "test"))
