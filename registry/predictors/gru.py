"""The GRU predictor: gated layers in series without cells, outputs fed back to the first layer."""

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor, nn
from typing_extensions import override

from registry.contracts import Predictor, PredictorEntry, Problem, StateLayout
from registry.core import PREDICTORS, option
from registry.kernels.gru import Layer, gru
from registry.kernels.mlp import affine
from registry.predictors.parts.weights import uniform


class GRUPredictor(Predictor):
    """Network of `GRU`. State: [ỹ_{k0} | hidden]; there are no cells. Rows of the weights: reset, update, candidate."""

    def __init__(self, entry: "GRU", problem: Problem) -> None:
        super().__init__(problem)
        self.hidden, n, h = entry.hidden, self.n_outputs, entry.hidden
        self.layout = StateLayout(n, entry.layers * h, 0)
        widths = [self.n_inputs + n] + [h] * (entry.layers - 1)
        draw = lambda w, *shape: uniform(*shape, fan_in=w + h, scale=entry.weight_scale)  # noqa: E731
        self.input_weight = nn.ParameterList([draw(w, 3 * h, w) for w in widths])
        self.recurrent_weight = nn.ParameterList([draw(w, 3 * h, h) for w in widths])
        self.bias = nn.ParameterList([nn.Parameter(torch.zeros(3 * h)) for _ in widths])
        with torch.no_grad():
            for bias in self.bias:
                bias[h : 2 * h] = entry.update_bias
        self.output_weight = uniform(n, h, fan_in=h, scale=entry.weight_scale)
        self.output_bias = nn.Parameter(torch.zeros(n))

    def init_buffers(self, inputs: Tensor, outputs: Tensor) -> Tensor:
        """The last measured output."""
        return outputs[..., -1, : self.n_outputs]

    @override
    def rollout(self, inputs: Tensor, state: Tensor, feedback: Tensor | None = None) -> tuple[Tensor, Tensor]:
        fed, hidden, _ = self.layout.split(state)
        layers = [*map(Layer, self.input_weight, self.recurrent_weight, self.bias)]
        outputs, hidden = gru(inputs, fed, hidden, layers, self.output_weight, self.output_bias, forced=feedback)
        latest = (outputs if feedback is None else feedback)[..., -1, :]
        return outputs, torch.cat([latest, hidden], -1)

    def readout(self, state: Tensor, inputs: Tensor) -> Tensor:
        """W_y h^L + b_y (A_s = [W_y], c = y − b_y in the paper's eq. state_init_cost)."""
        _, hidden, _ = self.layout.split(state)
        return affine(hidden[..., -self.hidden :], self.output_weight, self.output_bias)


@PREDICTORS.register("GRU")
@dataclass(frozen=True)
class GRU(PredictorEntry):
    """Stacked gated recurrent units; their outputs are fed back to the first layer.

    Cho et al. (2014), Learning Phrase Representations using RNN Encoder-Decoder, first version (arXiv:1406.1078v1):
    the reset gate acts after the recurrent product.
    """

    network: ClassVar[bool] = True
    supports_batching: ClassVar[bool] = True

    layers: int = option(1, "layers in series", low=1, high=20, search=(1, 2))
    hidden: int = option(50, "units in each layer", low=1, high=2000, log=True, search=(10, 100))
    weight_scale: float = option(1.0, "initial weights are uniform within ± this / √fan-in", low=0.0, high=10.0)
    update_bias: float = option(1.0, "initial bias of the update gates; above 0 they keep", low=-10.0, high=10.0)

    @override
    def build(self, problem: Problem) -> Predictor:
        return GRUPredictor(self, problem)
