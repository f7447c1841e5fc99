"""A force, torque or rate that no effect of the catalogue describes, as data: axis, signals and shape."""

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, ClassVar

import torch
from torch import Tensor

from registry.core import EFFECTS, finite, option
from registry.dynamics import LoadEffect, Motion, Parameter, PhysicsModel, RateEffect, constant, tensor
from registry.errors import BenchError, near
from registry.terms import shapes, signals
from registry.terms.unit_algebra import product

MOST_KNOTS = 40
"""Knots of a spline at most."""


@EFFECTS.register("learned_term")
@dataclass(frozen=True)
class LearnedTerm(LoadEffect, RateEffect):
    """What was learned from recordings and no catalogue has: a function of a signal, or that times another one."""

    axis: str = option("world_force_x", "along which it acts: of the body or the world, or a state's rate of change")
    signals: tuple[str, ...] = option(("position.x",), "what it follows; it is multiplied by the second")
    shape: str = option("linear", "the formula, or spline")
    values: Any = constant((0.0,), "parameters of the formula, or values at the knots", "1", typical=(-0.3,))
    knots: tuple[float, ...] = option((), "of a spline, in the unit of the first signal, ascending")
    span: tuple[float, float] = option((-1.0, 1.0), "values of the first signal between which it was learned")

    equation: ClassVar[str] = "F = f(x), or f(x) y: a spline or a short formula of signals x, y, along one axis"
    learned: ClassVar[bool] = True
    sees_extras: ClassVar[bool] = True
    needs: ClassVar[tuple[str, ...]] = ("velocity",)
    manoeuvre: ClassVar[str] = "go through the whole range of the signal that it follows, several times and at rest"

    def parameters(self) -> list[Parameter]:
        """The vector of parameters; typical of one is its own size, of a spline's values that of the largest."""
        (found,) = super().parameters()
        if isinstance(self.values, Tensor):
            return [found]
        largest = max(map(abs, self.values)) or 1.0
        sizes = tuple(largest if self.shape == shapes.SPLINE else abs(v) or 1.0 for v in self.values)
        return [replace(found, neutral=(0.0,) * len(self.values), typical=sizes)]

    def named_parameters(self, model: PhysicsModel) -> list[tuple[str, str]]:
        """Name and unit of every parameter; those of a spline are called after their knots."""
        whole, units = signals.axes_of(type(model))[self.axis], signals.available(model)
        first = units[self.signals[0]] if self.signals else "1"
        scale = product((whole, 1), *((units[s], -1) for s in self.signals[1:]))
        if self.shape == shapes.SPLINE:
            return [(f"at {k:.4g}", scale) for k in self.knots]
        shape = shapes.SHAPES[self.shape]
        named = [(n, product((scale, 1), (first, -power))) for n, power in shape.parameters]
        if shape.bent is not None:
            named[-1] = (named[-1][0], product((first, shape.bent)))
        return named

    def function(self, x: Tensor) -> Tensor:
        """f (…) of values of the first signal (…)."""
        return shapes.value(self.shape, self.knots, self.span, tensor(self.values, x), x)

    def load(self, motion: Motion) -> tuple[Tensor, Tensor]:
        """Force (…, 3) [N] and torque (…, 3) [N m], body frame; see `LoadEffect.load`."""
        followed = [signals.of_motion(s, motion) for s in self.signals]
        return signals.load_along(self.axis, self._amount(followed, torch.zeros_like(motion.velocity[..., 0])), motion)

    def rate(self, model: Any, state: Tensor, inputs: Tensor) -> Tensor:
        """What it adds to dx/dt (…, s); see `RateEffect.rate`."""
        followed = [signals.of_state(s, model, state, inputs) for s in self.signals]
        return signals.rate_along(
            self.axis, self._amount(followed, torch.zeros_like(state[..., 0])), model, state, inputs
        )

    def _amount(self, followed: list[Tensor], none: Tensor) -> Tensor:
        amount = self.function(followed[0] if followed else none)
        return amount * followed[1] if len(followed) > 1 else amount

    def misfit(self, model: PhysicsModel) -> str:
        """Why it cannot act in a model: an axis or a signal that this has not; empty: it can."""
        axes, known = signals.axes_of(type(model)), signals.available(model)
        if self.axis not in axes:
            return f"{type(model).system_name()} has no axis {self.axis!r}: {near(self.axis, axes)}"
        for name in self.signals:
            if name not in known:
                return f"{type(model).system_name()} has no signal {name!r} to follow: {near(name, known)}"
        return ""

    def options(self) -> dict[str, Any]:
        """What a file has beside the parameters."""
        more = {"knots": self.knots} if self.shape == shapes.SPLINE else {}
        return {"axis": self.axis, "signals": self.signals, "shape": self.shape, **more, "span": self.span}

    @classmethod
    def from_options(cls, where: str, given: dict[str, Any]) -> "LearnedTerm":
        """The term of a file's table; everything in it is data.

        Raises:
            BenchError: something is missing, unknown, of the wrong kind or does not fit together.
        """
        known = ("axis", "signals", "shape", "values", "knots", "span")
        for key in given:
            if key not in known:
                raise BenchError(f"{where}: unknown key {key!r}: {near(key, known)}")
        axis, shape = given.get("axis"), given.get("shape")
        if not isinstance(axis, str) or not isinstance(shape, str):
            raise BenchError(f'{where}: axis and shape must be texts, such as axis = "force_z", shape = "linear".')
        if shape not in (*shapes.SHAPES, shapes.SPLINE):
            raise BenchError(f"{where}: unknown shape {shape!r}: {near(shape, (*shapes.SHAPES, shapes.SPLINE))}")
        names = given.get("signals")
        fewest = 0 if shape == "constant" else 1
        if not isinstance(names, list) or not all(isinstance(n, str) for n in names) or not fewest <= len(names) <= 2:
            raise BenchError(f'{where}: signals must be one or two names, such as signals = ["height"].')
        knots = _numbers(where, "knots", given.get("knots", []))
        if shape != shapes.SPLINE and knots:
            raise BenchError(f"{where}: only a spline has knots; {shape} has none.")
        if shape == shapes.SPLINE and not 3 <= len(knots) <= MOST_KNOTS:
            raise BenchError(f"{where}: a spline has from 3 to {MOST_KNOTS} knots, not {len(knots)}.")
        if any(b <= a for a, b in pairwise(knots)):
            raise BenchError(f"{where}: knots must ascend.")
        values = _numbers(where, "values", given.get("values"))
        wanted = len(knots) if shape == shapes.SPLINE else len(shapes.SHAPES[shape].parameters)
        if len(values) != wanted:
            raise BenchError(f"{where}: {shape} takes {wanted} values here, not {len(values)}.")
        span = _numbers(where, "span", given.get("span"))
        if len(span) != 2 or not span[0] < span[1]:
            raise BenchError(f"{where}: span must be the lowest and the highest value of the signal, ascending.")
        return cls(axis, tuple(names), shape, values, knots, (span[0], span[1]))


def _numbers(where: str, key: str, given: Any) -> tuple[float, ...]:
    if not isinstance(given, list) or not all(map(finite, given)):
        raise BenchError(f"{where}: {key} must be a list of finite numbers, not {given!r}.")
    return tuple(map(float, given))
