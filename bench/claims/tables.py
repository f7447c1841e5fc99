"""Errors of a configuration, laid out for a paired comparison: one table (steps, recordings) a trained network."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from bench.analysis import stats
from bench.analysis.tables import is_baseline, phases
from bench.claims.estimate import ALPHA, Estimate
from bench.claims.evidence import Evidence

RATES = ("body_rates", "euler_rates")
"""What a claim calls "rates": whichever of them the data set predicts."""
Network = tuple[str, int | None]
"""Channel ("" where a whole signal is predicted) and seed (None for a model that has none)."""
Errors = dict[Network, pd.DataFrame]
"""Mean error of every step (rows, T) on every test recording (columns), by network."""


def signals(role: str) -> list[str]:
    """The names that a role may stand for: "rates_forced" → "body_rates_forced", "euler_rates_forced"."""
    head, underscore, view = role.partition("_")
    return [f"{r}{underscore}{view}" for r in RATES] if head == "rates" else [role]


def errors(evidence: Evidence, spec: str, role: str, horizon: int, norm: str = "paper") -> Errors:
    """Sound runs only; of a signal predicted whole its norm, else each channel that was predicted alone."""
    found: Errors = {}
    for run in evidence.of(spec, horizon):
        if not run.sound:
            continue
        seed = None if is_baseline(spec) else run.seed
        for signal in signals(role):
            whole = evidence.curves.get((run.key, signal, norm))
            channels = [o for o in run.outputs if o.startswith(f"{signal}.")]
            alone = {c: evidence.curves.get((run.key, c, "axis")) for c in channels} if whole is None else {"": whole}
            for channel, curves in alone.items():
                by_recording = {s: c for s, c in (curves or {}).items() if s.startswith("mean@")}
                if by_recording and all(np.isfinite(c).all() for c in by_recording.values()):
                    found[channel, seed] = pd.DataFrame(by_recording)
    return found


def rows(
    a: Errors, b: Errors, reduce: Callable[[pd.DataFrame], pd.Series] = pd.DataFrame.mean
) -> list[tuple[pd.Series, pd.Series]]:
    """Errors of the networks of both sides, one number a recording; what has no seed meets every seed."""
    return list(_matched(a, b, reduce).values())


def together(
    a: Errors, others: Sequence[Errors], reduce: Callable[[pd.DataFrame], pd.Series]
) -> list[tuple[pd.Series, pd.Series]]:
    """Errors of every network of a and the geometric mean of those of all others: a training of a counts once."""
    met = [m for m in (_matched(a, b, reduce) for b in others) if m]
    return [
        (mine, np.exp(sum(np.log(m[n][1]) for m in met) / len(met)))
        for n, (mine, _) in (met[0] if met else {}).items()
        if all(n in m for m in met)
    ]


def _matched(
    a: Errors, b: Errors, reduce: Callable[[pd.DataFrame], pd.Series]
) -> dict[Network, tuple[pd.Series, pd.Series]]:
    seeds: list[int | None] = [*sorted({seed for _, seed in (*a, *b) if seed is not None})]
    found = {}
    for channel in dict.fromkeys(c for c, _ in a):
        for seed in seeds or [None]:
            left, right = (side.get((channel, seed), side.get((channel, None))) for side in (a, b))
            if left is not None and right is not None:
                found[channel, seed] = reduce(left), reduce(right)
    return found


def over(phase: str, horizon: int) -> Callable[[pd.DataFrame], pd.Series]:
    """Mean over a phase of the horizon: "first", "whole" or "last" as in the tables, or "start", its first step."""
    if phase == "start":
        return lambda table: table.iloc[:1].mean()
    steps = next(s for name, s in phases(horizon).items() if name.startswith(phase))
    return lambda table: table.iloc[steps].mean()


def ratio(name: str, pairs: Sequence[tuple[pd.Series, pd.Series]], alpha: float) -> list[Estimate]:
    """The ratio of the left errors to the right ones, each pair a training; empty without a pair."""
    if not pairs:
        return []
    left, right = (pd.DataFrame([p[i] for p in pairs]).dropna(axis=1) for i in (0, 1))
    shared = [c for c in left.columns if c in right.columns]
    found = _estimate(name, left[shared].to_numpy(), right[shared].to_numpy(), alpha)
    return [replace(found, speaks=found.speaks and len(shared) > 1)]  # nor can one recording speak for the next


def _estimate(name: str, left: np.ndarray, right: np.ndarray, alpha: float) -> Estimate:
    draws = round(stats.RESAMPLES * max(1.0, min(50.0, ALPHA / alpha)))  # as many in the tails as at 95 %
    found = stats.compare(left, right, 1 - alpha, draws)
    return Estimate(name, found.ratio, found.low, found.high, found.basis, speaks=found.trainings > 1)


def ratio_of_numbers(name: str, left: Iterable[float], right: Iterable[float], alpha: float) -> list[Estimate]:
    """The same where a network has one number only."""
    a, b = np.array(list(left), dtype=float)[:, None], np.array(list(right), dtype=float)[:, None]
    return [_estimate(name, a, b, alpha)] if len(a) else []
