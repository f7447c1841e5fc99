"""The sections of a study's page. Everything that comes from records, names and text is escaped."""

import math
from collections.abc import Callable, Iterator, Sequence
from html import escape
from typing import Any

from bench.analysis import stats, tables
from bench.analysis.tables import FIRST, LAST, POOLED
from bench.reporting import figures, report
from bench.reporting import study_page_figures as drawings
from bench.reporting.drawing import Scale, interval, legend, swatch
from bench.reporting.page import grid, table
from bench.reporting.study_page_content import Content

ABREAST = 2
"""Quantities beside one another in a table."""
_TONES = {"better": "better", "worse": "worse"}


def looks(c: Content, baselines: bool = True) -> str:
    """The legend of all configurations."""
    return legend([(look, s) for s, look in c.looks.items() if baselines or not tables.is_baseline(s)])


def _fold(title: str, body: str) -> str:
    return f"<details><summary>{escape(title)}</summary>{body}</details>"


def _first_open(parts: Sequence[tuple[str, str]]) -> str:
    """The first of several groups of drawings is shown, the others are folded away."""
    (title, body), *rest = parts
    return f"<h4>{escape(title)}</h4>{body}" + "".join(_fold(t, b) for t, b in rest)


def asked_and_found(c: Content) -> str:
    """The paper's figure and ours, side by side."""
    if not c.study:
        return ""
    said = (c.study.paper_says or c.study.question).splitlines()
    paper = (
        f'<div class="card"><h3>The paper</h3><p class="quiet">{escape(c.study.source)}</p>'
        + "".join(f"<p>{escape(line)}</p>" for line in said if line.strip())
        + "</div>"
    )
    labels = sorted({r.summary["dataset"] for r in c.records})
    here = f'<div class="card"><h3>Here</h3><p class="quiet">{escape(", ".join(labels))}</p>{_findings(c)}</div>'
    return f'<div class="sides">{paper}{here}</div>'


def _findings(c: Content) -> str:
    """Ratios and verdicts in short, or the errors where nothing is compared."""
    if not c.grids:
        return _short_errors(c)
    rows, over = [], ""
    for g in c.grids:
        between = g.rows_are == "output"
        leading = _leading(g)
        what = figures.title(leading[0]) if between else f"{figures.title(g.a)} / {figures.title(g.b)}"
        if over != (over := f"{c.duration(g.horizon)}, {what}"):
            rows.append(f'<tr class="over-rows"><th colspan="{1 + len(g.phases)}">{escape(over)}</th></tr>')
        for name, cells in [leading] if between else g.rows:
            shown = "".join(
                f'<td data-label="{p}"><b class="{_tone(cell)}">{report.number(cell.ratio)}</b><br>'
                f"<small>{escape(report.verdict_cell(cell)[1].partition(';')[0])}</small></td>"
                for p, cell in zip(g.phases, cells, strict=True)
            )
            rows.append(f"<tr><td>{_divided(g) if between else escape(name)}</td>{shown}</tr>")
    return table(["error of the first / error of the second", *c.grids[0].phases], rows, kind="findings")


def _leading(g: report.Grid) -> tuple[str, list[Any]]:
    """The row over all outputs, or the first."""
    return next((row for row in g.rows if row[0] == POOLED), g.rows[0])


def _divided(g: report.Grid) -> str:
    """Both sides of a ratio, one a line."""
    return f"<span>{escape(_side(g, g.a))}</span><span>/ {escape(_side(g, g.b))}</span>"


def _side(g: report.Grid, name: str) -> str:
    return figures.title(name) if g.rows_are == "configuration" else name


def _tone(cell: Any) -> str:
    return _TONES.get(cell.verdict, "open")


def _short_errors(c: Content) -> str:
    """RMSSE of every configuration: a column a quantity and horizon."""
    columns = [(h, q) for h in c.horizons for q in c.quantities(h)]
    values = {(r.spec, r.horizon, r.output): r for r in c.table.itertuples()}
    heads = ["RMSSE", *(f"{escape(figures.title(q))}, T = {h} [{escape(c.unit(q))}]" for h, q in columns)]
    rows = []
    for spec in c.specs:
        cells = [report.number(r.rmsse) if (r := values.get((spec, h, q))) else "" for h, q in columns]
        shown = "".join(f'<td class="number" data-label="{h}">{t}</td>' for h, t in zip(heads[1:], cells, strict=True))
        rows.append(f"<tr><td>{escape(spec)}</td>{shown}</tr>")
    return table(heads, rows, range(1, len(heads)))


def errors(c: Content) -> str:
    """RMSSE and the ends of the horizon, a table a horizon."""
    body = f'<p class="quiet">{escape(report.HOW_TO_READ)}</p>'
    for horizon in c.horizons:
        shown = c.quantities(horizon)
        every = dict.fromkeys(c.table[c.table.horizon == horizon].output)
        rest = [q for q in every if q not in shown]
        body += f"<h3>{escape(c.duration(horizon))}</h3>{_errors(c, horizon, shown)}"
        if rest:
            body += _fold("Single axes", _errors(c, horizon, rest))
    return body


def _errors(c: Content, horizon: int, quantities: Sequence[str]) -> str:
    """Tables of at most `ABREAST` quantities: a row a configuration, three columns a quantity."""
    made = ""
    for i in range(0, len(quantities), ABREAST):
        some = quantities[i : i + ABREAST]
        names = [f"{figures.title(q)} [{c.unit(q)}]" for q in some]
        tops = "".join(f'<th colspan="3" class="top">{escape(n)}</th>' for n in names)
        columns = [("RMSSE", "number opens"), (f"first {FIRST}", "number"), (f"last {LAST}", "number")]
        heads = "".join(f'<th class="{kind}">{name}</th>' for _ in some for name, kind in columns)
        rows = []
        for spec in c.specs:
            found = {r.output: r for r in c.table.itertuples() if (r.spec, r.horizon) == (spec, horizon)}
            if not any(q in found for q in some):
                continue
            cells = "".join(_error_cells(found.get(q), n, columns) for q, n in zip(some, names, strict=True))
            some_row = next(iter(found.values()))
            seeds = ", ".join(dict.fromkeys(report.sound_runs(found[q]) for q in some if q in found))
            rows.append(
                f"<tr><td>{swatch(c.looks[spec])}{escape(spec)}</td>"
                f'<td class="number" data-label="weights">{_thousands(some_row.weights)}</td>'
                f'<td class="number" data-label="seeds">{seeds}</td>{cells}</tr>'
            )
        made += (
            f'<div class="scroll"><table class="errors"><thead><tr><th colspan="3"></th>{tops}</tr><tr>'
            f'<th>configuration</th><th class="number">weights</th><th class="number">seeds</th>{heads}</tr></thead>'
            f"<tbody>{''.join(rows)}</tbody></table></div>"
        )
    return made


def _error_cells(row: Any, name: str, columns: Sequence[tuple[str, str]]) -> str:
    values = (report.with_interval(row), report.number(row.first), report.number(row.last)) if row else ("", "", "")
    return "".join(
        f'<td class="{kind}" data-label="{escape(name)}, {column}">{value}</td>'
        for (column, kind), value in zip(columns, values, strict=True)
    )


def _thousands(count: int) -> str:
    return f"{count:,}".replace(",", "\u202f")


def comparisons(c: Content) -> str:
    """Ratios with intervals, then the same in sentences."""
    if not c.grids:
        return ""
    limits = [v for g in c.grids for _, cells in g.rows for r in cells for v in (r.low, r.high) if math.isfinite(v)]
    scale = Scale(max(1 / 64, min([0.5, *limits])), min(64.0, max([2.0, *limits])), log=True)
    body = (
        f'<p class="quiet">{escape(report.HOW_TO_COMPARE)} Dot and bar: ratio and interval on a logarithmic scale, '
        f"{report.number(scale.low)} to {report.number(scale.high)}; line: 1; pale: 0.8 to 1.25.</p>"
    )
    for horizon in c.horizons:
        for rows_are, first in (("output", "configurations"), ("configuration", "outputs")):
            at = [g for g in c.grids if g.horizon == horizon and g.rows_are == rows_are]
            if not at:
                continue
            main = {*c.principal, POOLED} if rows_are == "output" else {name for g in at for name, _ in g.rows}
            heads = [first, rows_are, *at[0].phases]
            rows = list(_compared(at, scale, main))
            rest = list(_compared(at, scale, {n for g in at for n, _ in g.rows} - main))
            body += f"<h3>{escape(c.duration(horizon))}, {first}</h3>{table(heads, rows, kind='compared')}"
            if rest:
                body += _fold("Single axes", table(heads, rest, kind="compared"))
    said = "".join(f"<li>{escape(s)}</li>" for s in report.sentences(c.records, c.pairs, c.within))
    return body + _fold("In sentences, and beside the baselines", f'<ul class="notes">{said}</ul>')


def _compared(grids: Sequence[report.Grid], scale: Scale, names: set[str]) -> Iterator[str]:
    for g in grids:
        rows = [row for row in g.rows if row[0] in names]
        for i, (name, cells) in enumerate(rows):
            head = f'<td rowspan="{len(rows)}" class="pair">{_divided(g)}</td>' if i == 0 else ""
            shown = "".join(_ratio(p, cell, scale) for p, cell in zip(g.phases, cells, strict=True))
            label = name if g.rows_are == "configuration" else figures.title(name)
            opens = ' class="opens"' if i == 0 else ""
            yield f'<tr{opens}>{head}<td class="{g.rows_are}">{escape(label)}</td>{shown}</tr>'


def _ratio(phase: str, cell: Any, scale: Scale) -> str:
    text, note = report.verdict_cell(cell)
    drawn = interval(cell.ratio, cell.low, cell.high, stats.ALIKE, scale, _tone(cell))
    below = f'<div>{drawn}<small class="{_tone(cell)}">{escape(note)}</small></div>'
    return f'<td data-label="{phase}"><b>{escape(text)}</b>{below}</td>'


def every_step(c: Content) -> str:
    """Mean error of every step."""
    body = (
        "<p>Mean over seeds; the band runs from the best to the worst seed. An axis fits the networks, so that a "
        f"baseline may leave it.</p>{looks(c)}"
    )
    for horizon in c.horizons:
        drawn = [drawings.curves(c, q, horizon) for q in c.quantities(horizon)]
        body += f"<h3>{escape(c.duration(horizon))}</h3>{grid(drawn)}"
    return body


def within_one(c: Content) -> str:
    """Two quantities of the same networks."""
    body = ""
    for a, b in c.within:
        entries = [(look, figures.title(q)) for look, q in zip(drawings.WITHIN, (a, b), strict=True)]
        for horizon in c.horizons:
            if drawn := drawings.within(c, a, b, horizon):
                title = f"{figures.title(a)} and {figures.title(b)}, {c.duration(horizon)}"
                body += f"<h3>{escape(title)}</h3>{legend(entries)}{grid(drawn, 'small')}"
    return (
        "<p>Two errors of the same networks, on one axis; bands run from the best to the worst seed.</p>" * bool(body)
        + body
    )


def spread(c: Content) -> str:
    """Box plots."""
    body = (
        "<p>Line: median; box: 25 to 75 %; whiskers: 5 to 95 % of the test windows; each a mean over seeds. Drawings "
        "beside one another have one axis.</p>"
    )
    for horizon in c.horizons:
        parts = [
            (figures.title(q), grid(drawn, "small"))
            for q in c.quantities(horizon)
            if (drawn := drawings.boxes(c, q, horizon))
        ]
        if parts:
            body += f"<h3>{escape(c.duration(horizon))}</h3>{_first_open(parts)}"
    return body


def size(c: Content) -> str:
    """Error against the number of weights."""
    networks = c.table[[not tables.is_baseline(s) for s in c.table.spec]]
    if networks.weights.nunique() < 3:
        return ""
    body = "<p>Bars are 95 % intervals over seeds.</p>"
    for horizon in c.horizons:
        sound = networks[(networks.horizon == horizon) & networks.rmsse.notna()]
        drawn = [drawings.size(c, q, horizon) for q in c.quantities(horizon) if (sound.output == q).any()]
        body += f"<h3>{escape(c.duration(horizon))}</h3>{grid(drawn, 'wide')}"
    return body


def worst_windows(c: Content) -> str:
    """Predictions that failed most."""
    entries = [(drawings.MEASURED, "measured"), (drawings.PREDICTED, "predicted")]
    body = (
        "<p>Of the test windows that every run keeps, from the best to the worst, the one with the largest error; of a "
        f"signal of three axes its worst. Every drawing has an axis of its own.</p>{legend(entries)}"
    )
    for horizon in c.horizons:
        parts = [
            (figures.title(q), grid(drawn, "small"))
            for q in c.quantities(horizon)
            if (drawn := drawings.worst(c, q, horizon))
        ]
        if parts:
            body += f"<h3>{escape(c.duration(horizon))}</h3>{_first_open(parts)}"
    return body


SECTIONS: dict[str, Callable[[Content], str]] = {
    "The paper and this study": asked_and_found,
    "Errors": errors,
    "Comparisons": comparisons,
    "Error of every step": every_step,
    "Within one network": within_one,
    "Spread of the errors": spread,
    "Error against size": size,
    "Worst windows": worst_windows,
}
"""By title, in the order of the page; a section that has nothing to say is empty."""
