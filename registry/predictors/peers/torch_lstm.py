"""The LSTM of PyTorch, as it is commonly set up for a simulation: inputs to outputs, nothing fed back."""

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor, nn
from typing_extensions import override

from registry.contracts import Predictor, PredictorEntry, Problem, StateLayout
from registry.core import PREDICTORS, option
from registry.errors import BenchError


class TorchLSTMPredictor(Predictor):
    """`torch.nn.LSTM` and `torch.nn.Linear` as they come. State: hidden, then cell states, layer by layer each."""

    def __init__(self, entry: "TorchLSTM", problem: Problem) -> None:
        super().__init__(problem)
        if not self.n_inputs:
            raise BenchError(
                "The torch LSTM sees inputs alone, and there are none: take an LSTM, which sees its outputs."
            )
        size = entry.layers * entry.hidden
        self.layout = StateLayout(0, size, size)
        self.network = nn.LSTM(self.n_inputs, entry.hidden, entry.layers, batch_first=True)
        self.head = nn.Linear(entry.hidden, self.n_outputs)

    def init_buffers(self, inputs: Tensor, outputs: Tensor) -> Tensor:
        """Nothing: no measured sample is part of the state."""
        return outputs[..., -1, :0]

    def rollout(self, inputs: Tensor, state: Tensor, feedback: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """See `Predictor.rollout`; outputs are not fed back, so that ``feedback`` changes nothing."""
        layers = (-1, (self.network.num_layers, self.network.hidden_size))
        before = [x.unflatten(*layers).transpose(0, 1).contiguous() for x in self.layout.split(state)[1:]]
        seen, (hidden, cell) = self.network(inputs, tuple(before))
        after = [x.transpose(0, 1).flatten(1) for x in (hidden, cell)]
        outputs: Tensor = self.head(seen)
        return outputs, torch.cat(after, -1)

    def readout(self, state: Tensor, inputs: Tensor) -> Tensor:
        """ŷ_{k0} of the last layer's hidden states."""
        hidden = self.layout.split(state)[1]
        read: Tensor = self.head(hidden[..., hidden.shape[-1] - self.network.hidden_size :])
        return read


@PREDICTORS.register("torch LSTM")
@dataclass(frozen=True)
class TorchLSTM(PredictorEntry):
    """The LSTM of PyTorch and a linear layer, inputs to outputs: no peepholes, nothing fed back, its own first weights.

    Hochreiter and Schmidhuber (1997), Long Short-Term Memory, as `torch.nn.LSTM` has it.
    """

    network: ClassVar[bool] = True

    layers: int = option(1, "layers in series", low=1, high=20, search=(1, 2))
    hidden: int = option(50, "cells in each layer", low=1, high=2000, log=True, search=(10, 100))

    @override
    def build(self, problem: Problem) -> Predictor:
        return TorchLSTMPredictor(self, problem)
