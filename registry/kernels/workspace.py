"""Big buffers that outlive a call: the page faults of fresh ones cost as much as a thin network's arithmetic."""

import math

from torch import Tensor

_MOST = 6
"""Buffers that are kept at most, the latest given back."""
_free: list[Tensor] = []


class Workspace:
    """A buffer of at least ``size`` numbers like ``like``, given back when the last who holds it lets go."""

    def __init__(self, size: int, like: Tensor) -> None:
        fitting = [
            i
            for i, b in enumerate(_free)
            if b.dtype == like.dtype and b.device == like.device and size <= len(b) <= 2 * size
        ]
        best = min(fitting, key=lambda i: len(_free[i]), default=None)
        self.buffer = like.new_empty(size) if best is None else _free.pop(best)

    @property
    def address(self) -> int:
        """Of its first number."""
        return self.buffer.data_ptr()

    def parts(self, *shapes: tuple[int, ...]) -> list[Tensor]:
        """Arrays end to end, not set to anything; they are good as long as this object is held."""
        sizes = [math.prod(s) for s in shapes]
        pieces = self.buffer[: sum(sizes)].split(sizes)
        return [p.view(s) for p, s in zip(pieces, shapes, strict=True)]

    def __del__(self) -> None:
        if hasattr(self, "buffer"):
            _free.append(self.buffer)
            del _free[:-_MOST]
