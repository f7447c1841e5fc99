"""The industrial robot: six joints with backlash, friction and gravity."""

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

RATE = 10.0
SAMPLES = 606
"""Of each trajectory; they stand one behind the other."""
JOINTS = ("1", "2", "3", "4", "5", "6")
SIGNALS = {
    "motor_torque": Signal("N m", JOINTS, "of the motors"),
    "joint_angle": Signal("rad", JOINTS, "of the joints"),
}


@DATASETS.register("industrial_robot")
@dataclass(frozen=True)
class IndustrialRobot(Dataset):
    """Motor torques to joint angles of a KUKA KR300 R2500, 10 Hz, trajectories of a minute; forward identification."""

    source: ClassVar[str] = (
        "J. Weigand, J. Götz, J. Ulmen, M. Ruskowski, Dataset and Baseline for an Industrial Robot Identification "
        "Benchmark, 2022, https://doi.org/10.26204/KLUEDO/6731"
    )
    inputs: ClassVar[tuple[str, ...]] = ("motor_torque",)
    targets: ClassVar[tuple[str, ...]] = ("joint_angle",)
    initial_window: ClassVar[int] = 50

    @override
    def read(self) -> RecordingSet:
        (file, *_) = locate(
            "industrial_robot",
            "forward_identification_without_raw_data.mat",
            "https://doi.org/10.26204/KLUEDO/6731",
            "it holds u_train, y_train, u_test and y_test",
        )
        data = read_v5(file, ["u_train", "y_train", "u_test", "y_test"])
        made = []
        for part in ("train", "test"):
            u, y = data[f"u_{part}"], data[f"y_{part}"]
            if u.shape != y.shape or u.shape[0] != len(JOINTS) or u.shape[1] % SAMPLES or not np.isfinite([u, y]).all():
                raise BenchError(f"{file}: u_{part} and y_{part} are not six rows of trajectories: download it again.")
            for i in range(u.shape[1] // SAMPLES):
                at = slice(i * SAMPLES, (i + 1) * SAMPLES)
                inputs, outputs = {"motor_torque": u[:, at].T}, {"joint_angle": np.deg2rad(y[:, at].T)}
                valid = np.ones(SAMPLES, dtype=bool)
                made.append(recording(f"{part}_{i + 1:02d}", RATE, inputs, outputs, valid, SIGNALS))
        return RecordingSet(tuple(made), ())

    def split(self, names: Sequence[str]) -> Split:
        """As the benchmark has it."""
        test = tuple(n for n in names if n.startswith("test"))
        return Split(tuple(n for n in names if n not in test), (), test)
