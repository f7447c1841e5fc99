"""How rates change with many numbers, of which each moves a few channels only: what stays zero is not kept."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Columns(Sequence[np.ndarray]):
    """Columns (L, N − 1, channels) of a linearised model; each is made when it is asked for."""

    responses: tuple[Mapping[int, np.ndarray], ...]
    """A column: by channel that responds, (L, N − 1)."""
    channels: tuple[int, ...]
    """Those of a column, in order."""
    shape: tuple[int, ...]
    """(L, N − 1)."""

    def __len__(self) -> int:
        return len(self.responses)

    def __getitem__(self, place):  # type: ignore[no-untyped-def]
        if isinstance(place, slice):
            return Columns(self.responses[place], self.channels, self.shape)
        out = np.zeros((*self.shape, len(self.channels)))
        for i, c in enumerate(self.channels):
            if c in self.responses[place]:
                out[..., i] = self.responses[place][c]
        return out

    def __iter__(self) -> Iterator[np.ndarray]:
        return (self[i] for i in range(len(self)))

    def acting(self, place: int) -> np.ndarray:
        """The columns (n,) to which the channel in this place responds, ascending."""
        return np.array([j for j, r in enumerate(self.responses) if self.channels[place] in r], dtype=int)

    def on(self, place: int, log: int, columns: Sequence[int] | np.ndarray) -> np.ndarray:
        """What some columns (n,) add to the rates of the channel in this place in a log (N − 1, n)."""
        channel = self.channels[place]
        out = np.empty((self.shape[1], len(columns)))
        for k, j in enumerate(columns):
            responding = self.responses[j].get(channel)
            out[:, k] = 0.0 if responding is None else responding[log]
        return out

    def replaced(self, by: Mapping[int, Mapping[int, np.ndarray]]) -> "Columns":
        """With other responses in some places."""
        return Columns(tuple(by.get(j, r) for j, r in enumerate(self.responses)), self.channels, self.shape)

    def with_more(self, more: Sequence[np.ndarray]) -> "Columns":
        """With further columns (L, N − 1, channels)."""
        added = (dict(zip(self.channels, np.moveaxis(x, -1, 0), strict=True)) for x in more)
        kept = ({c: x for c, x in one.items() if moves(x)} for one in added)
        return Columns((*self.responses, *kept), self.channels, self.shape)

    def forgotten(self) -> "Columns":
        """As many, with nothing in them: rows of them were made, and they would take gigabytes."""
        return Columns(({},) * len(self), self.channels, self.shape)


def response(
    after: np.ndarray, before: np.ndarray, measured: Sequence[int], step: float = 1.0
) -> dict[int, np.ndarray]:
    """By measured channel that responds, (L, N − 1) of how rates (L, N − 1, s) changed, over a step."""
    changes = ((c, np.subtract(after[..., c], before[..., c], order="C")) for c in measured)
    return {c: change if step == 1.0 else np.divide(change, step, out=change) for c, change in changes if moves(change)}


def moves(values: np.ndarray) -> bool:
    """Whether any is not zero; what is no number moves nothing."""
    return bool(values.max(initial=0.0) > 0 or values.min(initial=0.0) < 0)
