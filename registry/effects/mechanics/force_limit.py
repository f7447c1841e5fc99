"""The most that a drive with a controller of its own can exert."""

from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor
from typing_extensions import override

from registry.core import EFFECTS
from registry.dynamics import RateEffect, constant
from registry.effects.mechanics.friction import limited, scaled


class LimitEffect(RateEffect):
    """A limit of a drive that follows a set-point, which is in the unit of one of the states."""

    needs: ClassVar[tuple[str, ...]] = ("displacement",)
    systems: ClassVar[tuple[str, ...]] = ("oscillator", "mass_on_rail")
    acts_in: ClassVar[str] = "a class of your own that is driven by a set-point: in the unit of one of its states"
    changes_model: ClassVar[bool] = True
    manoeuvre: ClassVar[str] = "change the set-point in steps, small ones and the largest that are allowed"

    @classmethod
    @override
    def suits(cls, kind: Any) -> bool:
        return super().suits(kind) and followed(kind) is not None


def followed(kind: Any) -> int | None:
    """Place of the state that follows the set-point of a class; None: it is driven by something else."""
    if not kind.input_signals:
        return None
    drive = kind.signal(kind.input_signals[0])
    axis = drive.axes[0] if len(drive.axes) == 1 else ""
    alike = [i for i, channel in enumerate(kind.state_channels) if channel.unit == drive.unit]
    own = [i for i in alike if kind.state_channels[i].axis == axis]
    return next(iter(own or alike), None)


@EFFECTS.register("force_limit")
@dataclass(frozen=True)
class ForceLimit(LimitEffect):
    """A drive that follows a set-point, as a servo, pushes no harder than a limit. The parameter is one over that."""

    inverse: Any = constant(0.0, "1/F_max: one over the limit", "1/N", low=0, typical=0.4, measure="1/force", share=1.5)
    equation: ClassVar[str] = "F → max(−F_max, min(F_max, F)) of the model's own force"
    screen: ClassVar[dict[str, tuple[float, ...]]] = {"inverse": (1.1, 1.5, 2.2, 3.5, 6.0)}

    def rate(self, model: Any, state: Tensor, inputs: Tensor) -> Tensor:
        """What is missing of the force beyond the limit, as an addition to dx/dt (…, 2n); see `RateEffect.rate`."""
        force = model.own_force(state, inputs)
        added: Tensor = model.push(limited(force, scaled(self.inverse, force)) - force)
        return added


@EFFECTS.register("controller_saturation")
@dataclass(frozen=True)
class ControllerSaturation(LimitEffect):
    """The controller of a servo gives its full output from some error on: it pushes no harder, and has a top speed.

    What brakes a motor, such as its counter-voltage, is not limited by that, which tells it from a limit of the force.
    """

    inverse: Any = constant(
        0.0, "1/e_max: one over that error", "1/m", low=0, typical=4.0, measure="1/displacement", share=4.0
    )
    equation: ClassVar[str] = "u → q + max(−e_max, min(e_max, u − q))"
    screen: ClassVar[dict[str, tuple[float, ...]]] = {"inverse": (1.1, 1.7, 3.0, 5.0, 9.0, 16.0)}

    def rate(self, model: Any, state: Tensor, inputs: Tensor) -> Tensor:
        """What a set-point farther away would do beside one at that error (…, 2n); see `RateEffect.rate`."""
        place = followed(type(model))
        assert place is not None  # `suits`
        q = state[..., place : place + 1]
        error = inputs[..., :1] - q
        near = torch.cat([q + limited(error, scaled(self.inverse, error)), inputs[..., 1:]], dim=-1)
        added: Tensor = model.push(model.own_force(state, near) - model.own_force(state, inputs))
        return added
