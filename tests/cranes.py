"""A machine with a motor in each of its two joints, which no registered system is."""

from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor

from registry.contracts import Channel
from registry.dynamics import constant, tensor
from registry.physics.state_space import StateSpace
from registry.units import Signal


@dataclass(frozen=True)
class Cranes(StateSpace):
    """Two coupled trolleys with a motor each, the second one's channel first."""

    light: Any = constant(1.0, "m_1", "kg", low=1e-6)
    heavy: Any = constant(3.0, "m_2", "kg", low=1e-6)
    state_channels: ClassVar[tuple[Channel, ...]] = (
        Channel("place.light", "m"),
        Channel("place.heavy", "m"),
        Channel("pace.light", "m/s"),
        Channel("pace.heavy", "m/s"),
    )
    input_signals: ClassVar[tuple[str, ...]] = ("push",)
    signals: ClassVar[dict[str, Signal]] = {"push": Signal("N", ("heavy", "light"))}
    equation: ClassVar[str] = "m_1 a_1 = u_1 − u_2 / 2, m_2 a_2 = u_2"

    def own_rate(self, state: Tensor, inputs: Tensor) -> Tensor:
        first, second = inputs[..., 1] - inputs[..., 0] / 2, inputs[..., 0]
        moved = torch.stack([first / tensor(self.light, first), second / tensor(self.heavy, second)], dim=-1)
        return torch.cat([state[..., 2:], moved], dim=-1)
