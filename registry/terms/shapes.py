"""The shapes that a learned term can have: a spline, and short formulas in one signal.

A formula is linear in its parameters but for a last one in some, which is a width or a wave number of the signal.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from registry.terms.spline import through

Span = tuple[float, float]
"""Between which values of the signal a term was learned."""
SHARP = 0.01
"""Width of a smoothed sign, relative to the largest magnitude of the span."""


@dataclass(frozen=True)
class Shape:
    """A formula f(x)."""

    name: str
    """As in a file."""
    said: str
    """In words."""
    text: str
    """With x for the signal and the names of the parameters."""
    parameters: tuple[tuple[str, float], ...]
    """Names, and the power of the signal's unit by which that of the result is divided."""
    formula: Callable[[Sequence[Tensor], Tensor, Span], Tensor]
    bent: int | None = None
    """Power of the signal's unit that the last parameter has where f is not linear in it; None: it is in all."""
    positive: bool = False
    """Whether it exists for positive signals only."""

    @property
    def linear(self) -> int:
        """Number of parameters that f is linear in; they come first."""
        return len(self.parameters) - (self.bent is not None)

    @property
    def length(self) -> int:
        """What a shape costs a reader: its parameters, and one that bends it twice."""
        return 2 * len(self.parameters) + 2 * (self.bent is not None) + (self.name not in ("constant", "linear"))


def _at_least(x: Tensor, span: Span) -> Tensor:
    """x, kept away from zero by half of the smallest value met."""
    return x.clamp(min=max(span[0], 1e-9 * max(map(abs, span))) / 2)


def _sign(x: Tensor, span: Span) -> Tensor:
    return torch.tanh(x / (SHARP * max(map(abs, span))))


def _root(x: Tensor, span: Span) -> Tensor:
    """√|x| with the sign of x, straight through zero, where a root has no slope."""
    return x / (x * x + (SHARP * max(map(abs, span))) ** 2) ** 0.25


def _within(x: Tensor, width: Tensor) -> Tensor:
    return torch.minimum(torch.maximum(x, -width.abs()), width.abs())


SHAPES: dict[str, Shape] = {
    s.name: s
    for s in (
        Shape("constant", "constant", "c", (("c", 0),), lambda p, x, s: p[0] + torch.zeros_like(x)),
        Shape("linear", "linear", "k x", (("k", 1),), lambda p, x, s: p[0] * x),
        Shape("square", "square", "k x²", (("k", 2),), lambda p, x, s: p[0] * x * x),
        Shape("signed_square", "signed square", "k |x| x", (("k", 2),), lambda p, x, s: p[0] * x.abs() * x),
        Shape("root", "root", "k √x", (("k", 0.5),), lambda p, x, s: p[0] * _root(x, s)),
        Shape("cubic", "cubic", "k x³", (("k", 3),), lambda p, x, s: p[0] * x**3),
        Shape("sign", "sign", "c sign x", (("c", 0),), lambda p, x, s: p[0] * _sign(x, s)),
        Shape("inverse", "inverse", "k / x", (("k", -1),), lambda p, x, s: p[0] / _at_least(x, s), positive=True),
        Shape(
            "inverse_square",
            "inverse square",
            "k / x²",
            (("k", -2),),
            lambda p, x, s: p[0] / _at_least(x, s) ** 2,
            positive=True,
        ),
        Shape("affine", "straight line", "k x + c", (("k", 1), ("c", 0)), lambda p, x, s: p[0] * x + p[1]),
        Shape(
            "linear_square",
            "linear and square",
            "k x + q x²",
            (("k", 1), ("q", 2)),
            lambda p, x, s: p[0] * x + p[1] * x * x,
        ),
        Shape(
            "linear_signed_square",
            "linear and signed square",
            "k x + q |x| x",
            (("k", 1), ("q", 2)),
            lambda p, x, s: p[0] * x + p[1] * x.abs() * x,
        ),
        Shape(
            "sides",
            "linear on each side of zero",
            "k x above 0, q x below",
            (("k", 1), ("q", 1)),
            lambda p, x, s: p[0] * x.clamp(min=0) + p[1] * x.clamp(max=0),
        ),
        Shape(
            "square_sides",
            "square on each side of zero",
            "k x² above 0, q x² below",
            (("k", 2), ("q", 2)),
            lambda p, x, s: p[0] * x.clamp(min=0) ** 2 + p[1] * x.clamp(max=0) ** 2,
        ),
        Shape(
            "linear_cubic",
            "linear and cubic",
            "k x + q x³",
            (("k", 1), ("q", 3)),
            lambda p, x, s: p[0] * x + p[1] * x**3,
        ),
        Shape(
            "sign_linear",
            "sign and linear",
            "k x + c sign x",
            (("k", 1), ("c", 0)),
            lambda p, x, s: p[0] * x + p[1] * _sign(x, s),
        ),
        Shape(
            "saturation",
            "saturation",
            "k x, held beyond ±w",
            (("k", 1), ("w", 0)),
            lambda p, x, s: p[0] * _within(x, p[1]),
            bent=1,
        ),
        Shape(
            "dead_zone",
            "dead zone",
            "k (x ∓ w) beyond ±w",
            (("k", 1), ("w", 0)),
            lambda p, x, s: p[0] * (x - _within(x, p[1])),
            bent=1,
        ),
        Shape(
            "above",
            "one-sided, above",
            "k (x − w) above w",
            (("k", 1), ("w", 0)),
            lambda p, x, s: p[0] * (x - p[1]).clamp(min=0),
            bent=1,
        ),
        Shape(
            "below",
            "one-sided, below",
            "k (w − x) below w",
            (("k", 1), ("w", 0)),
            lambda p, x, s: p[0] * (p[1] - x).clamp(min=0),
            bent=1,
        ),
        Shape(
            "exponential",
            "exponential",
            "k exp(−n x)",
            (("k", 0), ("n", 0)),
            lambda p, x, s: p[0] * torch.exp((-p[1] * x).clamp(max=50.0)),
            bent=-1,
        ),
        Shape(
            "parabola",
            "parabola",
            "c + k x + q x²",
            (("c", 0), ("k", 1), ("q", 2)),
            lambda p, x, s: p[0] + p[1] * x + p[2] * x * x,
        ),
        Shape(
            "sine",
            "sine",
            "a sin n x",
            (("a", 0), ("n", 0)),
            lambda p, x, s: p[0] * torch.sin(p[1] * x),
            bent=-1,
        ),
        Shape(
            "wave",
            "wave",
            "a sin n x + b cos n x",
            (("a", 0), ("b", 0), ("n", 0)),
            lambda p, x, s: p[0] * torch.sin(p[2] * x) + p[1] * torch.cos(p[2] * x),
            bent=-1,
        ),
    )
}
SPLINE = "spline"
"""The shape that is no formula: its parameters are its values at the knots."""


def value(shape: str, knots: tuple[float, ...], span: Span, parameters: Tensor, x: Tensor) -> Tensor:
    """f(x) (…) of a shape.

    Args:
        shape: one of `SHAPES`, or `SPLINE`.
        knots: of a spline.
        span: between which values of the signal it was learned.
        parameters: (…, P).
        x: (…) the signal.
    """
    if shape == SPLINE:
        return through(knots, parameters, x)
    return SHAPES[shape].formula(parameters.unbind(-1), x, span)
