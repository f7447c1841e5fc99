"""Kinds of judgement that rest on the error as it runs over the horizon."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import ClassVar

import numpy as np
from typing_extensions import override

from bench.analysis.contrast import Cell
from bench.analysis.tables import FIRST, LAST
from bench.claims.estimate import ByQuantity, Estimate, Kind
from bench.claims.evidence import Evidence
from bench.claims.kinds.tables import (
    Errors,
    Network,
    Rows,
    Table,
    errors,
    gathered,
    pool,
    quotients,
    ratio,
    rows,
    strata,
)


def peaks_of(tables: Errors, before: int) -> dict[Network, np.ndarray]:
    """Where in the steps before ``before`` the error is largest: for every network and recording as all others see it.

    Choosing the step by the very curve that is judged there would find a peak in any noise. Only the networks of one
    configuration and channel belong together; one alone is its own judge, which `Estimate.conclusive` then forbids.
    """
    found = {}
    for network, table in tables.items():
        others = [
            t.values
            for n, t in tables.items()
            if n[0] == network[0] and n != network and t.recordings == table.recordings
        ]
        early = _rolling(np.sum(others or [table.values], axis=0))[:before]
        found[network] = (early.sum(1, keepdims=True) - early).argmax(0)
    return {n: p for n, p in found.items() if len(p) > 1}


def _rolling(values: np.ndarray) -> np.ndarray:
    """(T, R) means over `LAST` steps around each, over fewer at the ends."""
    steps = np.arange(len(values))
    first, after = np.maximum(steps - LAST // 2, 0), np.minimum(steps - LAST // 2 + LAST, len(values))
    sums = np.concatenate([np.zeros((1, values.shape[1])), values.cumsum(0)])
    return (sums[after] - sums[first]) / (after - first)[:, None]


def around(table: Table, peaks: np.ndarray) -> np.ndarray:
    """Mean error of every recording over the steps around its peak, as many as the end is judged by."""
    half = LAST // 2
    return np.array([table.values[max(0, p - half) : p + half, r].mean() for r, p in enumerate(peaks)])


@dataclass(frozen=True)
class EarlyPeak(ByQuantity):
    """The error over the end and over the first steps, each over that around its peak in the first half.

    Both below 1: it rises first and falls later. All configurations together.
    """

    specs: tuple[str, ...]
    anywhere: bool = False
    """The peak may lie anywhere before the end, and not only in the first half."""
    relative: ClassVar[bool] = False

    @override
    def compare(self, evidence: Evidence, role: str, horizon: int) -> list[Estimate]:
        found = []
        for name, steps in (("end", slice(-LAST, None)), ("start", slice(FIRST))):
            of = self._response(evidence, role, horizon, steps)
            wanted = [(row, ()) for spec in evidence.matching(self.specs) for row in of(spec).values()]
            found += ratio(f"{role}, T = {horizon}, {name} / peak:", wanted, pool(evidence, of))
        return found

    def _response(self, evidence: Evidence, role: str, horizon: int, steps: slice) -> Callable[[str], Rows]:
        def of(spec: str) -> Rows:
            tables = errors(evidence, spec, role, horizon)
            peaks = peaks_of(tables, horizon - LAST if self.anywhere else horizon // 2)
            return gathered(
                (n, np.log(tables[n].values[steps].mean(0) / around(tables[n], p)), tables[n].recordings)
                for n, p in peaks.items()
            )

        return cache(of)


@dataclass(frozen=True)
class Growth(ByQuantity):
    """The error of every quarter of the horizon over that of the quarter before, all configurations together."""

    specs: tuple[str, ...]
    relative: ClassVar[bool] = False

    @override
    def compare(self, evidence: Evidence, role: str, horizon: int) -> list[Estimate]:
        found, quarter = [], horizon // 4
        for i in range(1, 4):
            of = _growing(evidence, role, horizon, slice(i * quarter, (i + 1) * quarter), quarter)
            wanted = [(row, ()) for spec in evidence.matching(self.specs) for row in of(spec).values()]
            found += ratio(f"{role}, T = {horizon}, quarter {i + 1} / {i}:", wanted, pool(evidence, of))
        return found


def _growing(evidence: Evidence, role: str, horizon: int, later: slice, quarter: int) -> Callable[[str], Rows]:
    """Configuration → the logarithms of its errors in a quarter of the horizon over those in the quarter before."""
    before = slice(later.start - quarter, later.start)

    def of(spec: str) -> Rows:
        tables = errors(evidence, spec, role, horizon)
        return quotients(tables, tables, lambda v: v[later].mean(0), lambda v: v[before].mean(0))

    return cache(of)


def _families(evidence: Evidence, pattern: str) -> dict[int, str]:
    """History → the configuration of the pattern that has it; of several sizes the first."""
    found: dict[int, str] = {}
    for spec in evidence.specs(pattern, histories=True):
        history = evidence.of(spec)[0].history
        if history is not None:
            found.setdefault(history, spec)
    return dict(sorted(found.items()))


@dataclass(frozen=True)
class HistorySpread(Kind):
    """How much the length of the history matters: the largest ratio of errors between any two lengths."""

    specs: tuple[str, ...]
    quantities: tuple[str, ...]
    horizons: tuple[int, ...]

    @override
    def measure(self, evidence: Evidence) -> list[Estimate]:
        found = []
        for pattern in self.specs:
            by_history = _families(evidence, pattern)
            for role in self.quantities:
                for horizon in self.horizons:
                    of = _whole(evidence, role, horizon)
                    swept = {h: of(s) for h, s in by_history.items()}
                    if len(swept) > 1 and all(swept.values()):
                        found.append(_spread(f"{pattern}, {role}, T = {horizon}:", swept, pool(evidence, of)))
        return found


def _whole(evidence: Evidence, role: str, horizon: int) -> Callable[[str], Rows]:
    return cache(lambda spec: rows(errors(evidence, spec, role, horizon)))


def _spread(name: str, swept: dict[int, Rows], cells: list[Cell]) -> Estimate:
    """The largest ratio between two lengths; its limits hold for all pairs of lengths at once."""
    pairs = [(x, y) for x in swept for y in swept if x != y]
    seen = [e for x, y in pairs for e in ratio("", strata(swept[x], [swept[y]]), cells)]

    def limits(alpha: float, seeds: float, recordings: float) -> tuple[float, float]:
        each = [e.limits(2 * alpha / len(pairs), seeds, recordings) for e in seen]
        return max(1.0, *(low for low, _ in each)), max(high for _, high in each)  # the larger error over the smaller

    best = {}
    for channel in dict.fromkeys(c for found in swept.values() for c in found):
        means = {h: np.exp(found[channel].cell.values).mean() for h, found in swept.items() if channel in found}
        best[channel.partition(".")[2] or "all"] = min(means, key=lambda h: means[h])
    lengths = f"lengths {', '.join(map(str, swept))}; best " + ", ".join(f"{c}: {h}" for c, h in best.items())
    top = max(seen, key=lambda e: e.value)
    return replace(top, name=name, limits=limits, basis=f"{lengths}; {top.basis}")


@dataclass(frozen=True)
class PeakShrinks(ByQuantity):
    """The error around the early peak of the shortest history, with the longest history over with the shortest."""

    specs: tuple[str, ...]

    @override
    def compare(self, evidence: Evidence, role: str, horizon: int) -> list[Estimate]:
        wanted = []
        for pattern in self.specs:
            by_history = _families(evidence, pattern)
            if len(by_history) > 1:
                ends = (by_history[h] for h in (min(by_history), max(by_history)))
                short, long = (errors(evidence, spec, role, horizon) for spec in ends)
                wanted += [(row, ()) for row in _shrinking(short, long, horizon // 2).values()]
        return ratio(f"{role}, T = {horizon}, longest / shortest history:", wanted)


def _shrinking(short: Errors, long: Errors, before: int) -> Rows:
    """The logarithms of the errors around the peaks of the first, those of the second over its own, seed by seed."""
    return gathered(
        (n, np.log(around(long[n], peaks) / around(short[n], peaks)), short[n].recordings)
        for n, peaks in peaks_of(short, before).items()
        if n in long and long[n].recordings == short[n].recordings
    )
