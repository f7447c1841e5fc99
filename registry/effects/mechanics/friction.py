"""Forces on a moving mass that go with its velocity, or with nothing.

The sign of a measured speed is smoothed, sign v → tanh(v / v_0), so that gradients are finite. A simulation does not
smooth it: there friction stops a motion and holds it (`registry.dynamics.sticking`).
"""

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor
from typing_extensions import override

from registry.core import EFFECTS
from registry.dynamics import DryEffect, PhysicsModel, RateEffect, constant, tensor

STICKING = 1e-3
"""Speed [m/s] over which the sign of a velocity changes, where nobody says how fast a machine is."""
MECHANICAL = ("mass_on_rail", "oscillator", "pendulum", "falling_body", "projectile")
_NO_SPEED = 1e-12
"""Speed [m/s] that nothing has, so that a v_s of zero can be divided by."""
_V_0 = "v_0: speed over which the sign of the motion changes"
_EMPS = "order of magnitude of EMPS"


def sign(speed: Tensor, over: Tensor) -> Tensor:
    """The smoothed sign of speeds [m/s], which changes ``over`` a speed."""
    return torch.tanh(speed / over)


def scaled(parameter: Any, like: Tensor) -> Tensor:
    """A parameter, () or of batch shape (…), to multiply ``like`` (…, n)."""
    return tensor(parameter, like).unsqueeze(-1)


def limited(x: Tensor, inverse: Tensor) -> Tensor:
    """``x``, no further from zero than one over ``inverse`` says."""
    return x / (x.abs() * inverse).clamp(min=1)


class ForceEffect(RateEffect):
    """Adds a force along the path of a mechanical system."""

    needs: ClassVar[tuple[str, ...]] = ("speed",)
    systems: ClassVar[tuple[str, ...]] = MECHANICAL

    @abstractmethod
    def force(self, displacement: Tensor, speed: Tensor) -> Tensor:
        """Force (…, n) [N] at displacements (…, n) [m] and speeds (…, n) [m/s]."""

    def rate(self, model: Any, state: Tensor, inputs: Tensor) -> Tensor:
        """What the force adds to dx/dt (…, 2n); see `RateEffect.rate`."""
        added: Tensor = model.push(self.force(model.displacement(state), model.speed(state)))
        return added


class DryForce(DryEffect, ForceEffect):
    """Dry friction along the path of a mechanical system."""

    systems: ClassVar[tuple[str, ...]] = ("mass_on_rail", "oscillator", "pendulum", "falling_body")
    v_0: Any

    @abstractmethod
    def limit(self, speed: Tensor) -> Tensor:
        """The largest force (…, n) [N] against a motion at speeds (…, n) [m/s]."""

    @override
    def motions(self, model: Any) -> Sequence[int]:
        """Every velocity."""
        size = len(model.state_channels)
        return range(size // 2, size)

    @override
    def signs(self, model: Any, state: Tensor) -> Tensor:
        """See `DryEffect.signs`."""
        speed = model.speed(state)
        return sign(speed, scaled(self.v_0, speed))

    @override
    def resisting(self, model: Any, state: Tensor, inputs: Tensor, signs: Tensor) -> Tensor:
        """See `DryEffect.resisting`."""
        added: Tensor = model.push(-self.limit(model.speed(state)) * signs)
        return added

    @override
    def force(self, displacement: Tensor, speed: Tensor) -> Tensor:
        return -self.limit(speed) * sign(speed, scaled(self.v_0, speed))


@EFFECTS.register("viscous_friction")
@dataclass(frozen=True)
class ViscousFriction(ForceEffect):
    """Friction in proportion to speed, as of a lubricated bearing."""

    f_v: Any = constant(0.0, "F_v", "N s/m", low=0, typical=200.0, source=_EMPS, measure="force/speed", share=0.1)
    equation: ClassVar[str] = "F = −F_v dq/dt"
    manoeuvre: ClassVar[str] = "move at several constant speeds, slow and fast"

    @override
    def force(self, displacement: Tensor, speed: Tensor) -> Tensor:
        return -scaled(self.f_v, speed) * speed


@EFFECTS.register("coulomb_friction")
@dataclass(frozen=True)
class CoulombFriction(DryForce):
    """Dry friction: the same at every speed, against the motion."""

    f_c: Any = constant(0.0, "F_c", "N", low=0, typical=20.0, source=_EMPS, measure="force", share=0.1)
    v_0: Any = constant(
        STICKING, _V_0, "m/s", low=0, typical=STICKING, uncertainty=0.0, measure="speed", share=0.01, source="chosen"
    )
    equation: ClassVar[str] = "F = −F_c sign dq/dt"
    manoeuvre: ClassVar[str] = "move slowly in both directions, with reversals"

    @override
    def limit(self, speed: Tensor) -> Tensor:
        return scaled(self.f_c, speed).expand(speed.shape)


@EFFECTS.register("stribeck_friction")
@dataclass(frozen=True)
class StribeckFriction(DryForce):
    """Dry friction that is larger at the lowest speeds (F_s) than beyond them (F_c)."""

    f_c: Any = constant(
        0.0, "F_c: beyond the lowest speeds", "N", low=0, typical=20.0, source=_EMPS, measure="force", share=0.1
    )
    f_s: Any = constant(0.0, "F_s: at the lowest speeds", "N", low=0, typical=30.0, measure="force", share=0.15)
    v_s: Any = constant(
        0.01, "v_s: speed over which one gives way to the other", "m/s", low=0, typical=0.01, measure="speed", share=0.1
    )
    v_0: Any = constant(
        STICKING, _V_0, "m/s", low=0, typical=STICKING, uncertainty=0.0, measure="speed", share=0.01, source="chosen"
    )
    equation: ClassVar[str] = "F = −[F_c + (F_s − F_c) exp(−(dq/dt / v_s)²)] sign dq/dt"
    screen: ClassVar[dict[str, tuple[float, ...]]] = {"v_s": (0.02, 0.07, 0.2, 0.7)}
    manoeuvre: ClassVar[str] = "creep through standstill in both directions, and move faster for comparison"

    @override
    def possible_in(self, model: PhysicsModel) -> bool:
        return float(self.f_s) >= float(self.f_c)

    @override
    def limit(self, speed: Tensor) -> Tensor:
        f_c, f_s, v_s = (scaled(p, speed) for p in (self.f_c, self.f_s, self.v_s))
        return f_c + (f_s - f_c) * torch.exp(-((speed / v_s.clamp(min=_NO_SPEED)) ** 2))


@EFFECTS.register("offset_force")
@dataclass(frozen=True)
class OffsetForce(ForceEffect):
    """A constant force, such as of a slope, a spring that is always pressed or an amplifier's offset."""

    f_0: Any = constant(0.0, "F_0", "N", typical=3.0, source=_EMPS, measure="force", share=0.05)
    equation: ClassVar[str] = "F = F_0"
    needs: ClassVar[tuple[str, ...]] = ("displacement",)
    manoeuvre: ClassVar[str] = "make the same motion in both directions"
    systems: ClassVar[tuple[str, ...]] = ("mass_on_rail", "oscillator", "pendulum")

    @override
    def force(self, displacement: Tensor, speed: Tensor) -> Tensor:
        return scaled(self.f_0, speed).expand(speed.shape)


@EFFECTS.register("quadratic_drag")
@dataclass(frozen=True)
class QuadraticDrag(ForceEffect):
    """Drag of a blunt body in air or water."""

    c: Any = constant(
        0.0,
        "c: half of density, drag coefficient and area",
        "kg/m",
        low=0,
        typical=0.5,
        measure="force/speed^2",
        share=0.1,
    )
    equation: ClassVar[str] = "F = −c ‖v‖ v"
    manoeuvre: ClassVar[str] = "move at several constant speeds, slow and fast"

    @override
    def force(self, displacement: Tensor, speed: Tensor) -> Tensor:
        # The root of a sum that never is zero: at rest the norm has no gradient.
        norm = ((speed * speed).sum(-1, keepdim=True) + 1e-16).sqrt()
        return -scaled(self.c, speed) * norm * speed
