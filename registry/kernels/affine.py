"""An affine map whose bits do not depend on how many models run beside it."""

from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from registry.kernels.pointwise import pad16


def affine(x: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
    """W x + b for one model or for M models side by side.

    Args:
        x: (B, K) or (M, B, K).
        weight: (O, K) or (M, O, K).
        bias: (O,) or (M, O).

    Returns:
        (B, O) or (M, B, O).

    The bias joins the product as one more column, and both are padded: thin products (one
    output) and sums over the batch take other routes in BLAS when they are alone than in a group.
    """
    if x.dim() == 2:
        return affine(x.unsqueeze(0), weight.unsqueeze(0), bias.unsqueeze(0))[0]
    y: Tensor = _Affine.apply(x, weight, bias)
    return y


class _Affine(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
        (models, batch, k), n = x.shape, weight.shape[-2]
        columns = pad16(k + 1)
        w = x.new_zeros(models, pad16(n), columns)
        w[:, :n, :k], w[:, :n, k] = weight, bias
        rows = x.new_zeros(models, batch + -batch % 32, columns)
        rows[:, :batch, :k], rows[:, :batch, k] = x, 1
        ctx.save_for_backward(rows, w)
        ctx.sizes = batch, k, n
        return torch.bmm(rows, w.mT)[:, :batch, :n]

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        rows, w = ctx.saved_tensors
        batch, k, n = ctx.sizes
        g = rows.new_zeros(rows.shape[0], rows.shape[1], w.shape[1])
        g[:, :batch, :n] = grads[0]
        dw = torch.bmm(g.mT, rows)
        dx = torch.bmm(g, w)[:, :batch, :k] if ctx.needs_input_grad[0] else None
        return dx, dw[:, :n, :k], dw[:, :n, k]
