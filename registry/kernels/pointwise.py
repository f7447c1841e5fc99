"""Pointwise pieces of the recurrent loops."""

from collections.abc import Callable, Sequence

import torch
from torch import Tensor

sigmoid_grad = torch.ops.aten.sigmoid_backward.grad_input
"""``sigmoid_grad(g, s, grad_input=o)``: o = g·s·(1−s)."""
tanh_grad = torch.ops.aten.tanh_backward.grad_input
"""``tanh_grad(g, t, grad_input=o)``: o = g·(1−t²)."""


def tanh_(x: Tensor) -> Tensor:
    """In-place tanh as 2σ(2x) − 1: several times faster than `torch.tanh` on CPUs, absolute error a rounding of 1."""
    return x.mul_(2).sigmoid_().mul_(2).sub_(1)


def pad_batch(x: Tensor) -> Tensor:
    """(M, B, …) with zero rows after the batch up to a multiple of 32.

    Thin or odd products take other routes in BLAS alone than in a group, and pointwise loops end in scalar steps
    that round otherwise than the vector steps before: with whole vectors only, a model's bits are its own.
    """
    spare = -x.shape[1] % 32
    return x if not spare else torch.cat([x, x.new_zeros(x.shape[0], spare, *x.shape[2:])], 1)


def in_whole_vectors(
    run: Callable[..., Sequence[Tensor]], arrays: Sequence[Tensor | None], weights: Sequence[Tensor]
) -> tuple[Tensor, Tensor]:
    """What ``run(*arrays, weights)`` gives, with a model dimension where there is none and the batch padded.

    Args:
        run: of M models on B windows, B a multiple of 32; gives outputs and an end state, (M, B, …) each.
        arrays: (M, B, …), or (B, …) of one model; None: not given.
        weights: (M, …), or of one model.

    Returns:
        Outputs and end state of the batch as it was.
    """
    first = arrays[0]
    assert first is not None
    one, batch = first.dim() == 3, first.shape[-3]
    given = [x if x is None else pad_batch(x.unsqueeze(0) if one else x) for x in arrays]
    outputs, end = (x[:, :batch] for x in run(*given, [w.unsqueeze(0) if one else w for w in weights]))
    return (outputs[0], end[0]) if one else (outputs, end)


def dropout_mask(dropout: float, like: Tensor, *shape: int) -> Tensor | None:
    """Zeros with probability ``dropout``, else 1 / (1 − dropout); None for no dropout."""
    if dropout == 0:
        return None
    keep = torch.full(shape, 1 - dropout, dtype=like.dtype, device=like.device)
    return torch.bernoulli(keep).div_(1 - dropout)


def pad16(n: int) -> int:
    """The next multiple of 16: whole vector registers, and products whose bits do not depend on the batch."""
    return (n + 15) // 16 * 16
