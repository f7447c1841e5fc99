"""EMPS: an electro-mechanical positioning system, the classic of friction identification."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import scipy  # its parts are imported when they are used: scipy.signal takes longer than all else here
from typing_extensions import override

from registry.contracts import Dataset, Finding, RecordingSet, Split
from registry.core import DATASETS, option
from registry.datasets.locate import locate
from registry.datasets.reading.matlab import read_v5
from registry.datasets.signals import recording
from registry.errors import BenchError

RATE = 1000.0
WINDOW, ORDER = 21, 3
"""Local polynomial through the position, whose slope is the speed."""


@DATASETS.register("emps")
@dataclass(frozen=True)
class Emps(Dataset):
    """Motor voltage [V] to position [m] of a carriage on a rail, 1 kHz, two recordings of 25 s; friction is hidden.

    Measured in closed loop; the second recording has pulses of voltage on the drive, which the voltage given here
    includes. Speed [m/s] is not measured: it is the slope of a local cubic over 21 samples of the position.
    """

    official: bool = option(
        False, "as the benchmark is judged: the position alone, every sample of it; without, speed and masked ends too"
    )

    source: ClassVar[str] = (
        "A. Janot, M. Gautier, M. Brunot, Data Set and Reference Models of EMPS, 2019 Workshop on Nonlinear System "
        "Identification Benchmarks; https://github.com/wmkouw/NSI-EMPS, MIT"
    )
    system: ClassVar[str] = "mass_on_rail"
    inputs: ClassVar[tuple[str, ...]] = ("voltage",)
    initial_window: ClassVar[int] = 20
    targets: ClassVar[tuple[str, ...]] = ("displacement",)  # the speed is its slope, which looks ahead
    chain: ClassVar[tuple[str, ...]] = ("displacement", "speed")
    physics: ClassVar[dict[str, Any]] = {"mass": 95.1, "force_gain": 35.15065188248547}
    processing: ClassVar[dict[str, Any]] = {
        "smoothing": {"kind": "savgol", "window": WINDOW, "order": ORDER},
        "noise": {"displacement": 1e-7},  # what is left of the position beside that cubic, at rest and moving
    }

    @override
    def read(self) -> RecordingSet:
        files = locate(
            "emps",
            "DATA_EMPS*.mat",
            "https://github.com/wmkouw/NSI-EMPS (commit d1137b8)",
            "DATA_EMPS.mat has SHA-256 6cf6814ae14618795da0101aae2bb97ff0c6351b0501b5492751b02b07facf7e",
        )
        recordings, findings = [], []
        for file in files:
            table = {name: x.reshape(-1) for name, x in read_v5(file, ["t", "qm", "vir"]).items()}
            n = len(table["t"])
            if n <= WINDOW or any(len(x) != n or not np.isfinite(x).all() for x in table.values()):
                raise BenchError(
                    f"{file}: t, qm and vir are not columns of finite numbers of one length: download again."
                )
            if not np.allclose(np.diff(table["t"]), 1 / RATE, atol=1e-6):
                raise BenchError(f"{file}: its clock is not {RATE:.0f} Hz throughout: download it again.")
            inputs, outputs = {"voltage": table["vir"][:, None]}, {"displacement": table["qm"][:, None]}
            if self.official:
                recordings.append(recording(file.stem, RATE, inputs, outputs, np.ones(n, dtype=bool)))
                continue
            speed = scipy.signal.savgol_filter(table["qm"], WINDOW, ORDER, deriv=1, delta=1 / RATE)
            valid = np.ones(n, dtype=bool)
            valid[: WINDOW // 2] = valid[-(WINDOW // 2) :] = False
            detail = "samples at the ends, where the speed has neighbours on one side only, masked"
            findings.append(Finding(file.stem, "trimmed", float((~valid).sum()), detail))
            recordings.append(recording(file.stem, RATE, inputs, {**outputs, "speed": speed[:, None]}, valid))
        return RecordingSet(tuple(recordings), tuple(findings))

    def split(self, names: Sequence[str]) -> Split:
        """As published: the recording with pulses tests."""
        test = tuple(n for n in names if n.endswith("PULSES"))
        return Split(tuple(n for n in names if n not in test), (), test)
