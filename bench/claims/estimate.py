"""What a kind of judgement finds, and the one rule that makes a verdict of it."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

from bench.analysis.stats import ALIKE as ZONE
from bench.claims.evidence import Evidence

REPRODUCED, DIFFERS, ALIKE, OPEN, NOT_RUN = "reproduced", "differs", "alike", "not enough evidence", "not run"
VERDICTS = (REPRODUCED, DIFFERS, ALIKE, OPEN, NOT_RUN)
SETTLED = (REPRODUCED, DIFFERS, ALIKE)
ALPHA = 0.05
"""Chance of a wrong verdict on a claim that is the only one; among many, the share of verdicts that is wrong."""

Limits = Callable[[float, float, float], tuple[float, float]]
"""(α, factor on the seeds, factor on the recordings) → confidence limits at 1 − α."""


def _unknown(alpha: float, seeds: float, recordings: float) -> tuple[float, float]:
    return math.nan, math.nan


@dataclass(frozen=True, eq=False)
class Estimate:
    """One number that a claim speaks of, with its confidence limits (NaN: nothing repeats)."""

    name: str
    value: float
    limits: Limits = _unknown
    basis: str = ""
    conclusive: bool = True
    """Whether the limits may carry a verdict; one training cannot speak for the next."""
    seeds: int = 0
    """Of the configuration that has fewest; 0: no training is behind it."""
    recordings: int = 0
    """That its limits rest on; 0: none."""

    @property
    def low(self) -> float:
        """Lower limit at 95 %."""
        return self.limits(ALPHA, 1, 1)[0]

    @property
    def high(self) -> float:
        """Upper limit at 95 %."""
        return self.limits(ALPHA, 1, 1)[1]

    def grown(self, seeds: float, recordings: float) -> "Estimate":
        """The same number with so many times the repetition, as it would be if it stayed where it is."""
        return replace(self, limits=lambda alpha, s, r: self.limits(alpha, s * seeds, r * recordings), conclusive=True)


def fact(name: str, value: float) -> Estimate:
    """A number without doubt."""
    return Estimate(name, value, lambda *_: (value, value))


class Kind(ABC):
    """A way to judge. Subclasses are frozen dataclasses; their fields are the keys of ``judge`` in a claim."""

    relative: ClassVar[bool] = True
    """Whether the numbers compare two models, or one in two conditions, by a ratio: a difference may then be too small
    to matter. The shape of one curve is as it is, however slight.
    """

    @abstractmethod
    def measure(self, evidence: Evidence) -> list[Estimate]:
        """Every number that must lie in the claim's acceptance band.

        Empty where the evidence holds nothing of the kind.
        """


@dataclass(frozen=True)
class ByQuantity(Kind):
    """A kind that looks at every quantity and every prediction length by itself."""

    quantities: tuple[str, ...]
    horizons: tuple[int, ...]

    def measure(self, evidence: Evidence) -> list[Estimate]:
        """What `compare` finds for each, quantity by quantity."""
        return [
            e for role in self.quantities for horizon in self.horizons for e in self.compare(evidence, role, horizon)
        ]

    @abstractmethod
    def compare(self, evidence: Evidence, role: str, horizon: int) -> list[Estimate]:
        """The numbers of one quantity, as a claim calls it, and one horizon."""


@dataclass(frozen=True)
class Judgement:
    """A verdict with the number that decided it."""

    verdict: str
    value: float = math.nan
    low: float = math.nan
    """Confidence limits at 95 %, whatever confidence the verdict took."""
    high: float = math.nan
    basis: str = ""
    slight: bool = False
    """A direction is settled, but the whole interval lies within `ZONE`: by less than what matters."""

    @property
    def label(self) -> str:
        """The verdict, and whether it is slight."""
        return f"{self.verdict}, by less than a quarter" if self.slight else self.verdict


def directional(accept: tuple[float, float]) -> bool:
    """Whether a band of a ratio says which of two is larger, and nothing else."""
    return accept in ((0.0, 1.0), (1.0, math.inf))


def settle(
    found: Sequence[Estimate], accept: tuple[float, float], alpha: float = ALPHA, relative: bool = False
) -> Judgement:
    """Reproduced: all intervals lie within the band. Differs: one lies wholly outside. Alike: see below. Else open.

    Where several numbers must hold, "differs" could come from any of them, so that it takes intervals at ``alpha``
    divided by their count; "reproduced" takes all of them at ``alpha`` (intersection-union).

    A claim that a ratio is below (above) 1 is also settled where the difference, of whichever sign, is smaller than
    what matters: "alike" takes one interval at ``alpha`` over the count within `ZONE`, and each of the others at
    ``alpha`` within the band or the zone. A band that is itself one of equivalence has no such verdict.
    """
    verdict, e = decide(found, accept, alpha, relative)
    if e is None:
        return Judgement(verdict)
    basis = "; ".join(map(_said, found[:6])) + (f"; and {len(found) - 6} more" if len(found) > 6 else "")
    basis += f". Basis: {e.basis}." if e.basis else "."
    one_way = relative and directional(accept) and verdict in (REPRODUCED, DIFFERS)
    low, high = e.limits(ALPHA, 1, 1)
    return Judgement(verdict, e.value, low, high, basis, one_way and _within((low, high), ZONE))


def decide(
    found: Sequence[Estimate], accept: tuple[float, float], alpha: float, relative: bool
) -> tuple[str, Estimate | None]:
    """The verdict of `settle` and the number that decides it; none without any."""
    if not found:
        return NOT_RUN, None
    at = [e.limits(alpha, 1, 1) if e.conclusive else (math.nan, math.nan) for e in found]
    if all(_within(limits, accept) for limits in at):
        return REPRODUCED, min(found, key=lambda e: min(e.low - accept[0], accept[1] - e.high))
    strict = [e.limits(alpha / len(found), 1, 1) if e.conclusive else (math.nan, math.nan) for e in found]
    for e, (low, high) in zip(found, strict, strict=True):
        if high < accept[0] or low > accept[1]:
            return DIFFERS, e
    undecided = [i for i, limits in enumerate(at) if not _within(limits, accept)]
    if relative and directional(accept):
        either = min(accept[0], ZONE[0]), max(accept[1], ZONE[1])
        alike = [i for i in undecided if _within(strict[i], ZONE)]
        if alike and all(_within(limits, either) for limits in at):
            return ALIKE, found[alike[0]]
    return OPEN, found[undecided[0]]


def _within(limits: tuple[float, float], band: tuple[float, float]) -> bool:
    return band[0] <= limits[0] and limits[1] <= band[1]


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
