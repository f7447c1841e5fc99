"""The encoder of SUBNET: a network beside a linear map, from the history to unbounded states."""

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor
from typing_extensions import override

from registry.contracts import Initializer, InitializerEntry, Predictor, Problem
from registry.core import INITIALIZERS, option
from registry.initializers.mlp import bounded
from registry.predictors.subnet import Bypassed


class EncoderInitializer(Initializer):
    """x_{k0} = ψ(u_{k0−τ+1} .. u_{k0}, y_{k0−τ+1} .. y_{k0}); hidden states of other predictors pass a tanh."""

    def __init__(self, entry: "Encoder", predictor: Predictor, problem: Problem) -> None:
        super().__init__()
        self.history = entry.history
        columns, rows = entry.history * problem.n_measured, predictor.layout.hidden + predictor.layout.cell
        self.network = Bypassed(columns, rows, entry.layers, entry.hidden, entry.weight_scale)

    @override
    def initialize(self, predictor: Predictor, inputs: Tensor, outputs: Tensor) -> Tensor:
        u, y = inputs[..., -self.history :, :], outputs[..., -self.history :, :]
        states = self.network(torch.cat([u.flatten(-2), y.flatten(-2)], -1))
        return bounded(predictor, predictor.init_buffers(inputs, outputs), states)


@INITIALIZERS.register("Encoder")
@dataclass(frozen=True)
class Encoder(InitializerEntry):
    """The encoder of SUBNET: hidden layers beside a linear map of the history; no cost of its own.

    Beintema, Schoukens and Tóth (2023), Deep subspace encoders for nonlinear system identification, Automatica 156.
    """

    sized: ClassVar[bool] = True

    hidden: int = option(64, "tanh neurons in each hidden layer", low=1, high=50000, log=True, search=(10, 100))
    history: int = option(10, "initialization length τ", unit="samples", low=1, high=10000)
    layers: int = option(2, "hidden layers", low=1, high=20)
    weight_scale: float = option(1.0, "initial weights are uniform within ± this / √fan-in", low=0.0, high=10.0)

    @override
    def build(self, predictor: Predictor, problem: Problem) -> Initializer:
        return EncoderInitializer(self, predictor, problem)
