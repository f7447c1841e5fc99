"""Two tanks, one above the other."""

from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor

from registry.contracts import Channel
from registry.core import PHYSICS
from registry.dynamics import constant, tensor
from registry.physics.state_space import StateSpace

NEARLY_EMPTY = 1e-3
"""Level [V] below which the root of the level is continued by a straight line: its slope stays finite."""
_FITTED = "simulation fit to the training recording of cascaded_tanks"


def root(level: Tensor) -> Tensor:
    """√h [V^½] of levels of any shape [V]."""
    return level / level.clamp(min=NEARLY_EMPTY).sqrt()


@PHYSICS.register("tanks")
@dataclass(frozen=True)
class Tanks(StateSpace):
    """A pump fills the upper tank, which runs into the lower one, which runs out.

    Levels and pump are in the volts of sensor and drive, the upper level in such volts that a volt less there is a
    volt more below. Outflow goes with the root of the level (Bernoulli) and with the level itself, which bends that
    law either way, as real outlets do; with l_1 = l_2 = 0 it is Bernoulli's alone.
    """

    upper_outflow: Any = constant(0.0514, "k_1", "V^0.5/s", low=0, source=_FITTED, uncertainty=0.5)
    upper_linear: Any = constant(0.00068, "l_1", "1/s", source=_FITTED, uncertainty=2.0)
    lower_outflow: Any = constant(0.1315, "k_2", "V^0.5/s", low=0, source=_FITTED, uncertainty=0.5)
    lower_linear: Any = constant(-0.00466, "l_2", "1/s", source=_FITTED, uncertainty=2.0)
    pump_gain: Any = constant(0.0996, "k_p", "1/s", low=0, source=_FITTED, uncertainty=0.5)

    state_channels: ClassVar[tuple[Channel, ...]] = (Channel("upper_level.h", "V"), Channel("level.h", "V"))
    input_signals: ClassVar[tuple[str, ...]] = ("voltage",)
    equation: ClassVar[str] = "dh_1/dt = k_p u − f_1;  dh_2/dt = f_1 − f_2;  f_i = k_i √h_i + l_i h_i"

    def own_rate(self, state: Tensor, inputs: Tensor) -> Tensor:
        """dh/dt (…, 2) [V/s]; see `StateSpace.own_rate`."""
        k_1, l_1, k_2, l_2, gain = (
            tensor(c, state)
            for c in (
                self.upper_outflow,
                self.upper_linear,
                self.lower_outflow,
                self.lower_linear,
                self.pump_gain,
            )
        )
        upper, lower = state.unbind(-1)
        first, second = k_1 * root(upper) + l_1 * upper, k_2 * root(lower) + l_2 * lower
        return torch.stack([gain * inputs[..., 0] - first, first - second], dim=-1)
