"""A sweep as one HTML file that needs no network: was it worth it, how the search went, what mattered."""

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from bench.analysis import stats, tables
from bench.reporting import figures, page, report
from bench.reporting.page import Section
from bench.sweep import journal as sweeps
from bench.sweep.finalists import Verdict
from bench.sweep.page_search import Content, front, history, importances, shown, slices, trials
from bench.sweep.space import SPEC, described, options
from registry.atomic_io import writing

Cell = tuple[str, str]
"""A value and its interval; empty: there is none."""


@dataclass(frozen=True)
class _Result:
    verdicts: Sequence[tuple[str, str]]
    """Tone and sentence; none where the default is the best."""
    seeds: int
    heads: Sequence[str]
    sides: Sequence[tuple[str, Sequence[Cell]]]
    """The best and the default: name and cells."""
    best: int
    """Number of the best trial."""
    options: Sequence[Sequence[str]]


@dataclass(frozen=True)
class _Provenance:
    facts: dict[str, str]
    command: str


def result(c: Content) -> _Result:
    """Whether the best beats the default, and with which options."""
    heads, sides = _side_by_side(c)
    return _Result(
        verdicts=[(_tone(v), v.sentence) for v in c.verdicts],
        seeds=len(c.best_records),
        heads=heads,
        sides=sides,
        best=c.best.number,
        options=_options(c),
    )


def _tone(v: Verdict) -> str:
    return {"better": "better", "worse": "worse"}.get(v.comparison.verdict, "open")


def _side_by_side(c: Content) -> tuple[list[str], list[tuple[str, list[Cell]]]]:
    """Errors of both, mean over seeds, on both parts; and in the units of each output on the test part."""
    records = {"best": c.best_records, "default": c.default_records}
    made: dict[str, Any] = {name: tables.study_table(list(runs)) for name, runs in records.items() if runs}
    every = tables.quantities(c.best_records)
    whole = tables.whole_signals(every)  # they say enough of their axes
    quantities = [q for q in every if q in whole or q.partition(".")[0] not in whole]
    units = {row.output: row.unit for row in made["best"].itertuples()}
    heads = ["configuration", "weights", *(f"{v.part} RMSSE [std. dev.]" for v in c.verdicts)]
    heads += [f"test RMSSE, {figures.title(q)} [{units[q]}]" for q in quantities]
    sides = []
    for name, found in made.items():
        first = records[name][0].summary
        by = {row.output: row for row in found.itertuples()}
        cells: list[Cell] = [(str(first["weights"]), "")]
        for v in c.verdicts:
            cells.append(_mean([float(np.mean(seed)) for seed in (v.best if name == "best" else v.default)]))
        cells += [(report.with_interval(by[q]), "") for q in quantities]
        sides.append((f"{name}: {first['spec']}", cells))
    return heads, sides


def _mean(values: Sequence[float]) -> Cell:
    if not values:
        return "–", ""
    limits = stats.interval(values)
    text = report.number(float(np.mean(values)))
    return text, f"{report.number(limits[0])} to {report.number(limits[1])}" if limits else ""


def _options(c: Content) -> list[list[str]]:
    have = {path: value for path, _, value in options(c.sweep.default)} | {SPEC: c.sweep.default.spec}
    return [
        [path, shown(c.best.params[path]), shown(have[path]), described(path, distribution).removeprefix(path).strip()]
        for path, distribution in c.sweep.space.items()
    ]


def provenance(c: Content) -> _Provenance:
    """Data, code, and the command."""
    record = c.best_records[0]
    s, p = record.summary, record.provenance
    facts = {
        "Data": f"{s['dataset']}, SHA-256 {s['dataset_digest']}",
        "Windows": ", ".join(f"{s['windows'][part]} {part}" for part in ("train", "validation", "test")),
        "Recordings": "; ".join(
            f"{part}: {', '.join(s['recordings'][part])}" for part in ("train", "validation", "test")
        ),
        "Search": f"Optuna {version('optuna')}, TPE, seed {c.sweep.seed}; journal {sweeps.JOURNAL} beside this page",
        "Code": f"commit {p['git']}".replace("+", " with changes"),
        "Versions": ", ".join(f"{name} {v}" for name, v in p["versions"].items()),
        "Finalists": ", ".join(r.key for r in (*c.best_records, *c.default_records)),
    }
    return _Provenance(facts, c.sweep.command)


SECTIONS = (
    ("Result", "result", result),
    ("Search", "history", history),
    ("What mattered", "importances", importances),
    ("Error against each option", "slices", slices),
    ("Pareto front", "front", front),
    ("Trials", "trials", lambda c: trials(c, c.finished)),
    ("Provenance", "provenance", provenance),
)
"""Title, macro of ``sweep_sections.html.j2``, and what that is given."""


def render(c: Content) -> str:
    """The page as text."""
    return page.render(
        page.templates(Path(__file__).with_name("templates")),
        "sweep.html.j2",
        c.sweep.title,
        [Section(title, part, content(c)) for title, part, content in SECTIONS],
        trials=len(c.finished),
        heading=c.sweep.title[:1].upper() + c.sweep.title[1:],
    )


def write(path: Path, c: Content) -> None:
    """Write the page.

    Raises:
        BenchError: the file cannot be written, or a record is damaged.
    """
    text = render(c)
    with writing(f"The report {path}"):
        path.write_text(text, encoding="utf-8")
