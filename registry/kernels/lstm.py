"""Stacked peephole LSTM with delayed output feedback: the whole sequence in one call, hand-written BPTT.

Equations: paper, eq. LSTM (diagonal peepholes, cell input and output through tanh), layers in series, outputs
fed back to the first layer. Everything carries a leading model dimension M: models of one shape run side by side,
and a model's bits do not depend on its neighbours. Implementations of one interface: C++ for the CPU, where there is a
compiler; PyTorch with hand-written gradients; and for what these two do not know, steps under autograd (`lstm_steps`):
full peepholes always, increments where there is no compiler.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from torch import Tensor

from registry.kernels import lstm_steps, lstm_torch, plain
from registry.kernels.native import library
from registry.kernels.native import lstm as native
from registry.kernels.native.call import called
from registry.kernels.pointwise import dropout_mask, in_whole_vectors


@dataclass(frozen=True)
class Layer:
    """Weights of one layer: input (M, 4H, K), recurrent (M, 4H, H), bias (M, 4H), peephole (M, 3, H) or (M, 3, H, H).

    Gate rows: input, forget, cell, output. The K columns of the first layer: the D latest inputs, then the D latest
    outputs, newest first.
    """

    input: Tensor
    recurrent: Tensor
    bias: Tensor
    peephole: Tensor

    @property
    def full(self) -> bool:
        """Whether every cell looks into the gates of all."""
        return self.peephole.dim() > self.recurrent.dim()


def lstm(
    inputs: Tensor,
    state: Tensor,
    layers: list[Layer],
    output_weight: Tensor | None = None,
    output_bias: Tensor | None = None,
    forced: Tensor | None = None,
    dropout: float = 0.0,
    delays: int = 1,
    increments: bool = False,
) -> tuple[Tensor, Tensor]:
    """Run T steps, of M models or, where no argument has a model dimension, of one.

    Args:
        inputs: (M, B, T, m).
        state: (M, B, s) before the run: D − 1 inputs and D outputs, newest first each, then hidden and cell states of
            all layers, L·H each.
        layers: L layers.
        output_weight, output_bias: (M, n, H), (M, n) linear read-out of the last layer; None: no outputs, n = 0.
        forced: (M, B, T, n) outputs that are fed back in place of the network's own.
        dropout: probability of dropping what a layer passes up (to the next layer or the read-out).
        delays: D.
        increments: whether the read-out gives what the output fed back last changes by, and not the output.

    Returns:
        outputs (M, B, T, n) and the state (M, B, s) after the run.
    """
    weights, mask = _weights(layers, output_weight, output_bias), _mask(dropout, inputs, layers)
    if plain.exporting():
        return plain.lstm(inputs, state, forced, weights, delays=delays, increments=increments)
    full = layers[0].full
    core = None if full else library.core_for(inputs, state, forced, *weights)
    if core is None:
        run = partial(lstm_steps.run, increments=increments) if full or increments else lstm_torch.run
        return in_whole_vectors(partial(run, mask=mask, delays=delays), (inputs, state, forced), weights)
    make = partial(native.LstmCall, core, forced=forced, mask=mask, delays=delays, increments=increments)
    return called(make, (inputs, state), weights)


VJP = Callable[[Tensor | None, Tensor | None], tuple[Tensor, list[Tensor]]]
"""From the gradients of outputs and of the state after a run (None: zero) to that of the state before it and those of
the weights, as `Layer` has them, layer by layer, then of the read-out."""


def lstm_vjp(
    inputs: Tensor,
    state: Tensor,
    layers: list[Layer],
    output_weight: Tensor | None = None,
    output_bias: Tensor | None = None,
    forced: Tensor | None = None,
    dropout: float = 0.0,
    delays: int = 1,
    increments: bool = False,
) -> tuple[Tensor, Tensor, VJP]:
    """`lstm` on the compiled core without autograd, and its vector-Jacobian product, to be called at most once.

    Peepholes are diagonal.
    """
    weights, mask = _weights(layers, output_weight, output_bias), _mask(dropout, inputs, layers)
    core = library.core_for(inputs, state, forced, *weights)
    assert core is not None
    run = native.LstmCall(
        core, inputs, state, forced=forced, mask=mask, weights=weights, delays=delays, keep=True, increments=increments
    )
    outputs, end = run.forward()

    def vjp(d_outputs: Tensor | None, d_end: Tensor | None) -> tuple[Tensor, list[Tensor]]:
        _, *found = run.backward(d_outputs, d_end, inputs_too=False)
        d_state, *gradients = (g for g in found if g is not None)
        return d_state, gradients

    return outputs, end, vjp


def _weights(layers: list[Layer], output_weight: Tensor | None, output_bias: Tensor | None) -> list[Tensor]:
    weights = [w for layer in layers for w in (layer.input, layer.recurrent, layer.bias, layer.peephole)]
    return weights if output_weight is None or output_bias is None else [*weights, output_weight, output_bias]


def _mask(dropout: float, inputs: Tensor, layers: list[Layer]) -> Tensor | None:
    *lead, batch, steps, _ = inputs.shape
    models, cells = lead[0] if lead else 1, layers[0].recurrent.shape[-1]
    return dropout_mask(dropout, inputs, len(layers), steps, models, cells, batch + -batch % 32)
