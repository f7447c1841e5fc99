"""`bench check`: a verdict on every claim of the paper, and on every number that this suite published."""

import json
import math
import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from bench.cli import options
from registry.atomic_io import writing

COLOURS = {
    "reproduced": "green",
    "differs": "red",
    "alike": "cyan",
    "not enough evidence": "yellow",
    "not run": "dim",
}
CAUGHT = 1
"""Exit code where a published number no longer holds."""


@click.command("check")
@click.option("--claim", "wanted", multiple=True, metavar="ID", help="Only this claim, in full. May be repeated.")
@click.option("--details", "-v", is_flag=True, help="Source, basis and the command that would settle it, for each.")
@click.option("--json", "target", type=options.Output(), help="Write everything as JSON.")
@click.option("--markdown", "page", type=options.Output(), help="Write the verdicts as Markdown.")
@click.option(
    "--claims", "file", type=click.Path(path_type=Path, dir_okay=False), help="Default: results/paper/claims.toml."
)
@click.option(
    "--published", type=click.Path(path_type=Path, file_okay=False), help="Default: the checkout's results/published."
)
@options.results
@click.option("--rerun", type=click.Choice(("smoke",)), help="Train a small fixed set again instead: minutes.")
@click.option("--write", is_flag=True, help="With --rerun: publish its numbers instead of checking them.")
@click.option("--simulate", is_flag=True, help="Count in simulated data too, where a claim is about the recordings.")
@click.option("--seal", is_flag=True, help="List the published files as they are now, after publishing others.")
def check_command(
    wanted: tuple[str, ...],
    details: bool,
    target: Path | None,
    page: Path | None,
    file: Path | None,
    published: Path | None,
    results: Path,
    rerun: str | None,
    write: bool,
    simulate: bool,
    seal: bool,
) -> None:
    """For every claim of the paper: does it reproduce here? And do the published numbers of this suite still hold?

    Evidence is what was published with this suite and what `bench run STUDY` left in the results folder. Verdicts:
    reproduced, differs, alike (no difference within the margin), not enough evidence, not run.

    \b
    bench check                                  every claim
    bench check --claim body-rates-level         one of them, in full
    bench check --rerun smoke                    trains a small set again and compares: minutes

    A number that is made again is *same* (equal run keys: every bit), *within spread* of the seeds (another processor,
    kernel or version) or *moved*.

    Exit code 1: a number that was published moved, or a published file is not as it was published (by the hashes in its
    folder's SHA256SUMS; commands that publish keep them, --seal lists all files anew).
    """
    from bench.api.check import judged, published_folder
    from bench.claims import manifest, markdown

    own = published is None
    published = published_folder(published)
    if write and not rerun:
        raise click.UsageError("--write belongs to --rerun.")
    if seal:
        click.echo(f"{manifest.seal(published)} published files are listed in {published / manifest.FILE}.")
        return
    if not write and (own or manifest.sealed(published)):
        _refuse_spoilt(published)
    if rerun:
        _rerun(published, write)
        return
    verdicts = judged(wanted or None, results, published, file, simulate)
    rows, held = verdicts.rows, verdicts.published
    if target:
        _write(target, json.dumps(_plain(rows, held), indent=1, ensure_ascii=False, allow_nan=False) + "\n")
    if page:
        _write(page, markdown.render(rows, f"bench check {'--simulate ' if simulate else ''}--markdown {page.name}"))
    out = options.console()
    out.print(_table(rows))
    if details or wanted:
        _explain(rows, out)
    _summarize(rows, out, brief=not details and not wanted)
    for sentence in verdicts.left_out:
        out.print(sentence, style="dim", highlight=False, markup=False)
    _regressions(held, out)


def _refuse_spoilt(published: Path) -> None:
    """Say which published files were altered, and end with `CAUGHT`: nothing is judged by them."""
    from bench.claims import manifest

    spoilt = manifest.spoilt(published)
    if not spoilt:
        return
    for s in spoilt:
        click.echo(f"{s.how}: {published / s.name}", err=True)
    count = f"{len(spoilt)} published file{'s are' if len(spoilt) > 1 else ' is'} not as published"
    click.echo(f"bench: {count}: restore what was, or list what you published with `{manifest.SEAL}`.", err=True)
    sys.exit(CAUGHT)


def _table(rows: Sequence[Any]) -> Any:
    """A row a claim and data set, 100 columns."""
    from rich.markup import escape
    from rich.table import Table

    from bench.claims.estimate import number

    grid = Table(box=None, header_style="bold", pad_edge=False, padding=(0, 1, 0, 0))
    grid.add_column("claim", no_wrap=True)
    grid.add_column("published", max_width=12)
    grid.add_column("here", justify="right", no_wrap=True)
    grid.add_column("95 % interval", no_wrap=True)
    grid.add_column("verdict", width=10)
    grid.add_column("evidence")
    last = None
    for row in rows:
        j = row.judgement
        interval = "" if math.isnan(j.low) or j.low == j.high else f"{number(j.low)} to {number(j.high)}"
        if row.dataset and j.verdict != "not run":
            where = f"{row.dataset}, {row.label}" if row.label else row.dataset
        else:
            where = f"{j.basis or row.command}; {row.beside}".removesuffix("; ")
        first = row.claim.id != last
        last = row.claim.id
        grid.add_row(
            row.claim.id if first else "",
            escape(row.claim.stated) if first else "",
            "" if math.isnan(j.value) else number(j.value),
            interval,
            f"[{COLOURS[j.verdict]}]{j.verdict}[/]",
            escape(where),
        )
    return grid


def _explain(rows: Sequence[Any], out: Any) -> None:
    """What the table has no room for."""
    from rich.markup import escape

    from bench.claims.estimate import SETTLED

    last = None
    for row in rows:
        c, j = row.claim, row.judgement
        if c.id != last:
            out.print(f"\n[bold]{c.id}[/]: {escape(c.text)} ({escape(c.source)})", highlight=False)
            if c.note:
                out.print(f"  Note: {escape(c.note)}", highlight=False)
        last = c.id
        where = f"{row.dataset}, {row.label}" if row.label else row.dataset or "no evidence"
        out.print(f"  {escape(where)}: [{COLOURS[j.verdict]}]{j.label}[/]. {escape(j.basis)}", highlight=False)
        if row.beside:
            out.print(f"  On other data: {escape(row.beside)}", highlight=False)
        if j.verdict not in SETTLED:
            needed = f"{row.outlook}: " if row.outlook else ""
            out.print(f"  To settle it: {needed}{escape(row.command)}", highlight=False, soft_wrap=True)


def _summarize(rows: Sequence[Any], out: Any, brief: bool) -> None:
    """Counts of verdicts, and how they came about."""
    counts = {v: sum(r.judgement.verdict == v for r in rows) for v in COLOURS}
    claims = len({r.claim.id for r in rows})
    out.print(
        f"\n[bold]Claims: {claims}. Verdicts: {len(rows)}[/]: " + ", ".join(f"{n} {v}" for v, n in counts.items())
    )
    if brief:
        out.print(
            "Of the verdicts on comparative claims at most 5 % are expected to be wrong (Benjamini and Hochberg); "
            "intervals are plain 95 % ones. `bench check -v` says what each rests on and what would settle it; "
            "`--claim ID` says it of one. `bench settle` adds the seeds that some of them need.",
            style="dim",
            highlight=False,
        )


def _regressions(held: Sequence[Any], out: Any) -> None:
    """What this suite published, against what was run here; ends with `CAUGHT` where a number does not hold."""
    from rich.markup import escape

    lost = [h for h in held if not h.holds]
    if not held:
        out.print("None of the published numbers was made again in this results folder.")
        return
    counts = Counter(h.how for h in held)
    kinds = ", ".join(f"{counts[k]} {k}" for k in ("same", "within spread", "moved") if counts[k])
    out.print(f"{len(held) - len(lost)} of {len(held)} published numbers that were made again hold: {kinds}.")
    for h in lost:
        allowed = f"{100 * h.band:.1f} % is allowed" if h.band else "the same run must be equal"
        text = f"published {h.published:.6g}, here {h.here:.6g}; {allowed}"
        out.print(f"  [red]no longer holds[/]: {escape(h.name)}: {text}", highlight=False)
    if lost:
        sys.exit(CAUGHT)


def _rerun(published: Path, write: bool) -> None:
    """Train the small fixed set again."""
    from bench.claims import published as regression

    out = options.console()
    runs = regression.rerun()
    if write:
        out.print(f"Published: {regression.write_smoke(published, runs)}", highlight=False)
        return
    _regressions(regression.check_smoke(published, runs), out)


def _write(target: Path, text: str) -> None:
    from bench.claims import manifest

    with writing(target):
        target.write_text(text, encoding="utf-8")
        manifest.entered(target)


def _plain(rows: Sequence[Any], held: Sequence[Any]) -> dict[str, Any]:
    """Everything, for JSON; what is not a number is null."""

    def plain(value: float | None) -> float | None:
        return value if value is not None and math.isfinite(value) else None

    def picked(of: Any, *names: str) -> dict[str, Any]:
        return {name: getattr(of, name) for name in names}

    return {
        "claims": [
            {
                **picked(r.claim, "id", "text", "source", "scope", "published", "unit"),
                "accept": [plain(x) for x in r.claim.accept],
                "note": r.claim.note,
                **picked(r, "dataset", "label"),
                **picked(r.judgement, "verdict", "slight"),
                "here": plain(r.judgement.value),
                "interval": [plain(r.judgement.low), plain(r.judgement.high)],
                "basis": r.judgement.basis,
                **picked(r, "beside", "outlook", "command"),
            }
            for r in rows
        ],
        "published": [
            {"name": h.name, "published": plain(h.published), "here": plain(h.here), **picked(h, "band", "holds")}
            for h in held
        ],
    }
