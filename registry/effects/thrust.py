"""Thrust that is not what k_f and the rotor speed say, or does not point along body z."""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar, Self

import torch
from torch import Tensor

from registry.core import EFFECTS
from registry.dynamics import LoadEffect, Motion, Parameter, ThrustEffect, constant, tensor, vector
from registry.errors import BenchError

_MAGNITUDE = "order of magnitude"
_CELL, _CELL_IN_FLIGHT = 3.7, 3.8
"""Voltage of a lithium-polymer cell [V]: nominal, and about what it has in the middle of a flight."""


@EFFECTS.register("thrust_scale")
@dataclass(frozen=True)
class ThrustScale(ThrustEffect):
    """All rotors lift more, or less, than their coefficient says."""

    eps: Any = constant(0.0, "relative error of k_f", "1", low=-0.5, high=0.5, typical=0.1)
    equation: ClassVar[str] = "k_f → k_f (1 + ε), in force and torque"
    needs: ClassVar[tuple[str, ...]] = ("velocity", "attitude")
    systems: ClassVar[tuple[str, ...]] = ("quadrotor",)
    manoeuvre: ClassVar[str] = (
        "roll and pitch fast besides hover and hard climbs, with a fresh and with a flat battery: a wrong thrust "
        "coefficient changes the torques too, a wrong mass does not; or weigh the vehicle"
    )

    def thrust_factor(self, motion: Motion) -> Tensor:
        """One factor (…, 1) for all rotors."""
        return (1 + tensor(self.eps, motion.thrust)).unsqueeze(-1)


@dataclass(frozen=True)
class _RotorByRotor(ThrustEffect):
    """A factor on the thrust of each rotor."""

    eps_1: Any = constant(0.0, "relative error of rotor 1", "1", low=-0.5, high=0.5, typical=0.05, source=_MAGNITUDE)
    eps_2: Any = constant(0.0, "relative error of rotor 2", "1", low=-0.5, high=0.5, typical=-0.05, source=_MAGNITUDE)
    eps_3: Any = constant(0.0, "relative error of rotor 3", "1", low=-0.5, high=0.5, typical=0.05, source=_MAGNITUDE)
    eps_4: Any = constant(0.0, "relative error of rotor 4", "1", low=-0.5, high=0.5, typical=0.05, source=_MAGNITUDE)
    eps_5: Any = constant(None, "relative error of rotor 5", "1", low=-0.5, high=0.5, source=_MAGNITUDE)
    eps_6: Any = constant(None, "relative error of rotor 6", "1", low=-0.5, high=0.5, source=_MAGNITUDE)
    eps_7: Any = constant(None, "relative error of rotor 7", "1", low=-0.5, high=0.5, source=_MAGNITUDE)
    eps_8: Any = constant(None, "relative error of rotor 8", "1", low=-0.5, high=0.5, source=_MAGNITUDE)
    needs: ClassVar[tuple[str, ...]] = ("body_rates", "velocity", "attitude")
    systems: ClassVar[tuple[str, ...]] = ("quadrotor",)

    def parameters(self) -> list[Parameter]:
        """One a rotor, in order."""
        listed = super().parameters()
        return [replace(p, neutral=0.0, typical=0.05 if p.typical is None else p.typical) for p in listed]

    def misfit(self, model: Any) -> str:
        """That the model has another number of rotors; empty: it has as many."""
        told, rotors = len(self._errors), _rotors(model)
        return "" if told == rotors else f"it has factors of {told} rotors, and the vehicle has {rotors}."

    @classmethod
    def neutral_for(cls, model: Any, medians: Mapping[str, float]) -> Self:
        """As many zeros as ``model`` has rotors."""
        rotors = _rotors(model)
        return cls(**{f.name: 0.0 if i < rotors else None for i, f in enumerate(fields(cls))})

    @classmethod
    def together(cls, values: Mapping[str, float]) -> str:
        """How far each rotor is from the mean of all: what they have in common may as well be the coefficient's."""
        mean = 1 + sum(values.values()) / len(values)
        apart = (f"{100 * ((1 + v) / mean - 1):+.1f} %".replace("-", "−") for v in values.values())
        return f"beside the mean of all rotors {', '.join(apart)}"

    def thrust_factor(self, motion: Motion) -> Tensor:
        """Factors (…, rotors)."""
        return 1 + vector(self._errors, motion.thrust)

    @property
    def _errors(self) -> list[Any]:
        return [e for f in fields(self) if (e := getattr(self, f.name)) is not None]


@EFFECTS.register("unequal_rotors")
@dataclass(frozen=True)
class UnequalRotors(_RotorByRotor):
    """Each rotor lifts more, or less, than the common coefficient says, and is as hard to turn as it says."""

    equation: ClassVar[str] = "k_f,i = k_f (1 + ε_i), in force and torque r × T; s k_m ω² as it is"
    manoeuvre: ClassVar[str] = (
        "give doublets in roll, pitch and yaw at high and at low thrust, so that each rotor speeds up while others "
        "slow down: what follows the speed of one rotor is neither a displaced centre of gravity nor a constant torque"
    )


@EFFECTS.register("worn_rotors")
@dataclass(frozen=True)
class WornRotors(_RotorByRotor, LoadEffect):
    """Each rotor lifts and drags more, or less, than the common coefficients say; such as one with a chipped blade."""

    equation: ClassVar[str] = "k_f,i = k_f (1 + ε_i) and k_m,i = k_m (1 + ε_i)"
    manoeuvre: ClassVar[str] = (
        "climb and descend hard without turning in yaw, then give doublets about all axes: a rotor that lost part of "
        "its blade turns the vehicle in yaw as it loses thrust, and more so the faster it runs, a constant torque does "
        "not"
    )

    def load(self, motion: Motion) -> tuple[Tensor, Tensor]:
        """No force; what is missing of the reaction torque (…, 3) [N m], body frame."""
        speed = motion.inputs
        signs, size = tensor(motion.model.rotor_directions, speed), tensor(motion.model.torque_coefficient, speed)
        yaw = (signs * size.unsqueeze(-1) * vector(self._errors, speed) * speed * speed).sum(-1)
        torque = yaw.unsqueeze(-1) * tensor((0.0, 0.0, 1.0), speed)
        return torch.zeros_like(torque), torque


def _rotors(model: Any) -> int:
    places = model.rotor_positions
    return int(places.shape[-2]) if isinstance(places, Tensor) else len(places)


@EFFECTS.register("battery_sag")
@dataclass(frozen=True)
class BatterySag(ThrustEffect):
    """Thrust follows the voltage of the battery or, where that is not measured, falls with the time of flight.

    The slope acts in a model with the signal battery, the rate in one that has only time.
    """

    slope: Any = constant(0.0, "relative gain over voltage", "1/V", low=-2, high=2, typical=0.1, source=_MAGNITUDE)
    rate: Any = constant(0.0, "relative loss over time", "1/s", low=-0.05, high=0.05, typical=1e-3, source=_MAGNITUDE)
    reference: Any = constant(
        _CELL,
        "V_ref: voltage at which k_f holds, not fitted: 3.7 V a cell of the pack",
        "V",
        low=0,
        typical=_CELL,
        uncertainty=0.0,
        source="one lithium-polymer cell, nominal",
    )
    equation: ClassVar[str] = "T → T (1 + slope (V − V_ref));  without a voltage signal, T → T (1 − rate t)"
    needs: ClassVar[tuple[str, ...]] = ("velocity", "attitude")
    systems: ClassVar[tuple[str, ...]] = ("quadrotor",)
    manoeuvre: ClassVar[str] = (
        "log the voltage and fly the same with a full and with a nearly empty battery: the error of the thrust changes "
        "between them, that of a wrong mass or thrust coefficient does not"
    )

    @classmethod
    def neutral_for(cls, model: Any, medians: Mapping[str, float]) -> Self:
        """About the nominal voltage of a pack of as many cells as give the logged one.

        About that of one cell the thrust of a large pack would hardly be the stated one, whatever the slope.
        """
        cells = max(1, round(medians.get("battery", _CELL) / _CELL_IN_FLIGHT))
        return cls(reference=cells * _CELL)

    def thrust_factor(self, motion: Motion) -> Tensor:
        """One factor (…, 1) for all rotors.

        Raises:
            BenchError: the model has neither of the signals.
        """
        if "battery" in motion.extras:
            volts = motion.extras["battery"]
            change = tensor(self.slope, volts) * (volts - tensor(self.reference, volts))
        elif "time" in motion.extras:
            time = motion.extras["time"]
            change = -tensor(self.rate, time) * time
        else:
            raise BenchError('battery_sag needs a model with extras=("battery",) or extras=("time",).')
        return (1 + change).unsqueeze(-1)


@EFFECTS.register("rotor_misalignment")
@dataclass(frozen=True)
class RotorMisalignment(LoadEffect):
    """The thrust leans away from body z, as if all rotors were mounted with a tilt."""

    a_x: Any = constant(0.0, "tilt about body x", "rad", low=-0.3, high=0.3, typical=0.02, source=_MAGNITUDE)
    a_y: Any = constant(0.0, "tilt about body y", "rad", low=-0.3, high=0.3, typical=0.02, source=_MAGNITUDE)
    equation: ClassVar[str] = "F_xy = T (a_y, −a_x),  T = Σ T_i"
    needs: ClassVar[tuple[str, ...]] = ("velocity", "attitude")
    systems: ClassVar[tuple[str, ...]] = ("quadrotor",)
    manoeuvre: ClassVar[str] = (
        "hover and climb hard at several headings: this force turns with the body and grows with the thrust, that of "
        "the wind stays with the world"
    )

    def load(self, motion: Motion) -> tuple[Tensor, Tensor]:
        """Force (…, 3) [N], body frame; no torque."""
        thrust = motion.total_thrust
        lean = vector((self.a_y, self.a_x, 0.0), thrust) * tensor((1.0, -1.0, 0.0), thrust)
        return lean * thrust.unsqueeze(-1), tensor((0.0, 0.0, 0.0), thrust)
