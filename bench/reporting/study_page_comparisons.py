"""What a study's page shows of its question and its verdicts."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from markupsafe import Markup

from bench.analysis import stats
from bench.analysis.tables import POOLED
from bench.reporting import figures, report
from bench.reporting.drawing import Scale, interval
from bench.reporting.study_page_content import Content, Plain

_TONES = {"better": "better", "worse": "worse"}


# ------------------------------------------------------------------------------------------ the paper and this study


@dataclass(frozen=True)
class _Finding:
    ratio: str
    short: str
    """The verdict in a word or two."""
    tone: str


@dataclass(frozen=True)
class _FoundGroup:
    title: str
    phases: int
    rows: Sequence[tuple[str | tuple[str, str], Sequence[_Finding]]]
    """Name, or both sides of a ratio, and a cell a phase."""


@dataclass(frozen=True)
class _Findings:
    phases: list[str]
    groups: Sequence[_FoundGroup]


@dataclass(frozen=True)
class _Asked:
    source: str
    said: Sequence[str]
    data: str
    findings: _Findings | None
    smoke: bool
    errors: Plain | None
    """Where nothing is compared."""


def asked_and_found(c: Content) -> _Asked | None:
    """The paper's figure and ours, side by side."""
    if not c.study:
        return None
    said = (c.study.paper_says or c.study.question).splitlines()
    return _Asked(
        source=c.study.source,
        said=[line for line in said if line.strip()],
        data=", ".join(sorted({r.summary["dataset"] for r in c.records})),
        findings=_findings(c) if c.grids else None,
        smoke=c.smoke,
        errors=None if c.grids else _short_errors(c),
    )


def _findings(c: Content) -> _Findings:
    """Ratios and verdicts in short; grids that follow one another under one heading."""
    groups: list[_FoundGroup] = []
    for g in c.grids:
        between = g.rows_are == "output"
        leading = _leading(g)
        what = figures.title(leading[0]) if between else f"{figures.title(g.a)} / {figures.title(g.b)}"
        title = f"{c.duration(g.horizon)}, {what}"
        rows = [
            (_sides(g) if between else name, [_finding(cell, c.smoke) for cell in cells])
            for name, cells in ([leading] if between else g.rows)
        ]
        if groups and groups[-1].title == title:
            groups[-1] = _FoundGroup(title, groups[-1].phases, [*groups[-1].rows, *rows])
        else:
            groups.append(_FoundGroup(title, len(g.phases), rows))
    return _Findings(c.grids[0].phases, groups)


def _finding(cell: Any, smoke: bool) -> _Finding:
    short = "" if smoke else report.verdict_cell(cell)[1].partition(";")[0]
    return _Finding(report.number(cell.ratio), short, _tone(cell, smoke))


def _leading(g: report.Grid) -> tuple[str, list[Any]]:
    """The row over all outputs, or the first."""
    return next((row for row in g.rows if row[0] == POOLED), g.rows[0])


def _sides(g: report.Grid) -> tuple[str, str]:
    """Both sides of a ratio."""
    a, b = ((figures.title(n) if g.rows_are == "configuration" else n) for n in (g.a, g.b))
    return a, b


def _tone(cell: Any, smoke: bool) -> str:
    return "open" if smoke else _TONES.get(cell.verdict, "open")


def _short_errors(c: Content) -> Plain:
    """RMSSE of every configuration: a column a quantity and horizon."""
    columns = [(h, q) for h in c.horizons for q in c.quantities(h)]
    values = {(r.spec, r.horizon, r.output): r for r in c.table.itertuples()}
    heads = ["RMSSE", *(f"{figures.title(q)}, T = {h} [{c.unit(q)}]" for h, q in columns)]
    rows = [
        [spec, *(report.number(r.rmsse) if (r := values.get((spec, h, q))) else "" for h, q in columns)]
        for spec in c.specs
    ]
    return Plain(heads, rows)


# ------------------------------------------------------------------------------------------------------- comparisons


@dataclass(frozen=True)
class _Ratio:
    text: str
    note: str
    drawn: Markup
    tone: str


@dataclass(frozen=True)
class _Pair:
    sides: tuple[str, str]
    rows: Sequence[tuple[str, Sequence[_Ratio]]]
    """Name and a cell a phase."""


@dataclass(frozen=True)
class _Compared:
    title: str
    heads: Sequence[str]
    rows_are: str
    main: Sequence[_Pair]
    rest: Sequence[_Pair]
    """Of single axes."""


@dataclass(frozen=True)
class _Comparisons:
    how_to_read: str
    low: str
    high: str
    groups: Sequence[_Compared]
    sentences: Sequence[str]


def comparisons(c: Content) -> _Comparisons | None:
    """Ratios with intervals, then the same in sentences."""
    if not c.grids:
        return None
    limits = [v for g in c.grids for _, cells in g.rows for r in cells for v in (r.low, r.high) if math.isfinite(v)]
    scale = Scale(max(1 / 64, min([0.5, *limits])), min(64.0, max([2.0, *limits])), log=True)
    groups = []
    for horizon in c.horizons:
        for rows_are, first in (("output", "configurations"), ("configuration", "outputs")):
            at = [g for g in c.grids if g.horizon == horizon and g.rows_are == rows_are]
            if not at:
                continue
            every = {name for g in at for name, _ in g.rows}
            main = {*c.principal, POOLED} if rows_are == "output" else every
            groups.append(
                _Compared(
                    title=f"{c.duration(horizon)}, {first}",
                    heads=[first, rows_are, *at[0].phases],
                    rows_are=rows_are,
                    main=list(_compared(at, scale, main, c.smoke)),
                    rest=list(_compared(at, scale, every - main, c.smoke)),
                )
            )
    return _Comparisons(
        how_to_read=report.HOW_TO_COMPARE,
        low=report.number(scale.low),
        high=report.number(scale.high),
        groups=groups,
        sentences=[] if c.smoke else report.sentences(c.records, c.pairs, c.within),
    )


def _compared(grids: Sequence[report.Grid], scale: Scale, names: set[str], smoke: bool) -> Iterator[_Pair]:
    for g in grids:
        rows = [
            (
                name if g.rows_are == "configuration" else figures.title(name),
                [_ratio(cell, scale, smoke) for cell in cells],
            )
            for name, cells in g.rows
            if name in names
        ]
        if rows:
            yield _Pair(_sides(g), rows)


def _ratio(cell: Any, scale: Scale, smoke: bool) -> _Ratio:
    text, note = report.verdict_cell(cell)
    drawn = interval(cell.ratio, cell.low, cell.high, stats.ALIKE, scale, _tone(cell, smoke))
    return _Ratio(text, "" if smoke else note, drawn, _tone(cell, smoke))
