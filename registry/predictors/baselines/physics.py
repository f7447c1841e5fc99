"""The physics model alone: what a motion model predicts without anything learnt."""

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import torch
from torch import Tensor
from typing_extensions import override

from registry.contracts import Dataset, Predictor, PredictorEntry, Problem, StateLayout
from registry.core import PREDICTORS, option
from registry.errors import BenchError
from registry.predictors.parts.white_box import WhiteBox, default_signals
from registry.regular_file import regular


class PhysicsPredictor(Predictor):
    """Free run of a physics model from the measured state at k0.

    The state is [u_{k0} of what drives the model | its full state], SI.
    """

    def __init__(self, entry: "Physics", problem: Problem) -> None:
        super().__init__(problem)
        self.box = WhiteBox(problem, entry.model, sought=entry.start == "sought")
        self.history = problem.history
        self.layout = StateLayout(len(self.box.drives) + self.box.size, 0, 0)

    def init_buffers(self, inputs: Tensor, outputs: Tensor) -> Tensor:
        """What drives the model at k0, and its full state as the history leaves it; see `WhiteBox.start`."""
        return self.box.init_buffers(self, inputs, outputs)

    def rollout(self, inputs: Tensor, state: Tensor, feedback: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """See `Predictor.rollout`; measured outputs take the place of predicted states."""
        drives, rows = self.box.drives, self.box.rows
        before, full = state.split([len(drives), self.box.size], -1)
        driving = self.input_scaler.invert(inputs)[..., drives]
        measured = None if feedback is None else self.output_scaler.invert(feedback)
        predicted = []
        for k in range(inputs.shape[-2]):
            full = self.box.model.step(full, before, driving[..., k, :], self.box.dt)
            predicted.append(full[..., rows])
            if measured is not None:
                full = full.clone()
                full[..., rows] = measured[..., k, :]
            before = driving[..., k, :]
        outputs = self.output_scaler(torch.stack(predicted, -2))
        return outputs, torch.cat([before, full], -1)


@PREDICTORS.register("physics")
@dataclass(frozen=True)
class Physics(PredictorEntry):
    """The physics model of the recorded system alone, with nominal constants or as a model.toml says."""

    training: ClassVar[str] = "none"
    stateful: ClassVar[bool] = False

    model: str = option("", "path of a model.toml, as `bench extend` writes it; empty: nominal constants")

    start: str = option(
        "zero",
        "unmeasured states at the start of the history: zero, or sought so that a free run meets the history best",
        choices=("zero", "sought"),
    )

    @override
    def signals(self, dataset: Dataset) -> tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]]:
        return default_signals(dataset, self.model)

    @override
    def content(self) -> str:
        return digest(self.model)

    @override
    def build(self, problem: Problem) -> Predictor:
        return PhysicsPredictor(self, problem)


def digest(file: str) -> str:
    """SHA-256 of a file; empty for none.

    Raises:
        BenchError: it cannot be read.
    """
    if not file:
        return ""
    try:
        return hashlib.sha256(regular(Path(file)).read_bytes()).hexdigest()
    except OSError as error:
        raise BenchError(f"{file} cannot be read: {error.strerror or error}.") from error
