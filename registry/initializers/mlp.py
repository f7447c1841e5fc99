"""The MLP initializer of the paper."""

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor, nn
from typing_extensions import override

from registry.contracts import Gradients, Initializer, InitializerEntry, InitialVJP, Predictor, Problem
from registry.core import INITIALIZERS, option
from registry.kernels.mlp import mlp, mlp_vjp
from registry.kernels.pointwise import tanh_grad
from registry.predictors.parts.weights import uniform

WEIGHTS = "hidden_weight", "hidden_bias", "output_weight", "output_bias"


def bounded(predictor: Predictor, buffers: Tensor, states: Tensor) -> Tensor:
    """State (…, s) of buffers and network states within their range: hidden through tanh, cell states as they are."""
    count = predictor.layout.hidden
    hidden, cell = states.split([count, states.shape[-1] - count], -1)
    return torch.cat([buffers, hidden.tanh(), cell], -1)


def bounded_vjp(predictor: Predictor, state: Tensor, d_state: Tensor) -> Tensor:
    """From the gradient of what `bounded` gave, which is overwritten, to that of the network states."""
    start, end = predictor.layout.buffer, predictor.layout.buffer + predictor.layout.hidden
    d_hidden = d_state[..., start:end]
    tanh_grad(d_hidden, state[..., start:end], grad_input=d_hidden)
    return d_state[..., start:]


class MLPInitializer(Initializer):
    """x_{k0} = ζ(u_{k0−τ+1} .. u_{k0}, y_{k0−τ+1} .. y_{k0}): one tanh layer, linear output."""

    def __init__(self, entry: "MLP", predictor: Predictor, problem: Problem) -> None:
        super().__init__()
        width, states = entry.history * problem.n_measured, predictor.layout.hidden + predictor.layout.cell
        self.history, self.state_cost = entry.history, entry.state_cost
        self.hidden_weight = uniform(entry.hidden, width, fan_in=width, scale=entry.weight_scale)
        self.hidden_bias = nn.Parameter(torch.zeros(entry.hidden))
        self.output_weight = uniform(states, entry.hidden, fan_in=entry.hidden, scale=entry.weight_scale)
        self.output_bias = nn.Parameter(torch.zeros(states))

    @property
    def uses_state_cost(self) -> bool:  # type: ignore[override]
        """As its entry says."""
        return self.state_cost

    @override
    def initialize(self, predictor: Predictor, inputs: Tensor, outputs: Tensor) -> Tensor:
        return bounded(predictor, predictor.init_buffers(inputs, outputs), mlp(*self._run(inputs, outputs)))

    @override
    def initialize_vjp(self, predictor: Predictor, inputs: Tensor, outputs: Tensor) -> tuple[Tensor, InitialVJP]:
        states, back = mlp_vjp(*self._run(inputs, outputs))
        state = bounded(predictor, predictor.init_buffers(inputs, outputs), states)

        def vjp(d_state: Tensor) -> tuple[Gradients, Gradients]:
            _, gradients = back(bounded_vjp(predictor, state, d_state), False)
            return dict(zip(WEIGHTS, gradients, strict=True)), {}

        return state, vjp

    def _run(self, inputs: Tensor, outputs: Tensor) -> tuple[Tensor, list[tuple[Tensor, Tensor]]]:
        """What `mlp` is given."""
        u, y = inputs[..., -self.history :, :], outputs[..., -self.history :, :]
        x = torch.cat([u.flatten(-2), y.flatten(-2)], -1)
        return x, [(self.hidden_weight, self.hidden_bias), (self.output_weight, self.output_bias)]


@INITIALIZERS.register("MLP")
@dataclass(frozen=True)
class MLP(InitializerEntry):
    """A feed-forward network that maps the history to the initial states.

    Paper, section "MLP Initializer Network", eq. init_state_mapping.
    """

    sized: ClassVar[bool] = True
    supports_batching: ClassVar[bool] = True
    state_cost: ClassVar[bool] = True
    """Whether L_si joins the training cost."""

    hidden: int = option(60, "neurons in the hidden layer", low=1, high=50000, log=True, search=(10, 100))
    history: int = option(10, "initialization length τ", unit="samples", low=1, high=10000)
    weight_scale: float = option(1.0, "initial weights are uniform within ± this / √fan-in", low=0.0, high=10.0)

    @override
    def build(self, predictor: Predictor, problem: Problem) -> Initializer:
        return MLPInitializer(self, predictor, problem)


@INITIALIZERS.register("MLP no L_si")
@dataclass(frozen=True)
class MLPWithoutStateCost(MLP):
    """`MLP` whose states are judged by the prediction alone: no state-initialization cost, which is β = 0.

    Of a hybrid, whose physics starts from the measured state, that cost asks for an output model that adds nothing at
    k0, where the paper wants it to compensate at once.
    """

    state_cost: ClassVar[bool] = False
