"""Hidden polynomial terms of the undriven systems: one effect a monomial and equation, up to degree 3.

Such as `van_der_pol.dy.y3`: the term c y³ in dy/dt. What a mechanical effect says already is left out (of the pendulum
the constant, `offset_force`, and the one linear in the rate, `viscous_friction`).
"""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor

from registry.core import EFFECTS
from registry.dynamics import RateEffect, constant, tensor

DEGREE = 3


class Monomial(RateEffect):
    """Adds c · Π x_i^e_i to one component of dx/dt."""

    c: Any
    exponents: ClassVar[tuple[int, ...]]
    component: ClassVar[int]
    manoeuvre: ClassVar[str] = "start from many different states, near and far"

    def rate(self, model: Any, state: Tensor, inputs: Tensor) -> Tensor:
        """What the term adds to dx/dt (…, s); see `RateEffect.rate`."""
        value = tensor(self.c, state)
        for x, e in zip(state.unbind(-1), self.exponents, strict=True):
            value = value * x**e
        added = torch.zeros_like(state)
        added[..., self.component] = value
        return added


def monomials(names: Sequence[str]) -> Iterator[tuple[str, tuple[int, ...]]]:
    """Every monomial of the variables up to the degree: its name, such as "x2y" (the constant: "1"), and exponents."""
    for exponents in itertools.product(range(DEGREE + 1), repeat=len(names)):
        if sum(exponents) <= DEGREE:
            parts = (n + (str(e) if e > 1 else "") for n, e in zip(names, exponents, strict=True) if e)
            yield "".join(parts) or "1", exponents


def _register(
    system: str, names: tuple[str, ...], equation: int, term: str, exponents: tuple[int, ...], unit: str
) -> None:
    """Make and file the class of one term."""

    @dataclass(frozen=True)
    class Term(Monomial):
        c: Any = constant(0.0, "coefficient of the term", unit, low=-100, high=100, typical=0.01)

    shown = " ".join(n + ("", "", "²", "³")[e] for n, e in zip(names, exponents, strict=True) if e)
    Term.__name__ = Term.__qualname__ = f"{system}_d{names[equation]}_{term}"
    Term.__doc__ = f"A term c {shown}".rstrip() + f" in d{names[equation]}/dt."
    Term.equation = f"d{names[equation]}/dt = … + c {shown}".rstrip()
    Term.systems, Term.exponents, Term.component = (system,), exponents, equation
    Term.needs = ("angle", "angle_rate") if system == "pendulum" else (system,)
    globals()[Term.__name__] = EFFECTS.register(f"{system}.d{names[equation]}.{term}")(Term)


for _system, _names in (("van_der_pol", ("x", "y")), ("lorenz", ("x", "y", "z"))):
    for _equation in range(len(_names)):
        for _term, _exponents in monomials(_names):
            _register(_system, _names, _equation, _term, _exponents, "1/s")
for _term, _exponents in monomials(("theta", "omega")):
    if _exponents not in ((0, 0), (0, 1)):
        _unit = ("1/s^2", "1/s", "1", "s")[_exponents[1]]  # radians count as 1
        _register("pendulum", ("theta", "omega"), 1, _term, _exponents, _unit)
