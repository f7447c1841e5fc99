"""Big buffers that outlive a call: the page faults of fresh ones cost as much as a thin network's arithmetic."""

import torch
from torch import Tensor

_MOST = 6
"""Buffers that are kept at most, the latest given back."""
_free: list[Tensor] = []


class Workspace:
    """A buffer of at least ``size`` numbers, given back when the last who holds it lets go."""

    def __init__(self, size: int, dtype: torch.dtype) -> None:
        fitting = [i for i, b in enumerate(_free) if b.dtype == dtype and size <= len(b) <= 2 * size]
        best = min(fitting, key=lambda i: len(_free[i]), default=None)
        self.buffer = torch.empty(size, dtype=dtype) if best is None else _free.pop(best)

    @property
    def address(self) -> int:
        """Of its first number."""
        return self.buffer.data_ptr()

    def __del__(self) -> None:
        if hasattr(self, "buffer"):
            _free.append(self.buffer)
            del _free[:-_MOST]
