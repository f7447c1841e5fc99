"""Lorenz's system."""

from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor

from registry.contracts import Channel
from registry.core import PHYSICS
from registry.dynamics import constant, tensor
from registry.physics.state_space import StateSpace

_LORENZ = "E. N. Lorenz, Deterministic Nonperiodic Flow (1963)"


@PHYSICS.register("lorenz")
@dataclass(frozen=True)
class Lorenz(StateSpace):
    """Undriven chaotic convection in three states; states and time without dimension, time in s."""

    sigma: Any = constant(10.0, "σ", "1/s", source=_LORENZ)
    rho: Any = constant(28.0, "ρ", "1/s", source=_LORENZ)
    beta: Any = constant(8 / 3, "β", "1/s", source=_LORENZ)

    state_channels: ClassVar[tuple[Channel, ...]] = tuple(Channel(f"lorenz.{a}", "1") for a in "xyz")
    input_signals: ClassVar[tuple[str, ...]] = ()
    equation: ClassVar[str] = "dx/dt = σ (y − x);  dy/dt = x (ρ − z) − y;  dz/dt = x y − β z"

    def own_rate(self, state: Tensor, inputs: Tensor) -> Tensor:
        """dx/dt (…, 3); see `StateSpace.own_rate`."""
        x, y, z = state.unbind(-1)
        sigma, rho, beta = (tensor(c, state) for c in (self.sigma, self.rho, self.beta))
        return torch.stack([sigma * (y - x), x * (rho - z) - y, x * y - beta * z], dim=-1)
