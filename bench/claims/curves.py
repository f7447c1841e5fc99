"""Kinds of judgement that rest on the error as it runs over the horizon."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pandas as pd

from bench.analysis import stats
from bench.analysis.tables import FIRST, LAST
from bench.claims.estimate import Estimate, Kind
from bench.claims.evidence import Evidence
from bench.claims.tables import Errors, Network, errors, ratio, rows, signals
from registry.errors import BenchError
from registry.units import to_si


def converted(unit: str, to: str) -> float:
    """Factor from one unit to another of the same quantity.

    Raises:
        BenchError: they measure different things.
    """
    (base, factor), (wanted, divisor) = to_si(unit), to_si(to)
    if base != wanted:
        raise BenchError(f"A claim in {to} cannot be judged on errors in {unit}: mend its unit.")
    return factor / divisor


def _unit_of(evidence: Evidence, role: str) -> str | None:
    return next((evidence.units[s] for s in signals(role) if s in evidence.units), None)


@dataclass(frozen=True)
class Level(Kind):
    """The largest mean error of any step ("max"), or its mean over the horizon ("mean"), of every configuration."""

    specs: tuple[str, ...]
    quantities: tuple[str, ...]
    horizons: tuple[int, ...]
    unit: str
    of: str = "max"

    def measure(self, evidence: Evidence, alpha: float) -> list[Estimate]:
        """See `Kind.measure`."""
        found = []
        reduce = np.max if self.of == "max" else np.mean
        for role in self.quantities:
            unit = _unit_of(evidence, role)
            for horizon in self.horizons if unit else ():
                factor = converted(str(unit), self.unit)
                for spec in [s for pattern in self.specs for s in evidence.specs(pattern)]:
                    tables = list(errors(evidence, spec, role, horizon).values())
                    if not tables:
                        continue
                    curves = factor * np.stack([t.to_numpy().T for t in tables])
                    value = float(reduce(curves.mean((0, 1))))
                    low, high = math.nan, math.nan
                    if curves.shape[1] > 1:
                        low, high = _level_limits(curves, reduce, 1 - alpha)
                    basis = f"bootstrap over {curves.shape[1]} recordings; jackknife of {len(tables)} trained networks"
                    name = f"{spec}, {role}, T = {horizon}:"
                    found.append(Estimate(name, value, low, high, basis, len(tables) > 1 and curves.shape[1] > 1))
        return found


def _level_limits(curves: np.ndarray, reduce: Callable[..., np.ndarray], confidence: float) -> tuple[float, float]:
    """Limits of a level of the mean curve of (S, R, T); half-widths of recordings and trainings add up squared.

    The few trainings get Student's interval over the jackknife's pseudo-values (Tukey 1958): to draw two of them
    again would never leave the range of the two.
    """
    mean = curves.mean(1)
    value = float(reduce(mean.mean(0)))
    low, high = stats.curve_interval(curves.mean(0, keepdims=True), lambda c: reduce(c, axis=1), confidence)
    n = len(mean)
    pseudo = [n * value - (n - 1) * float(reduce(np.delete(mean, s, 0).mean(0))) for s in range(n if n > 1 else 0)]
    around = stats.interval(pseudo, confidence) or (0.0, 0.0)
    half = (around[1] - around[0]) / 2
    return max(0.0, value - math.hypot(value - low, half)), value + math.hypot(high - value, half)


@dataclass(frozen=True)
class Quantile(Kind):
    """The 99 % quantile of the error at the worst step and axis, mean over seeds, of every configuration."""

    specs: tuple[str, ...]
    quantities: tuple[str, ...]
    horizons: tuple[int, ...]
    unit: str

    def measure(self, evidence: Evidence, alpha: float) -> list[Estimate]:
        """See `Kind.measure`."""
        found = []
        for role in self.quantities:
            for horizon in self.horizons:
                for spec in [s for pattern in self.specs for s in evidence.specs(pattern)]:
                    worst: dict[int, float] = {}
                    for run in evidence.of(spec, horizon):
                        for channel in [o for o in run.outputs if o.partition(".")[0] in signals(role)]:
                            curve = evidence.curves.get((run.key, channel, "axis"), {}).get("q99")
                            if curve is not None and run.sound:
                                factor = converted(evidence.units[channel], self.unit)
                                worst[run.seed] = max(worst.get(run.seed, 0.0), factor * float(curve.max()))
                    if worst:
                        values = list(worst.values())
                        low, high = stats.interval(values, 1 - alpha) or (math.nan, math.nan)
                        low = max(0.0, low) if len(values) > 1 else low  # an error is never negative
                        basis = f"t-interval over {len(values)} seeds; every step and every axis"
                        name = f"{spec}, {role}, T = {horizon}:"
                        found.append(Estimate(name, float(np.mean(values)), low, high, basis, len(values) > 1))
        return found


def peaks_of(tables: Errors, before: int) -> dict[Network, pd.Series]:
    """Where in the steps before ``before`` the error is largest: for every network and recording as all others see it.

    Choosing the step by the very curve that is judged there would find a peak in any noise. Only the networks of one
    configuration and channel belong together; one alone is its own judge, which `Estimate.speaks` then forbids.
    """
    found = {}
    for network, table in tables.items():
        others = [t for n, t in tables.items() if n[0] == network[0] and n != network] or [table]
        early = sum(o.reindex(columns=table.columns) for o in others).rolling(LAST, center=True, min_periods=1).mean()
        early = early.iloc[:before]
        without = early.sum(axis=1).to_numpy()[:, None] - early.to_numpy()
        found[network] = pd.Series(without.argmax(0), index=table.columns)
    return {n: p for n, p in found.items() if len(p) > 1}


def around(table: pd.DataFrame, peaks: pd.Series) -> pd.Series:
    """Mean error of every recording over the steps around its peak, as many as the end is judged by."""
    half = LAST // 2
    return pd.Series({c: table[c].iloc[max(0, p - half) : p + half].mean() for c, p in peaks.items()})


@dataclass(frozen=True)
class EarlyPeak(Kind):
    """The error over the end and over the first steps, each over that around its peak in the first half.

    Both below 1: it rises first and falls later. All configurations together.
    """

    specs: tuple[str, ...]
    quantities: tuple[str, ...]
    horizons: tuple[int, ...]
    anywhere: bool = False
    """The peak may lie anywhere before the end, and not only in the first half."""

    def measure(self, evidence: Evidence, alpha: float) -> list[Estimate]:
        """See `Kind.measure`."""
        found = []
        for role in self.quantities:
            for horizon in self.horizons:
                peaked = []
                for spec in [s for pattern in self.specs for s in evidence.specs(pattern)]:
                    tables = errors(evidence, spec, role, horizon)
                    peaks = peaks_of(tables, horizon - LAST if self.anywhere else horizon // 2)
                    peaked += [(tables[n], around(tables[n], p)) for n, p in peaks.items()]
                for name, steps in (("end", slice(-LAST, None)), ("start", slice(FIRST))):
                    pairs = [(table.iloc[steps].mean(), peak) for table, peak in peaked]
                    found += ratio(f"{role}, T = {horizon}, {name} / peak:", pairs, alpha)
        return found


@dataclass(frozen=True)
class Growth(Kind):
    """The error of every quarter of the horizon over that of the quarter before, all configurations together."""

    specs: tuple[str, ...]
    quantities: tuple[str, ...]
    horizons: tuple[int, ...]

    def measure(self, evidence: Evidence, alpha: float) -> list[Estimate]:
        """See `Kind.measure`."""
        found = []
        for role in self.quantities:
            for horizon in self.horizons:
                quarter = horizon // 4
                tables = [
                    t
                    for pattern in self.specs
                    for spec in evidence.specs(pattern)
                    for t in errors(evidence, spec, role, horizon).values()
                ]
                for i in range(1, 4):
                    later, before = slice(i * quarter, (i + 1) * quarter), slice((i - 1) * quarter, i * quarter)
                    pairs = [(t.iloc[later].mean(), t.iloc[before].mean()) for t in tables]
                    found += ratio(f"{role}, T = {horizon}, quarter {i + 1} / {i}:", pairs, alpha)
        return found


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

    def measure(self, evidence: Evidence, alpha: float) -> list[Estimate]:
        """See `Kind.measure`."""
        found = []
        for pattern in self.specs:
            by_history = _families(evidence, pattern)
            for role in self.quantities:
                for horizon in self.horizons:
                    tables = {h: errors(evidence, s, role, horizon) for h, s in by_history.items()}
                    if len(tables) > 1 and all(tables.values()):
                        found.append(_spread(f"{pattern}, {role}, T = {horizon}:", tables, alpha))
        return found


def _spread(name: str, tables: dict[int, Errors], alpha: float) -> Estimate:
    """The largest ratio between two lengths; its limits hold for all pairs of lengths at once."""
    pairs = [(x, y) for x in tables for y in tables if x != y]
    seen = [e for x, y in pairs for e in ratio("", rows(tables[x], tables[y]), 2 * alpha / len(pairs))]
    best = {}
    for channel in dict.fromkeys(c for table in tables.values() for c, _ in table):
        means = {
            h: np.mean([t.to_numpy().mean() for (c, _), t in e.items() if c == channel]) for h, e in tables.items()
        }
        best[channel.partition(".")[2] or "all"] = min(means, key=lambda h: means[h])
    lengths = f"lengths {', '.join(map(str, tables))}; best " + ", ".join(f"{c}: {h}" for c, h in best.items())
    top = max(seen, key=lambda e: e.value)
    low = float(np.maximum(1.0, max(e.low for e in seen)))  # the larger error over the smaller
    limits = low, max(e.high for e in seen)
    return Estimate(name, top.value, *limits, f"{lengths}; {top.basis}", top.speaks)


@dataclass(frozen=True)
class PeakShrinks(Kind):
    """The error around the early peak of the shortest history, with the longest history over with the shortest."""

    specs: tuple[str, ...]
    quantities: tuple[str, ...]
    horizons: tuple[int, ...]

    def measure(self, evidence: Evidence, alpha: float) -> list[Estimate]:
        """See `Kind.measure`."""
        found = []
        for role in self.quantities:
            for horizon in self.horizons:
                pairs = []
                for pattern in self.specs:
                    by_history = _families(evidence, pattern)
                    if len(by_history) < 2:
                        continue
                    short, long = (errors(evidence, by_history[h], role, horizon) for h in _ends(by_history))
                    for network, peaks in peaks_of(short, horizon // 2).items():
                        if network in long:
                            pairs.append((around(long[network], peaks), around(short[network], peaks)))
                found += ratio(f"{role}, T = {horizon}, longest / shortest history:", pairs, alpha)
        return found


def _ends(by_history: dict[int, str]) -> tuple[int, int]:
    return min(by_history), max(by_history)
