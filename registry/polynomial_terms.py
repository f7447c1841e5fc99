"""Names of the hidden polynomial terms of the undriven systems: one a monomial and equation, up to degree 3."""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

DEGREE = 3


@dataclass(frozen=True)
class TermName:
    """The term c Π x_i^e_i of one equation of a system."""

    system: str
    variables: tuple[str, ...]
    equation: int
    """Which variable's derivative it is in."""
    term: str
    """Such as "x2y"; the constant: "1"."""
    exponents: tuple[int, ...]
    unit: str
    """Of its coefficient."""

    @property
    def name(self) -> str:
        """As it is registered, such as "van_der_pol.dy.x2y"."""
        return f"{self.system}.d{self.variables[self.equation]}.{self.term}"

    @property
    def shown(self) -> str:
        """As a formula, without the coefficient; the constant: empty."""
        pairs = zip(self.variables, self.exponents, strict=True)
        return " ".join(n + ("", "", "²", "³")[e] for n, e in pairs if e)

    @property
    def about(self) -> str:
        """One line."""
        return f"A term c {self.shown}".rstrip() + f" in d{self.variables[self.equation]}/dt."


def monomials(names: Sequence[str]) -> Iterator[tuple[str, tuple[int, ...]]]:
    """Every monomial of the variables up to the degree: its name, such as "x2y" (the constant: "1"), and exponents."""
    for exponents in itertools.product(range(DEGREE + 1), repeat=len(names)):
        if sum(exponents) <= DEGREE:
            parts = (n + (str(e) if e > 1 else "") for n, e in zip(names, exponents, strict=True) if e)
            yield "".join(parts) or "1", exponents


def terms() -> Iterator[TermName]:
    """All of them. What a mechanical effect says already is left out.

    Of the pendulum that is the constant, `offset_force`, and the one linear in the rate, `viscous_friction`.
    """
    for system, names in (("van_der_pol", ("x", "y")), ("lorenz", ("x", "y", "z"))):
        for equation in range(len(names)):
            for term, exponents in monomials(names):
                yield TermName(system, names, equation, term, exponents, "1/s")
    for term, exponents in monomials(("theta", "omega")):
        if exponents not in ((0, 0), (0, 1)):
            unit = ("1/s^2", "1/s", "1", "s")[exponents[1]]  # radians count as 1
            yield TermName("pendulum", ("theta", "omega"), 1, term, exponents, unit)


def outline() -> dict[str, str]:
    """Name → one line, of every term."""
    return {t.name: t.about for t in terms()}
