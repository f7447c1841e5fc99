"""What swings or relaxes out of sight: a small linear system that measured motion drives and that acts back."""

import math
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import torch
from torch import Tensor

from registry.core import EFFECTS, finite, option
from registry.dynamics import InternalEffect, Motion, Parameter, PhysicsModel, RateEffect, constant, tensor
from registry.effects.learned_term import LearnedTerm
from registry.errors import BenchError, near
from registry.terms import signals
from registry.terms.unit_algebra import product

MOST_AXES = 3
"""Axes along which one mode acts, at most."""


@EFFECTS.register("hidden_mode")
@dataclass(frozen=True)
class HiddenMode(InternalEffect, RateEffect):
    """A hidden mode: along each axis an oscillator, or a first-order lag, that the signal of the axis drives.

    Its own states are, axis by axis, z and (of what swings) ż/ω. Where they begin in a recording is told by what was
    measured there before. At a constant signal it does nothing: z is the signal then. Driven by a velocity it is what
    a mass on a spring and a damper does to what carries it: with p = 0, −q is that mass, of a rate of speed a share.
    """

    axes: tuple[str, ...] = option(("world_force_x",), "along which it acts: of body or world, or a state's rate")
    drivers: tuple[str, ...] = option(("velocity.x",), "the signal that drives it, one an axis")
    order: int = option(2, "2: it swings, 1: it relaxes", choices=(1, 2))
    frequency: Any = constant(1.0, "ω/2π: how often it swings, what carries it held; or 1/(2πT)", "Hz", low=0)
    damping: Any = constant(0.02, "ζ: damping ratio of what swings", "1", low=0, high=1)
    gains: Any = constant((0.0, 0.0), "p and q of each axis; of what relaxes, p alone", "1")

    equation: ClassVar[str] = (
        "z̈ + 2ζω ż + ω² z = ω² d;  F = ω (p (z − d) + q ż/ω)   or   ż = ω (d − z);  F = ω p (z − d)"
    )
    learned: ClassVar[bool] = True
    needs: ClassVar[tuple[str, ...]] = ("velocity",)
    manoeuvre: ClassVar[str] = "start and stop sharply, and let it swing out at rest"

    @property
    def internal_size(self) -> int:  # type: ignore[override]
        """Number of states of its own."""
        return self.order * len(self.axes)

    def parameters(self) -> list[Parameter]:
        """Frequency, damping and gains; that it does nothing is told by the gains alone."""
        out = []
        for p in super().parameters():
            many = isinstance(p.value, Tensor)
            if p.name == "gains":
                neutral = (0.0,) * (self.order * len(self.axes))
                largest = 1.0 if many else max(map(abs, p.value)) or 1.0
                out.append(replace(p, neutral=neutral, typical=(largest,) * len(neutral)))
            elif p.name == "frequency" or self.order == 2:
                value = 1.0 if many else p.value
                out.append(replace(p, neutral=value, typical=value if p.name == "frequency" else 0.1))
        return out

    def units(self, model: PhysicsModel) -> tuple[str, ...]:
        """The unit of every gain."""
        axes, known = signals.axes_of(type(model)), signals.available(model)
        pairs = zip(self.axes, self.drivers, strict=True)
        return tuple(product((axes[a], 1), (known[d], -1), ("s", 1)) for a, d in pairs for _ in range(self.order))

    def constants(self) -> tuple[LearnedTerm, ...]:
        """A unit along each axis that does not change."""
        return tuple(LearnedTerm(axis, (), "constant", (1.0,)) for axis in self.axes)

    def load(self, motion: Motion, acceleration: Tensor) -> tuple[Tensor, Tensor]:
        """Force (…, 3) [N] and torque (…, 3) [N m], body frame; see `InternalEffect.load`."""
        assert motion.internal is not None
        force = torque = torch.zeros_like(motion.velocity)
        for i, (axis, driver) in enumerate(zip(self.axes, self.drivers, strict=True)):
            amount = self.amount(i, motion.internal, signals.of_motion(driver, motion))
            more = signals.load_along(axis, amount, motion)
            force, torque = force + more[0], torque + more[1]
        return force, torque

    def internal_rate(self, motion: Motion, acceleration: Tensor) -> Tensor:
        """Time derivative (…, n) of the own states; see `InternalEffect.internal_rate`."""
        assert motion.internal is not None
        return self.turning(motion.internal, [signals.of_motion(d, motion) for d in self.drivers])

    def rate(self, model: Any, state: Tensor, inputs: Tensor) -> Tensor:
        """What it adds to dx/dt, and the derivative of its own states (…, s + n); see `RateEffect.rate`."""
        size = self.internal_size
        proper, own = state[..., :-size], state[..., -size:]
        driven = [signals.of_state(d, model, proper, inputs) for d in self.drivers]
        added = torch.zeros_like(proper)
        for i, axis in enumerate(self.axes):
            added = added + signals.rate_along(axis, self.amount(i, own, driven[i]), model, proper, inputs)
        return torch.cat([added, self.turning(own, driven)], dim=-1)

    def amount(self, i: int, own: Tensor, driver: Tensor) -> Tensor:
        """What it does (…) along axis ``i`` with own states (…, n) and the driver (…) of that axis."""
        turn, gains = 2 * math.pi * tensor(self.frequency, driver), tensor(self.gains, driver)
        z = own[..., self.order * i]
        out = gains[..., self.order * i] * (z - driver)
        if self.order == 2:
            out = out + gains[..., 2 * i + 1] * own[..., 2 * i + 1]
        return turn * out

    def turning(self, own: Tensor, driven: list[Tensor]) -> Tensor:
        """Time derivative (…, n) of the own states (…, n) with drivers (…)."""
        turn, zeta = 2 * math.pi * tensor(self.frequency, own), tensor(self.damping, own)
        rates = []
        for i, d in enumerate(driven):
            z = own[..., self.order * i]
            if self.order == 1:
                rates.append(turn * (d - z))
                continue
            y = own[..., 2 * i + 1]
            rates += [turn * y, turn * (d - z - 2 * zeta * y)]
        return torch.stack(torch.broadcast_tensors(*rates), dim=-1)

    def misfit(self, model: PhysicsModel) -> str:
        """Why it cannot act in a model: an axis or a signal that this has not; empty: it can."""
        axes, known = signals.axes_of(type(model)), signals.available(model)
        for axis in self.axes:
            if axis not in axes:
                return f"{type(model).system_name()} has no axis {axis!r}: {near(axis, axes)}"
        for name in self.drivers:
            if name not in known:
                return f"{type(model).system_name()} has no signal {name!r} to be driven by: {near(name, known)}"
        return ""

    def options(self) -> dict[str, Any]:
        """What a file has beside the parameters."""
        return {"axes": self.axes, "drivers": self.drivers, "order": self.order}

    @classmethod
    def from_options(cls, where: str, given: dict[str, Any]) -> "HiddenMode":
        """The mode of a file's table; everything in it is data.

        Raises:
            BenchError: something is missing, unknown, of the wrong kind or does not fit together.
        """
        known = ("axes", "drivers", "order", "frequency", "damping", "gains")
        for key in given:
            if key not in known:
                raise BenchError(f"{where}: unknown key {key!r}: {near(key, known)}")
        order = given.get("order", 2)
        if isinstance(order, bool) or order not in (1, 2):
            raise BenchError(f"{where}: order must be 2 (it swings) or 1 (it relaxes), not {order!r}.")
        axes, drivers = (_names(where, key, given.get(key)) for key in ("axes", "drivers"))
        if len(drivers) != len(axes):
            raise BenchError(f"{where}: drivers must be as many as axes: one signal drives it along each.")
        numbers = [given.get("frequency"), given.get("damping", 0.0)]
        frequency, damping = numbers
        if not finite(frequency) or not frequency > 0:
            raise BenchError(f"{where}: frequency must be a positive number [Hz], not {frequency!r}.")
        if not finite(damping) or not 0 <= damping <= 1:
            raise BenchError(f"{where}: damping must be a number from 0 to 1, not {damping!r}.")
        gains = given.get("gains")
        if not isinstance(gains, list) or not all(map(finite, gains)) or len(gains) != order * len(axes):
            raise BenchError(f"{where}: gains must be a list of {order * len(axes)} finite numbers, not {gains!r}.")
        return cls(axes, drivers, order, float(frequency), float(damping), tuple(map(float, gains)))


def _names(where: str, key: str, given: Any) -> tuple[str, ...]:
    if not isinstance(given, list) or not 1 <= len(given) <= MOST_AXES or not all(isinstance(n, str) for n in given):
        raise BenchError(f'{where}: {key} must be one to {MOST_AXES} names, such as {key} = ["speed.q"].')
    return tuple(given)
