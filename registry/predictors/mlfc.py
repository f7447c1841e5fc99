"""The multi-layer fully connected RNN of the paper."""

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor, nn

from registry.contracts import Predictor, PredictorEntry, Problem, StateLayout
from registry.core import PREDICTORS, option
from registry.kernels.mlfc import mlfc
from registry.kernels.mlp import affine
from registry.predictors.lstm import newest_first
from registry.predictors.weights import uniform


class MLFCPredictor(Predictor):
    """Network of `MLFC`: tanh layers with skip connections forward and backward, linear read-out of all of them."""

    def __init__(self, entry: "MLFC", problem: Problem) -> None:
        super().__init__(problem)
        n_inputs, n_outputs = self.n_inputs, self.n_outputs
        self.layers, self.hidden, self.dropout = entry.layers, entry.hidden, entry.dropout
        size = entry.layers * entry.hidden
        self.layout = StateLayout(n_outputs, size, 0)
        columns = n_inputs + n_outputs + size - entry.hidden
        draw = lambda *shape: uniform(*shape, fan_in=columns + entry.hidden, scale=entry.weight_scale)  # noqa: E731
        each = range(entry.layers)
        self.input_weight = nn.ParameterList([draw(entry.hidden, columns) for _ in each])
        self.feedback_weight = nn.ParameterList([draw(entry.hidden, entry.hidden) for _ in each])
        self.bias = nn.ParameterList([nn.Parameter(torch.zeros(entry.hidden)) for _ in each])
        self.output_weight = uniform(n_outputs, size, fan_in=size + n_inputs, scale=entry.weight_scale)
        self.direct_weight = uniform(n_outputs, n_inputs, fan_in=size + n_inputs, scale=entry.weight_scale)
        self.output_bias = nn.Parameter(torch.zeros(n_outputs))

    def fill(self, inputs: Tensor, outputs: Tensor) -> Tensor:
        """The last measured output."""
        return newest_first(outputs[..., : self.n_outputs], 1)

    def rollout(self, inputs: Tensor, state: Tensor, feedback: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """See `Predictor.rollout`."""
        fed, hidden, _ = self.layout.split(state)
        single = inputs.dim() == 3
        lead = (lambda x: x.unsqueeze(0)) if single else (lambda x: x)
        seen = self.n_inputs + self.n_outputs  # columns of input_weight before the other layers'
        layers = []
        for i in range(self.layers):
            w, before = self.input_weight[i], seen + i * self.hidden
            layers.append(
                lead(
                    torch.cat(
                        [
                            w[..., :seen],
                            self.bias[i].unsqueeze(-1),
                            w[..., seen:before],
                            self.feedback_weight[i],
                            w[..., before:],
                        ],
                        -1,
                    )
                )
            )
        no_fed = torch.zeros_like(self.output_bias).unsqueeze(-1).expand(*self.output_bias.shape, self.n_outputs)
        readout = torch.cat([self.direct_weight, no_fed, self.output_bias.unsqueeze(-1), self.output_weight], -1)
        outputs, hidden = mlfc(
            lead(inputs),
            lead(fed),
            lead(hidden),
            layers,
            lead(readout),
            None if feedback is None else lead(feedback),
            self.dropout if self.training else 0.0,
        )
        if single:
            outputs, hidden = outputs[0], hidden[0]
        latest = (outputs if feedback is None else feedback)[..., -1, :]
        return outputs, torch.cat([latest, hidden], -1)

    def readout(self, state: Tensor, inputs: Tensor) -> Tensor:
        """A [y¹ .. y^L] + B u + b (the paper's A_s = A, c = y − B u − b)."""
        _, hidden, _ = self.layout.split(state)
        weight = torch.cat([self.output_weight, self.direct_weight], -1)
        return affine(torch.cat([hidden, inputs], -1), weight, self.output_bias)


@PREDICTORS.register("MLFC")
@dataclass(frozen=True)
class MLFC(PredictorEntry):
    """Multi-layer fully connected RNN: tanh layers joined by skip connections forward and backward.

    Mohajerin and Waslander, eqs. LRLayer and layerinput; the output is fed back beside the input.
    """

    network: ClassVar[bool] = True

    layers: int = option(1, "layers", low=1, high=20, search=(1, 3))
    hidden: int = option(50, "neurons in each layer", low=1, high=2000, log=True, search=(10, 100))
    dropout: float = option(0.0, "probability of dropping a layer output before the read-out", low=0.0, high=0.9)
    weight_scale: float = option(1.0, "initial weights are uniform within ± this / √fan-in", low=0.0, high=10.0)

    def build(self, problem: Problem) -> Predictor:
        """See `PredictorEntry.build`."""
        return MLFCPredictor(self, problem)
