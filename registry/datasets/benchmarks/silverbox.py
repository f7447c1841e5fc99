"""Silverbox: an electronic circuit that imitates a mass on a hardening spring."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import pandas as pd
from typing_extensions import override

from registry.contracts import Dataset, Finding, Recording, RecordingSet, Split
from registry.core import DATASETS, option
from registry.datasets.locate import locate
from registry.datasets.signals import recording
from registry.errors import BenchError

RATE = 1e7 / 2**14
"""Of the generator and the acquisition board that share one clock [Hz]."""
SAMPLES = 131_072
ARROW = slice(0, 40_500)
"""Filtered Gaussian noise that grows."""
MULTISINES = tuple(slice(40_580 + 8_692 * k, 49_180 + 8_692 * k) for k in range(10))
"""Ten random odd multisines, one after the other, with 92 quiet samples between two."""
QUIET = slice(127_460, 127_860)
"""No drive: what the channels read at rest."""
CUTOFF, ROLL_OFF = 240.0, 30.0
"""Frequencies up to the first enter the derivative; it fades out over the second [Hz]. The drive ends at 200 Hz."""
OFFICIAL = {
    "multisine": slice(40_650, 105_712),
    "multisine_test": slice(105_712, 127_400),
    "arrow": slice(100, 40_575),
    "arrow_no_extrapolation": slice(100, 32_100),
}
"""Parts of the benchmark: the first three quarters of the multisines train, the rest and the arrow test."""
EDGE = 32
"""Samples at either end at which the derivative is not trusted."""


@DATASETS.register("silverbox")
@dataclass(frozen=True)
class Silverbox(Dataset):
    """Drive voltage to output voltage of an electronic Duffing oscillator, 4 × 610 Hz, 3.5 minutes in 11 recordings.

    A volt of the circuit stands for 1 N of drive and 1 m of displacement. Both channels are taken from their readings
    at rest and interpolated within the band up to 240 Hz, beyond which nothing drives. Speed is not measured: it is the
    derivative of the displacement within that band.
    """

    finer: int = option(
        4,
        "times the measured rate, by band-limited interpolation: at 9 samples a period of the resonance neither "
        "straight lines between the samples nor an integrator's steps are near enough",
        choices=(1, 2, 4, 8),
    )

    official: bool = option(
        False, "as the benchmark is judged: raw samples of drive and output at 610 Hz, in its own four parts"
    )

    source: ClassVar[str] = (
        "T. Wigren, J. Schoukens, Three free data sets for development and benchmarking in nonlinear system "
        "identification, European Control Conference 2013; https://github.com/forgi86/pytorch-ident, MIT"
    )
    system: ClassVar[str] = "oscillator"
    inputs: ClassVar[tuple[str, ...]] = ("force",)
    initial_window: ClassVar[int] = 50
    targets: ClassVar[tuple[str, ...]] = ("displacement",)  # the speed is its slope, which looks ahead
    chain: ClassVar[tuple[str, ...]] = ("displacement", "speed")
    # Least squares of the linear equation on the training recordings, in the frequency band.
    physics: ClassVar[dict[str, Any]] = {"mass": 5.346e-6, "damping": 2.254e-4, "stiffness": 1.020}
    uncertainty: ClassVar[dict[str, float]] = {"mass": 0.05, "damping": 0.05, "stiffness": 0.05}

    @override
    def read(self) -> RecordingSet:
        (file, *_) = locate(
            "silverbox",
            "SNLS80mV.csv",
            "https://github.com/forgi86/pytorch-ident (commit f00d79f)",
            "it has SHA-256 ae62d5a91230c10f76e6dd02c8a4fac3c9d4d8a95fbf50e87cb0c4885003e0f1",
        )
        try:
            table = pd.read_csv(file, usecols=["V1", "V2"], dtype=float)[["V1", "V2"]].to_numpy()
        except (OSError, ValueError) as error:
            raise BenchError(f"{file} is damaged or not the published file ({error}): download it again.") from error
        if len(table) != SAMPLES or not np.isfinite(table).all():
            raise BenchError(f"{file} does not hold {SAMPLES} samples of V1 and V2: download it again.")
        if self.official:
            return RecordingSet(tuple(_raw(name, table[part]) for name, part in OFFICIAL.items()), ())
        rest = table[QUIET].mean(axis=0)
        table = table - rest
        parts = {"arrow": ARROW, **{f"multisine_{k + 1:02d}": part for k, part in enumerate(MULTISINES)}}
        shift = f"drive {1e3 * rest[0]:.2f} mV and output {1e3 * rest[1]:.2f} mV at rest, subtracted"
        findings = [Finding(name, "offset", part.stop - part.start, shift) for name, part in parts.items()]
        used = sum(part.stop - part.start for part in parts.values())
        findings.append(Finding(file.stem, "trimmed", SAMPLES - used, "quiet samples between the parts left out"))
        return RecordingSet(
            tuple(_part(name, table[part], self.finer) for name, part in parts.items()), tuple(findings)
        )

    def split(self, names: Sequence[str]) -> Split:
        """The arrow tests, as published, and the last two multisines; the one before them validates (our choice).

        The official parts but the first test.
        """
        if self.official:
            return Split(tuple(n for n in names if n == "multisine"), (), tuple(n for n in names if n != "multisine"))
        test = tuple(n for n in names if n in ("arrow", "multisine_09", "multisine_10"))
        validation = tuple(n for n in names if n == "multisine_08")
        return Split(tuple(n for n in names if n not in test and n not in validation), validation, test)


def _raw(name: str, table: np.ndarray) -> Recording:
    outputs = {"displacement": table[:, 1:]}
    return recording(name, RATE, {"force": table[:, :1]}, outputs, np.ones(len(table), dtype=bool))


def _part(name: str, table: np.ndarray, finer: int) -> Recording:
    displacement, speed = (band_limited(table[:, 1], finer, order)[:, None] for order in (0, 1))
    valid = np.ones(len(speed), dtype=bool)
    valid[: EDGE * finer] = valid[-EDGE * finer :] = False
    outputs = {"displacement": displacement, "speed": speed}
    return recording(name, RATE * finer, {"force": band_limited(table[:, 0], finer)[:, None]}, outputs, valid)


def band_limited(x: np.ndarray, finer: int = 1, order: int = 0) -> np.ndarray:
    """``x`` (N,) or a derivative of it, within the band, at ``finer`` times the rate (N finer,).

    Beyond its ends the signal is turned about them.
    """
    reach = 1000
    padded = np.concatenate([2 * x[0] - x[reach:0:-1], x, 2 * x[-1] - x[-2 : -reach - 2 : -1]])
    frequency = np.fft.rfftfreq(len(padded), 1 / RATE)
    pass_band = np.clip((CUTOFF + ROLL_OFF - frequency) / ROLL_OFF, 0, 1)
    spectrum = np.fft.rfft(padded) * (2j * np.pi * frequency) ** order * pass_band
    fine: np.ndarray = np.fft.irfft(spectrum, len(padded) * finer) * finer
    return fine[reach * finer : (reach + len(x)) * finer]
