"""Pointwise pieces of the recurrent loops."""

import torch
from torch import Tensor

sigmoid_grad = torch.ops.aten.sigmoid_backward.grad_input
"""``sigmoid_grad(g, s, grad_input=o)``: o = g·s·(1−s)."""
tanh_grad = torch.ops.aten.tanh_backward.grad_input
"""``tanh_grad(g, t, grad_input=o)``: o = g·(1−t²)."""


def tanh_(x: Tensor) -> Tensor:
    """In-place tanh as 2σ(2x) − 1: several times faster than `torch.tanh` on CPUs, same to one unit of rounding."""
    return x.mul_(2).sigmoid_().mul_(2).sub_(1)


def pad16(n: int) -> int:
    """The next multiple of 16: whole vector registers, and products whose bits do not depend on the batch."""
    return (n + 15) // 16 * 16
