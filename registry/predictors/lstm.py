"""LSTM predictors: layers in series, peepholes, outputs fed back to the first layer; with or without delay lines."""

from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor, nn
from typing_extensions import override

from registry.contracts import Gradients, Predictor, PredictorEntry, Problem, ReadoutVJP, RunVJP, StateLayout
from registry.core import PREDICTORS, option
from registry.kernels.lstm import Layer, lstm, lstm_vjp
from registry.kernels.mlp import affine, mlp_vjp
from registry.predictors.parts.weights import uniform


class LSTMWeights(nn.Module):
    """Weights of L layers of H cells. Gate rows: input, forget, cell, output (paper, eq. LSTM)."""

    def __init__(
        self, columns: int, layers: int, hidden: int, scale: float, forget_bias: float, full: bool = False
    ) -> None:
        super().__init__()
        widths = [columns] + [hidden] * (layers - 1)
        draw = lambda w, *shape: uniform(*shape, fan_in=w + hidden, scale=scale)  # noqa: E731
        self.input_weight = nn.ParameterList([draw(w, 4 * hidden, w) for w in widths])
        self.recurrent_weight = nn.ParameterList([draw(w, 4 * hidden, hidden) for w in widths])
        self.bias = nn.ParameterList([nn.Parameter(torch.zeros(4 * hidden)) for _ in widths])
        self.peephole = nn.ParameterList([nn.Parameter(torch.zeros(3, *[hidden] * (2 if full else 1))) for _ in widths])
        with torch.no_grad():
            for bias in self.bias:
                bias[hidden : 2 * hidden] = forget_bias


def names(layers: int) -> list[str]:
    """Of the weights of a network, layer by layer, then of its read-out."""
    kinds = "input_weight", "recurrent_weight", "bias", "peephole"
    return [f"{kind}.{i}" for i in range(layers) for kind in kinds] + ["output_weight", "output_bias"]


class LSTMPredictor(Predictor):
    """Network of `LSTM` and `LSTM TDL`; ``delays`` taps of inputs and outputs enter the first layer."""

    def __init__(self, entry: "LSTM", problem: Problem) -> None:
        super().__init__(problem)
        n_inputs, n_outputs = self.n_inputs, self.n_outputs
        self.layers, self.hidden, self.dropout = entry.layers, entry.hidden, entry.dropout
        self.delays = getattr(entry, "delays", 1)
        self.history = self.delays
        size = entry.layers * entry.hidden
        self.layout = StateLayout((self.delays - 1) * n_inputs + self.delays * n_outputs, size, size)
        self.increments, full = entry.increments, entry.peepholes == "full"
        self.by_hand = not full
        columns = self.delays * (n_inputs + n_outputs)
        weights = LSTMWeights(columns, entry.layers, entry.hidden, entry.weight_scale, entry.forget_bias, full=full)
        self.input_weight, self.recurrent_weight = weights.input_weight, weights.recurrent_weight
        self.bias, self.peephole = weights.bias, weights.peephole
        self.output_weight = uniform(n_outputs, entry.hidden, fan_in=entry.hidden, scale=entry.weight_scale)
        self.output_bias = nn.Parameter(torch.zeros(n_outputs))
        self.names = names(entry.layers)
        if entry.increments:
            self.register_buffer("increment_scale", torch.ones(n_outputs))
            self.increment_scale: Tensor

    def init_buffers(self, inputs: Tensor, outputs: Tensor) -> Tensor:
        """Newest first: u_{k0} .. u_{k0−D+2}, then y_{k0} .. y_{k0−D+1}; a short history repeats its first sample."""
        y = newest_first(outputs[..., : self.n_outputs], self.delays)
        return y if self.delays == 1 else torch.cat([newest_first(inputs, self.delays - 1), y], -1)

    @override
    def rollout(self, inputs: Tensor, state: Tensor, feedback: Tensor | None = None) -> tuple[Tensor, Tensor]:
        return lstm(*self._run(inputs, state, feedback))

    @override
    def rollout_vjp(
        self, inputs: Tensor, state: Tensor, feedback: Tensor | None = None
    ) -> tuple[Tensor, Tensor, RunVJP]:
        outputs, end, back = lstm_vjp(*self._run(inputs, state, feedback))

        def vjp(d_outputs: Tensor | None, d_end: Tensor | None) -> tuple[Tensor, Gradients]:
            d_state, gradients = back(d_outputs, d_end)
            found = dict(zip(self.names, gradients, strict=True))
            if self.increments:
                found["output_weight"] = self.increment_scale.unsqueeze(-1) * found["output_weight"]
                found["output_bias"] = self.increment_scale * found["output_bias"]
            return d_state, found

        return outputs, end, vjp

    def _run(self, inputs: Tensor, state: Tensor, feedback: Tensor | None) -> tuple[Any, ...]:
        """What `lstm` is given."""
        weights = zip(self.input_weight, self.recurrent_weight, self.bias, self.peephole, strict=True)
        weight: Tensor = self.output_weight
        bias: Tensor = self.output_bias
        if self.increments:
            weight, bias = self.increment_scale.unsqueeze(-1) * weight, self.increment_scale * bias
        return (
            inputs,
            state,
            [Layer(*ws) for ws in weights],
            weight,
            bias,
            feedback,
            self.dropout if self.training else 0.0,
            self.delays,
            self.increments,
        )

    @override
    def set_increments(self, scale: Tensor) -> None:
        if self.increments:
            self.increment_scale.copy_(scale)

    def readout(self, state: Tensor, inputs: Tensor) -> Tensor | None:
        """W_y m^L + b_y (the paper's A_s = [W_y 0], c = y − b_y); of increments none, y_{k0} being where they start."""
        if self.increments:
            return None
        return affine(self._top(state), self.output_weight, self.output_bias)

    @override
    def readout_vjp(self, state: Tensor, inputs: Tensor) -> tuple[Tensor, ReadoutVJP] | None:
        if self.increments:
            return None
        read, back = mlp_vjp(self._top(state), [(self.output_weight, self.output_bias)])

        def vjp(d_read: Tensor, d_state: Tensor) -> Gradients:
            d_top, (d_weight, d_bias) = back(d_read, True)
            assert d_top is not None
            self._top(d_state).add_(d_top)
            return {"output_weight": d_weight, "output_bias": d_bias}

        return read, vjp

    def _top(self, state: Tensor) -> Tensor:
        """The last layer's hidden states, a part of the state."""
        end = self.layout.buffer + self.layout.hidden
        return state[..., end - self.hidden : end]


def newest_first(sequence: Tensor, count: int) -> Tensor:
    """The last ``count`` samples of (…, τ, n), newest first, as (…, count·n); the first one repeated if τ < count."""
    if count == 0:
        return sequence[..., :0, :].flatten(-2)
    if count == 1:
        return sequence[..., -1, :]
    missing = count - sequence.shape[-2]
    if missing > 0:
        first = sequence[..., :1, :]
        sequence = torch.cat([first.expand(*first.shape[:-2], missing, first.shape[-1]), sequence], -2)
    return sequence[..., sequence.shape[-2] - count :, :].flip(-2).flatten(-2)


@PREDICTORS.register("LSTM")
@dataclass(frozen=True)
class LSTM(PredictorEntry):
    """Stacked LSTM with peepholes; its outputs are fed back to the first layer.

    Mohajerin and Waslander, eq. LSTM; peepholes after Sak, Senior and Beaufays (2014).
    """

    network: ClassVar[bool] = True
    supports_batching: ClassVar[bool] = True

    layers: int = option(1, "layers in series", low=1, high=20, search=(1, 2))
    hidden: int = option(50, "cells in each layer", low=1, high=2000, log=True, search=(10, 100))
    dropout: float = option(0.0, "probability of dropping what a layer passes up", low=0.0, high=0.9)
    weight_scale: float = option(1.0, "initial weights are uniform within ± this / √fan-in", low=0.0, high=10.0)
    forget_bias: float = option(1.0, "initial bias of the forget gates", low=-10.0, high=10.0)
    peepholes: str = option(
        "diagonal",
        "what a gate sees of the cells: its own, or all of its layer (slower: autograd, without the compiled kernel)",
        choices=("diagonal", "full"),
        source="the paper's W^c are printed as matrices; Sak et al. (2014), whom it follows, have diagonal ones",
    )
    increments: bool = option(
        False, "whether the read-out gives the change of the outputs in a step, in units of its standard deviation"
    )

    @override
    def build(self, problem: Problem) -> Predictor:
        return LSTMPredictor(self, problem)


@PREDICTORS.register("LSTM TDL")
@dataclass(frozen=True)
class LSTMTDL(LSTM):
    """Stacked LSTM whose first layer sees tapped delay lines of inputs and outputs.

    Mohajerin and Waslander, section "Architectures and Implementation": the delay lines hold 10 steps.
    """

    delays: int = option(10, "taps of each delay line: u_k .. and ỹ_{k−1} ..", unit="samples", low=1, high=100)
