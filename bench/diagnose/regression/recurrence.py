"""Recurrences x_{k+1} = f_k(x_k) that are affine in x, solved for all k at once, and where they began."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from bench.diagnose.settings import LINEARISING


@dataclass(frozen=True, eq=False)
class Solved:
    """The affine maps from the beginning of each of about √K stretches of steps to after each step of it."""

    matrix: Tensor
    """(…, stretches, length, i, i); where all steps have the same matrix, of one recording for all."""
    offset: Tensor
    """(…, stretches, length, i)."""
    count: int
    """K."""

    def path(self, begin: Tensor | None = None) -> Tensor:
        """The path (…, K + 1, i) from x_0 (…, i), zero if not given."""
        if begin is None:
            begin = self.offset.new_zeros(*self.offset.shape[:-3], self.offset.shape[-1])
        starts = [begin]
        ends = zip(self.matrix[..., :-1, -1, :, :].unbind(-3), self.offset[..., :-1, -1, :].unbind(-2), strict=True)
        for matrix, offset in ends:
            starts.append(_times(matrix, starts[-1]) + offset)
        at = torch.stack(starts, dim=-2).unsqueeze(-2)  # (…, stretches, 1, i)
        path = (_times(self.matrix, at) + self.offset).flatten(-3, -2)
        return torch.cat([begin.unsqueeze(-2), path[..., : self.count, :]], dim=-2)

    def turned(self, at: Tensor) -> Tensor:
        """What a beginning x_0 adds to the path after so many steps (n,), as matrices (…, n, i, i)."""
        starts = [torch.eye(self.matrix.shape[-1]).to(self.matrix)]
        for matrix in self.matrix[..., :-1, -1, :, :].unbind(-3):
            starts.append(matrix @ starts[-1])
        starts[0] = starts[0].expand(self.matrix[..., 0, 0, :, :].shape)
        stretch, step = (at - 1).clamp_min(0) // self.matrix.shape[-3], (at - 1) % self.matrix.shape[-3]
        turned = self.matrix[..., stretch, step, :, :] @ torch.stack(starts, dim=-3)[..., stretch, :, :]
        turned[..., at == 0, :, :] = starts[0].unsqueeze(-3)
        return turned


def _times(matrix: Tensor, x: Tensor) -> Tensor:
    return (matrix @ x.unsqueeze(-1)).squeeze(-1)


Step = Callable[[Tensor], Tensor]


def solved(step: Step, first: Step, shape: tuple[int, ...], size: int, like: Tensor) -> Solved | None:
    """x_{k+1} = f_k(x_k) = A_k x_k + b_k for all k.

    A and b of every stretch of steps are multiplied out side by side, then the stretches are joined one after another.

    Args:
        step: f_k of all k at once, (…, L, K, size) to (…, L, K, size).
        first: f_0 of the first recording, (…, 1, 1, size) to (…, 1, 1, size); mostly all others have its matrix.
        shape: (…, L, K).
        size: of x.
        like: a tensor of the type and device to use.

    Returns:
        None where the maps are not affine.
    """
    offset = step(like.new_zeros(*shape, size))
    probe = torch.linspace(0.3, 0.7, size, dtype=like.dtype, device=like.device)
    answer = step(probe.expand(*shape, size)) - offset
    length = max(1, round(shape[-1] ** 0.5))
    stretches = -(-shape[-1] // length)
    short = stretches * length - shape[-1]  # the last stretch is filled up with steps that nobody looks at
    matrix = _matrix(first, (*shape[:-2], 1, 1), size, like)
    if _wrong(matrix, probe, answer, offset):
        matrix = _matrix(step, shape, size, like)
        if _wrong(matrix, probe, answer, offset):
            return None
        unit = torch.eye(size).to(like).expand(*shape[:-1], short, size, size)
        matrix = torch.cat([matrix, unit], dim=-3).unflatten(-3, (stretches, length))
    else:
        matrix = matrix.unsqueeze(-3).repeat_interleave(length, -3)  # (…, 1, 1, length, i, i)
    offset = torch.cat([offset, offset.new_zeros(*shape[:-1], short, size)], dim=-2).unflatten(-2, (stretches, length))
    # From the beginning of a stretch to after each of its steps, in place of the steps: of many models they are large.
    for k in range(1, length):
        now = matrix[..., k, :, :].clone()
        matrix[..., k, :, :] = now @ matrix[..., k - 1, :, :]
        offset[..., k, :] += _times(now, offset[..., k - 1, :])
    return Solved(matrix.expand(*matrix.shape[:-4], stretches, *matrix.shape[-3:]), offset, shape[-1])


def _matrix(step: Step, shape: tuple[int, ...], size: int, like: Tensor) -> Tensor:
    """A_k (…, size, size) of affine maps."""
    rest = step(like.new_zeros(*shape, size))
    return torch.stack([step(e.expand(*shape, size)) - rest for e in torch.eye(size).to(like)], dim=-1)


def _wrong(matrix: Tensor, probe: Tensor, answer: Tensor, offset: Tensor) -> bool:
    """Whether what maps add to their offset at a probe (…, size) is not what matrices say, or is no number."""
    off = (answer - matrix @ probe).abs().max()
    return not bool(off <= LINEARISING.affine * (matrix.abs().max() + offset.abs().max()))


def normal_equations(seen: Tensor, left: Tensor, so_far: bool) -> tuple[Tensor, Tensor]:
    """Gram matrices (…, i, i) and moments (…, i) of what is seen of a beginning, for least squares.

    Args:
        seen: (…, K, c, i) how each of c residuals answers a beginning; zero where it does not count.
        left: (…, K, c) the residuals.
        so_far: whether each place knows what came before it only, or all.

    Returns:
        (…, 1, i, i) and (…, 1, i) of all; or (…, K + 1, …) of what came before each place, and of all.
    """
    gram = (seen.unsqueeze(-1) * seen.unsqueeze(-2)).sum(-3)
    moment = (seen * left.unsqueeze(-1)).sum(-2)
    if not so_far:
        return gram.sum(-3, keepdim=True), moment.sum(-2, keepdim=True)
    gram, moment = gram.cumsum(-3), moment.cumsum(-2)
    nothing = torch.zeros_like(gram[..., :1, :, :]), torch.zeros_like(moment[..., :1, :])
    return torch.cat([nothing[0], gram], dim=-3), torch.cat([nothing[1], moment], dim=-2)
