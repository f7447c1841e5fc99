"""What the sections of a study's page show: drawings, and values as a reader compares them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from bench.analysis import tables
from bench.analysis.tables import FIRST, LAST
from bench.reporting import figures, report
from bench.reporting import study_page_figures as drawings
from bench.reporting.drawing import Look
from bench.reporting.page import Drawing
from bench.reporting.study_page_comparisons import asked_and_found, comparisons
from bench.reporting.study_page_content import Content, Legend, Titled, looks

ABREAST = 2
"""Quantities beside one another in a table."""


@dataclass(frozen=True)
class ByHorizon:
    """Drawings of every prediction length, and what their lines mean."""

    legend: Legend
    horizons: Titled | Sequence[tuple[str, Titled]]


# ------------------------------------------------------------------------------------------------------------ errors


@dataclass(frozen=True)
class _ErrorRow:
    look: Look
    spec: str
    weights: str
    seeds: str
    errors: Sequence[Sequence[str]]
    """A quantity each, a cell a column of the table."""


@dataclass(frozen=True)
class _ErrorTable:
    names: Sequence[str]
    """At most `ABREAST` quantities."""
    rows: Sequence[_ErrorRow]
    columns: Sequence[str]
    """RMSSE and both ends of the horizon, which are one where it is short."""


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
                    errors=[_cells(found.get(q))[: 3 if horizon > FIRST else 2] for q in quantities],
                )
            )
    ends = (f"first {FIRST}", f"last {LAST}") if horizon > FIRST else (f"all {horizon}",)
    return _ErrorTable([f"{figures.title(q)} [{c.unit(q)}]" for q in quantities], rows, ("RMSSE", *ends))


def _cells(row: Any) -> tuple[str, str, str]:
    if not row:
        return "", "", ""
    return report.with_interval(row), report.number(row.first), report.number(row.last)


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
