"""Numbers with units, names and data problems as they are shown. Plain text, not escaped."""

import math
import re
from collections.abc import Iterable, Sequence

from bench.diagnose.result import DataProblem, NamedEffect, ParameterEstimate
from registry.core import EFFECTS
from registry.units import display

_MILLI = {"m": "mm", "s": "ms", "V": "mV", "N": "mN", "N m": "mN m", "kg": "g"}
_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
NOTHING = "–"


def shown(si_unit: str, signal: str = "", values: Iterable[float] = ()) -> tuple[str, float]:
    """The unit in which a signal is shown and the factor from SI: degrees, and milli- where all values are small."""
    unit, factor = display(si_unit, signal)
    largest = max((abs(v) for v in values if math.isfinite(v)), default=math.inf)
    if unit in _MILLI and largest < 0.1:
        unit, factor = _MILLI[unit], 1e3 * factor
    return _in_brackets(unit.replace("^2", "²").replace("^3", "³")), factor


def _in_brackets(unit: str) -> str:
    """With what it is divided by in brackets, where that is several units."""
    above, slash, below = unit.partition("/")
    below = below.strip().removeprefix("(").removesuffix(")")
    return f"{above.rstrip()}/({below})" if slash and " " in below else unit


def united(value: str, unit: str) -> str:
    """A shown value and its unit; "1" is none."""
    return value if unit == "1" else f"{value} {unit}"


_CALLED = {"bouc wen": "Bouc-Wen hysteresis"}
_PEOPLE = re.compile(r"\b(?:bouc wen|coulomb|munk|stribeck)\b")
"""Whom effects are called after."""


def named(identifier: str) -> str:
    """ "rotor_drag", "munk_moment", "body_rates.p", "angle.a-angle.b" and "inertia[2]" (about z) as words."""
    apart = re.sub(
        r"(\.\w+)([+-])(?=\w+\.\w)", lambda found: f"{found[1]} {'+' if found[2] == '+' else '−'} ", identifier
    )
    about = re.sub(r"\binertia\[([012])\]", lambda found: f"inertia about {'xyz'[int(found[1])]}", apart)
    said = about.replace("_", " ").replace(".", " ")
    return _PEOPLE.sub(lambda found: _CALLED.get(found[0]) or found[0].capitalize(), said)


def number(value: float, digits: int = 3) -> str:
    """A value to so many significant digits, with a power of ten where it is very small or large."""
    if not math.isfinite(value):
        return NOTHING
    rounded = float(f"{value:.{digits - 1}e}")
    exponent = math.floor(math.log10(abs(rounded))) if rounded else 0
    if -4 < exponent < 5:
        return f"{rounded:.{max(0, digits - 1 - exponent)}f}".replace("-", "−")
    return f"{rounded / 10.0**exponent:.{digits - 1}f}×10{str(exponent).translate(_SUPERSCRIPT)}".replace("-", "−")


def lasting(seconds: float) -> str:
    """A time as one would say it: "0.5 s"; of slow systems "10 h" and "3 days"."""
    for unit, long in (("days", 86400), ("h", 3600)):
        if seconds >= 2 * long:
            return f"{seconds / long:.4g} {unit}"
    return f"{seconds:.4g} s"


def percent(share: float) -> str:
    """A share in whole per cent."""
    if not math.isfinite(share):
        return NOTHING
    if 0 < share < 0.01:
        return "< 1 %"
    if -0.01 < share < 0:
        return f"−{-100 * share:.1g} %" if share < -1e-4 else "0 %"
    return f"{100 * share:.0f} %".replace("-", "−")


def changed(by: float) -> str:
    """A relative change in per cent, with its sign: "+0.4 %", "−12 %"."""
    if not math.isfinite(by):
        return NOTHING
    size = 100 * abs(by)
    digits = number(size, 1 if size < 1 else 2) if size < 100 else f"{size:.0f}"
    return "0 %" if size < 1e-3 else f"{'+' if by > 0 else '−'}{digits} %"


def estimate(name: str, p: ParameterEstimate) -> str:
    """Such as "0.120 kg/s (0.110 to 0.130)": with as many digits as the interval warrants."""
    value, low, high, unit = estimate_parts(name, p)
    return united(value, unit) + (f" ({low} to {high})" if low != NOTHING else "")


def estimate_parts(name: str, p: ParameterEstimate) -> tuple[str, str, str, str]:
    """Value, low, high and unit as they are shown."""
    finite = [v for v in (p.value, p.low, p.high) if math.isfinite(v)]
    unit, factor = shown(p.unit, name, finite)
    digits = digits_of(*(v * factor for v in (p.value, p.low, p.high)))
    return number(p.value * factor, digits), number(p.low * factor, digits), number(p.high * factor, digits), unit


def digits_of(value: float, low: float, high: float) -> int:
    """As many significant digits as an interval warrants: two of half of it at the most, one at the least."""
    half, largest = (high - low) / 2, max((abs(v) for v in (value, low, high) if math.isfinite(v)), default=0.0)
    if not (math.isfinite(half) and half > 0 and largest > 0):
        return 3
    return min(6, max(2, math.floor(math.log10(largest)) - math.floor(math.log10(half) + 0.02) + 2))


def typeset(text: str) -> str:
    """Numbers and units as they are printed: "2.8e-08 kg m^2" becomes "2.8×10⁻⁸ kg m²", "0.15 1" has no unit."""
    text = re.sub(
        r"(\d)e([+-]?)0*(\d+)\b", lambda m: f"{m[1]}×10{(m[2].strip('+') + m[3]).translate(_SUPERSCRIPT)}", text
    )
    text = re.sub(r"\^(-?\d+)(?![\d.])", lambda m: m[1].translate(_SUPERSCRIPT), text)
    return re.sub(r"(?<=[=,] )-(?=\d)", "−", re.sub(r"(?<=\d) 1(?=[,;]|$)", "", text))


def about(effect: str) -> tuple[str, str]:
    """What an effect is, in a line, and its equation; empty for one that is not registered here."""
    if effect not in EFFECTS.names():
        return "", ""
    return EFFECTS.summary(effect), EFFECTS.get(effect).equation


def listed(items: Iterable[str], last: str = "and") -> str:
    """ "a, b and c"."""
    *head, tail = list(items) or [""]
    return f"{', '.join(head)} {last} {tail}" if head else tail


def rows(problem: DataProblem) -> str:
    """Where a data problem is, in samples from 0."""
    if problem.rows is None:
        return "all samples"
    first, end = problem.rows
    return f"sample {first}" if first == end else f"samples {first} to {end}"


def gathered(problems: Sequence[DataProblem]) -> list[str]:
    """A line for every kind of problem of a signal: which recordings have it, and what it is in the first of them."""
    alike: dict[tuple[str, str], list[DataProblem]] = {}
    for p in problems:
        alike.setdefault((p.signal, p.kind), []).append(p)
    out = []
    for (signal, kind), found in alike.items():
        names, first = list(dict.fromkeys(p.recording for p in found)), found[0]
        more = [f"{len(names) - 2} more"] if len(names) > 3 else []
        where = listed([*(names[:2] if more else names), *more])
        again = f", {len(found)} times" if len(found) > len(names) else ""
        at = f", {rows(first)}" if len(found) == 1 else ""
        detail = first.detail if len({p.detail for p in found}) == 1 else f"in {first.recording}: {first.detail}"
        out.append(f"{where}, {named(signal)}{at}: {kind}{again}; {detail}")
    return out


def parameters(effect: NamedEffect) -> str:
    """All parameters of an effect in a line, and what they say only together."""
    each = ", ".join(f"{name} = {estimate(name, p)}" for name, p in effect.parameters.items())
    said = together(effect)
    return f"{each}; {said}" if said else each


def together(effect: NamedEffect) -> str:
    """What an effect's parameters say only together; see `Effect.together`."""
    if effect.id not in EFFECTS.names() or not effect.parameters:
        return ""
    said: str = EFFECTS.get(effect.id).together({name: p.value for name, p in effect.parameters.items()})
    return said
