"""What the sections of a study's page show: drawings, and values as a reader compares them."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from markupsafe import Markup

from bench.analysis import stats, tables
from bench.analysis.tables import FIRST, LAST, POOLED
from bench.reporting import figures, report
from bench.reporting import study_page_figures as drawings
from bench.reporting.drawing import Look, Scale, interval
from bench.reporting.page import Drawing
from bench.reporting.study_page_content import Content

ABREAST = 2
"""Quantities beside one another in a table."""
_TONES = {"better": "better", "worse": "worse"}

Legend = Sequence[tuple[Look, str]]
Titled = Sequence[tuple[str, Sequence[Drawing]]]
"""Drawings below a heading each."""


@dataclass(frozen=True)
class Plain:
    """A table of texts, the first of each row its name."""

    heads: Sequence[str]
    rows: Sequence[Sequence[str]]


@dataclass(frozen=True)
class ByHorizon:
    """Drawings of every prediction length, and what their lines mean."""

    legend: Legend
    horizons: Titled | Sequence[tuple[str, Titled]]


def looks(c: Content, baselines: bool = True) -> Legend:
    """The legend of all configurations."""
    return [(look, s) for s, look in c.looks.items() if baselines or not tables.is_baseline(s)]


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
            (_sides(g) if between else name, [_finding(cell) for cell in cells])
            for name, cells in ([leading] if between else g.rows)
        ]
        if groups and groups[-1].title == title:
            groups[-1] = _FoundGroup(title, groups[-1].phases, [*groups[-1].rows, *rows])
        else:
            groups.append(_FoundGroup(title, len(g.phases), rows))
    return _Findings(c.grids[0].phases, groups)


def _finding(cell: Any) -> _Finding:
    return _Finding(report.number(cell.ratio), report.verdict_cell(cell)[1].partition(";")[0], _tone(cell))


def _leading(g: report.Grid) -> tuple[str, list[Any]]:
    """The row over all outputs, or the first."""
    return next((row for row in g.rows if row[0] == POOLED), g.rows[0])


def _sides(g: report.Grid) -> tuple[str, str]:
    """Both sides of a ratio."""
    a, b = ((figures.title(n) if g.rows_are == "configuration" else n) for n in (g.a, g.b))
    return a, b


def _tone(cell: Any) -> str:
    return _TONES.get(cell.verdict, "open")


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


# ------------------------------------------------------------------------------------------------------------ errors


@dataclass(frozen=True)
class _ErrorRow:
    look: Look
    spec: str
    weights: str
    seeds: str
    errors: Sequence[tuple[str, str, str]]
    """A quantity each: RMSSE, first and last."""


@dataclass(frozen=True)
class _ErrorTable:
    names: Sequence[str]
    """At most `ABREAST` quantities."""
    rows: Sequence[_ErrorRow]
    columns: tuple[str, str, str] = ("RMSSE", f"first {FIRST}", f"last {LAST}")


@dataclass(frozen=True)
class _HorizonErrors:
    title: str
    tables: Sequence[_ErrorTable]
    axes: Sequence[_ErrorTable]
    """Of single axes."""


@dataclass(frozen=True)
class _Errors:
    how_to_read: str
    horizons: Sequence[_HorizonErrors]


def errors(c: Content) -> _Errors:
    """RMSSE and the ends of the horizon, a table a horizon."""
    found = []
    for horizon in c.horizons:
        shown = c.quantities(horizon)
        every = dict.fromkeys(c.table[c.table.horizon == horizon].output)
        rest = [q for q in every if q not in shown]
        found.append(_HorizonErrors(c.duration(horizon), _errors(c, horizon, shown), _errors(c, horizon, rest)))
    return _Errors(report.HOW_TO_READ, found)


def _errors(c: Content, horizon: int, quantities: Sequence[str]) -> list[_ErrorTable]:
    """Tables of at most `ABREAST` quantities: a row a configuration."""
    return [_error_table(c, horizon, quantities[i : i + ABREAST]) for i in range(0, len(quantities), ABREAST)]


def _error_table(c: Content, horizon: int, quantities: Sequence[str]) -> _ErrorTable:
    rows = []
    for spec in c.specs:
        found = {r.output: r for r in c.table.itertuples() if (r.spec, r.horizon) == (spec, horizon)}
        here = [found[q] for q in quantities if q in found]
        if here:
            rows.append(
                _ErrorRow(
                    look=c.looks[spec],
                    spec=spec,
                    weights=f"{here[0].weights:,}".replace(",", "\u202f"),
                    seeds=", ".join(dict.fromkeys(map(report.sound_runs, here))),
                    errors=[_three(found.get(q)) for q in quantities],
                )
            )
    return _ErrorTable([f"{figures.title(q)} [{c.unit(q)}]" for q in quantities], rows)


def _three(row: Any) -> tuple[str, str, str]:
    if not row:
        return "", "", ""
    return report.with_interval(row), report.number(row.first), report.number(row.last)


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
                    main=list(_compared(at, scale, main)),
                    rest=list(_compared(at, scale, every - main)),
                )
            )
    return _Comparisons(
        how_to_read=report.HOW_TO_COMPARE,
        low=report.number(scale.low),
        high=report.number(scale.high),
        groups=groups,
        sentences=report.sentences(c.records, c.pairs, c.within),
    )


def _compared(grids: Sequence[report.Grid], scale: Scale, names: set[str]) -> Iterator[_Pair]:
    for g in grids:
        rows = [
            (
                name if g.rows_are == "configuration" else figures.title(name),
                [_ratio(cell, scale) for cell in cells],
            )
            for name, cells in g.rows
            if name in names
        ]
        if rows:
            yield _Pair(_sides(g), rows)


def _ratio(cell: Any, scale: Scale) -> _Ratio:
    text, note = report.verdict_cell(cell)
    drawn = interval(cell.ratio, cell.low, cell.high, stats.ALIKE, scale, _tone(cell))
    return _Ratio(text, note, drawn, _tone(cell))


# ---------------------------------------------------------------------------------------------------------- drawings


@dataclass(frozen=True)
class _Within:
    title: str
    legend: Legend
    drawings: Sequence[Drawing]


def every_step(c: Content) -> ByHorizon:
    """Mean error of every step."""
    found = [(c.duration(h), [drawings.curves(c, q, h) for q in c.quantities(h)]) for h in c.horizons]
    return ByHorizon(looks(c), found)


def within_one(c: Content) -> list[_Within]:
    """Two quantities of the same networks."""
    found = []
    for a, b in c.within:
        entries = [(look, figures.title(q)) for look, q in zip(drawings.WITHIN, (a, b), strict=True)]
        for horizon in c.horizons:
            if drawn := drawings.within(c, a, b, horizon):
                title = f"{figures.title(a)} and {figures.title(b)}, {c.duration(horizon)}"
                found.append(_Within(title, entries, drawn))
    return found


def spread(c: Content) -> list[tuple[str, Titled]]:
    """Box plots."""
    return _by_quantity(c, drawings.boxes)


def size(c: Content) -> Titled:
    """Error against the number of weights."""
    networks = c.table[[not tables.is_baseline(s) for s in c.table.spec]]
    if networks.weights.nunique() < 3:
        return []
    found = []
    for horizon in c.horizons:
        sound = networks[(networks.horizon == horizon) & networks.rmsse.notna()]
        drawn = [drawings.size(c, q, horizon) for q in c.quantities(horizon) if (sound.output == q).any()]
        found.append((c.duration(horizon), drawn))
    return found


def worst_windows(c: Content) -> ByHorizon:
    """Predictions that failed most."""
    entries = [(drawings.MEASURED, "measured"), (drawings.PREDICTED, "predicted")]
    return ByHorizon(entries, _by_quantity(c, drawings.worst))


def _by_quantity(c: Content, draw: Callable[[Content, str, int], list[Drawing]]) -> list[tuple[str, Titled]]:
    """By horizon and quantity; what has no drawing is left out."""
    found: list[tuple[str, Titled]] = []
    for horizon in c.horizons:
        groups = [(figures.title(q), drawn) for q in c.quantities(horizon) if (drawn := draw(c, q, horizon))]
        if groups:
            found.append((c.duration(horizon), groups))
    return found


SECTIONS: tuple[tuple[str, str, Callable[[Content], Any]], ...] = (
    ("The paper and this study", "asked_and_found", asked_and_found),
    ("Errors", "errors", errors),
    ("Comparisons", "comparisons", comparisons),
    ("Error of every step", "every_step", every_step),
    ("Within one network", "within_one", within_one),
    ("Spread of the errors", "spread", spread),
    ("Error against size", "size", size),
    ("Worst windows", "worst_windows", worst_windows),
)
"""Title, macro of ``study_sections.html.j2``, and what that is given; a section that has nothing to say is empty."""
