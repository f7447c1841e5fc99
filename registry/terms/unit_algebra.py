"""Products of units, so that a parameter of a formula has the unit that the formula gives it."""

import re

from registry.errors import BenchError
from registry.units import bare, exponents, powers_of

_PLAIN = re.compile(r"(1|[^\W\d]+(\^\d)?)([ /][^\W\d]+(\^\d)?)*")
"""A product of powers, of whatever symbols."""


def product(*factors: tuple[str, float]) -> str:
    """The product of units to powers, such as "N s^2/m^2" of ("N", 1) and ("m/s", −2).

    Symbols that are not of SI stand for themselves; a unit that is no product of powers is only written beside others.
    """
    powers: dict[str, float] = {}
    for unit, power in factors:
        try:
            parts = exponents(unit)
        except BenchError:
            parts = powers_of(unit) if _PLAIN.fullmatch(bare(unit)) else {unit.replace("/", " per "): 1}
        for symbol, times in parts.items():
            powers[symbol] = powers.get(symbol, 0) + times * power
    above, below = ([_power(s, p * side) for s, p in powers.items() if p * side > 0] for side in (1, -1))
    under = f"({' '.join(below)})" if len(below) > 1 else "".join(below)
    over = " ".join(above) or "1"
    return f"{over}/{under}" if under else over


def _power(symbol: str, power: float) -> str:
    return symbol if power == 1 else f"√{symbol}" if power == 0.5 else f"{symbol}^{power:g}"
