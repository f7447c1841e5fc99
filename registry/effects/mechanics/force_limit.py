"""The most that a drive with a controller of its own can exert."""

from dataclasses import dataclass
from typing import Any, ClassVar

from torch import Tensor
from typing_extensions import override

from registry.core import EFFECTS
from registry.dynamics import RateEffect, constant
from registry.effects.mechanics.friction import limited, scaled


@EFFECTS.register("force_limit")
@dataclass(frozen=True)
class ForceLimit(RateEffect):
    """A drive that follows a set-point, as a servo, pushes no harder than a limit. The parameter is one over that."""

    inverse: Any = constant(0.0, "1/F_max: one over the limit", "1/N", low=0, typical=0.4, measure="1/force", share=1.5)
    equation: ClassVar[str] = "F → max(−F_max, min(F_max, F)) of the model's own force"
    needs: ClassVar[tuple[str, ...]] = ("displacement",)
    systems: ClassVar[tuple[str, ...]] = ("oscillator", "mass_on_rail")
    acts_in: ClassVar[str] = "a class of your own that is driven by a set-point: in the unit of one of its states"
    screen: ClassVar[dict[str, tuple[float, ...]]] = {"inverse": (1.1, 1.5, 2.2, 3.5, 6.0)}
    changes_model: ClassVar[bool] = True
    manoeuvre: ClassVar[str] = "change the set-point in steps, small ones and the largest that are allowed"

    @classmethod
    @override
    def suits(cls, kind: Any) -> bool:
        units = {channel.unit for channel in kind.state_channels}
        drive = next((kind.signal(name) for name in kind.input_signals), None)
        return super().suits(kind) and drive is not None and drive.unit in units

    def rate(self, model: Any, state: Tensor, inputs: Tensor) -> Tensor:
        """What is missing of the force beyond the limit, as an addition to dx/dt (…, 2n); see `RateEffect.rate`."""
        force = model.own_force(state, inputs)
        added: Tensor = model.push(limited(force, scaled(self.inverse, force)) - force)
        return added
