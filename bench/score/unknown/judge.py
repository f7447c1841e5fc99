"""What is right about one answer to a case of the unknown."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.score.judge import ERROR, Judged
from bench.score.unknown.condition import EMPTY, STATIC, SWINGS, UnknownCase
from bench.score.unknown.terms import Term

LEFT, MOST = 0.10, 0.30
"""Of the error above the floor, that may be left in the median and in nine cases of ten."""
NEAR = 1.05
"""Times the floor, within which what is left is worth no verdict."""
OFF = 0.03
"""Relative, by which a frequency may be wrong."""
ROUNDING = 1e-6
"""Relative difference of two errors that is none."""


@dataclass(frozen=True)
class JudgedUnknown(Judged):
    """A case of the unknown, and what was said of it (`attempt.attempt`)."""

    @property
    def asked_case(self) -> UnknownCase:
        """The case, of its own kind."""
        assert isinstance(self.case, UnknownCase)
        return self.case

    @property
    def learned(self) -> list[dict[str, Any]]:
        """Terms that were learned."""
        return list(self.said.get("extra", {}).get("terms", ()))

    @property
    def hidden(self) -> bool:
        """Whether something is hidden."""
        return self.case.condition not in EMPTY

    @property
    def static(self) -> bool:
        """Whether it is a function of measured signals."""
        return self.case.condition in STATIC

    @property
    def swings(self) -> bool:
        """Whether it has a frequency of its own."""
        return self.case.condition in SWINGS

    @property
    def worse(self) -> bool:
        """Whether the answer's model forecasts held-out recordings worse than the nominal and calibrated ones."""
        if self.verdict == "data_problem":
            return False
        error = self.said["error"]
        last, before, floor = (self.pooled(error.get(k, {}), error) for k in ("extended", "calibrated", "floor"))
        return not last <= max(min(before, 1.0), floor) + ROUNDING

    def matching(self, term: Term) -> dict[str, Any] | None:
        """What was learned along the axis and of the signals of a hidden term; a product's order does not matter."""
        axes = (term.axis, *term.instead)
        return next((t for t in self.learned if t["axis"] in axes and set(t["signals"]) == set(term.signals)), None)

    @property
    def place(self) -> bool:
        """Whether all axes and signals are right, and nothing else is said."""
        truth = self.asked_case.truth
        wanted = [self.matching(t) for t in truth]
        known = {t.axis for t in truth} | {a for t in truth for a in t.alike}
        alike = {a for t in truth for a in t.alike}
        beside = [t for t in self.learned if not any(t is w for w in wanted)]
        stray = [t for t in beside if t["axis"] not in alike]
        return bool(truth) and all(w is not None for w in wanted) and not stray and not self.named and bool(known)

    @property
    def form(self) -> bool:
        """Whether every hidden term is said by its true form."""
        found = [(self.matching(t), t) for t in self.asked_case.truth]
        return bool(found) and all(w is not None and w["shape"] in t.forms for w, t in found)

    @property
    def band(self) -> tuple[int, int]:
        """Points of true curves inside the 95 % bands, and all points, of terms along the right axis and signals."""
        inside = total = 0
        for term in self.asked_case.truth:
            said = self.matching(term)
            if said is None or said["curve"] is None:
                continue
            if said["axis"] != term.axis:
                continue  # in another unit, by an inertia that the pendulum changes
            curve = said["curve"]
            x, low, high = (np.array(curve[k]) for k in ("x", "low", "high"))
            order = list(said["signals"])
            if order[0] != term.signals[0] and term.form != "linear":
                continue  # the other factor's function is another one
            y = term.curve(x)
            inside += int(((low <= y) & (y <= high)).sum())
            total += len(x)
        return inside, total

    @property
    def called(self) -> bool:
        """Whether something is said to swing."""
        return any(t["swings"] for t in self.learned)

    @property
    def frequency(self) -> float:
        """Relative error of the nearest frequency said; NaN: none was."""
        said = [float(t["frequency"]) for t in self.learned if t["frequency"] is not None]
        true = self.asked_case.frequencies
        return min((abs(s / f - 1) for s in said for f in true), default=math.nan)

    @property
    def above_floor(self) -> float:
        """Largest error of the last model over the floor, over all groups of outputs."""
        error = self.said["error"]
        last, floor = error.get("extended", {}), error.get("floor", {})
        return max((last[g] / max(floor[g], 1e-300) for g in floor), default=math.inf)

    @property
    def right(self) -> bool:
        """Whether the answer as a whole is the one that counts."""
        kind = self.case.condition
        if self.verdict == ERROR:
            return False
        if not self.hidden:  # what calibration alone makes of gusts is no answer
            return self.verdict in self.case.verdicts and not self.learned
        if self.worse:
            return False
        if kind == "twisted":
            return self.verdict in ("unknown_effect", "data_problem")
        if self.swings:
            return self.called and self.frequency <= OFF
        return self.place and self.form and self.remaining <= MOST

    @property
    def answer_line(self) -> str:
        """The answer in one line."""
        left = self.remaining
        words = [
            super().answer_line,
            *(f"{t['axis']} ~ {' * '.join(t['signals']) or '1'}: {t['shape']}" + self._often(t) for t in self.learned),
        ]
        return "; ".join(words) + ("" if math.isinf(left) or not self.hidden else f" ({100 * left:.0f} % left)")

    @staticmethod
    def _often(term: dict[str, Any]) -> str:
        return "" if term["frequency"] is None else f" at {term['frequency']:.4g} Hz"

    @property
    def truth_line(self) -> str:
        """The truth in one line."""
        case = self.asked_case
        if not self.hidden:
            return "nothing"
        if case.condition == "twisted":
            return f"sensors turned by {np.degrees(case.twist):.1f} deg"
        if self.swings:
            return f"{case.condition} at {' or '.join(f'{f:.4g}' for f in case.frequencies)} Hz"
        return "; ".join(f"{t.axis} ~ {' * '.join(t.signals)}: {t.form}" for t in case.truth)
