"""Kinds of judgement that rest on ratios of errors."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from itertools import combinations

import numpy as np
import pandas as pd
from typing_extensions import override

from bench.claims.estimate import ByQuantity, Estimate, Kind
from bench.claims.evidence import Evidence
from bench.claims.kinds.tables import (
    Network,
    Rows,
    Stratum,
    errors,
    gathered,
    over,
    pool,
    quotients,
    ratio,
    ratio_of_numbers,
    rows,
    signals,
    strata,
)


def _at(role: str, horizon: int) -> str:
    return f"{role}, T = {horizon}:"


@dataclass(frozen=True)
class Ratio(ByQuantity):
    """Error of a over error of b in a phase of the horizon, all pairs together, one number a quantity and horizon."""

    pairs: tuple[tuple[str, str], ...]
    """Patterns of a and b."""
    phase: str = "whole"

    @override
    def compare(self, evidence: Evidence, role: str, horizon: int) -> list[Estimate]:
        opponents: dict[str, list[str]] = {}
        for a, b in [pair for patterns in self.pairs for pair in evidence.pairs(*patterns)]:
            opponents.setdefault(a, []).append(b)
        of = _response(evidence, role, horizon, self.phase)
        wanted = [s for a, others in opponents.items() for s in strata(of(a), [of(b) for b in others])]
        return ratio(_at(role, horizon), wanted, pool(evidence, of))


def _response(
    evidence: Evidence, role: str, horizon: int, phase: str = "whole", norm: str = "paper"
) -> Callable[[str], Rows]:
    """Configuration → the logarithms of its errors in a phase of the horizon."""
    return cache(lambda spec: rows(errors(evidence, spec, role, horizon, norm), over(phase, horizon)))


@dataclass(frozen=True)
class Alike(ByQuantity):
    """Every two of the configurations against each other."""

    specs: tuple[str, ...]
    phase: str = "whole"

    @override
    def compare(self, evidence: Evidence, role: str, horizon: int) -> list[Estimate]:
        of = _response(evidence, role, horizon, self.phase)
        around = pool(evidence, of)
        return [
            e
            for a, b in combinations(evidence.matching(self.specs), 2)
            for e in ratio(f"{a} / {b}, {_at(role, horizon)}", strata(of(a), [of(b)]), around)
        ]


@dataclass(frozen=True)
class Factor(Kind):
    """Error in one quantity over error in another, of the same networks; ``against`` divides by that of others."""

    specs: tuple[str, ...]
    quantities: tuple[tuple[str, str], ...]
    """(above, below) the line; one number each."""
    horizons: tuple[int, ...]
    phase: str = "whole"
    against: tuple[str, ...] = ()
    """For each of specs the pattern of those whose own factor it is divided by; equal sizes belong together."""

    @override
    def measure(self, evidence: Evidence) -> list[Estimate]:
        found = []
        for above, below in self.quantities:
            for horizon in self.horizons:
                of = self._response(evidence, above, below, horizon)
                wanted: list[Stratum] = []
                if not self.against:
                    wanted = [(row, ()) for spec in evidence.matching(self.specs) for row in of(spec).values()]
                for patterns in zip(self.specs, self.against, strict=bool(self.against)):
                    wanted += [s for a, b in evidence.pairs(*patterns) for s in strata(of(a), [of(b)])]
                found += ratio(f"{above} / {below}, T = {horizon}:", wanted, pool(evidence, of))
        return found

    def _response(self, evidence: Evidence, above: str, below: str, horizon: int) -> Callable[[str], Rows]:
        def of(spec: str) -> Rows:
            top, bottom = (errors(evidence, spec, role, horizon) for role in (above, below))
            return quotients(top, bottom, over(self.phase, horizon))

        return cache(of)


@dataclass(frozen=True)
class FewerWeights(ByQuantity):
    """Error of every a over every b that has more weights than it; the RMSSE of both is said beside."""

    a: str
    b: str

    @override
    def compare(self, evidence: Evidence, role: str, horizon: int) -> list[Estimate]:
        found = []
        of = _response(evidence, role, horizon)
        around = pool(evidence, of)
        for a in evidence.specs(self.a):
            for b in evidence.specs(self.b):
                if evidence.weights(a) < evidence.weights(b):
                    sizes = f"{evidence.weights(a):,} / {evidence.weights(b):,} weights"
                    rmsse = ratio_of_numbers(*_rmsse(evidence, a, b, role, horizon))
                    beside = f", RMSSE {rmsse:.2f}" if rmsse else ""
                    name = f"{a} / {b} ({sizes}{beside}), {_at(role, horizon)}"
                    found += ratio(name, strata(of(a), [of(b)]), around)
        return found


def _rmsse(evidence: Evidence, a: str, b: str, role: str, horizon: int) -> tuple[list[float], list[float]]:
    """RMSSE of the networks of a and of b that have the same seed and outputs."""
    sides = []
    for spec in (a, b):
        found: dict[tuple[str, int], float] = {}
        for run in evidence.of(spec, horizon):
            for signal in signals(role):
                whole = f"rmsse.{signal}"
                names = [whole] if whole in run.metrics else [n for n in run.metrics if n.startswith(f"{whole}.")]
                found |= {(n, run.seed): float(run.metrics[n] or 0) for n in names if run.sound}
        sides.append(found)
    shared = [k for k in sides[0] if k in sides[1]]
    return [sides[0][k] for k in shared], [sides[1][k] for k in shared]


@dataclass(frozen=True)
class Norms(Kind):
    """By how much the ratio of every two configurations changes when errors are measured in another norm."""

    specs: tuple[str, ...]
    quantities: tuple[str, ...]
    horizons: tuple[int, ...]

    @override
    def measure(self, evidence: Evidence) -> list[Estimate]:
        names = list(dict.fromkeys(evidence.matching(self.specs)))
        found, same, turned = [], 0, 0
        for role in self.quantities:
            for horizon in self.horizons:
                paper, other = (_response(evidence, role, horizon, norm=n) for n in ("paper", "euclidean"))
                change = _change(evidence, role, horizon)
                around = {of: pool(evidence, of) for of in (paper, change)}
                for a, b in combinations(names, 2):
                    changed = ratio(
                        f"{a} / {b}, {_at(role, horizon)} euclidean against paper",
                        strata(change(a), [change(b)]),
                        around[change],
                    )
                    clear = ratio("", strata(paper(a), [paper(b)]), around[paper])
                    turns = [e.value for e in ratio("", strata(other(a), [other(b)]))]
                    turns += [r for r in [ratio_of_numbers(*_rmsse(evidence, a, b, role, horizon))] if r]
                    for value in turns:
                        if clear and (clear[0].high < 1 or clear[0].low > 1):
                            same += (value < 1) == (clear[0].value < 1)
                            turned += (value < 1) != (clear[0].value < 1)
                    found += changed
        note = f"{same} of {same + turned} orders that are clear in the paper's norm are the same by Euclid or RMSSE"
        return [replace(e, basis=f"{note}; {e.basis}") for e in found]


def _change(evidence: Evidence, role: str, horizon: int) -> Callable[[str], Rows]:
    """Configuration → the logarithms of its errors by Euclid over those in the paper's norm."""

    def of(spec: str) -> Rows:
        paper, other = (errors(evidence, spec, role, horizon, n) for n in ("paper", "euclidean"))
        return quotients(other, paper)

    return cache(of)


@dataclass(frozen=True)
class Convergence(Kind):
    """Updates until a reaches a validation cost over those of b: the lowest cost that both reach, seed by seed."""

    pairs: tuple[tuple[str, str], ...]
    horizons: tuple[int, ...]

    @override
    def measure(self, evidence: Evidence) -> list[Estimate]:
        found = []
        for horizon in self.horizons:
            wanted: list[Stratum] = []
            for a, b in [pair for patterns in self.pairs for pair in evidence.pairs(*patterns)]:
                left, right = (_learning(evidence, s, horizon) for s in (a, b))
                updates: list[tuple[Network, np.ndarray, tuple[str, ...]]] = []
                for network in [n for n in left if n in right]:
                    sides = left[network], right[network]
                    reached = max(float(side.min()) for side in sides)
                    spent = np.log([_first(sides[0], reached) / _first(sides[1], reached)])
                    updates.append((network, spent, ("",)))
                wanted += [(row, ()) for row in gathered(updates).values()]
            found += ratio(f"updates, T = {horizon}:", wanted, recorded=False)
        return found


def _learning(evidence: Evidence, spec: str, horizon: int) -> dict[Network, pd.Series]:
    """(first output, seed) → validation cost by update, of every sound training; views of a model come last."""
    runs = [r for r in evidence.of(spec, horizon) if r.sound and r.key in evidence.learning]
    return {(r.outputs[0], r.seed): evidence.learning[r.key] for r in runs}


def _first(cost: pd.Series, reached: float) -> float:
    """The first update at which the cost is as low."""
    return float(cost.index[int((cost <= reached).to_numpy().argmax())])
