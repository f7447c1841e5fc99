"""The recurrent initializer of the paper."""

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor, nn
from typing_extensions import override

from registry.contracts import Gradients, Initializer, InitializerEntry, InitialVJP, Predictor, Problem
from registry.core import INITIALIZERS, option
from registry.initializers.mlp import bounded, bounded_vjp
from registry.kernels.lstm import Layer, lstm, lstm_vjp
from registry.kernels.mlp import affine, mlp_vjp
from registry.predictors.lstm import LSTMWeights
from registry.predictors.parts.weights import uniform

WEIGHTS = "input_weight", "recurrent_weight", "bias", "peephole", "output_weight", "output_bias"


class RNNInitializer(Initializer):
    """One LSTM layer reads [u_k | y_k] from zero states; its last output is mapped to the predictor's states."""

    uses_state_cost: ClassVar[bool] = True

    def __init__(self, entry: "RNN", predictor: Predictor, problem: Problem) -> None:
        super().__init__()
        states = predictor.layout.hidden + predictor.layout.cell
        self.history, self.hidden = entry.history, entry.hidden
        weights = LSTMWeights(problem.n_measured, 1, entry.hidden, entry.weight_scale, entry.forget_bias)
        self.input_weight, self.recurrent_weight = weights.input_weight[0], weights.recurrent_weight[0]
        self.bias, self.peephole = weights.bias[0], weights.peephole[0]
        self.output_weight = uniform(states, entry.hidden, fan_in=entry.hidden, scale=entry.weight_scale)
        self.output_bias = nn.Parameter(torch.zeros(states))

    @override
    def initialize(self, predictor: Predictor, inputs: Tensor, outputs: Tensor) -> Tensor:
        _, after = lstm(*self._run(inputs, outputs))
        states = affine(after[..., : self.hidden], self.output_weight, self.output_bias)
        return bounded(predictor, predictor.init_buffers(inputs, outputs), states)

    @override
    def initialize_vjp(self, predictor: Predictor, inputs: Tensor, outputs: Tensor) -> tuple[Tensor, InitialVJP]:
        _, after, through_time = lstm_vjp(*self._run(inputs, outputs))
        states, back = mlp_vjp(after[..., : self.hidden], [(self.output_weight, self.output_bias)])
        state = bounded(predictor, predictor.init_buffers(inputs, outputs), states)

        def vjp(d_state: Tensor) -> tuple[Gradients, Gradients]:
            d_last, head = back(bounded_vjp(predictor, state, d_state), True)
            assert d_last is not None
            d_after = torch.zeros_like(after)
            d_after[..., : self.hidden] = d_last
            _, gradients = through_time(None, d_after)
            return dict(zip(WEIGHTS, [*gradients, *head], strict=True)), {}

        return state, vjp

    def _run(self, inputs: Tensor, outputs: Tensor) -> tuple[Tensor, Tensor, list[Layer]]:
        """What `lstm` is given."""
        x = torch.cat([inputs, outputs], -1)[..., -self.history :, :]
        layer = Layer(self.input_weight, self.recurrent_weight, self.bias, self.peephole)
        return x, x.new_zeros(*x.shape[:-2], 2 * self.hidden), [layer]


@INITIALIZERS.register("RNN")
@dataclass(frozen=True)
class RNN(InitializerEntry):
    """One layer of LSTM cells that reads the history and sets the initial states.

    Paper, section "Recurrent Initializer Network", eq. init_state_mapping_RNN.
    """

    sized: ClassVar[bool] = True
    supports_batching: ClassVar[bool] = True

    hidden: int = option(60, "LSTM cells", low=1, high=10000, log=True, search=(10, 100))
    history: int = option(10, "initialization length τ", unit="samples", low=1, high=10000)
    weight_scale: float = option(1.0, "initial weights are uniform within ± this / √fan-in", low=0.0, high=10.0)
    forget_bias: float = option(1.0, "initial bias of the forget gates", low=-10.0, high=10.0)

    @override
    def build(self, predictor: Predictor, problem: Problem) -> Initializer:
        return RNNInitializer(self, predictor, problem)
