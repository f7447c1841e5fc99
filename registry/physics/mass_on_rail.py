"""A carriage on a straight rail, pushed by a motor."""

from dataclasses import dataclass
from typing import Any, ClassVar

from torch import Tensor

from registry.contracts import Channel
from registry.core import PHYSICS
from registry.dynamics import constant, tensor
from registry.physics.state_space import Mechanical

_EMPS = "Janot, Gautier and Brunot, Data Set and Reference Models of EMPS (2019)"


@PHYSICS.register("mass_on_rail")
@dataclass(frozen=True)
class MassOnRail(Mechanical):
    """A mass without friction, pushed by a motor whose force goes with its drive voltage."""

    mass: Any = constant(95.1, "M: carriage and, reflected, motor", "kg", low=1e-6, source=_EMPS)
    force_gain: Any = constant(
        35.15065188248547, "g: force over drive voltage", "N/V", source="gtau in the files of EMPS"
    )

    state_channels: ClassVar[tuple[Channel, ...]] = (Channel("displacement.q", "m"), Channel("speed.q", "m/s"))
    input_signals: ClassVar[tuple[str, ...]] = ("voltage",)
    alike: ClassVar[tuple[str, ...]] = ()
    equation: ClassVar[str] = "M d²q/dt² = g u"

    def own_force(self, state: Tensor, inputs: Tensor) -> Tensor:
        """The motor's force (…, 1) [N]; see `Mechanical.own_force`."""
        return tensor(self.force_gain, state).unsqueeze(-1) * inputs
