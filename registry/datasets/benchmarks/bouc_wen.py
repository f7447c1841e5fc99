"""Bouc–Wen: a mass whose spring remembers, simulated by its authors; everyone makes training data of their own."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from typing_extensions import override

from registry.contracts import Dataset, Recording, RecordingSet, Split
from registry.core import DATASETS
from registry.datasets.locate import locate
from registry.datasets.reading.matlab import read_v5
from registry.datasets.signals import recording
from registry.errors import BenchError

RATE = 750.0


@DATASETS.register("bouc_wen")
@dataclass(frozen=True)
class BoucWen(Dataset):
    """Force to displacement of a hysteretic oscillator, 750 Hz: the published test signals, and training signals.

    The benchmark gives a simulator and no training data. What was made with it is read from pairs of files u_NAME.mat
    and y_NAME.mat beside uval_multisine.mat and the others, each with one variable of the file's name.
    """

    source: ClassVar[str] = (
        "J.-P. Noël, M. Schoukens, Hysteretic benchmark with a dynamic nonlinearity, Workshop on Nonlinear System "
        "Identification Benchmarks, Brussels 2016; https://data.4tu.nl (12967592)"
    )
    system: ClassVar[str] = "oscillator"
    inputs: ClassVar[tuple[str, ...]] = ("force",)
    targets: ClassVar[tuple[str, ...]] = ("displacement",)
    physics: ClassVar[dict[str, Any]] = {"mass": 2.0, "damping": 10.0, "stiffness": 5e4}  # of the linear part
    initial_window: ClassVar[int] = 50

    @override
    def read(self) -> RecordingSet:
        files = locate(
            "bouc_wen",
            "u*_*.mat",
            "https://www.nonlinearbenchmark.org/benchmarks/bouc-wen",
            "uval_multisine.mat and yval_multisine.mat are among the files",
        )
        return RecordingSet(tuple(map(_read, files)), ())

    def split(self, names: Sequence[str]) -> Split:
        """The published signals test.

        Raises:
            BenchError: there is nothing to train on.
        """
        test = tuple(n for n in names if n.startswith("val_"))
        train = tuple(n for n in names if n not in test)
        if not train:
            raise BenchError(
                "The Bouc-Wen benchmark comes without training data: make some with its simulator and put them beside "
                "the published files as u_NAME.mat and y_NAME.mat."
            )
        return Split(train, (), test)


def _read(drive: Path) -> Recording:
    response = drive.with_name("y" + drive.name[1:])
    if not response.is_file():
        raise BenchError(f"{drive} has no {response.name} beside it: put both there.")
    u, y = (read_v5(file, [file.stem])[file.stem].reshape(-1, 1) for file in (drive, response))
    if len(u) != len(y) or not np.isfinite(u).all() or not np.isfinite(y).all():
        raise BenchError(f"{drive} and {response.name} are not finite numbers of one length: download them again.")
    name = drive.stem[1:].lstrip("_")
    return recording(name, RATE, {"force": u}, {"displacement": y}, np.ones(len(u), dtype=bool))
