"""A study's tables and what they say in sentences, on the terminal and in Markdown. Sentences follow verdicts."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import pandas as pd

from bench.analysis.tables import (
    FIRST,
    LAST,
    POOLED,
    Pairs,
    comparisons,
    contrasts,
    horizons,
    is_baseline,
    named,
    specs,
    study_table,
)
from bench.records.record import RunRecord

__all__ = ["comparisons", "render_terminal", "sentences", "study_table", "to_markdown"]


def sentences(records: Sequence[RunRecord], pairs: Pairs, within: Pairs = ()) -> list[str]:
    """What the verdicts say: at once, overall, at the end, within each configuration, and beside the baselines.

    Args:
        records: runs of one study.
        pairs: (a, b) configurations to compare.
        within: (a, b) quantities to compare within each configuration.
    """
    found = comparisons(records, pairs)
    out = []
    for (horizon, a, b), rows in found.groupby(["horizon", "a", "b"], sort=False) if len(found) else ():
        rows = summed(rows)
        lost = ", ".join(f"{n} of {s}" for s, n in ((a, rows.diverged_a.iloc[0]), (b, rows.diverged_b.iloc[0])) if n)
        output = named(rows.output.iloc[0])
        out.append(
            f"T = {horizon}, {output}: {a} against {b}: {'; '.join(map(_said, rows.itertuples()))}. "
            f"Basis: {rows.basis.iloc[0]}." + (f" Left out because they diverged: {lost}." if lost else "")
        )
    pooled = int((found.output == POOLED).sum()) if len(found) else 0
    inside = contrasts(records, within)
    for (horizon, a, b), rows in inside.groupby(["horizon", "a", "b"], sort=False) if len(inside) else ():
        said = [f"{r.spec} {_said(r)}" for r in rows[rows.phase == "whole horizon"].itertuples()]
        out.append(f"T = {horizon}: {named(a)} against {named(b)}: {'; '.join(said)}.")
    out += _beside_baselines(records)
    if tested := len(found) + len(inside) - pooled:
        out.append(
            f"{tested} single differences are tested at 95 %: were there none at all, chance would still show "
            f"about {tested * 0.05:.1f} of them."
        )
    return out


def summed(rows: pd.DataFrame) -> pd.DataFrame:
    """The rows over all outputs, or those of the first (a signal of three axes before its channels)."""
    return rows[rows.output == (POOLED if POOLED in set(rows.output) else rows.output.iloc[0])]


def _said(row: Any) -> str:
    """One phase of one pair as a clause."""
    where = "overall" if row.phase == "whole horizon" else f"over the {row.phase}"
    if math.isnan(row.ratio):
        return f"{where} there is nothing to compare"
    times = f"{where} {row.ratio:.2f} times the error"
    if math.isnan(row.low):
        return f"{times} (no interval)"
    notes = f"95 %: {row.low:.2f} to {row.high:.2f}"
    if row.trainings < 2:
        return f"{times} ({notes} for these two networks; one training cannot speak for the method)"
    if row.alike:
        word = "the two are alike" if row.verdict == "cannot tell" else f"{row.verdict}, but by little"
        return f"{times} ({notes}, within 0.8 to 1.25): {word}"
    if row.verdict == "cannot tell":
        return f"{times} ({notes}): cannot tell (a reduction by {100 * row.smallest:.0f} % would have been seen)"
    return f"{times} ({notes}): {row.verdict}"


def _beside_baselines(records: Sequence[RunRecord]) -> Iterator[str]:
    """One sentence a horizon and baseline: which networks are better than it over the whole horizon."""
    networks = [s for s in specs(records) if not is_baseline(s)]
    words = {"better": "better than it", "worse": "worse than it", "cannot tell": "cannot be told from it"}
    for horizon in horizons(records):
        at = [r for r in records if r.summary["horizon"] == horizon]
        for base in filter(is_baseline, specs(at)):
            rows = comparisons(at, [(n, base) for n in networks], "whole horizon")
            if len(rows):
                rows = summed(rows)
                output = named(rows.output.iloc[0])
                said = [f"diverged: {r.a}" for r in rows.itertuples() if math.isnan(r.ratio)]
                rows = rows[rows.ratio.notna()]
                for verdict, meaning in words.items():
                    chosen = [
                        f"{r.a} ({r.ratio:.2f} times its error)" for r in rows.itertuples() if _verdict(r) == verdict
                    ]
                    said += [f"{meaning}: {', '.join(chosen)}"] if chosen else []
                single = [
                    f"{r.a}: {r.ratio:.2f} times the error of `{base}`"
                    for r in rows.itertuples()
                    if _verdict(r) == "one training"
                ]
                said += [f"{', '.join(single)}, from one seed: run more with --seeds"] if single else []
                yield f"T = {horizon}, {output}, beside the baseline `{base}`: {'; '.join(said)}."


def _verdict(row: Any) -> str:
    return "one training" if row.verdict == "cannot tell" and row.trainings < 2 else str(row.verdict)


# ------------------------------------------------------------------------------------------------- rendering


def number(value: float) -> str:
    """Three significant digits, never an exponent."""
    if math.isnan(value):
        return "–"
    digits = 2 if value == 0 else max(0, 2 - math.floor(math.log10(abs(value))))
    return f"{value:.{digits}f}"


def with_interval(row: Any) -> str:
    text, half = number(row.rmsse), (row.rmsse_high - row.rmsse_low) / 2
    return text if math.isnan(half) else f"{text} ± {half:.{len(text.partition('.')[2])}f}"


def table_cells(row: Any) -> list[str]:
    """A row of `study_table` as the Markdown table has it."""
    size = [with_interval(row), number(row.first), number(row.last)]
    return [named(row.output), row.spec, str(row.weights), row.unit, *size, sound_runs(row)]


def markdown_row(cells: Sequence[str]) -> str:
    """One line of a Markdown table."""
    return "| " + " | ".join(cells) + " |"


def sound_runs(row: Any) -> str:
    return f"{row.seeds} of {row.seeds + row.diverged}"


def verdict_cell(row: Any) -> tuple[str, str]:
    """Ratio with interval, and the verdict with what could have been seen."""
    if math.isnan(row.low):
        return number(row.ratio), "no interval"
    if row.trainings < 2:
        return f"{row.ratio:.2f} ({row.low:.2f} to {row.high:.2f})", "one training cannot tell"
    word = "alike" if row.alike and row.verdict == "cannot tell" else row.verdict
    return f"{row.ratio:.2f} ({row.low:.2f} to {row.high:.2f})", f"{word}; sees {100 * row.smallest:.0f} %"


@dataclass(frozen=True)
class Grid:
    """The verdicts on one pair at one horizon: a row an output (or a configuration), a column a phase."""

    horizon: int
    a: str
    b: str
    rows_are: str
    """ "output" or "configuration"."""
    phases: list[str]
    rows: list[tuple[str, list[Any]]]
    """Name and, phase by phase, the row of `comparisons` or `contrasts`."""

    @property
    def heading(self) -> str:
        """What is divided by what."""
        return f"T = {self.horizon}: error of {named(self.a)} / error of {named(self.b)}"


def grids(records: Sequence[RunRecord], pairs: Pairs, within: Pairs) -> list[Grid]:
    """All comparisons as they are shown: of configurations, then of quantities within each configuration."""
    made = []
    for found, column, rows_are in (
        (comparisons(records, pairs), "output", "output"),
        (contrasts(records, within), "spec", "configuration"),
    ):
        for (horizon, a, b), rows in found.groupby(["horizon", "a", "b"], sort=False) if len(found) else ():
            names = list(dict.fromkeys(rows.phase))
            body = [(str(q), list(group.itertuples())) for q, group in rows.groupby(column, sort=False)]
            made.append(Grid(int(horizon), a, b, rows_are, names, body))
    return made


HOW_TO_READ = (
    "RMSSE: root mean sum of squared errors, mean over seeds ± 95 % interval over seeds; first and last: mean error "
    f"over the first {FIRST} and the last {LAST} steps (all of them where the horizon is shorter); "
    "seeds: runs that did not diverge, of all."
)
HOW_TO_COMPARE = (
    "Ratio of errors (95 % interval); below 1 the first is better. “alike”: the interval lies within 0.8 to 1.25. "
    "“sees n %”: the smallest reduction of the error that four of five such experiments would show."
)


def render_terminal(records: Sequence[RunRecord], pairs: Pairs, out: Any, within: Pairs = ()) -> None:
    """Print tables and sentences; ``out`` is a rich console, 100 columns are enough; the rest as for `sentences`."""
    from rich.markup import escape
    from rich.table import Table

    table = study_table(records)
    for horizon, rows in table.groupby("horizon", sort=False):
        grid = Table(title=f"T = {horizon} steps", title_justify="left")
        for name in ("output", "configuration"):  # these give way on a narrow terminal, numbers do not
            grid.add_column(name, overflow="fold")
        for name in ("weights", "RMSSE", f"first {FIRST}", f"last {LAST}", "seeds"):
            grid.add_column(name, justify="right", no_wrap=True)
        for output, group in rows.groupby("output", sort=False):
            for i, row in enumerate(group.itertuples()):
                head = [named(str(output)) if i == 0 else f"[{row.unit}]" if i == 1 else ""]
                cells = [
                    row.spec,
                    str(row.weights),
                    with_interval(row),
                    number(row.first),
                    number(row.last),
                    sound_runs(row),
                ]
                grid.add_row(*map(escape, head + cells), end_section=i == len(group) - 1)
        out.print(grid)
    out.print(HOW_TO_READ, style="dim", highlight=False)
    colour = {"better": "green", "worse": "red"}
    shown = grids(records, pairs, within)
    for found in shown:
        grid = Table(title=escape(found.heading), title_justify="left")
        grid.add_column(found.rows_are, no_wrap=True)
        for name in found.phases:
            grid.add_column(name)
        for name, cells in found.rows:
            style = [colour.get(c.verdict, "") for c in cells]
            texts = ["\n".join(verdict_cell(c)) for c in cells]
            grid.add_row(escape(named(name)), *(f"[{s}]{t}[/]" if s else t for s, t in zip(style, texts, strict=True)))
        out.print(grid)
    if shown:
        out.print(HOW_TO_COMPARE, style="dim", highlight=False)
    for sentence in sentences(records, pairs, within):
        out.print("• " + escape(sentence), highlight=False)


def to_markdown(
    records: Sequence[RunRecord], pairs: Pairs, title: str, command: str, figure: str = "", within: Pairs = ()
) -> str:
    """The same as a page; ``figure`` is the address of a picture to show."""
    first = records[0].summary
    lines = [f"# {title[:1].upper()}{title[1:]}", "", f"Made by `{command}`."]
    lines += [f"Data: `{first['dataset']}`, SHA-256 `{first['dataset_digest'][:12]}`; {len(records)} runs.", ""]
    lines += [f"- {s}" for s in sentences(records, pairs, within)] + [""]
    if figure:
        lines += [f"![Mean error of every prediction step]({figure})", ""]
    table = study_table(records)

    def grid(head: Sequence[str], body: Sequence[Sequence[str]]) -> list[str]:
        return [markdown_row(r) for r in (head, ["---"] * len(head), *body)] + [""]

    for horizon, rows in table.groupby("horizon", sort=False):
        head = ["output", "configuration", "weights", "unit", "RMSSE", f"first {FIRST}", f"last {LAST}", "seeds"]
        body = [table_cells(r) for r in rows.itertuples()]
        lines += [f"## T = {horizon} steps", "", *grid(head, body)]
    lines += [HOW_TO_READ, ""]
    shown = grids(records, pairs, within)
    for found in shown:
        body = [[named(name), *("<br>".join(verdict_cell(c)) for c in cells)] for name, cells in found.rows]
        lines += [f"### {found.heading}", "", *grid([found.rows_are, *found.phases], body)]
    return "\n".join([*lines, HOW_TO_COMPARE] if shown else lines).rstrip() + "\n"
