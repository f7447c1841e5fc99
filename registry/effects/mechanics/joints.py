"""Friction in the joints of a machine with a motor in each: what resists a joint acts where its motor does."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar, Self

from torch import Tensor
from typing_extensions import override

from registry.core import EFFECTS
from registry.dynamics import DryEffect, Parameter, RateEffect, constant, vector
from registry.effects.mechanics.friction import STICKING, scaled, sign

_EACH = "f_"
"""How the fields begin that are a number a joint."""
_TYPICAL = 0.1
_DRY: dict[str, Any] = {"low": 0, "measure": "input", "share": 0.1, "source": "chosen"}
_VISCOUS: dict[str, Any] = {**_DRY, "measure": "input/joint_rate"}


class JointEffect(RateEffect):
    """Resists every joint by a number of its own, in the unit of what drives it; moves what is coupled to it."""

    needs: ClassVar[tuple[str, ...]] = ("angle_rate",)
    acts_in: ClassVar[str] = "a class of your own with a motor in each joint"

    @classmethod
    @override
    def suits(cls, kind: Any) -> bool:
        return 0 < len(_joints(kind)) <= len(_each(cls))

    @classmethod
    @override
    def neutral_for(cls, model: Any, medians: Mapping[str, float]) -> Self:
        """As many zeros as ``model`` has joints."""
        joints = len(_joints(type(model)))
        return cls(**{name: 0.0 if i < joints else None for i, name in enumerate(_each(cls))})

    @override
    def parameters(self) -> list[Parameter]:
        """One a joint, in order, and what they share."""
        each = _each(type(self))
        return [replace(p, neutral=0.0, typical=_TYPICAL) if p.name in each else p for p in super().parameters()]

    @override
    def misfit(self, model: Any) -> str:
        """That the model has another number of joints; empty: it has as many."""
        told, joints = len(self._numbers), len(_joints(type(model)))
        return "" if told == joints else f"it has numbers of {told} joint(s), and the model {joints}."

    def without(self, model: Any, state: Tensor, inputs: Tensor, lost: Tensor) -> Tensor:
        """What is added to dx/dt (…, s) where the drive loses so much (…, n)."""
        added: Tensor = model.driven_by(-lost, state, inputs)
        return added

    @property
    def _numbers(self) -> list[Any]:
        return [v for name in _each(type(self)) if (v := getattr(self, name)) is not None]


@EFFECTS.register("joint_friction")
@dataclass(frozen=True)
class JointFriction(DryEffect, JointEffect):
    """Dry friction in every joint: the same at every speed, against the motion, as of gears and seals."""

    f_1: Any = constant(0.0, "F_c of joint 1", "V", typical=_TYPICAL, **_DRY)
    f_2: Any = constant(0.0, "F_c of joint 2", "V", typical=_TYPICAL, **_DRY)
    f_3: Any = constant(None, "F_c of joint 3", "V", **_DRY)
    f_4: Any = constant(None, "F_c of joint 4", "V", **_DRY)
    f_5: Any = constant(None, "F_c of joint 5", "V", **_DRY)
    f_6: Any = constant(None, "F_c of joint 6", "V", **_DRY)
    f_7: Any = constant(None, "F_c of joint 7", "V", **_DRY)
    w_0: Any = constant(
        STICKING,
        "ω_0: rate over which the sign of the motion changes",
        "rad/s",
        low=0,
        typical=STICKING,
        uncertainty=0.0,
        measure="joint_rate",
        share=0.01,
        source="chosen",
    )
    equation: ClassVar[str] = "u_i → u_i − F_c,i sign dq_i/dt"
    manoeuvre: ClassVar[str] = "move every joint slowly in both directions, with reversals"

    @override
    def motions(self, model: Any) -> Sequence[int]:
        """The rates of the joints."""
        return _joints(type(model))

    @override
    def signs(self, model: Any, state: Tensor) -> Tensor:
        """See `DryEffect.signs`."""
        rate = state[..., list(self.motions(model))]
        return sign(rate, scaled(self.w_0, rate))

    @override
    def resisting(self, model: Any, state: Tensor, inputs: Tensor, signs: Tensor) -> Tensor:
        """See `DryEffect.resisting`."""
        return self.without(model, state, inputs, vector(self._numbers, signs) * signs)


@EFFECTS.register("joint_damping")
@dataclass(frozen=True)
class JointDamping(JointEffect):
    """Friction in every joint in proportion to its rate, as of lubricated bearings and of a motor's counter-voltage."""

    f_1: Any = constant(0.0, "F_v of joint 1", "V s/rad", typical=_TYPICAL, **_VISCOUS)
    f_2: Any = constant(0.0, "F_v of joint 2", "V s/rad", typical=_TYPICAL, **_VISCOUS)
    f_3: Any = constant(None, "F_v of joint 3", "V s/rad", **_VISCOUS)
    f_4: Any = constant(None, "F_v of joint 4", "V s/rad", **_VISCOUS)
    f_5: Any = constant(None, "F_v of joint 5", "V s/rad", **_VISCOUS)
    f_6: Any = constant(None, "F_v of joint 6", "V s/rad", **_VISCOUS)
    f_7: Any = constant(None, "F_v of joint 7", "V s/rad", **_VISCOUS)
    equation: ClassVar[str] = "u_i → u_i − F_v,i dq_i/dt"
    manoeuvre: ClassVar[str] = "move every joint at several constant speeds, slow and fast"

    @override
    def rate(self, model: Any, state: Tensor, inputs: Tensor) -> Tensor:
        """What it adds to dx/dt (…, s); see `RateEffect.rate`."""
        rate = state[..., list(_joints(type(model)))]
        return self.without(model, state, inputs, vector(self._numbers, rate) * rate)


def _joints(kind: Any) -> tuple[int, ...]:
    """Places of the rates that the driving channels of a class drive; see `StateSpace.joints`."""
    found: tuple[int, ...] = getattr(kind, "joints", tuple)()
    return found


def _each(kind: type[JointEffect]) -> list[str]:
    return [f.name for f in fields(kind) if f.name.startswith(_EACH)]
