"""A study's records as two tables: the errors of every configuration, and the verdict on every pair."""

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
import pandas as pd

from bench.analysis import stats
from bench.experiment.notation import label
from bench.records.record import RunRecord
from registry.units import SIGNALS, display

FIRST, LAST = 5, 20
"""Steps at the two ends of the horizon where the paper looks: "immediate" and "eventually"."""
POOLED = "all outputs"
Pairs = Sequence[tuple[str, str]]


def is_baseline(spec: str) -> bool:
    """A model that is not trained by gradient: nothing about it depends on the seed."""
    return not label(spec).trained


@lru_cache(maxsize=4096)
def sound(record: RunRecord) -> bool:
    """Finished, and with finite errors; anything else is counted as diverged."""
    return record.finished and bool(np.isfinite(record.steps["value"]).all())


def norm_of(record: RunRecord, quantity: str) -> str:
    """The norm a quantity is reported in: "axis" for a channel, the paper's for a signal of three axes."""
    return "axis" if quantity in record.summary["outputs"] else "paper"


def quantities(records: Sequence[RunRecord]) -> list[str]:
    """Predicted signals of three axes, then channels, in the order of the records."""
    groups: dict[str, None] = {}
    channels: dict[str, None] = {}
    for r in records:
        for name in r.summary["outputs"]:
            channels[name] = None
            group = name.partition(".")[0]
            if sum(o.partition(".")[0] == group for o in r.summary["outputs"]) == 3:
                groups[group] = None
    return [*groups, *channels]


def whole_signals(names: Sequence[str]) -> list[str]:
    """Those of the quantities that stand for all the axes of a signal."""
    return [n for n in names if any(other.startswith(f"{n}.") for other in names)]


def predicts(record: RunRecord, quantity: str) -> bool:
    """Whether the record's model predicts the channel, or all of the signal."""
    return quantity in quantities([record])


def named(quantity: str) -> str:
    """A quantity as it is shown: "velocity_forced.x" (the view "forced" of a predictor) → "velocity.x (forced)"."""
    group, dot, axis = quantity.partition(".")
    signal = max((s for s in SIGNALS if group == s or group.startswith(f"{s}_")), key=len, default=group)
    view = group[len(signal) + 1 :].replace("_", " ")
    return f"{signal}{dot}{axis}" + (f" ({view})" if view else "")


def specs(records: Sequence[RunRecord]) -> list[str]:
    """Configurations in the order of the records, baselines last."""
    return sorted(dict.fromkeys(r.summary["spec"] for r in records), key=is_baseline)


def horizons(records: Sequence[RunRecord]) -> list[int]:
    """Prediction lengths, ascending."""
    return sorted({r.summary["horizon"] for r in records})


def unit_of(record: RunRecord, quantity: str) -> tuple[str, float]:
    """Display unit of a quantity and the factor from SI."""
    units = record.summary["units"]
    return display(next(u for name, u in units.items() if quantity in (name, name.partition(".")[0])))


def phases(horizon: int) -> dict[str, slice]:
    """The parts of the horizon that are compared, as slices of its steps; those that a short one has."""
    parts = {f"first {FIRST} steps": slice(0, FIRST)} if horizon > FIRST else {}
    parts["whole horizon"] = slice(None)
    if horizon > LAST:
        parts[f"last {LAST} steps"] = slice(-LAST, None)
    return parts


@lru_cache(maxsize=4096)
def by_recording(record: RunRecord, quantity: str) -> pd.DataFrame:
    """Mean error (T rows, one column a test recording), display unit."""
    t = record.steps
    t = t[(t.quantity == quantity) & (t.norm == norm_of(record, quantity)) & t.statistic.str.startswith("mean@")]
    return t.pivot(index="step", columns="statistic", values="value")


def _select(records: Sequence[RunRecord], spec: str, quantity: str, horizon: int) -> list[RunRecord]:
    return [
        r for r in records if r.summary["spec"] == spec and r.summary["horizon"] == horizon and predicts(r, quantity)
    ]


def study_table(records: Sequence[RunRecord]) -> pd.DataFrame:
    """One row a horizon, output and configuration.

    Returns:
        horizon, output, spec, weights, unit, rmsse (mean over seeds), rmsse_low, rmsse_high (95 % interval over
        seeds; NaN with one), first, whole, last (mean error over the first `FIRST`, all and the last `LAST` steps),
        seeds (sound runs), diverged (runs left out of the means). Errors in the unit named; NaN where none is sound.
    """
    return _study_table(tuple(records))


@lru_cache(maxsize=4)  # the terminal, the file and the page ask for the same
def _study_table(records: tuple[RunRecord, ...]) -> pd.DataFrame:
    rows = []
    for horizon in horizons(records):
        for quantity in quantities(records):
            for spec in specs(records):
                runs = _select(records, spec, quantity, horizon)
                if not runs:
                    continue
                good = [r for r in runs if sound(r)]
                unit, factor = unit_of(runs[0], quantity)
                rmsse = [factor * r.summary["metrics"][f"rmsse.{quantity}"] for r in good]
                low, high = stats.interval(rmsse) or (math.nan, math.nan)
                curves = [r.error(quantity, norm_of(r, quantity)).to_numpy() for r in good]
                curve = np.mean(curves, axis=0) if curves else np.full(horizon, math.nan)
                rows.append(
                    {
                        "horizon": horizon,
                        "output": quantity,
                        "spec": spec,
                        "weights": runs[0].summary["weights"],
                        "unit": unit,
                        "rmsse": float(np.mean(rmsse)) if rmsse else math.nan,
                        "rmsse_low": low,
                        "rmsse_high": high,
                        "first": float(curve[:FIRST].mean()),
                        "whole": float(curve.mean()),
                        "last": float(curve[-LAST:].mean()),
                        "seeds": len(good),
                        "diverged": len(runs) - len(good),
                    }
                )
    return pd.DataFrame(rows)


def _errors(runs: Sequence[RunRecord], quantity: str, steps: slice) -> dict[int, pd.Series]:
    """Seed → mean error of each recording over those steps; sound runs only."""
    return {r.summary["seed"]: by_recording(r, quantity).iloc[steps].mean() for r in runs if sound(r)}


def _paired(
    runs_a: Sequence[RunRecord], runs_b: Sequence[RunRecord], quantity: str, steps: slice, other: str = ""
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Errors (seeds, recordings) of the seeds that are sound on both sides; a baseline meets every seed.

    ``other`` is the quantity of the second side where it is not that of the first.
    """
    a, b = _errors(runs_a, quantity, steps), _errors(runs_b, other or quantity, steps)
    for mine, theirs, runs in ((a, b, runs_a), (b, a, runs_b)):
        if mine and is_baseline(runs[0].summary["spec"]):
            only = next(iter(mine.values()))
            mine |= dict.fromkeys(theirs, only)
    seeds = sorted(a.keys() & b.keys())
    left, right = (pd.DataFrame([e[s] for s in seeds], index=seeds) for e in (a, b))
    shared = [c for c in left.columns if c in right.columns]
    return left[shared], right[shared]


def comparisons(records: Sequence[RunRecord], pairs: Pairs, only: str = "") -> pd.DataFrame:
    """Does a beat b? One row a horizon, pair, output and phase of the horizon, and one over all outputs where each is
    a training of its own.

    Args:
        records: runs of one study.
        pairs: (a, b) configurations.
        only: the one phase to compare; empty: all.

    Returns:
        horizon, a, b, output, phase, ratio (error a / error b), low, high (95 %), smallest (reduction that would have
        been seen), verdict, alike, trainings, recordings, basis, diverged_a, diverged_b.
    """
    return _comparisons(tuple(records), tuple(pairs), only)


@lru_cache(maxsize=32)
def _comparisons(records: tuple[RunRecord, ...], pairs: tuple[tuple[str, str], ...], only: str) -> pd.DataFrame:
    rows = []
    for horizon in horizons(records):
        for a, b in pairs:
            names = [q for q in quantities(records) if all(_select(records, s, q, horizon) for s in (a, b))]
            sides = {q: (_select(records, a, q, horizon), _select(records, b, q, horizon)) for q in names}
            for phase, steps in phases(horizon).items():
                if only not in ("", phase):
                    continue
                tables = {q: _paired(sides[q][0], sides[q][1], q, steps) for q in names}
                channels = [q for q in names if sides[q][0][0].summary["outputs"] == [q]]
                if len(channels) > 1:
                    tables[POOLED] = _pool([tables[q] for q in channels])
                for quantity, errors in tables.items():
                    runs = sides.get(quantity) or [[r for q in channels for r in sides[q][i]] for i in (0, 1)]
                    where = {"horizon": horizon, "a": a, "b": b, "output": quantity, "phase": phase}
                    rows.append(where | _judged(*errors, *runs))
    return pd.DataFrame(rows)


def contrasts(records: Sequence[RunRecord], wanted: Pairs) -> pd.DataFrame:
    """Is quantity a predicted better than quantity b by the same networks? One row a horizon, pair of quantities,
    configuration that records both, and phase of the horizon.

    Returns:
        the columns of `comparisons`, with spec for output; a and b are quantities.
    """
    rows = []
    for horizon in horizons(records):
        for a, b in wanted:
            for spec in specs(records):
                runs = [r for r in _select(records, spec, a, horizon) if predicts(r, b)]
                for phase, steps in phases(horizon).items() if runs else ():
                    where = {"horizon": horizon, "a": a, "b": b, "spec": spec, "phase": phase}
                    rows.append(where | _judged(*_paired(runs, runs, a, steps, b), runs, runs))
    return pd.DataFrame(rows)


def _judged(
    left: pd.DataFrame, right: pd.DataFrame, runs_a: Sequence[RunRecord], runs_b: Sequence[RunRecord]
) -> dict[str, Any]:
    """What is said of two tables of paired errors and the runs that they come from."""
    found = stats.compare(left.to_numpy(), right.to_numpy())
    names = ("ratio", "low", "high", "smallest", "verdict", "alike", "trainings", "recordings", "basis")
    lost = {f"diverged_{s}": sum(not sound(r) for r in runs) for s, runs in (("a", runs_a), ("b", runs_b))}
    return {name: getattr(found, name) for name in names} | lost


def _pool(tables: Sequence[tuple[pd.DataFrame, pd.DataFrame]]) -> tuple[pd.DataFrame, pd.DataFrame]:
    """The trainings of all channels below one another, on the recordings that they share."""
    left, right = (pd.concat([pair[i] for pair in tables], join="inner", ignore_index=True) for i in (0, 1))
    return left, right
