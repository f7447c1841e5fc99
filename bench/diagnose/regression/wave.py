"""A wave of known frequency in what a model leaves: amplitude and phase from all of a recording or from its past."""

import math

import torch
from torch import Tensor

from bench.diagnose.settings import WAVING


def wave(left: Tensor, good: Tensor, frequency: float, dt: float, so_far: bool) -> Tensor:
    """The wave and its quadrature (…, L, N, 2) at every sample, each recording with its own amplitude and phase.

    By least squares, a constant beside it.

    Args:
        left: (…, L, N − 1) mean over each sampling interval.
        good: (L, N − 1) intervals that count.
        frequency: of the wave [Hz].
        dt: sampling period [s].
        so_far: whether a sample knows what came before it only, or the whole recording.
    """
    count = left.shape[-1]
    turn = 2 * math.pi * frequency * dt
    middle = turn * (torch.arange(count, dtype=left.dtype) + 0.5)
    seen = torch.stack([middle.cos(), middle.sin(), torch.ones_like(middle)], dim=-1) * good.unsqueeze(
        -1
    )  # (L, N−1, 3)
    gram = seen.unsqueeze(-1) * seen.unsqueeze(-2)
    moment = seen * torch.where(good, left, 0.0).unsqueeze(-1)
    if so_far:
        gram, moment = gram.cumsum(-3), moment.cumsum(-2)
        gram = torch.cat([torch.zeros_like(gram[..., :1, :, :]), gram], dim=-3)
        moment = torch.cat([torch.zeros_like(moment[..., :1, :]), moment], dim=-2)
    else:
        gram, moment = gram.sum(-3, keepdim=True), moment.sum(-2, keepdim=True)
    cycle = 1 / (frequency * dt)
    held = torch.diag(torch.tensor([WAVING.silent * cycle / 2, WAVING.silent * cycle / 2, 1.0], dtype=left.dtype))
    held = held if so_far else held * 1e-6
    both = torch.linalg.solve(gram + held, moment.unsqueeze(-1)).squeeze(-1)[..., :2]
    both = torch.where(gram[..., 2, 2].unsqueeze(-1) >= WAVING.heard * cycle, both, 0.0)
    at = turn * torch.arange(count + 1, dtype=left.dtype)
    a, b = (both[..., i].expand(*both.shape[:-2], count + 1) for i in range(2))
    return torch.stack([a * at.cos() + b * at.sin(), b * at.cos() - a * at.sin()], dim=-1)
