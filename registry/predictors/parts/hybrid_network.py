"""The LSTM networks within a hybrid model, which see what no recording holds."""

from typing import Any

import torch
from torch import Tensor, nn

from registry.contracts import Predictor, Problem, StateLayout
from registry.errors import BenchError
from registry.kernels.lstm import Layer
from registry.kernels.lstm_cell import LSTMCell
from registry.predictors.lstm import LSTMWeights
from registry.predictors.parts.weights import single


class Network(Predictor):
    """One of the two LSTM networks of a hybrid model: hidden and cell states, no buffers.

    Its read-out starts at zero: a fresh hybrid model is its physics model.
    """

    def __init__(self, entry: Any, problem: Problem, columns: int, rows: int) -> None:
        super().__init__(problem)
        size = entry.layers * entry.hidden
        self.layers, self.layout = entry.layers, StateLayout(0, size, size)
        weights = LSTMWeights(columns, entry.layers, entry.hidden, entry.weight_scale, entry.forget_bias)
        self.input_weight, self.recurrent_weight = weights.input_weight, weights.recurrent_weight
        self.bias, self.peephole = weights.bias, weights.peephole
        self.output_weight = nn.Parameter(torch.zeros(rows, entry.hidden))
        self.output_bias = nn.Parameter(torch.zeros(rows))

    def weights(self) -> list[Tensor]:
        """Those of the layers, one layer after the other, then of the read-out; without a model dimension."""
        series = (self.input_weight, self.recurrent_weight, self.bias, self.peephole)
        each = [single(w, dims) for ws in zip(*series, strict=True) for w, dims in zip(ws, (2, 2, 1, 2), strict=True)]
        return [*each, single(self.output_weight, 2), single(self.output_bias, 1)]

    def init_buffers(self, inputs: Tensor, outputs: Tensor) -> Tensor:
        """No buffers (B, 0)."""
        return inputs[..., -1, :0]

    def rollout(self, inputs: Tensor, state: Tensor, feedback: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """See `Predictor.rollout`.

        Raises:
            BenchError: always; within the hybrid model it sees what no recording holds.
        """
        raise BenchError("The networks of a Hybrid do not run alone: initialize it by MLP or RNN.")


class RunningNetwork:
    """A network in the loop: its weights laid out, and its states (L, H, B) now."""

    def __init__(self, network: Network, hidden: Tensor, cell: Tensor) -> None:
        *layers, self.weight, bias = network.weights()
        self.cell = LSTMCell([Layer(*layers[i : i + 4]) for i in range(0, len(layers), 4)])
        self.bias = bias.unsqueeze(-1)
        self.states = tuple(s.T.unflatten(0, (network.layers, -1)).contiguous() for s in (hidden, cell))

    def read(self) -> Tensor:
        """What the read-out says of the states now (rows, B)."""
        return torch.addmm(self.bias, self.weight, self.states[0][-1])

    def step(self, *entering: Tensor) -> Tensor:
        """Advance one step with inputs ``entering`` (K_i, B); gives the output (rows, B)."""
        self.states = self.cell(entering, *self.states)
        return self.read()

    def ends(self) -> tuple[Tensor, Tensor]:
        """Hidden and cell states (B, L·H) now."""
        hidden, cell = (s.flatten(0, 1).T for s in self.states)
        return hidden, cell
