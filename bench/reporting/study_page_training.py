"""The last sections of a study's page: how training went, which runs were lost, and where the numbers come from."""

from collections.abc import Iterable
from datetime import UTC, datetime
from html import escape
from typing import Any

import numpy as np

from bench.analysis import tables
from bench.records.record import RunRecord
from bench.reporting import figures, report
from bench.reporting import study_page_figures as drawings
from bench.reporting.page import grid, table
from bench.reporting.study_page_content import Content
from bench.reporting.study_page_sections import looks


def _predicted(record: RunRecord) -> str:
    """What a run was trained on: "velocity, body rates p"; views that it is also judged in are left out."""
    names = [n for n in tables.quantities([record]) if "(" not in tables.named(n)]
    return ", ".join(figures.title(n) for n in figures.principal(names))


def training(c: Content) -> str:
    """Learning curves, times, and runs that diverged."""
    body = "<p>One line a run; the network kept is that of the lowest validation cost.</p>"
    body += looks(c, baselines=False)
    for horizon in c.horizons:
        groups: dict[str, list[RunRecord]] = {}
        for r in c.records:
            if r.summary["horizon"] == horizon and not tables.is_baseline(r.summary["spec"]):
                groups.setdefault(_predicted(r), []).append(r)
        drawn = [d for name, runs in groups.items() if (d := drawings.learning(c, name, runs))]
        if drawn:
            body += f"<h3>{escape(c.duration(horizon))}</h3>{grid(drawn)}"
    return f"{body}<h3>Time</h3>{_times(c)}{_lost(c)}"


def _times(c: Content) -> str:
    heads = ["configuration", "T", "runs", "updates", "best update", "time a run [s]", "ms an update", "diverged"]
    rows = []
    for spec in (s for s in c.specs if not tables.is_baseline(s)):
        for horizon in c.horizons:
            runs = [r for r in c.records if (r.summary["spec"], r.summary["horizon"]) == (spec, horizon)]
            if not runs:
                continue
            seconds = [r.provenance["seconds"] for r in runs]
            updates = [r.summary["updates"] for r in runs]
            best = [r.summary["best_update"] for r in runs if r.summary["best_update"] is not None]
            cells = [
                str(horizon),
                str(len(runs)),
                f"{np.mean(updates):.0f}",
                f"{np.mean(best):.0f}" if best else "–",
                report.number(float(np.mean(seconds))),
                report.number(1000 * sum(seconds) / sum(updates)) if sum(updates) else "–",
                str(sum(not tables.sound(r) for r in runs)),
            ]
            shown = "".join(
                f'<td class="number" data-label="{h}">{v}</td>' for h, v in zip(heads[1:], cells, strict=True)
            )
            rows.append(f"<tr><td>{escape(spec)}</td>{shown}</tr>")
    note = (
        '<p class="quiet">Means over runs, on one thread each, test included. Networks of one shape are trained side '
        "by side; a run's time is its share of theirs.</p>"
    )
    return note + table(heads, rows, range(1, len(heads)))


def _lost(c: Content) -> str:
    lost = c.lost()
    if not lost:
        return '<p class="after">No run diverged.</p>'
    rows = []
    for r in lost:
        s = r.summary
        when = f"at update {s['diverged_at']}" if not r.finished else "its test errors are not finite"
        cells = [s["spec"], _predicted(r), str(s["horizon"]), str(s["seed"]), when]
        rows.append("<tr>" + "".join(f"<td>{escape(t)}</td>" for t in cells) + "</tr>")
    many = f"{len(lost)} of {len(c.records)} runs diverged"
    return f"<h3>{many}</h3>{table(['configuration', 'outputs', 'T', 'seed', 'when'], rows)}"


def provenance(c: Content) -> str:
    """Data, code, machine, and the command that makes all of it again."""
    seconds = sum(r.provenance["seconds"] for r in c.records)
    starts = [r.provenance["started_ms"] for r in c.records]
    dates = {datetime.fromtimestamp(ms / 1000, UTC).date().isoformat() for ms in (min(starts), max(starts))}

    def of(where: str, name: str) -> list[str]:
        return [str(getattr(r, where).get(name, "")) for r in c.records]

    def pairs(found: dict[str, Any]) -> str:
        return ", ".join(f"{name} {value}" for name, value in found.items())

    facts = {
        "Data": [f"{r.summary['dataset']}, SHA-256 {r.summary['dataset_digest']}" for r in c.records],
        "Rate": [f"{r.summary['rate_hz']:g} Hz" for r in c.records],
        "Inputs": [", ".join(r.summary["inputs"]) for r in c.records],
        "History": sorted({f"{v} samples" for v in of("summary", "history")}, key=lambda t: int(t.split()[0])),
        "Windows": [", ".join(f"{v} {k}" for k, v in r.summary["windows"].items()) for r in c.records],
        "Recordings": [_recordings(r.summary["recordings"]) for r in c.records],
        "Code": [f"commit {g}".replace("+", " with changes") for g in of("provenance", "git") if g],
        "Versions": [pairs(r.provenance["versions"]) for r in c.records],
        "Machine": [pairs(r.provenance["host"]) for r in c.records],
        "Numerics": [pairs(r.summary["environment"]) for r in c.records],
        "Made": [f"{' to '.join(sorted(dates))} (UTC), {seconds:.0f} s of training and test in {len(c.records)} runs"],
    }
    rows = [
        f"<tr><td>{name}</td><td>{'<br>'.join(map(escape, dict.fromkeys(said)))}</td></tr>"
        for name, said in facts.items()
        if said
    ]
    again = f"<h3>To make it again</h3><pre>{escape(c.command)}</pre>"
    return f"{table(['', ''], rows, kind='facts')}{_runs(c.records)}{again}"


def _recordings(parts: dict[str, list[str]]) -> str:
    """Such as "13 train, 4 test (melon_1, melon_2, …)": test recordings by name."""
    test = parts.get("test", [])
    counts = ", ".join(f"{len(names)} {part}" for part, names in parts.items() if part != "test")
    return f"{counts}; {len(test)} test: {', '.join(test)}".lstrip("; ")


def _runs(records: Iterable[RunRecord]) -> str:
    def row(r: RunRecord) -> str:
        s: dict[str, Any] = r.summary
        cells = [s["key"], s["spec"], _predicted(r), str(s["horizon"]), str(s["seed"]), s["status"]]
        return "<tr>" + "".join(f"<td>{escape(t)}</td>" for t in cells) + "</tr>"

    listed = table(["key", "configuration", "outputs", "T", "seed", "status"], map(row, records))
    return f"<details><summary>All runs</summary>{listed}</details>"
