"""Affine maps, and multi-layer perceptrons of them, whose bits do not depend on how many models run beside them.

Two implementations of one interface: C++ for the CPU, where there is a compiler, and PyTorch.
"""

from collections.abc import Callable
from functools import lru_cache, partial
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from registry.kernels import plain
from registry.kernels.native import library
from registry.kernels.native import mlp as native
from registry.kernels.native.call import called
from registry.kernels.pointwise import pad16, pad_batch


def affine(x: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
    """W x + b for one model or for M models side by side.

    Args:
        x: (B, K) or (M, B, K).
        weight: (O, K) or (M, O, K).
        bias: (O,) or (M, O).

    Returns:
        (B, O) or (M, B, O).
    """
    return mlp(x, [(weight, bias)])


def mlp(x: Tensor, layers: list[tuple[Tensor, Tensor]]) -> Tensor:
    """W_L tanh(… tanh(W_1 x + b_1) …) + b_L: as `affine`, with weight and bias of each layer."""
    if plain.exporting():
        return plain.mlp(x, layers)
    weights = [w for layer in layers for w in layer]
    core = library.core_for(x, *weights)
    if core is not None:
        return called(partial(native.MlpCall, core), [x], weights)
    if x.dim() == 2:
        return mlp(x.unsqueeze(0), [(w.unsqueeze(0), b.unsqueeze(0)) for w, b in layers])[0]
    for weight, bias in layers[:-1]:
        x = _Affine.apply(x, weight, bias).tanh()
    y: Tensor = _Affine.apply(x, *layers[-1])
    return y


VJP = Callable[[Tensor, bool], tuple[Tensor | None, list[Tensor]]]
"""From the gradient of the outputs to that of x, if wanted, and those of weight and bias of every layer."""


def mlp_vjp(x: Tensor, layers: list[tuple[Tensor, Tensor]]) -> tuple[Tensor, VJP]:
    """`mlp` on the compiled core without autograd, and its vector-Jacobian product, to be called at most once."""
    weights = [w for layer in layers for w in layer]
    core = library.core_for(x, *weights)
    assert core is not None
    run = native.MlpCall(core, x, weights=weights)
    y = run.forward()

    def vjp(dy: Tensor, inputs_too: bool) -> tuple[Tensor | None, list[Tensor]]:
        dx, *gradients = run.backward(dy, inputs_too)
        return dx, [g for g in gradients if g is not None]

    return y, vjp


class _Affine(torch.autograd.Function):
    """The bias joins the product as one more column, and both are padded.

    Thin products (one output) and sums over the batch take other routes in BLAS when they are alone than in a group.
    """

    @staticmethod
    def forward(ctx: Any, x: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
        (models, batch, k), n = x.shape, weight.shape[-2]
        spare = pad16(k + 1) - k
        w = torch.cat([weight, bias.unsqueeze(-1), _columns(0, models, n, spare - 1, x.dtype, x.device)], -1)
        if n % 16:
            w = torch.cat([w, _columns(0, models, -n % 16, k + spare, x.dtype, x.device)], -2)
        rows = pad_batch(torch.cat([x, _columns(1, models, batch, spare, x.dtype, x.device)], -1))
        ctx.save_for_backward(rows, w)
        ctx.sizes = batch, k, n
        return torch.bmm(rows, w.mT)[:, :batch, :n]

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        rows, w = ctx.saved_tensors
        batch, k, n = ctx.sizes
        g = pad_batch(torch.cat([grads[0], _columns(0, len(w), batch, -n % 16, w.dtype, w.device)], -1))
        dw = torch.bmm(g.mT, rows)
        dx = torch.bmm(g, w)[:, :batch, :k] if ctx.needs_input_grad[0] else None
        return dx, dw[:, :n, :k], dw[:, :n, k]


@lru_cache(maxsize=64)
def _columns(first: int, models: int, rows: int, columns: int, dtype: torch.dtype, device: torch.device) -> Tensor:
    """What stands beside the numbers: one column of ``first``, and zeros. Not to be written to."""
    made = torch.zeros(models, rows, columns, dtype=dtype, device=device)
    made[..., :1] = first
    return made
