"""Hidden polynomial terms of the undriven systems: one effect a monomial and equation, up to degree 3.

Such as `van_der_pol.dy.y3`: the term c y³ in dy/dt.
"""

from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor

from registry.core import EFFECTS
from registry.dynamics import RateEffect, constant, tensor
from registry.polynomial_terms import TermName, terms

OUTLINE = "registry.polynomial_terms:outline"


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


def _register(named: TermName) -> None:
    """Make and file the class of one term."""

    @dataclass(frozen=True)
    class Term(Monomial):
        c: Any = constant(0.0, "coefficient of the term", named.unit, low=-100, high=100, typical=0.01)

    system, variable = named.system, named.variables[named.equation]
    Term.__name__ = Term.__qualname__ = f"{system}_d{variable}_{named.term}"
    Term.__doc__ = named.about
    Term.equation = f"d{variable}/dt = … + c {named.shown}".rstrip()
    Term.systems, Term.exponents, Term.component = (system,), named.exponents, named.equation
    Term.needs = ("angle", "angle_rate") if system == "pendulum" else (system,)
    globals()[Term.__name__] = EFFECTS.register(named.name)(Term)


for _named in terms():
    _register(_named)
