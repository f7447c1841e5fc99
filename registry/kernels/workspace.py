"""What outlives a call: the page faults of fresh buffers cost as much as a thin network's arithmetic."""

from collections.abc import Callable, Hashable
from typing import Any, Generic, TypeVar

from torch import Tensor

_MOST = 10
"""Buffers, and made things, that are kept at most, the latest given back."""
_free: list[Tensor] = []
_made: list[tuple[Hashable, Any]] = []
Thing = TypeVar("Thing")


class Workspace:
    """A buffer of at least ``size`` numbers like ``like``, given back when the last who holds it lets go."""

    def __init__(self, size: int, like: Tensor) -> None:
        fitting = [
            i
            for i, b in enumerate(_free)
            if b.dtype == like.dtype and b.device == like.device and size <= b.numel() <= 2 * size
        ]
        best = min(fitting, key=lambda i: _free[i].numel(), default=None)
        self.buffer = like.new_empty(size) if best is None else _free.pop(best)

    @property
    def address(self) -> int:
        """Of its first number."""
        return self.buffer.data_ptr()

    def __del__(self) -> None:
        if hasattr(self, "buffer"):
            _free.append(self.buffer)
            del _free[:-_MOST]


class Reused(Generic[Thing]):
    """``thing``, as ``make`` makes it or as somebody with an equal key left it; given back like a `Workspace`."""

    def __init__(self, key: Hashable, make: Callable[[], Thing]) -> None:
        at = next((i for i in reversed(range(len(_made))) if _made[i][0] == key), None)
        self.key = key
        self.thing: Thing = make() if at is None else _made.pop(at)[1]

    def __del__(self) -> None:
        if hasattr(self, "thing"):
            _made.append((self.key, self.thing))
            del _made[:-_MOST]
