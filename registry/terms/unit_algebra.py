"""Products of units, so that a parameter of a formula has the unit that the formula gives it."""

from registry.errors import BenchError
from registry.units import exponents


def product(*factors: tuple[str, float]) -> str:
    """The product of units to powers, such as "N s^2/m^2" of ("N", 1) and ("m/s", −2).

    Units that are not of SI are only written side by side.
    """
    powers: dict[str, float] = {}
    for unit, power in factors:
        try:
            parts = exponents(unit)
        except BenchError:
            parts = {unit.replace("/", " per "): 1}
        for symbol, times in parts.items():
            powers[symbol] = powers.get(symbol, 0) + times * power
    above, below = (" ".join(_power(s, p * side) for s, p in powers.items() if p * side > 0) for side in (1, -1))
    return f"{above or '1'}/{below}" if below else above or "1"


def _power(symbol: str, power: float) -> str:
    return symbol if power == 1 else f"√{symbol}" if power == 0.5 else f"{symbol}^{power:g}"
