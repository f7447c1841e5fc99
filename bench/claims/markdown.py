"""The verdicts as a page of Markdown."""

import math
from collections.abc import Sequence

from bench.claims.estimate import OPEN, SETTLED, number
from bench.claims.judge import Row

HEAD = """\
# The paper's claims, judged

Made by `{command}`: {summary}. A band that reproduces a claim was written before it was run
([claims.toml](../paper/claims.toml)). *Alike* settles a claim that one is better than another: the difference, if there
is one, is smaller than a quarter (interval within 0.8 to 1.25). Of the verdicts on comparative claims at most 5 % are
expected to be wrong (Benjamini and Hochberg, all of them together); intervals are plain 95 % ones. `bench check -v`
says what each rests on, [how a claim is judged](../../docs/explanations/claims.md) how that is known.

| claim | published | here | 95 % interval | verdict | on |
| --- | --- | --- | --- | --- | --- |
"""


def render(rows: Sequence[Row], command: str) -> str:
    """One row a claim and data set, as `bench check` prints them."""
    counts: dict[str, int] = {}
    for row in rows:
        counts[row.judgement.verdict] = counts.get(row.judgement.verdict, 0) + 1
    claims = len({row.claim.id for row in rows})
    summary = f"{claims} claims, {len(rows)} verdicts: " + ", ".join(f"{n} {v}" for v, n in counts.items())
    said_before = ["", *(row.claim.id for row in rows)]
    lines = (_line(row, row.claim.id != before) for row, before in zip(rows, said_before, strict=False))
    return HEAD.format(command=command, summary=summary) + "".join(lines)


def _verdict(row: Row) -> str:
    j = row.judgement
    if j.verdict == OPEN and row.outlook:
        return f"{j.verdict}; to settle it: {row.outlook}"
    return j.label.replace(j.verdict, f"**{j.verdict}**", 1) if j.verdict in SETTLED else j.verdict


def _line(row: Row, first: bool) -> str:
    """A row of the table; the claim stands in its first row only."""
    j = row.judgement
    interval = "" if math.isnan(j.low) or j.low == j.high else f"{number(j.low)} to {number(j.high)}"
    where = ", ".join(filter(None, (row.dataset, row.label))) if j.verdict != "not run" else j.basis or row.command
    cells = [
        f"{row.claim.text} *{row.claim.source}*" if first else "",
        row.claim.stated if first else "",
        "" if math.isnan(j.value) else number(j.value),
        interval,
        _verdict(row),
        f"{where}; {row.beside}".removesuffix("; "),
    ]
    return "| " + " | ".join(c.replace("|", "\\|") for c in cells) + " |\n"
