"""Kinds of judgement that rest on ratios of errors."""

from dataclasses import dataclass
from itertools import combinations

import pandas as pd

from bench.claims.estimate import Estimate, Kind
from bench.claims.evidence import Evidence
from bench.claims.tables import errors, over, ratio, ratio_of_numbers, rows, signals, together


def _at(role: str, horizon: int) -> str:
    return f"{role}, T = {horizon}:"


@dataclass(frozen=True)
class Ratio(Kind):
    """Error of a over error of b in a phase of the horizon, all pairs together, one number a quantity and horizon."""

    pairs: tuple[tuple[str, str], ...]
    """Patterns of a and b."""
    quantities: tuple[str, ...]
    horizons: tuple[int, ...]
    phase: str = "whole"

    def measure(self, evidence: Evidence, alpha: float) -> list[Estimate]:
        """See `Kind.measure`."""
        found = []
        opponents: dict[str, list[str]] = {}
        for a, b in [pair for patterns in self.pairs for pair in evidence.pairs(*patterns)]:
            opponents.setdefault(a, []).append(b)
        for role in self.quantities:
            for horizon in self.horizons:
                pairs = []
                for a, others in opponents.items():
                    mine, *theirs = (errors(evidence, s, role, horizon) for s in (a, *others))
                    pairs += together(mine, theirs, over(self.phase, horizon))
                found += ratio(_at(role, horizon), pairs, alpha)
        return found


@dataclass(frozen=True)
class Alike(Kind):
    """Every two of the configurations against each other."""

    specs: tuple[str, ...]
    quantities: tuple[str, ...]
    horizons: tuple[int, ...]
    phase: str = "whole"

    def measure(self, evidence: Evidence, alpha: float) -> list[Estimate]:
        """See `Kind.measure`."""
        names = [s for pattern in self.specs for s in evidence.specs(pattern)]
        found = []
        for role in self.quantities:
            for horizon in self.horizons:
                for a, b in combinations(names, 2):
                    left, right = (errors(evidence, s, role, horizon) for s in (a, b))
                    found += ratio(
                        f"{a} / {b}, {_at(role, horizon)}", rows(left, right, over(self.phase, horizon)), alpha
                    )
        return found


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

    def measure(self, evidence: Evidence, alpha: float) -> list[Estimate]:
        """See `Kind.measure`."""
        found = []
        for above, below in self.quantities:
            for horizon in self.horizons:
                pairs: list[tuple[pd.Series, pd.Series]] = []
                if not self.against:
                    for spec in [s for pattern in self.specs for s in evidence.specs(pattern)]:
                        pairs += self._factors(evidence, spec, above, below, horizon)
                for patterns in zip(self.specs, self.against, strict=bool(self.against)):
                    for a, b in evidence.pairs(*patterns):
                        mine, theirs = (self._factors(evidence, s, above, below, horizon) for s in (a, b))
                        pairs += [(p / q, r / s) for (p, q), (r, s) in zip(mine, theirs, strict=False)]
                found += ratio(f"{above} / {below}, T = {horizon}:", pairs, alpha)
        return found

    def _factors(
        self, evidence: Evidence, spec: str, above: str, below: str, horizon: int
    ) -> list[tuple[pd.Series, pd.Series]]:
        top, bottom = (errors(evidence, spec, role, horizon) for role in (above, below))
        return rows(top, bottom, over(self.phase, horizon))


@dataclass(frozen=True)
class FewerWeights(Kind):
    """Error of every a over every b that has more weights than it; the RMSSE of both is said beside."""

    a: str
    b: str
    quantities: tuple[str, ...]
    horizons: tuple[int, ...]

    def measure(self, evidence: Evidence, alpha: float) -> list[Estimate]:
        """See `Kind.measure`."""
        found = []
        pairs = [
            (a, b)
            for a in evidence.specs(self.a)
            for b in evidence.specs(self.b)
            if evidence.weights(a) < evidence.weights(b)
        ]
        for role in self.quantities:
            for horizon in self.horizons:
                for a, b in pairs:
                    sizes = f"{evidence.weights(a):,} / {evidence.weights(b):,} weights"
                    rmsse = ratio_of_numbers("", *_rmsse(evidence, a, b, role, horizon), alpha)
                    beside = f", RMSSE {rmsse[0].value:.2f}" if rmsse else ""
                    name = f"{a} / {b} ({sizes}{beside}), {_at(role, horizon)}"
                    left, right = (errors(evidence, s, role, horizon) for s in (a, b))
                    found += ratio(name, rows(left, right), alpha)
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

    def measure(self, evidence: Evidence, alpha: float) -> list[Estimate]:
        """See `Kind.measure`."""
        names = list(dict.fromkeys(s for pattern in self.specs for s in evidence.specs(pattern)))
        found, same, turned = [], 0, 0
        for role in self.quantities:
            for horizon in self.horizons:
                for a, b in combinations(names, 2):
                    paper, other = (
                        rows(errors(evidence, a, role, horizon, n), errors(evidence, b, role, horizon, n))
                        for n in ("paper", "euclidean")
                    )
                    where = f"{a} / {b}, {_at(role, horizon)}"
                    changes = [(p / q, r / s) for (p, q), (r, s) in zip(other, paper, strict=True)]
                    change = ratio(f"{where} euclidean against paper", changes, alpha)
                    clear, turns = ratio("", paper, alpha), ratio("", other, alpha)
                    rmsse = ratio_of_numbers("", *_rmsse(evidence, a, b, role, horizon), alpha)
                    for seen in (*turns, *rmsse):
                        if clear and (clear[0].high < 1 or clear[0].low > 1):
                            same += (seen.value < 1) == (clear[0].value < 1)
                            turned += (seen.value < 1) != (clear[0].value < 1)
                    found += change
        note = f"{same} of {same + turned} orders that are clear in the paper's norm are the same by Euclid or RMSSE"
        return [Estimate(e.name, e.value, e.low, e.high, f"{note}; {e.basis}", e.speaks) for e in found]


@dataclass(frozen=True)
class Convergence(Kind):
    """Updates until a reaches a validation cost over those of b: the lowest cost that both reach, seed by seed."""

    pairs: tuple[tuple[str, str], ...]
    horizons: tuple[int, ...]

    def measure(self, evidence: Evidence, alpha: float) -> list[Estimate]:
        """See `Kind.measure`."""
        found = []
        for horizon in self.horizons:
            updates: list[tuple[float, float]] = []
            for a, b in [pair for patterns in self.pairs for pair in evidence.pairs(*patterns)]:
                mine, theirs = (_learning(evidence, s, horizon) for s in (a, b))
                for network in [n for n in mine if n in theirs]:
                    sides = mine[network], theirs[network]
                    reached = max(float(side.min()) for side in sides)
                    updates.append((_first(sides[0], reached), _first(sides[1], reached)))
            left, right = [u for u, _ in updates], [u for _, u in updates]
            found += ratio_of_numbers(f"updates, T = {horizon}:", left, right, alpha)
        return found


def _learning(evidence: Evidence, spec: str, horizon: int) -> dict[tuple[str, int], pd.Series]:
    """(first output, seed) → validation cost by update, of every sound training; views of a model come last."""
    runs = [r for r in evidence.of(spec, horizon) if r.sound and r.key in evidence.learning]
    return {(r.outputs[0], r.seed): evidence.learning[r.key] for r in runs}


def _first(cost: pd.Series, reached: float) -> float:
    """The first update at which the cost is as low."""
    return float(cost.index[int((cost <= reached).to_numpy().argmax())])
