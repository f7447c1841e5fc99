"""What a study leaves for the judgement of claims, small enough to be published: runs and their error curves.

``study.json`` holds the runs, ``evidence.parquet`` beside it the curves: key, quantity, norm, unit, step, statistic,
value (float32). Statistics are those that claims rest on: mean and mean@RECORDING of every signal that was predicted
whole (norms "paper" and "euclidean") and of every channel that was predicted alone, q99 of every channel. The learning
curve is there as the quantity `COST`, its steps being updates.
"""

import fnmatch
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from bench.experiment.notation import label
from bench.records.record import RunRecord

FILE = "evidence.parquet"
KEPT_BITS = 12
"""Bits of a value's fraction that are kept: a relative error below 2⁻¹³, 0.013 %, and half the file."""
COST = "validation cost"
NAMES = ("key", "quantity", "norm", "unit", "statistic")
"""Columns of text."""
_SCHEMA = pa.schema(
    [(name, pa.dictionary(pa.int32(), pa.string())) for name in NAMES] + [("step", pa.int32()), ("value", pa.float32())]
)
HISTORY = 10
"""The paper's initialization length; other ones are looked at only where they are swept."""


def evidence_table(records: Sequence[RunRecord]) -> pa.Table:
    """The rows of all records that claims can rest on, names as indices into a dictionary."""
    tables = [_SCHEMA.empty_table()]
    for record in records:
        t = record.steps
        if t.empty:  # diverged
            continue
        whole = set(t.quantity[t.norm == "paper"])
        alone = ~t.quantity.map(lambda q: str(q).partition(".")[0]).isin(whole)
        means = (t.statistic == "mean") | t.statistic.str.startswith("mean@")
        kept = t[(means & ((t.norm != "axis") | alone)) | ((t.norm == "axis") & (t.statistic == "q99"))]
        learned = record.curve.rename(columns={"update": "step", "validation_loss": "value"})
        learned = learned.assign(quantity=COST, norm="scaled", unit="1", statistic="mean")
        rows = pd.concat([kept, learned], ignore_index=True).assign(key=record.key)
        rows = rows.assign(value=_rounded(rows["value"].to_numpy(np.float32)))
        tables.append(pa.Table.from_pandas(rows, _SCHEMA, preserve_index=False))
    return pa.concat_tables(tables).unify_dictionaries().combine_chunks()


def _rounded(values: np.ndarray) -> np.ndarray:
    """float32 values of which `KEPT_BITS` bits are kept, the finite ones rounded to them."""
    bits, drop = values.view(np.uint32), np.uint32(23 - KEPT_BITS)
    rounded = (bits + (np.uint32(1) << (drop - np.uint32(1)))) >> drop << drop
    return np.where(np.isfinite(values), rounded, bits).view(np.float32)


def write_evidence(records: Sequence[RunRecord], path: Path) -> None:
    """Write the table of the records, compressed."""
    write_table(evidence_table(records), path)


def write_table(table: pa.Table, path: Path) -> None:
    """Write a table as `evidence_table` makes it, compressed."""
    pq.write_table(
        table,
        path,
        compression="zstd",
        compression_level=19,
        use_dictionary=[name for name in _SCHEMA.names if name != "value"],
        column_encoding={"value": "BYTE_STREAM_SPLIT"},
        store_schema=False,
    )


@dataclass(frozen=True)
class StudyRun:
    """One run of a study, as ``study.json`` says it."""

    key: str
    spec: str
    dataset: str
    outputs: tuple[str, ...]
    horizon: int
    seed: int
    status: str
    weights: int
    metrics: Mapping[str, float | None]
    numerics: int = 0
    """Version of the code that trained it; 0: from before that was published."""

    @classmethod
    def of(cls, summary: Mapping[str, Any]) -> "StudyRun":
        """From what a record, or ``study.json``, says of it."""
        values = {n: summary[n] for n in cls.__dataclass_fields__ if n != "numerics"}
        numerics = summary.get("numerics", summary.get("environment", {}).get("numerics", 0))
        return cls(**{**values, "outputs": tuple(values["outputs"]), "numerics": int(numerics)})

    @property
    def sound(self) -> bool:
        """Finished, with finite errors."""
        return self.status == "finished" and None not in self.metrics.values()

    @property
    def history(self) -> int | None:
        """Initialization length τ; None for a model without an initializer."""
        return label(self.spec).history


Curves = dict[str, np.ndarray]
"""Statistic → (T,) values."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """All runs of one study on one data set at one preset."""

    study: str
    dataset: str
    preset: str
    runs: tuple[StudyRun, ...]
    steps: pd.DataFrame
    first: int = 0
    """Seeds that it had when it was first looked at; 0: as many as it has."""
    superseded: tuple[str, ...] = ()
    """Trainings that do not count, since others of the same configurations do: a sentence each."""

    @property
    def seeds(self) -> int:
        """Of the configuration that has most."""
        return max((r.seed for r in self.runs), default=-1) + 1

    def seeds_of(self, patterns: Sequence[str]) -> dict[str, int]:
        """Seeds of every trained configuration that matches one of the patterns."""
        specs = {s for pattern in patterns for s in self.specs(pattern, histories=True)}
        runs = [r for r in self.runs if r.spec in specs and r.history is not None]
        return {spec: 1 + max(r.seed for r in runs if r.spec == spec) for spec in dict.fromkeys(r.spec for r in runs)}

    @cached_property
    def laid_out(self) -> dict[Any, Any]:
        """What claims have asked of it so far; see `kinds.tables.errors`."""
        return {}

    @cached_property
    def curves(self) -> dict[tuple[str, str, str], Curves]:
        """(key, quantity, norm) → its curves, in the unit of `units`."""
        columns = {name: self.steps[name].astype("category").cat for name in ("key", "quantity", "norm", "statistic")}
        named = {name: list(map(str, column.categories)) for name, column in columns.items()}
        codes = np.zeros(len(self.steps), dtype=np.int64)
        for name, column in columns.items():
            codes = codes * len(named[name]) + column.codes.to_numpy()
        steps, values = self.steps["step"].to_numpy(), self.steps["value"].to_numpy(float)
        same = codes[1:] == codes[:-1]
        starts = np.concatenate([[0], np.flatnonzero(~same) + 1])[: len(codes)]
        if len(np.unique(codes[starts])) < len(starts) or (np.diff(steps)[same] < 0).any():
            order = np.lexsort((steps, codes))
            codes, values = codes[order], values[order]
            starts = np.concatenate([[0], np.flatnonzero(np.diff(codes)) + 1])
        found: dict[tuple[str, str, str], Curves] = {}
        for code, curve in zip(codes[starts].tolist(), np.split(values, starts[1:]), strict=True):
            names = []
            for known in reversed(named.values()):
                code, index = divmod(code, len(known))
                names.append(known[index])
            statistic, norm, quantity, key = names
            found.setdefault((key, quantity, norm), {})[statistic] = curve
        return found

    @cached_property
    def learning(self) -> dict[str, pd.Series]:
        """Key → the validation cost (scaled units) at every update where it was looked at."""
        rows = self.steps[self.steps["quantity"] == COST].sort_values(["key", "step"], kind="stable")
        keys, updates, costs = rows["key"].astype(str).to_numpy(), rows["step"].to_numpy(), rows["value"].to_numpy()
        starts = np.flatnonzero(keys[1:] != keys[:-1]) + 1
        parts = (np.split(values, starts) for values in (keys, updates, costs))
        return {str(k[0]): pd.Series(cost, index=step) for k, step, cost in zip(*parts, strict=True) if len(k)}

    @cached_property
    def units(self) -> dict[str, str]:
        """Quantity → the unit of its errors."""
        rows = self.steps.drop_duplicates(["quantity", "unit"])
        return dict(zip(rows["quantity"].astype(str), rows["unit"].astype(str), strict=True))

    def specs(self, pattern: str, histories: bool = False) -> list[str]:
        """Configurations that match (fnmatch) at the paper's history, or at all histories."""
        return list(
            dict.fromkeys(
                r.spec
                for r in self.runs
                if fnmatch.fnmatchcase(r.spec, pattern) and (histories or r.history in (None, HISTORY))
            )
        )

    def matching(self, patterns: Sequence[str]) -> list[str]:
        """Those of one pattern after another; one that two patterns match is there twice."""
        return [s for pattern in patterns for s in self.specs(pattern)]

    def pairs(self, a: str, b: str) -> list[tuple[str, str]]:
        """Configurations matching a and b that belong together: the only ones, or those of equal layers and size."""
        left, right = self.specs(a), self.specs(b)
        if len(left) == 1 or len(right) == 1:
            return [(x, y) for x in left for y in right]
        return [(x, y) for x in left for y in right if label(x).size == label(y).size]

    def of(self, spec: str, horizon: int | None = None) -> list[StudyRun]:
        """The runs of one configuration."""
        return [r for r in self.runs if r.spec == spec and horizon in (None, r.horizon)]

    def weights(self, spec: str) -> int:
        """Number of weights of a configuration."""
        return self.of(spec)[0].weights
