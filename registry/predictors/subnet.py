"""SUBNET: a state-space model whose maps are networks; its encoder is the initializer `Encoder`."""

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor, nn
from torch.nn import functional
from typing_extensions import override

from registry.contracts import Predictor, PredictorEntry, Problem, StateLayout
from registry.core import PREDICTORS, option
from registry.predictors.parts.weights import uniform


class Bypassed(nn.Module):
    """A x + W_{L+1} tanh(… tanh(W_1 x + b_1) …) + b_{L+1}: a network of L hidden layers beside a linear map."""

    def __init__(self, columns: int, rows: int, layers: int, hidden: int, scale: float = 1.0) -> None:
        super().__init__()
        widths = [columns] + [hidden] * layers
        heights = [hidden] * layers + [rows]
        pairs = zip(widths, heights, strict=True)
        self.linear = uniform(rows, columns, fan_in=columns, scale=scale)
        self.weight = nn.ParameterList([uniform(h, w, fan_in=w, scale=scale) for w, h in pairs])
        self.bias = nn.ParameterList([nn.Parameter(torch.zeros(h)) for h in heights])

    def forward(self, x: Tensor) -> Tensor:
        """(…, columns) → (…, rows)."""
        y = x
        for i, (weight, bias) in enumerate(zip(self.weight, self.bias, strict=True)):
            y = functional.linear(y if i == 0 else y.tanh(), weight, bias)
        return y + functional.linear(x, self.linear)


class SubnetPredictor(Predictor):
    """Network of `Subnet`. State: x, unbounded as cells are."""

    def __init__(self, entry: "Subnet", problem: Problem) -> None:
        super().__init__(problem)
        sizes = entry.layers, entry.hidden, entry.weight_scale
        self.layout = StateLayout(0, 0, entry.states)
        self.transition = Bypassed(entry.states + self.n_inputs, entry.states, *sizes)
        self.output = Bypassed(entry.states, self.n_outputs, *sizes)

    def init_buffers(self, inputs: Tensor, outputs: Tensor) -> Tensor:
        """Nothing: no measured sample is part of the state."""
        return outputs[..., -1, :0]

    def rollout(self, inputs: Tensor, state: Tensor, feedback: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """See `Predictor.rollout`; outputs are not fed back, so that ``feedback`` changes nothing."""
        states = []
        for u in inputs.unbind(-2):
            state = self.transition(torch.cat([state, u], -1))
            states.append(state)
        return self.output(torch.stack(states, -2)), state

    def readout(self, state: Tensor, inputs: Tensor) -> Tensor:
        """h(x_{k0})."""
        read: Tensor = self.output(state)
        return read


@PREDICTORS.register("SUBNET")
@dataclass(frozen=True)
class Subnet(PredictorEntry):
    """State-space model of two networks, x_k = f(x_{k−1}, u_k), ŷ_k = h(x_k); with `Encoder` it is encoder SUBNET.

    Beintema, Schoukens and Tóth (2023), Deep subspace encoders for nonlinear system identification, Automatica 156.
    There x_{k+1} = f(x_k, u_k), y_k = h(x_k); here a state has seen the input of its own sample, as the outputs of all
    predictors of this suite may. Networks with a linear bypass, as there.
    """

    network: ClassVar[bool] = True

    layers: int = option(2, "hidden layers of f and of h", low=1, high=20, search=(1, 2))
    hidden: int = option(64, "tanh neurons in each of them", low=1, high=2000, log=True, search=(10, 100))
    states: int = option(8, "length of x", low=1, high=1000, log=True, search=(2, 16))
    weight_scale: float = option(1.0, "initial weights are uniform within ± this / √fan-in", low=0.0, high=10.0)

    @override
    def build(self, problem: Problem) -> Predictor:
        return SubnetPredictor(self, problem)
