"""A sweep as one HTML file that needs no network: was it worth it, how the search went, what mattered."""

from collections.abc import Sequence
from html import escape
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from bench.analysis import stats, tables
from bench.reporting import figures, report
from bench.reporting.page import document, table
from bench.sweep import journal as sweeps
from bench.sweep.finalists import Verdict
from bench.sweep.page_search import Content, front, history, importances, shown, slices, trials_table
from bench.sweep.space import SPEC, options, said
from registry.errors import BenchError


def result(c: Content) -> str:
    """Whether the best beats the default, and with which options."""
    if not c.verdicts:
        body = "<p>No trial was better than the default configuration, so there is nothing to compare.</p>"
    else:
        body = "".join(f'<p class="lead {_tone(v)}">{escape(v.sentence)}</p>' for v in c.verdicts) + (
            f'<p class="quiet">Both were trained from {len(c.best_records)} seeds that the sweep had not used. The '
            "sweep chose by the validation part, which therefore flatters its choice; the test part was looked at "
            "once, now. Errors are in standard deviations of each output over the training part: 1 is as bad as the "
            "mean.</p>"
        )
    return body + _side_by_side(c) + _options_table(c)


def _tone(v: Verdict) -> str:
    return {"better": "better", "worse": "worse"}.get(v.comparison.verdict, "open")


def _side_by_side(c: Content) -> str:
    """Errors of both, mean over seeds, on both parts; and in the units of each output on the test part."""
    sides = {"best": c.best_records, "default": c.default_records}
    rows, heads = [], ["configuration", "weights"]
    heads += [f"{v.part} RMSSE [std. dev.]" for v in c.verdicts]
    made: dict[str, Any] = {name: tables.study_table(list(runs)) for name, runs in sides.items() if runs}
    every = tables.quantities(c.best_records)
    whole = tables.whole_signals(every)  # they say enough of their axes
    quantities = [q for q in every if q in whole or q.partition(".")[0] not in whole]
    units = {row.output: row.unit for row in made["best"].itertuples()}
    heads += [f"test RMSSE, {escape(figures.title(q))} [{escape(units[q])}]" for q in quantities]
    for name, found in made.items():
        cells = [str(sides[name][0].summary["weights"])]
        for v in c.verdicts:
            per_seed = [float(np.mean(seed)) for seed in (v.best if name == "best" else v.default)]
            cells.append(_mean(per_seed))
        by = {row.output: row for row in found.itertuples()}
        cells += [report.with_interval(by[q]) for q in quantities]
        shown = "".join(f'<td class="number" data-label="{h}">{v}</td>' for h, v in zip(heads[1:], cells, strict=True))
        rows.append(f"<tr><td>{name}: {escape(sides[name][0].summary['spec'])}</td>{shown}</tr>")
    return table(heads, rows, range(1, len(heads)), "errors")


def _mean(values: Sequence[float]) -> str:
    if not values:
        return "–"
    limits = stats.interval(values)
    text = report.number(float(np.mean(values)))
    return text + (f" <small>({report.number(limits[0])} to {report.number(limits[1])})</small>" if limits else "")


def _options_table(c: Content) -> str:
    have = {path: value for path, _, value in options(c.sweep.default)} | {SPEC: c.sweep.default.spec}
    rows = []
    for path, distribution in c.sweep.space.items():
        cells = (shown(c.best.params[path]), shown(have[path]), said(path, distribution).removeprefix(path).strip())
        rows.append(f"<tr><td>{escape(path)}</td>" + "".join(f"<td>{escape(x)}</td>" for x in cells) + "</tr>")
    return f"<h3>Options</h3>{table(['option', f'best (trial {c.best.number})', 'default', 'searched'], rows)}"


def trials(c: Content) -> str:
    """Every trial, folded away."""
    return f"<details><summary>All {len(c.told)} trials</summary>{trials_table(c, c.told)}</details>"


def provenance(c: Content) -> str:
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
    rows = [f"<tr><td>{name}</td><td>{escape(text)}</td></tr>" for name, text in facts.items()]
    return f"{table(['', ''], rows, kind='facts')}<h3>To make it again</h3><pre>{escape(c.sweep.command)}</pre>"


def render(c: Content) -> str:
    """The page as text."""
    sections = {
        "Result": result(c),
        "Search": history(c),
        "What mattered": importances(c),
        "Error against each option": slices(c),
        "Pareto front": front(c),
        "Trials": trials(c),
        "Provenance": provenance(c),
    }
    head = (
        f'<header><p class="over"><span class="badge">sweep</span><span>{len(c.told)} trials</span></p>'
        f"<h1>{escape(c.sweep.title[:1].upper() + c.sweep.title[1:])}</h1></header>"
    )
    return document(
        c.sweep.title,
        head,
        {name: body for name, body in sections.items() if body},
        "Intervals are 95 %.",
        Path(__file__).parent.with_name("reporting") / "study_page.css",
    )


def write(path: Path, c: Content) -> None:
    """Write the page.

    Raises:
        BenchError: the file cannot be written, or a record is damaged.
    """
    page = render(c)
    try:
        path.write_text(page, encoding="utf-8")
    except OSError as error:
        raise BenchError(f"The report {path} cannot be written: {error.strerror or error}.") from error
