"""Initial weights, and weights of one model."""

import torch
from torch import Tensor, nn


def uniform(*shape: int, fan_in: int, scale: float = 1.0) -> nn.Parameter:
    """A parameter drawn from U(−r, r) with r = scale / √fan_in; a small ``scale`` gives tiny weights."""
    r = scale / max(fan_in, 1) ** 0.5
    return nn.Parameter(torch.empty(*shape).uniform_(-r, r))


def single(weight: Tensor, dims: int) -> Tensor:
    """A weight without the leading model dimension that training gives it."""
    return weight.squeeze(0) if weight.dim() > dims else weight
