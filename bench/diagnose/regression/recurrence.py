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
    """(…, L, stretches, length, i, i); where all steps have the same matrix, (…, 1, 1, length, i, i)."""
    offset: Tensor
    """(…, L, stretches, length, i)."""
    count: int
    """K."""

    def path(self, begin: Tensor | None = None) -> Tensor:
        """The path (…, K + 1, i) from x_0 (…, i), zero if not given."""
        if begin is None:
            begin = self.offset.new_zeros(*self.offset.shape[:-3], self.offset.shape[-1])
        starts, ends = [begin], self._ends()
        for matrix, offset in zip(ends, self.offset[..., :-1, -1, :].unbind(-2), strict=True):
            starts.append(_times(matrix, starts[-1]) + offset)
        path = (self._spread(torch.stack(starts, dim=-2)) + self.offset).flatten(-3, -2)
        return torch.cat([begin.unsqueeze(-2), path[..., : self.count, :]], dim=-2)

    def turned(self) -> Tensor:
        """What a beginning x_0 adds to the path, as matrices (…, L or 1, K + 1, i, i)."""
        starts = [torch.eye(self.matrix.shape[-1]).to(self.matrix).expand(self.matrix[..., 0, 0, :, :].shape)]
        for matrix in self._ends():
            starts.append(matrix @ starts[-1])
        turned = (self.matrix @ torch.stack(starts, dim=-3).unsqueeze(-3)).flatten(-4, -3)
        return torch.cat([starts[0].unsqueeze(-3), turned[..., : self.count, :, :]], dim=-3)

    def _ends(self) -> list[Tensor]:
        """The matrices (…, L or 1, i, i) of every whole stretch but the last one."""
        stretches = self.offset.shape[-3]
        return [self.matrix[..., k if self.matrix.shape[-4] > 1 else 0, -1, :, :] for k in range(stretches - 1)]

    def _spread(self, starts: Tensor) -> Tensor:
        """What the beginnings (…, L, stretches, i) of stretches make of every step (…, L, stretches, length, i)."""
        length, size = self.matrix.shape[-3], self.matrix.shape[-1]
        if self.matrix.shape[-5:-3] != (1, 1):
            return _times(self.matrix, starts.unsqueeze(-2))
        maps = self.matrix[..., 0, 0, :, :, :].flatten(-3, -2)  # (…, length i, i), one product for all recordings
        spread: Tensor = starts.flatten(-3, -2) @ maps.mT
        return spread.unflatten(-1, (length, size)).unflatten(-3, starts.shape[-3:-1])


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
    return Solved(matrix, offset, shape[-1])


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
    if not so_far:
        seen, left = seen.flatten(-3, -2), left.flatten(-2)
        return (seen.mT @ seen).unsqueeze(-3), (seen.mT @ left.unsqueeze(-1)).mT
    gram = (seen.unsqueeze(-1) * seen.unsqueeze(-2)).sum(-3).cumsum(-3)
    moment = (seen * left.unsqueeze(-1)).sum(-2).cumsum(-2)
    nothing = torch.zeros_like(gram[..., :1, :, :]), torch.zeros_like(moment[..., :1, :])
    return torch.cat([nothing[0], gram], dim=-3), torch.cat([nothing[1], moment], dim=-2)
