"""What a kind of judgement finds, and the one rule that makes a verdict of it."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from bench.claims.evidence import Evidence

REPRODUCED, DIFFERS, OPEN, NOT_RUN = "reproduced", "differs", "not enough evidence", "not run"
VERDICTS = (REPRODUCED, DIFFERS, OPEN, NOT_RUN)
ALPHA = 0.05
"""Chance of a wrong verdict on one claim, where it is the only one."""


@dataclass(frozen=True)
class Estimate:
    """One number that a claim speaks of, with its confidence limits (NaN: nothing repeats)."""

    name: str
    value: float
    low: float = math.nan
    high: float = math.nan
    basis: str = ""
    speaks: bool = True
    """Whether the limits may carry a verdict; one training cannot speak for the next."""


class Kind(ABC):
    """A way to judge. Subclasses are frozen dataclasses; their fields are the keys of ``judge`` in a claim."""

    @abstractmethod
    def measure(self, evidence: Evidence, alpha: float) -> list[Estimate]:
        """Every number that must lie in the claim's acceptance band, at confidence 1 − ``alpha``.

        Empty where the evidence holds nothing of the kind.
        """


@dataclass(frozen=True)
class Judgement:
    """A verdict with the number that decided it."""

    verdict: str
    value: float = math.nan
    low: float = math.nan
    high: float = math.nan
    basis: str = ""


def settle(measure: Callable[[float], Sequence[Estimate]], accept: tuple[float, float], alpha: float) -> Judgement:
    """Reproduced: all intervals lie within the band. Differs: one lies wholly outside. Else the evidence is too thin.

    Where several numbers must hold, "differs" could come from any of them, so that it takes intervals at ``alpha``
    divided by their count; "reproduced" takes all of them at ``alpha`` (intersection-union).
    """
    found = measure(alpha)
    if not found:
        return Judgement(NOT_RUN)
    basis = "; ".join(map(_said, found[:6])) + (f"; and {len(found) - 6} more" if len(found) > 6 else "")
    basis += f". Basis: {found[0].basis}." if found[0].basis else "."
    if all(_within(e, accept) for e in found):
        tightest = min(found, key=lambda e: min(e.low - accept[0], accept[1] - e.high))
        return Judgement(REPRODUCED, tightest.value, tightest.low, tightest.high, basis)
    strict = measure(alpha / len(found)) if len(found) > 1 else found
    outside = [e for e, strictly in zip(found, strict, strict=True) if _outside(strictly, accept)]
    if outside:
        return Judgement(DIFFERS, outside[0].value, outside[0].low, outside[0].high, basis)
    undecided = next(e for e in found if not _within(e, accept))
    return Judgement(OPEN, undecided.value, undecided.low, undecided.high, basis)


def _within(e: Estimate, accept: tuple[float, float]) -> bool:
    return e.speaks and accept[0] <= e.low and e.high <= accept[1]


def _outside(e: Estimate, accept: tuple[float, float]) -> bool:
    return e.speaks and (e.high < accept[0] or e.low > accept[1])


def number(value: float) -> str:
    """A whole number as it is, else three significant digits; never an exponent."""
    if not math.isfinite(value):
        return "–" if math.isnan(value) else "∞"
    if value == round(value):
        return f"{value:,.0f}"
    digits = max(0, 2 - math.floor(math.log10(abs(value))))
    return f"{value:,.{digits}f}"


def _said(e: Estimate) -> str:
    interval = "" if math.isnan(e.low) or e.low == e.high else f" ({number(e.low)} to {number(e.high)})"
    return f"{e.name} {number(e.value)}{interval}"
