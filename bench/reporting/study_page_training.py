"""The last sections of a study's page: how training went, which runs were lost, and where the numbers come from."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import numpy as np

from bench.analysis import tables
from bench.records.record import RunRecord
from bench.reporting import figures, report
from bench.reporting import study_page_figures as drawings
from bench.reporting.study_page_content import Content, Legend, Plain, Titled, looks


def _predicted(record: RunRecord) -> str:
    """What a run was trained on: "velocity, body rates p"; views that it is also judged in are left out."""
    names = [n for n in tables.quantities([record]) if "(" not in tables.named(n)]
    return ", ".join(figures.title(n) for n in figures.principal(names))


@dataclass(frozen=True)
class _Training:
    legend: Legend
    horizons: Titled
    times: Plain
    lost: Sequence[Sequence[str]]
    runs: int


@dataclass(frozen=True)
class _Provenance:
    facts: dict[str, Sequence[str]]
    """By name; alike ones once."""
    runs: Sequence[Sequence[str]]
    command: str


def training(c: Content) -> _Training:
    """Learning curves, times, and runs that diverged."""
    found = []
    for horizon in c.horizons:
        groups: dict[str, list[RunRecord]] = {}
        for r in c.records:
            if r.summary["horizon"] == horizon and not tables.is_baseline(r.summary["spec"]):
                groups.setdefault(_predicted(r), []).append(r)
        drawn = [d for name, runs in groups.items() if (d := drawings.learning(c, name, runs))]
        if drawn:
            found.append((c.duration(horizon), drawn))
    return _Training(looks(c, baselines=False), found, _times(c), _lost(c), len(c.records))


def _times(c: Content) -> Plain:
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
            rows.append(
                [
                    spec,
                    str(horizon),
                    str(len(runs)),
                    f"{np.mean(updates):.0f}",
                    f"{np.mean(best):.0f}" if best else "–",
                    report.number(float(np.mean(seconds))),
                    report.number(1000 * sum(seconds) / sum(updates)) if sum(updates) else "–",
                    str(sum(not tables.sound(r) for r in runs)),
                ]
            )
    return Plain(heads, rows)


def _lost(c: Content) -> list[list[str]]:
    rows = []
    for r in c.lost():
        s = r.summary
        when = f"at update {s['diverged_at']}" if not r.finished else "its test errors are not finite"
        rows.append([s["spec"], _predicted(r), str(s["horizon"]), str(s["seed"]), when])
    return rows


def provenance(c: Content) -> _Provenance:
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
    return _Provenance({n: list(dict.fromkeys(said)) for n, said in facts.items()}, _runs(c.records), c.command)


def _recordings(parts: dict[str, list[str]]) -> str:
    """Such as "13 train, 4 test (melon_1, melon_2, …)": test recordings by name."""
    test = parts.get("test", [])
    counts = ", ".join(f"{len(names)} {part}" for part, names in parts.items() if part != "test")
    return f"{counts}; {len(test)} test: {', '.join(test)}".lstrip("; ")


def _runs(records: Iterable[RunRecord]) -> list[list[str]]:
    return [
        [str(s[name]) for name in ("key", "spec")]
        + [_predicted(r)]
        + [str(s[name]) for name in ("horizon", "seed", "status")]
        for r in records
        for s in [r.summary]
    ]


LAST_SECTIONS: tuple[tuple[str, str, Callable[[Content], Any]], ...] = (
    ("Training", "training", training),
    ("Provenance", "provenance", provenance),
)
"""As `study_page_sections.SECTIONS`."""
