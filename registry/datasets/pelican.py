"""The AscTec Pelican flight data set of the paper: 54 flights under motion capture."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
from typing_extensions import override

from registry.contracts import Dataset, Finding, Recording, RecordingSet, Split
from registry.core import DATASETS, option
from registry.datasets.locate import locate
from registry.datasets.reading.matlab import read_cell_structs
from registry.datasets.reading.rotations import (
    body_rates_from_euler,
    euler_rates_from_body,
    quaternion_from_euler,
)
from registry.datasets.signals import recording
from registry.errors import BenchError
from registry.units import to_si

RATE = 100.0
FLIGHTS, SAMPLES = 54, 1_388_410
"""What the published file holds."""
MAXIMA = {"velocity": (3.9268, 3.9721, 5.8526), "body_rates": (3.9116, 3.8506, 3.7902)}
"""The paper's table of maxima [m/s], [rad/s]."""
_ROWS = {"Pos": 3, "Euler": 3, "Motors": 4, "Motors_CMD": 4, "Vel": 3, "pqr": 3}


@DATASETS.register("pelican")
@dataclass(frozen=True)
class Pelican(Dataset):
    """AscTec Pelican, 54 flights at 100 Hz, 3.9 hours, all regimes from hover to aggressive.

    Position [m], velocity [m/s] in the world, attitude xyzw, body and Euler rates [rad/s]; measured and commanded
    motor speeds as integers 0–218 (the documentation gives no rpm: "using NNs it is not necessary"). Smoothed by its
    authors with a local quadratic of 5 samples. A difference of samples k−1 and k is filed under k.
    """

    body_rates: str = option(
        "published", "as in the file, or recomputed from the Euler angles", choices=("published", "recomputed")
    )

    source: ClassVar[str] = (
        "N. Mohajerin, S. L. Waslander, Multistep Prediction of Dynamic Systems With Recurrent Neural Networks, "
        "IEEE TNNLS 2019; https://github.com/wavelab/pelican_dataset, no licence stated"
    )
    system: ClassVar[str] = "quadrotor"
    inputs: ClassVar[tuple[str, ...]] = ("motor_count",)
    targets: ClassVar[tuple[str, ...]] = ("body_rates",)
    chain: ClassVar[tuple[str, ...]] = ("velocity", "body_rates")

    @override
    def read(self) -> RecordingSet:
        (file,) = locate(
            "pelican",
            "AscTec_Pelican_Flight_Dataset.mat",
            "http://wavelab.uwaterloo.ca/wp-content/uploads/2017/09/AscTec_Pelican_Flight_Dataset.mat",
            "its SHA-256 is not known to us (238.1 MB)",
        )
        recordings, findings = [], []
        misprinted = 0
        for i, cell in enumerate(read_cell_structs(file, ["len", *_ROWS])):
            flight, printed_fits = self._flight(file, i + 1, cell)
            recordings.append(flight)
            misprinted += printed_fits
        total = sum(len(r) + 1 for r in recordings)
        if (len(recordings), total) != (FLIGHTS, SAMPLES):
            detail = f"{len(recordings)} flights of {total} samples where {FLIGHTS} of {SAMPLES} are published"
            findings.append(Finding("all flights", "size", total - SAMPLES, detail))
        if misprinted:
            detail = (
                "flights whose pqr fit the documentation's matrix (body rates to Euler rates) applied to Euler rates "
                "better than its inverse, which gives body rates; body_rates = recomputed mends it"
            )
            findings.append(Finding("all flights", "convention", misprinted, detail))
        for signal, published in MAXIMA.items():
            found = np.max([np.abs(r.pick([signal])[0]).max(axis=0) for r in recordings], axis=0)
            off = float(np.max(np.abs(found / published - 1)))
            if off > 1e-3:
                values = ", ".join(f"{v:.4f}" for v in found)
                detail = f"maxima of {signal} are {values} and differ from the paper's table by up to {off:.1%}"
                findings.append(Finding("all flights", "maxima", off, detail))
        return RecordingSet(tuple(recordings), tuple(findings))

    def split(self, names: Sequence[str]) -> Split:
        """Of every six flights four train, one validates and one tests (our choice: the paper names none)."""
        groups: dict[int, list[str]] = {0: [], 1: [], 2: []}
        for i, name in enumerate(sorted(names)):
            groups[{4: 1, 5: 2}.get(i % 6, 0)].append(name)
        if not groups[2]:
            raise BenchError(f"The Pelican file holds {len(names)} flights, too few to split: download it again.")
        return Split(tuple(groups[0]), tuple(groups[1]), tuple(groups[2]))

    def _flight(self, file: Path, number: int, cell: dict[str, np.ndarray]) -> tuple[Recording, bool]:
        samples = int(cell["len"].reshape(-1)[0])
        x = {}
        for name, rows in _ROWS.items():
            expected = (rows, samples - 1 if name in ("Vel", "pqr") else samples)
            if cell[name].shape != expected or not np.isfinite(cell[name]).all():
                raise BenchError(
                    f"{file}: {name} of flight {number} is not {expected[0]} x {expected[1]} finite numbers: "
                    "download it again."
                )
            x[name] = cell[name].T
        position, euler = x["Pos"] * to_si("mm")[1], x["Euler"] * to_si("deg")[1]
        velocity = np.diff(position, axis=0) * RATE
        euler_rates = np.diff(np.unwrap(euler, axis=0), axis=0) * RATE
        euler = euler[1:]
        rates = body_rates_from_euler(euler, euler_rates)
        printed = euler_rates_from_body(euler, euler_rates)  # what the documentation's equation computes
        # The documentation does not say whether Vel and pqr kept the units of Pos and Euler.
        published_velocity = x["Vel"] * _unit(x["Vel"], [velocity], to_si("mm")[1], f"{file}: Vel of flight {number}")
        published = x["pqr"] * _unit(x["pqr"], [rates, printed], to_si("deg")[1], f"{file}: pqr of flight {number}")
        printed_fits = bool(((published - printed) ** 2).sum() < ((published - rates) ** 2).sum() * 0.99)
        outputs = {
            "position": position[1:],
            "velocity": published_velocity,
            "attitude": quaternion_from_euler(euler),
            "body_rates": published if self.body_rates == "published" else rates,
            "euler_rates": euler_rates,
            "pwm": x["Motors_CMD"][1:],
        }
        inputs = {"motor_count": x["Motors"][1:]}
        valid = np.ones(samples - 1, dtype=bool)
        return recording(f"flight_{number:02d}", RATE, inputs, outputs, valid), printed_fits


def _unit(published: np.ndarray, own: list[np.ndarray], small: float, label: str) -> float:
    """1 or ``small``: the factor that brings ``published`` nearest to one of ``own``."""
    error = {k: min(float(((published * k - x) ** 2).sum()) for x in own) for k in (1.0, small)}
    best = min(error, key=error.__getitem__)
    if error[best] > 0.1 * float((own[0] ** 2).sum()) + 1e-12:
        raise BenchError(f"{label} does not agree with the derivative of the flight's own angles and positions.")
    return best
