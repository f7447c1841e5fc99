"""Recurrences x_{k+1} = f_k(x_k) that are affine in x, solved for all k at once instead of one step after another."""

from collections.abc import Callable

import torch
from torch import Tensor

from bench.diagnose.settings import LINEARISING


def solved(step: Callable[[Tensor], Tensor], shape: tuple[int, ...], size: int, like: Tensor) -> Tensor | None:
    """The path (…, K + 1, size) from zero of x_{k+1} = f_k(x_k).

    The steps are cut into √K stretches: A and b of every stretch are multiplied out side by side, then the stretches
    are joined one after another.

    Args:
        step: f_k of all k at once, (…, K, size) to (…, K, size).
        shape: (…, K).
        size: of x.
        like: a tensor of the type and device to use.

    Returns:
        The path; None where the maps are not affine.
    """
    count = shape[-1]
    unit = torch.eye(size, dtype=like.dtype, device=like.device)
    offset = step(like.new_zeros(*shape, size))
    matrix = torch.stack([step(e.expand(*shape, size)) - offset for e in unit], dim=-1)
    probe = torch.linspace(0.3, 0.7, size, dtype=like.dtype, device=like.device)
    off = (step(probe.expand(*shape, size)) - offset - matrix @ probe).abs().max()
    if not off <= LINEARISING.affine * (matrix.abs().max() + offset.abs().max()):
        return None
    length = max(1, round(count**0.5))
    stretches = -(-count // length)
    short = stretches * length - count  # the last stretch is filled up with steps that nobody looks at
    matrix = torch.cat([matrix, unit.expand(*shape[:-1], short, size, size)], dim=-3)
    offset = torch.cat([offset, offset.new_zeros(*shape[:-1], short, size)], dim=-2)
    matrix, offset = matrix.unflatten(-3, (stretches, length)), offset.unflatten(-2, (stretches, length))
    # From the beginning of a stretch to after each of its steps, in place of the steps: of many models they are large.
    for k in range(1, length):
        now = matrix[..., k, :, :].clone()
        matrix[..., k, :, :] = now @ matrix[..., k - 1, :, :]
        offset[..., k, :] += (now @ offset[..., k - 1, :].unsqueeze(-1)).squeeze(-1)
    begun = [like.new_zeros(*shape[:-1], size)]
    for s in range(stretches - 1):
        begun.append((matrix[..., s, -1, :, :] @ begun[-1].unsqueeze(-1)).squeeze(-1) + offset[..., s, -1, :])
    start = torch.stack(begun, dim=-2).unsqueeze(-2)  # (…, stretches, 1, size)
    path = (matrix @ start.unsqueeze(-1)).squeeze(-1) + offset
    path = path.flatten(-3, -2)[..., :count, :]
    return torch.cat([path.new_zeros(*shape[:-1], 1, size), path], dim=-2)
