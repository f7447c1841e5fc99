"""The baseline that holds the last measured output."""

from dataclasses import dataclass
from typing import ClassVar

from torch import Tensor
from typing_extensions import override

from registry.contracts import Predictor, PredictorEntry, Problem, StateLayout
from registry.core import PREDICTORS


class ConstantPredictor(Predictor):
    """ŷ_k = y_{k0} for every k."""

    def __init__(self, problem: Problem) -> None:
        super().__init__(problem)
        self.layout = StateLayout(self.n_outputs, 0, 0)

    def init_buffers(self, inputs: Tensor, outputs: Tensor) -> Tensor:
        """The last measured output."""
        return outputs[..., -1, : self.n_outputs]

    @override
    def rollout(self, inputs: Tensor, state: Tensor, feedback: Tensor | None = None) -> tuple[Tensor, Tensor]:
        held = state.unsqueeze(-2).expand(*state.shape[:-1], inputs.shape[-2], state.shape[-1])
        return held, state


@PREDICTORS.register("constant")
@dataclass(frozen=True)
class Constant(PredictorEntry):
    """Holds the last measured output: the error that any predictor has to beat."""

    training: ClassVar[str] = "none"
    stateful: ClassVar[bool] = False

    @override
    def build(self, problem: Problem) -> Predictor:
        return ConstantPredictor(problem)
