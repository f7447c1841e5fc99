"""The attainable line in what was published before studies had it: `python tests/attainable_rows.py`.

Every folder below results/published/ whose flights are simulated and that has no line yet gets it: in ``study.json``,
``evidence.parquet`` and ``table.md``, and in the figure, which is drawn from the evidence. The line is that of another
published folder with the same flights and outputs, where there is one; else it is run, as the study declares it, and
`constant` beside it, which must have its published errors. Nothing that was there changes; but channels of a signal
that was predicted whole have no curves in the evidence, so that the figure shows the whole signal there. Runs are kept
in the folder --kept, so that a second call goes on; four minutes of a core.
"""

import argparse
import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, cast

import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from bench.analysis.tables import is_baseline, study_table
from bench.claims import gathering, manifest
from bench.claims.evidence import FILE, NAMES, StudyRun, evidence_table, write_table
from bench.claims.gathering import Folder
from bench.execution import engine
from bench.experiment.request import Options, request
from bench.records.record import RunRecord
from bench.records.stamp import canonical
from bench.reporting import figures, report
from bench.reporting.study_outputs import PUBLISHED
from registry import atomic_io
from registry.errors import BenchError

LINE, CONTROL = "attainable", "constant"
SAMPLE = 0.01
"""Of simulated flights [s]."""
WITH = (
    "Rows, sentences and curve of `attainable` were added by `python tests/attainable_rows.py`; all others are as they "
    "were."
)


@dataclass(frozen=True)
class Line:
    """What a folder gets."""

    runs: list[dict[str, Any]]
    """As ``study.json`` has them."""
    evidence: pa.Table
    rows: dict[int, list[str]]
    """Horizon → lines of the Markdown table."""


@dataclass(frozen=True, eq=False)
class Kept:
    """A published run as tables and figures ask a record: its outputs are what the evidence has curves of."""

    run: dict[str, Any]
    rows: pd.DataFrame = field(repr=False)
    """Of the evidence, this run's alone, with time_s [s]."""

    @cached_property
    def summary(self) -> dict[str, Any]:
        return self.run | {"outputs": list(dict.fromkeys(self.rows.quantity))}

    @cached_property
    def steps(self) -> pd.DataFrame:
        """The curves that are reported: of signals in the paper's norm, which is called that of an axis here."""
        return self.rows.assign(norm="axis")

    @property
    def finished(self) -> bool:
        return self.run["status"] == "finished"


def views(runs: Sequence[dict[str, Any]], evidence: pa.Table) -> list[RunRecord]:
    """Runs as records."""
    table = evidence.to_pandas().astype(dict.fromkeys(NAMES, str))
    mean = table.statistic.str.startswith("mean") & table.norm.isin(("paper", "axis"))
    table = table[mean].assign(time_s=lambda t: t.step * SAMPLE)
    found = {key: rows.reset_index(drop=True) for key, rows in table.groupby("key")}
    return [cast(RunRecord, Kept(r, found.get(r["key"], table[:0]))) for r in runs]


def errors(folder: Folder, spec: str) -> dict[Any, Any]:
    """(outputs, horizon) → errors of a configuration that has no seed."""
    return {(r.outputs, r.horizon): r.metrics for r in folder.runs if r.spec == spec}


def published(folder: Folder, others: Sequence[Folder]) -> Line | None:
    """The line of another folder, which has the same flights if `constant` has the same errors on them."""
    wanted = errors(folder, CONTROL)
    for other in others:
        if errors(other, LINE).keys() == wanted.keys() and errors(other, CONTROL) == wanted:
            runs = [r for r in json.loads((other.path / "study.json").read_text())["runs"] if r["spec"] == LINE]
            table = read(other.path / FILE)
            table = table.filter(pc.is_in(table["key"], pa.array([r["key"] for r in runs])))
            rows: dict[int, list[str]] = {}
            horizon = 0
            for text in (other.path / "table.md").read_text().splitlines():
                if text.startswith("## T = "):
                    horizon = int(text.split()[3])
                if f" | {LINE} | " in text:
                    rows.setdefault(horizon, []).append(text)
            return Line(runs, table, rows)
    return None


def made(folder: Folder, kept: Path) -> Line:
    """The line, run here.

    Raises:
        BenchError: `constant` has other errors than were published.
    """
    asked = request(folder.study, Options(folder.runs[0].dataset, folder.preset))
    wanted = [c for c in asked.configs if c.spec in (LINE, CONTROL)]
    records = engine.execute(engine.plan(wanted, kept), kept)
    there = errors(folder, CONTROL)
    for run in (StudyRun.of(r.summary) for r in records if r.summary["spec"] == CONTROL):
        if there.get((run.outputs, run.horizon)) != run.metrics:
            raise BenchError(f"{folder.path}: {CONTROL} has {run.metrics} here, not what was published: other flights.")
    records = [r for r in records if r.summary["spec"] == LINE]
    rows: dict[int, list[str]] = {}
    for row in study_table(records).itertuples():
        rows.setdefault(int(cast(int, row.horizon)), []).append(report.markdown_row(report.table_cells(row)))
    runs = [
        {name: r.summary[name] for name in PUBLISHED} | {"numerics": r.summary["environment"]["numerics"]}
        for r in records
    ]
    return Line(runs, evidence_table(records), rows)


def with_rows(text: str, line: Line, sentences: Sequence[str], runs: int) -> str:
    """A published table with the line: its rows below the last one of each output, and what is said of it."""
    lines = text.splitlines()
    at = next(i for i, found in enumerate(lines) if found.startswith("Data: "))
    lines[at] = f"{lines[at].rpartition('; ')[0]}; {runs} runs. {WITH}"
    at = max(i for i, found in enumerate(lines) if "beside the baseline" in found)
    lines[at + 1 : at + 1] = [f"- {s}" for s in sentences]
    for horizon, rows in line.rows.items():
        for row in rows:
            begun = lines.index(f"## T = {horizon} steps")
            end = next((i for i in range(begun + 1, len(lines)) if lines[i].startswith("#")), len(lines))
            head = row[: row.index(f"{LINE} |")]
            lines.insert(max(i for i in range(begun, end) if lines[i].startswith(head)) + 1, row)
    return "\n".join(lines) + "\n"


def read(path: Path) -> pa.Table:
    """Evidence as `evidence_table` makes it."""
    return pq.read_table(path, read_dictionary=list(NAMES)).cast(evidence_table([]).schema)


def add(folder: Folder, line: Line) -> None:
    """Add the line to a published folder; ``study.json``, which says that it is there, comes last."""
    path = folder.path
    study = json.loads((path / "study.json").read_text())
    study["runs"] += line.runs
    study["keys"] += [r["key"] for r in line.runs]
    table = pa.concat_tables([read(path / FILE), line.evidence]).unify_dictionaries().combine_chunks()
    records = views(study["runs"], table)
    beside = [r for r in records if r.summary["spec"] == LINE or not is_baseline(r.summary["spec"])]
    said = [s for s in report.sentences(beside, ()) if f"baseline `{LINE}`" in s]
    text = with_rows((path / "table.md").read_text(), line, said, len(study["runs"]))
    (drawn, vector) = figures.per_step_figure(records, path / "error_per_step.png")
    vector.unlink()
    write_table(table, path / FILE)
    atomic_io.write_text(path / "table.md", text)
    atomic_io.write_text(path / "study.json", canonical(study))
    for file in (drawn, path / FILE, path / "table.md", path / "study.json"):
        manifest.entered(file)


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    options.add_argument("--published", type=Path, default=Path("results/published"))
    options.add_argument("--kept", type=Path, default=Path("results/runs"))
    given = options.parse_args()
    twins = [f for f in gathering.folders(given.published) if f.runs and f.runs[0].dataset.endswith("_twin")]
    for folder in twins:
        if folder.comparable and not errors(folder, LINE):
            print(folder.path, flush=True)
            add(folder, published(folder, twins) or made(folder, given.kept))


if __name__ == "__main__":
    main()
