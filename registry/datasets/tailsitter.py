"""The tail-sitter hovering data set: 18 flights under motion capture."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from typing_extensions import override

from registry.contracts import Dataset, Finding, RecordingSet, Split
from registry.core import DATASETS
from registry.datasets.locate import locate
from registry.datasets.reading.matlab import read_v5
from registry.datasets.reading.rotations import body_rates_from_euler, quaternion_from_euler
from registry.datasets.signals import recording
from registry.errors import BenchError

RATE = 100.0


@DATASETS.register("tailsitter")
@dataclass(frozen=True)
class Tailsitter(Dataset):
    """Quadrotor tail-sitter hovering, 18 flights at 100 Hz with motor and elevon PWM; 24 minutes.

    Motion-capture position [m], velocity [m/s], attitude xyzw; body and Euler rates [rad/s]. The published "vision
    rate" is the time derivative of the Euler angles, so body rates are computed from it. PWM counts are µs. Everything
    was smoothed by its authors with a moving mean that looks ahead. No physics model of the vehicle is registered.
    """

    source: ClassVar[str] = (
        "PolyU MAV/UAV Lab, quadrotor tail-sitter hovering data set; "
        "https://github.com/RockyJBL/Tailsitter-hovering-dataset, no licence stated"
    )
    inputs: ClassVar[tuple[str, ...]] = ("pwm", "elevon")
    targets: ClassVar[tuple[str, ...]] = ("body_rates",)
    chain: ClassVar[tuple[str, ...]] = ("velocity", "body_rates")

    @override
    def read(self) -> RecordingSet:
        files = locate(
            "tailsitter_polyu",
            "*.mat",
            "https://github.com/RockyJBL/Tailsitter-hovering-dataset (commit 5bba36f)",
            "manual_position_1.mat has SHA-256 7e003c574b0a551f2dcd9491cc25d9cd6276eb07dfa02a4b59db91b89661c98e",
        )
        names = {"time": 1, "actuator_outputs": 6}
        names |= {f"vision_{signal}": 3 for signal in ("position", "velocity", "attitude", "rate")}
        recordings, findings = [], []
        for file in files:
            table = read_v5(file, list(names))
            if not table["time"].size:
                raise BenchError(f"{file} holds no samples: download it again.")
            for name, columns in names.items():
                x = table[name]
                if x.ndim != 2 or x.shape[1] != columns or len(x) != len(table["time"]) or not np.isfinite(x).all():
                    raise BenchError(f"{file}: {name} is not a table of {columns} finite columns: download it again.")
            if not np.allclose(np.diff(table["time"][:, 0]), 1 / RATE, atol=1e-4):
                raise BenchError(f"{file}: its clock is not {RATE:.0f} Hz throughout: download it again.")
            euler, euler_rates = table["vision_attitude"], table["vision_rate"]
            outputs = {
                "position": table["vision_position"],
                "velocity": table["vision_velocity"],
                "attitude": quaternion_from_euler(euler),
                "body_rates": body_rates_from_euler(euler, euler_rates),
                "euler_rates": euler_rates,
            }
            pwm = table["actuator_outputs"]
            stuck = np.isin(pwm[:, 4:], (1000.0, 2000.0)).any(axis=1)
            if stuck.any():
                detail = "an elevon at the end of its travel (1000 or 2000 µs), kept"
                findings.append(Finding(file.stem, "saturated", int(stuck.sum()), detail))
            inputs = {"pwm": pwm[:, :4], "elevon": pwm[:, 4:]}
            recordings.append(recording(file.stem, RATE, inputs, outputs, np.ones(len(pwm), dtype=bool)))
        return RecordingSet(tuple(recordings), tuple(findings))

    def split(self, names: Sequence[str]) -> Split:
        """Of each kind, the third repetition tests and the second validates (our choice: none is published)."""
        test = tuple(n for n in names if n.endswith("_3"))
        validation = tuple(n for n in names if n.endswith("_2"))
        return Split(tuple(n for n in names if n not in test and n not in validation), validation, test)
