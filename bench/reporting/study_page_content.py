"""What the page of a study shows, read from its records: curves, quantiles, windows, in the units of a reader."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
import pandas as pd

from bench.analysis import tables
from bench.experiment.grid import matched
from bench.experiment.study import Study
from bench.records.record import RunRecord
from bench.reporting import figures, report
from bench.reporting.drawing import Look
from bench.reporting.page import Drawing

QUANTILES = ("q05", "q25", "median", "q75", "q95")


Legend = Sequence[tuple[Look, str]]
Titled = Sequence[tuple[str, Sequence[Drawing]]]
"""Drawings below a heading each."""


@dataclass(frozen=True)
class Plain:
    """A table of texts, the first of each row its name."""

    heads: Sequence[str]
    rows: Sequence[Sequence[str]]


@dataclass(frozen=True)
class Curve:
    """A per-step error, mean over seeds, and the best and worst seed of every step."""

    time: np.ndarray
    """[s], (T,)."""
    mean: np.ndarray
    low: np.ndarray
    high: np.ndarray
    seeds: int


@dataclass(frozen=True)
class WorstWindow:
    """One channel of the worst window that a configuration's records hold."""

    time: np.ndarray
    measured: np.ndarray
    predicted: np.ndarray
    channel: str
    recording: str
    seed: int


@lru_cache(maxsize=512)
def distribution(record: RunRecord) -> dict[tuple[str, str], np.ndarray]:
    """(quantity, statistic) → value of every step, in the norm in which the quantity is reported."""
    t = record.steps
    t = t[~t["statistic"].str.startswith("mean@")]
    return {
        (quantity, statistic): rows.to_numpy()
        for (quantity, norm, statistic), rows in t.groupby(["quantity", "norm", "statistic"], sort=False)["value"]
        if norm == tables.norm_of(record, quantity)
    }


@dataclass(frozen=True)
class Content:
    """A finished study."""

    records: Sequence[RunRecord]
    title: str
    study: Study | None
    command: str

    @cached_property
    def pairs(self) -> tables.Pairs:
        """Configurations that are compared."""
        return tuple(matched(self.study.pairs, tables.specs(self.records))) if self.study else ()

    @cached_property
    def within(self) -> tables.Pairs:
        """Quantities that are compared within each configuration."""
        return self.study.contrasts if self.study else ()

    @property
    def smoke(self) -> bool:
        """Whether runs of a few updates try the machinery, and say nothing of what is compared."""
        return "(smoke)" in self.title

    @cached_property
    def specs(self) -> list[str]:
        """Configurations, baselines last."""
        return tables.specs(self.records)

    @cached_property
    def horizons(self) -> list[int]:
        """Prediction lengths, ascending."""
        return tables.horizons(self.records)

    @cached_property
    def looks(self) -> dict[str, Look]:
        """Configuration → the line of its curves, the same on the whole page."""
        return {
            s: Look(colour, dashes, 1.25 * width) for s, (colour, dashes, width) in figures.looks(self.specs).items()
        }

    @cached_property
    def table(self) -> pd.DataFrame:
        """`bench.analysis.tables.study_table`."""
        return tables.study_table(self.records)

    @cached_property
    def grids(self) -> list[report.Grid]:
        """All comparisons."""
        return report.grids(self.records, self.pairs, self.within)

    @cached_property
    def principal(self) -> list[str]:
        """Quantities that get drawings."""
        return figures.principal(tables.quantities(self.records))

    def quantities(self, horizon: int) -> list[str]:
        """Those of `principal` that runs of this horizon predict."""
        at = set(tables.quantities([r for r in self.records if r.summary["horizon"] == horizon]))
        return [q for q in self.principal if q in at]

    def duration(self, horizon: int) -> str:
        """ "T = 40 steps (0.4 s)"."""
        rates = {r.summary["rate_hz"] for r in self.records if r.summary["horizon"] == horizon}
        return f"T = {horizon} steps" + (f" ({horizon / rates.pop():g} s)" if len(rates) == 1 else "")

    def unit(self, quantity: str) -> str:
        """The unit in which a quantity is shown."""
        return tables.unit_of(next(r for r in self.records if tables.predicts(r, quantity)), quantity)[0]

    def sound(self, spec: str, quantity: str, horizon: int) -> list[RunRecord]:
        """Runs that can be drawn."""
        found = (r for r in self.records if (r.summary["spec"], r.summary["horizon"]) == (spec, horizon))
        return [r for r in found if tables.predicts(r, quantity) and tables.sound(r)]

    def lost(self) -> list[RunRecord]:
        """Runs that diverged, or whose errors are not finite."""
        return [r for r in self.records if not tables.sound(r)]

    def _statistic(self, runs: Sequence[RunRecord], quantity: str, statistic: str) -> np.ndarray:
        return np.array([distribution(r)[quantity, statistic] for r in runs])  # (seeds, T)

    def curve(self, spec: str, quantity: str, horizon: int) -> Curve | None:
        """Mean error; None where no run is sound."""
        runs = self.sound(spec, quantity, horizon)
        if not runs:
            return None
        values = self._statistic(runs, quantity, "mean")
        time = np.arange(1, horizon + 1) / runs[0].summary["rate_hz"]
        return Curve(time, values.mean(0), values.min(0), values.max(0), len(runs))

    def quantiles(self, spec: str, quantity: str, horizon: int) -> dict[str, np.ndarray]:
        """`QUANTILES` of the error of every step, each a mean over seeds; empty where no run is sound."""
        runs = self.sound(spec, quantity, horizon)
        return {q: self._statistic(runs, quantity, q).mean(0) for q in QUANTILES} if runs else {}

    def ceiling(self, curves: dict[str, float]) -> float:
        """Top of an axis that fits the networks: configuration → its largest value; baselines may leave it."""
        networks = [v for s, v in curves.items() if not tables.is_baseline(s) and np.isfinite(v)]
        return 1.08 * max(networks or [v for v in curves.values() if np.isfinite(v)], default=1.0) or 1.0

    def worst_window(self, spec: str, quantity: str, horizon: int) -> WorstWindow | None:
        """Of the example windows of all seeds that with the largest error in ``quantity``, and its worst axis."""
        found: tuple[float, RunRecord, pd.DataFrame] | None = None
        for run in self.sound(spec, quantity, horizon):
            t = run.windows
            t = t[(t["channel"] == quantity) | (t["channel"].str.partition(".")[0] == quantity)]
            squares = ((t["measured"] - t["predicted"]) ** 2).groupby(t["window"], sort=False).mean()
            if len(squares) and (found is None or squares.max() > found[0]):
                found = (float(squares.max()), run, t[t["window"] == squares.idxmax()])
        if found is None:
            return None
        _, run, rows = found
        axis = ((rows["measured"] - rows["predicted"]) ** 2).groupby(rows["channel"], sort=False).mean().idxmax()
        rows = rows[rows["channel"] == axis]
        factor = tables.unit_of(run, str(axis))[1]
        return WorstWindow(
            rows["time_s"].to_numpy(),
            factor * rows["measured"].to_numpy(),
            factor * rows["predicted"].to_numpy(),
            str(axis),
            str(rows["recording"].iloc[0]),
            int(run.summary["seed"]),
        )


def looks(c: Content, baselines: bool = True) -> Legend:
    """The legend of all configurations."""
    return [(look, s) for s, look in c.looks.items() if baselines or not tables.is_baseline(s)]
