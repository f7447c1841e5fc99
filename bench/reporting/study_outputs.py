"""What a study leaves behind: one folder with its table, figures and every step of every run in one long table."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from bench.analysis.tables import specs
from bench.claims.evidence import FILE, write_evidence
from bench.experiment.grid import matched
from bench.experiment.study import Study
from bench.records.record import RunRecord
from bench.records.stamp import canonical
from registry import atomic_io
from registry.errors import BenchError

STEPS = "steps.parquet"
REPORT = "report.html"
PUBLISHED = ("key", "spec", "dataset", "outputs", "horizon", "seed", "status", "weights", "updates", "metrics")
"""What ``study.json`` says of every run, so that a published number can be checked against a new one."""


def write_steps(records: Sequence[RunRecord], path: Path) -> None:
    """One long table: the columns of `RunRecord.steps`, key, spec, seed and horizon; a record at a time in memory."""

    def rows(r: RunRecord) -> pa.Table:
        said = {"key": r.key, **{name: r.summary[name] for name in ("spec", "seed", "horizon")}}
        return pa.Table.from_pandas(r.steps.assign(**said), preserve_index=False)

    kept = [r for r in records if not r.steps.empty] or records[:1]  # one that diverged has no rows, and no types
    with pq.ParquetWriter(path, rows(kept[0]).schema, compression="zstd") as target:
        for r in kept:
            target.write_table(rows(r))


def write_outputs(
    out: Any, records: Sequence[RunRecord], title: str, study: Study | None, command: str, folder: Path
) -> list[Path]:
    """Print the table and write the study's folder.

    Args:
        out: a rich console.
        records: all runs of the study, baselines included.
        title: heading.
        study: for the pairs to compare; None for a single configuration.
        command: the command that makes this again.
        folder: where the files go.

    Returns:
        The files worth attaching to a tracker.
    """
    from bench.reporting import report, simulations

    pairs = tuple(matched(study.pairs, specs(records))) if study else ()
    report.render_terminal(records, pairs, out, study.contrasts if study else ())
    simulations.render_terminal(records, study, out)
    try:
        return _write(records, title, study, command, folder)
    except OSError as error:
        raise BenchError(
            f"The results folder {folder} cannot be written: {error.strerror or error}; every finished run is kept, "
            "and the same command makes the rest."
        ) from error


def _write(records: Sequence[RunRecord], title: str, study: Study | None, command: str, folder: Path) -> list[Path]:
    """The files of the folder, each whole or as it was; ``study.json``, which says that all are there, comes last."""
    folder.mkdir(parents=True, exist_ok=True)
    with atomic_io.drafting(folder, ".outputs.") as draft:
        _draw(records, title, study, command, draft)
        made = sorted(draft.iterdir())
        for file in made:
            atomic_io.flush(file)
            atomic_io.move(file, folder / file.name)
    files = [folder / p.name for p in made if p.suffix in (".png", ".svg", ".md", ".html")]
    content = {
        "title": title,
        "study": study.name if study else None,
        "keys": [r.key for r in records],
        "command": command,
        "files": [p.name for p in files],
        "runs": [
            {name: r.summary[name] for name in PUBLISHED} | {"numerics": r.summary["environment"].get("numerics", 0)}
            for r in records
        ],
    }
    atomic_io.write_text(folder / "study.json", canonical(content))
    return files


def _draw(records: Sequence[RunRecord], title: str, study: Study | None, command: str, folder: Path) -> None:
    """Figures, tables and page in an empty folder."""
    from bench.reporting import figures, report, simulations, study_page

    pairs = tuple(matched(study.pairs, specs(records))) if study else ()
    within = study.contrasts if study else ()
    figures.per_step_figure(records, folder / "error_per_step.png")
    if study is None and records[0].finished:
        figures.box_figure(records[0], folder / "error_distribution.png")
    text = report.to_markdown(records, pairs, title, command, "error_per_step.png", within)
    whole = simulations.lines(records, study)
    (folder / "table.md").write_text("\n".join([text, *whole]).rstrip() + "\n" if whole else text)
    study_page.write(folder / REPORT, records, title, study, command)
    write_steps(records, folder / STEPS)
    write_evidence(records, folder / FILE)
