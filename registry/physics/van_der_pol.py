"""Van der Pol's oscillator."""

from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor

from registry.contracts import Channel
from registry.core import PHYSICS
from registry.dynamics import constant, tensor
from registry.physics.state_space import StateSpace


@PHYSICS.register("van_der_pol")
@dataclass(frozen=True)
class VanDerPol(StateSpace):
    """Undriven oscillator whose damping is negative near the origin; states and time without dimension, time in s."""

    mu: Any = constant(0.5, "μ", "1/s", source="value of the discrepancy-modelling examples")

    state_channels: ClassVar[tuple[Channel, ...]] = tuple(Channel(f"van_der_pol.{a}", "1") for a in "xy")
    input_signals: ClassVar[tuple[str, ...]] = ()
    equation: ClassVar[str] = "dx/dt = y;  dy/dt = μ (1 − x²) y − x"

    def own_rate(self, state: Tensor, inputs: Tensor) -> Tensor:
        """dx/dt (…, 2); see `StateSpace.own_rate`."""
        x, y = state.unbind(-1)
        return torch.stack([y, tensor(self.mu, state) * (1 - x * x) * y - x], dim=-1)
