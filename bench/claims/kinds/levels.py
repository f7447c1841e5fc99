"""Kinds of judgement that rest on a level of the error, in a unit: those of the paper's own recordings."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import ClassVar

import numpy as np
from typing_extensions import override

from bench.analysis import stats
from bench.claims.estimate import ByQuantity, Estimate
from bench.claims.evidence import Evidence
from bench.claims.kinds.tables import errors, signals
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
class Level(ByQuantity):
    """The largest mean error of any step ("max"), or its mean over the horizon ("mean"), of every configuration."""

    specs: tuple[str, ...]
    unit: str
    of: str = "max"
    relative: ClassVar[bool] = False

    @override
    def compare(self, evidence: Evidence, role: str, horizon: int) -> list[Estimate]:
        found, unit = [], _unit_of(evidence, role)
        for spec in evidence.matching(self.specs) if unit else ():
            tables = list(errors(evidence, spec, role, horizon).values())
            if tables:
                curves = converted(str(unit), self.unit) * np.stack([t.values.T for t in tables])
                reduce = np.max if self.of == "max" else np.mean
                found.append(_level(f"{spec}, {role}, T = {horizon}:", curves, reduce))
        return found


def _level(name: str, curves: np.ndarray, reduce: Callable[..., np.ndarray]) -> Estimate:
    """A level of the mean curve of (S, R, T)."""
    trainings, recordings, _ = curves.shape
    value = float(reduce(curves.mean((0, 1))))

    @cache
    def at(alpha: float) -> tuple[float, float]:
        return _level_limits(curves, reduce, 1 - alpha) if recordings > 1 else (math.nan, math.nan)

    basis = f"bootstrap over {recordings} recordings; jackknife of {trainings} trained networks"
    conclusive = trainings > 1 and recordings > 1
    return Estimate(name, value, lambda alpha, *_: at(alpha), basis, conclusive)


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
class Quantile(ByQuantity):
    """The 99 % quantile of the error at the worst step and axis, mean over seeds, of every configuration."""

    specs: tuple[str, ...]
    unit: str
    relative: ClassVar[bool] = False

    @override
    def compare(self, evidence: Evidence, role: str, horizon: int) -> list[Estimate]:
        found = []
        for spec in evidence.matching(self.specs):
            worst: dict[int, float] = {}
            for run in evidence.of(spec, horizon):
                for channel in [o for o in run.outputs if o.partition(".")[0] in signals(role)]:
                    curve = evidence.curves.get((run.key, channel, "axis"), {}).get("q99")
                    if curve is not None and run.sound:
                        factor = converted(evidence.units[channel], self.unit)
                        worst[run.seed] = max(worst.get(run.seed, 0.0), factor * float(curve.max()))
            if worst:
                found.append(_quantile(f"{spec}, {role}, T = {horizon}:", list(worst.values())))
        return found


def _quantile(name: str, values: list[float]) -> Estimate:
    """The mean of one value a seed; an error is never negative."""

    def limits(alpha: float, seeds: float, recordings: float) -> tuple[float, float]:
        low, high = stats.interval(values, 1 - alpha) or (math.nan, math.nan)
        return (max(0.0, low) if len(values) > 1 else low), high

    basis = f"t-interval over {len(values)} seeds; every step and every axis"
    return Estimate(name, float(np.mean(values)), limits, basis, len(values) > 1)
