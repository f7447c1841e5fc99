"""The simulation errors of a study's runs, beside those that others published."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pandas as pd

from bench.analysis.tables import is_baseline, sound, unit_of
from bench.experiment.study import Reference, Study
from bench.records.record import SIMULATION, RunRecord

HERE = "here"


def table(records: Sequence[RunRecord], references: Sequence[Reference]) -> pd.DataFrame:
    """One row a test recording, channel and model, the smallest error first.

    Returns:
        recording, output, model, weights (0: not known), rmse (mean over seeds), unit, seeds, source.
    """
    rows: list[dict[str, Any]] = []
    simulated = [r for r in records if any(name.startswith(SIMULATION) for name in r.summary["metrics"])]
    found = dict.fromkeys(n for r in simulated for n in r.summary["metrics"] if n.startswith(SIMULATION))
    for name in found:
        output, _, recording = name.removeprefix(SIMULATION).partition("@")
        those = [r for r in simulated if name in r.summary["metrics"]]  # physics may predict what networks do not
        unit, factor = unit_of(those[0], output)
        where = {"recording": recording, "output": output, "unit": unit}
        for spec in dict.fromkeys(r.summary["spec"] for r in those):
            own = [r for r in those if r.summary["spec"] == spec and sound(r)]
            errors = [e for r in own if (e := r.summary["metrics"].get(name)) is not None]
            said = {"model": spec, "weights": own[0].summary["weights"] if own else 0}
            rmse = factor * float(np.mean(errors)) if errors else np.nan
            rows.append({**where, **said, "rmse": rmse, "seeds": len(errors), "source": HERE})
        dataset = simulated[0].summary["dataset"]
        for r in references:
            if (r.dataset, SIMULATION + r.quantity) == (dataset, name):
                rows.append({**where, "model": r.model, "rmse": factor * r.rmse, "weights": 0, "source": r.source})
    made = pd.DataFrame(rows)
    return made.sort_values(["recording", "output", "rmse"], kind="stable") if rows else made


def _cells(group: pd.DataFrame, sources: list[str]) -> Iterator[list[str]]:
    for row in group.itertuples():
        ours = row.source == HERE
        error = "not finite" if np.isnan(row.rmse) else f"{row.rmse:.4g}"
        weights = str(row.weights) if ours and not (is_baseline(row.model) and not row.weights) else ""
        yield [row.model, error, weights, f"{HERE}, {row.seeds:.0f}" if ours else f"[{sources.index(row.source) + 1}]"]


def lines(records: Sequence[RunRecord], study: Study | None) -> list[str]:
    """The tables as Markdown; empty where nothing was simulated."""
    made = table(records, study.references() if study and study.references else ())
    if made.empty:
        return []
    sources = [s for s in dict.fromkeys(made["source"]) if s != HERE]
    out = [
        "## Simulation of whole test recordings",
        "",
        f"Each from its first {records[0].summary['history']} samples and the inputs alone; root mean square of all "
        "that follows. Rows with a number in brackets are published by others.",
        "",
    ]
    for (recording, output), group in made.groupby(["recording", "output"], sort=False):
        out += [f"### {recording}, {output}", "", f"| model | RMSE [{group['unit'].iloc[0]}] | weights | from, seeds |"]
        out += ["|---|---|---|---|", *("| " + " | ".join(cells) + " |" for cells in _cells(group, sources)), ""]
    return out + [f"[{i}] {source}  " for i, source in enumerate(sources, 1)]


def render_terminal(records: Sequence[RunRecord], study: Study | None, out: Any) -> None:
    """Print the tables; ``out`` is a rich console."""
    from rich.markup import escape
    from rich.table import Table

    made = table(records, study.references() if study and study.references else ())
    sources = [s for s in dict.fromkeys(made["source"]) if s != HERE] if len(made) else []
    for (recording, output), group in made.groupby(["recording", "output"], sort=False) if len(made) else ():
        grid = Table(
            title=escape(f"Simulation of {recording}, {output} [{group['unit'].iloc[0]}]"), title_justify="left"
        )
        for name in ("model", "RMSE", "weights", "from, seeds"):
            grid.add_column(name, justify="left" if name == "model" else "right")
        for cells in _cells(group, sources):
            grid.add_row(*map(escape, cells))
        out.print(grid)
    for i, source in enumerate(sources, 1):
        out.print(escape(f"[{i}] {source}"), style="dim", highlight=False)
