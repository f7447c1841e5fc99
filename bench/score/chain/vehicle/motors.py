"""Motors: commands that are held between the controller's ticks, a dead time, and a first-order answer."""

from dataclasses import dataclass

import numpy as np

Array = np.ndarray


@dataclass(frozen=True)
class Motors:
    """First order, exact for held commands."""

    up: float
    """Time constant when the speed rises [s]; 0: at once."""
    down: float
    delay: float = 0.0
    """Dead time [s]; a whole number of steps of the integration, so that commands switch between two of them."""

    @property
    def slowest(self) -> float:
        """Time that an answer takes at most [s]."""
        return max(self.up, self.down) + self.delay

    def step(self, speed: Array, command: Array, dt: float) -> tuple[tuple[Array, Array, Array], tuple[Array, ...]]:
        """Speeds (4, B) at start, middle and end of a step under one command, and their time derivatives."""
        if not self.up or not self.down:
            none = np.zeros_like(command)
            return (command, command, command), (none, none, none)
        gap = command - speed
        tau = np.where(gap > 0, self.up, self.down)
        half = np.exp(-dt / 2 / tau)
        gaps = gap, gap * half, gap * half * half
        return (speed, command - gaps[1], command - gaps[2]), tuple(g / tau for g in gaps)
