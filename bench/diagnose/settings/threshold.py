"""A threshold: a field with its unit, its meaning, and what its value rests on."""

from dataclasses import field
from enum import StrEnum
from typing import Any


class Basis(StrEnum):
    """What the value of a threshold rests on."""

    CONVENTION = "a convention, such as 95 %"
    EFFORT = "computing time against scatter: more of it changes no finding"
    SHOWN = "how much a page or a sentence shows: it changes no finding"
    ROUNDING = "rounding errors, far below what data have"
    MEASURED = "measured; the meaning gives the figure"
    JUDGED = "judged, and kept while `bench score-discovery` finds what it should; no calibration is recorded"


def threshold(value: Any, meaning: str, basis: Basis, unit: str = "1") -> Any:
    """A field of a settings class.

    Args:
        value: its default.
        meaning: what it bounds, and what happens beyond it.
        basis: what ``value`` rests on.
        unit: SI, "count" for numbers of things, "1" for ratios and shares.
    """
    return field(default=value, metadata={"meaning": meaning, "unit": unit, "basis": basis})
