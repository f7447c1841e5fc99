"""Pilots: of vehicles that would fall if they were driven open loop."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from torch import Tensor


@dataclass(frozen=True)
class SetPoint:
    """One signal that a pilot is asked to follow."""

    name: str
    unit: str
    rate: int
    """Place of the state that is, about, its rate of change."""
    state: int | None = None
    """Place of the state that follows it; None: no state alone does."""
    ends: tuple[float, float] = (0.0, 0.0)
    """Of one that no state follows: lowest and highest."""


class Pilot(ABC):
    """Follows set-points with a model."""

    set_points: ClassVar[tuple[SetPoint, ...]]
    """c of them."""
    band: ClassVar[tuple[float, float]]
    """Frequencies of set-points that it can follow [Hz]."""
    path_columns: ClassVar[tuple[tuple[str, str], ...]]
    """Names and units of what `path` tells."""

    @abstractmethod
    def path(self, asked: np.ndarray, dt: float) -> np.ndarray:
        """What a vehicle is to follow (W, N, columns) where set-points (W, N, c) are asked for every ``dt`` seconds."""

    @abstractmethod
    def flown(self, asked: np.ndarray, extras: Tensor, dt: float) -> tuple[Tensor, Tensor]:
        """What drives (W, N, m − e) and the states (W, N, s) of runs that follow set-points.

        Args:
            asked: (W, N, c).
            extras: (W, N, e) the model's extra inputs.
            dt: [s].
        """
