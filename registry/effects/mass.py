"""How much mass the vehicle has, and where."""

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import torch
from torch import Tensor
from typing_extensions import override

from registry.core import EFFECTS
from registry.dynamics import ModelEffect, constant, tensor, vector

_MAGNITUDE = "order of magnitude"
_TO_HUBS: dict[str, Any] = {"typical": 0.003, "relative_to": "rotor_positions"}
"""Torques tell a ratio of lengths: arms that are all longer by a tenth put the centre as much further out."""


@EFFECTS.register("mass")
@dataclass(frozen=True)
class Mass(ModelEffect):
    """The vehicle is heavier, or lighter, than the model says; such as by a payload at its centre of gravity."""

    delta: Any = constant(0.0, "added mass", "kg", low=-0.5, high=5, typical=0.15, source=_MAGNITUDE)
    equation: ClassVar[str] = "m → m + delta"
    needs: ClassVar[tuple[str, ...]] = ("velocity", "attitude")
    systems: ClassVar[tuple[str, ...]] = ("quadrotor",)
    manoeuvre: ClassVar[str] = (
        "roll and pitch fast besides hover and hard climbs, with a fresh and with a flat battery: a wrong mass leaves "
        "the torques as they are, a wrong thrust coefficient does not; or weigh the vehicle"
    )

    def adapt(self, model: Any) -> Any:
        """The model with the mass added."""
        return replace(model, mass=model.mass + self.delta)


@EFFECTS.register("inertia_products")
@dataclass(frozen=True)
class InertiaProducts(ModelEffect):
    """The principal axes of inertia are not those of the body, so that rotation about one turns the others."""

    J_xy: Any = constant(0.0, "entry of J", "kg m^2", low=-5e-3, high=5e-3, typical=3e-4, source=_MAGNITUDE)
    J_xz: Any = constant(0.0, "entry of J", "kg m^2", low=-5e-3, high=5e-3, typical=3e-4, source=_MAGNITUDE)
    J_yz: Any = constant(0.0, "entry of J", "kg m^2", low=-5e-3, high=5e-3, typical=3e-4, source=_MAGNITUDE)
    equation: ClassVar[str] = "J = [J_x J_xy J_xz; J_xy J_y J_yz; J_xz J_yz J_z]"
    needs: ClassVar[tuple[str, ...]] = ("body_rates",)
    systems: ClassVar[tuple[str, ...]] = ("quadrotor", "helicopter")
    manoeuvre: ClassVar[str] = (
        "give doublets about one axis at a time and watch the other two: this coupling follows the torque, that of "
        "spinning rotors the rate and the difference of their speeds"
    )

    def adapt(self, model: Any) -> Any:
        """The model with the products added to its own."""
        own = model.inertia_products
        own = own.unbind(-1) if isinstance(own, Tensor) else own
        added = (self.J_xy, self.J_xz, self.J_yz)
        return replace(model, inertia_products=tuple(a + b for a, b in zip(own, added, strict=True)))

    @override
    def possible_in(self, model: Any) -> bool:
        """Whether the inertia matrix is positive definite: whatever has mass resists every rotation."""
        (xx, yy, zz), (xy, xz, yz) = model.inertia, self.adapt(model).inertia_products
        matrix = torch.tensor([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        return bool(torch.linalg.eigvalsh(matrix).min() > 0)


@EFFECTS.register("cog_offset")
@dataclass(frozen=True)
class CogOffset(ModelEffect):
    """The centre of gravity is not where the rotor positions are measured from, so that thrust turns the body.

    All that acts at the hubs does, and their velocity through the air and their height change with it.
    """

    x: Any = constant(0.0, "of the centre of gravity, along body x", "m", low=-0.1, high=0.1, **_TO_HUBS)
    y: Any = constant(0.0, "of the centre of gravity, along body y", "m", low=-0.1, high=0.1, **_TO_HUBS)
    equation: ClassVar[str] = "r_i → r_i − r_cg,  r_cg = (x, y, 0)"
    needs: ClassVar[tuple[str, ...]] = ("body_rates",)
    systems: ClassVar[tuple[str, ...]] = ("quadrotor",)
    manoeuvre: ClassVar[str] = (
        "climb and descend hard with little rotation: this torque grows with the thrust, a constant one does not"
    )

    def adapt(self, model: Any) -> Any:
        """The model with its hubs (…, rotors, 3) as they are seen from the centre of gravity."""
        hubs = model.rotor_positions
        tensors = [c for c in (self.x, self.y, hubs) if isinstance(c, Tensor)]
        if not tensors:
            return replace(model, rotor_positions=tuple((x - self.x, y - self.y, z) for x, y, z in hubs))
        centre = vector((self.x, self.y, 0.0), tensors[0]).unsqueeze(-2)
        return replace(model, rotor_positions=tensor(hubs, centre) - centre)
