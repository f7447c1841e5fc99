"""The table of `bench score-discovery` on a terminal and as a page."""

import math

from rich.console import Console
from rich.table import Table as RichTable

from bench.score.table import Method, Table, percent

_MARK = {True: "yes", False: "no", None: ""}
_METHODS = ("", "exact: single", "exact: several", "false names", "parameter error", "error left", "≤ 5 % left")


def show(out: Console, found: Table) -> None:
    """Print the table."""
    for title, lines in found.sections:
        grid = RichTable(title=title, title_justify="left", box=None, header_style="bold", padding=(0, 2, 0, 0))
        for name in ("", "answer (95 % interval)", "wanted", "met"):
            grid.add_column(name)
        for x in lines:
            colour = {True: "green", False: "red", None: "dim"}[x.met]
            grid.add_row(x.text, x.value, x.wanted, f"[{colour}]{_MARK[x.met]}[/]")
        out.print(grid)
        out.print()
    if found.methods:
        grid = RichTable(title=_compared(found), title_justify="left", box=None, header_style="bold")
        for name in _METHODS:
            grid.add_column(name, justify="left" if not name else "right")
        for m in found.methods:
            grid.add_row(*_row(m))
        out.print(grid)
        out.print()
    for name, truth, said in found.failures[:20]:
        out.print(f"{name}: {truth} → {said}", highlight=False, markup=False)
    if len(found.failures) > 20:
        out.print(f"… and {len(found.failures) - 20} more")
    raised = f" ({found.raised} raised an error)" if found.raised else ""
    wrong = f"{len(found.failures)} wrong{raised}"
    out.print(f"{found.scored} of {found.asked} cases scored, {wrong}, {found.unmet} figures not met.")


def markdown(found: Table, command: str) -> str:
    """The table as a page; the same on every machine."""
    out = [
        f"# {found.title}",
        "",
        f"Made by `{command}`: {found.scored} of {found.asked} cases scored, ",
    ]
    out[-1] += f"{len(found.failures)} answered wrongly. Intervals are exact (Clopper–Pearson), 95 %."
    for title, lines in found.sections:
        out += ["", f"## {title}", "", "| | answer | wanted | met |", "|---|---|---|---|"]
        out += [f"| {x.text} | {x.value} | {x.wanted} | {_MARK[x.met]} |" for x in lines]
    if found.methods:
        out += ["", f"{_compared(found)}:", "", f"| {' | '.join(_METHODS)} |", "|---" * len(_METHODS) + "|"]
        out += [f"| {' | '.join(_row(m))} |" for m in found.methods]
    out += ["", f"## More than {100 * found.near:.0f} % of the error above the floor left ({len(found.leftovers)})", ""]
    out += [f"- `{name}`: {_left(*shares)}" for name, *shares in found.leftovers] or ["None."]
    out += ["", f"## Wrong answers ({len(found.failures)})", ""]
    out += [f"- `{name}`: {truth} → {said}" for name, truth, said in found.failures] or ["None."]
    return "\n".join(out) + "\n"


def _left(left: float, by_truth: float) -> str:
    known = "" if math.isnan(by_truth) else f"; the model with the true numbers leaves {percent(by_truth)}"
    return f"{percent(left)}{known}"


def _compared(found: Table) -> str:
    return f"On the same logs, {found.compared[0]} sets with effects and {found.compared[1]} without"


def _row(m: Method) -> tuple[str, ...]:
    figures = (m.singles, m.several, m.false_names, m.parameter, m.left, m.near)
    return m.name.replace("_", " "), *(percent(x) for x in figures)
