"""`bench report`: a finished study as one HTML file."""

import re
from pathlib import Path

import click

from bench import record, study
from bench.cli import options
from bench.conclude import REPORT, Concluded, concluded
from registry.errors import BenchError

TITLE = re.compile(r"(?P<name>.+) on (?P<dataset>.+?)(?: \((?P<preset>\w+)\))?(?:, .*)?")
"""Of a finished study, as `bench run` makes it: what, on which data, preset, options."""


@click.command("report")
@click.argument("name", metavar="STUDY|SPEC")
@options.dataset
@click.option("--preset", type=click.Choice(study.PRESETS), help="Size of the study.")
@options.results
@click.option("-o", "--output", type=click.Path(path_type=Path, dir_okay=False), help="Where to write the page.")
def report_command(name: str, dataset: str | None, preset: str | None, results: Path, output: Path | None) -> None:
    """Write the report of a STUDY (or SPEC) that `bench run` has finished: one HTML page that needs no network.

    \b
    bench report washout_vs_mlp
    bench report washout_vs_mlp --dataset nanodrone --preset laptop -o report.html

    What was asked, the paper's figure and ours, tables, error of every step, spread, worst predictions, training,
    provenance, and the command that makes it again. `bench run` writes the same page into the study's folder.
    """
    from bench import study_page

    found = finished_study(name, dataset, preset, results)
    missing = [k for k in found.keys if not record.exists(results / "runs", k)]
    if missing:
        raise BenchError(
            f"{len(missing)} of the {len(found.keys)} runs of “{found.title}” are not in {results / 'runs'}: "
            f"make them again with `{found.command}`."
        )
    records = [record.RunRecord(results / "runs" / key) for key in found.keys]
    path = output or found.folder / REPORT
    study_page.write(path, records, found.title, study.studies().get(found.study or ""), found.command)
    click.echo(str(path))


def finished_study(name: str, dataset: str | None, preset: str | None, results: Path) -> Concluded:
    """The finished study of that name (of its folder, of its title), data set and preset.

    Raises:
        BenchError: none, or several; the sentence lists them.
    """
    every = list(concluded(results))
    exact = [c for c in every if name in (c.folder.name, c.title)]
    fitting = exact or [
        c
        for c in every
        if (match := TITLE.fullmatch(c.title))
        and match["name"] == name
        and dataset in (None, match["dataset"])
        and preset in (None, match["preset"])
    ]
    if len(fitting) == 1:
        return fitting[0]
    if fitting:
        listed = "; ".join(c.folder.name for c in fitting)
        raise BenchError(f"{len(fitting)} finished studies fit: give --dataset, --preset, or one of {listed}.")
    if not every:
        raise BenchError(f"No study is finished in {results}: start one with `bench run {name}`.")
    listed = "; ".join(c.folder.name for c in every)
    raise BenchError(f"No finished study fits: start it with `bench run {name}`, or give one of {listed}.")
