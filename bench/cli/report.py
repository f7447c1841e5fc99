"""`bench report`: a finished study or sweep as one HTML file."""

import re
import shutil
from collections.abc import Iterable
from pathlib import Path
from typing import TypeVar

import click

from bench.cli import options
from bench.cli.run import check_target
from bench.experiment import study
from bench.records import record
from bench.records.concluded import Concluded, concluded
from bench.reporting.conclude import REPORT
from registry.errors import BenchError

T = TypeVar("T")
TITLE = re.compile(r"(?P<name>.+) on (?P<dataset>.+?)(?: \((?P<preset>\w+)\))?(?:, .*)?")
"""Of a finished study, as `bench run` makes it: what, on which data, preset, options."""


@click.command("report")
@click.argument("name", metavar="STUDY|SPEC|SWEEP")
@options.dataset
@click.option("--preset", type=click.Choice(study.PRESETS), help="Size of the study.")
@options.results
@click.option("-o", "--output", type=options.Output(), help="Where to write the page.")
def report_command(name: str, dataset: str | None, preset: str | None, results: Path, output: Path | None) -> None:
    """Write the report of a STUDY (or SPEC) that `bench run` has finished: one HTML page that needs no network.

    \b
    bench report washout_vs_mlp
    bench report washout_vs_mlp --dataset nanodrone --preset laptop -o report.html
    bench report NAME                                    the page of a sweep, by its folder in results/sweeps

    What was asked, the paper's figure and ours, tables, error of every step, spread, worst predictions, training,
    provenance, and the command that makes it again. `bench run` writes the same page into the study's folder, and
    `bench sweep` that of a sweep: the verdict, history, importances and the Pareto front.
    """
    from bench.reporting import study_page

    page = sweep_page(name, dataset, preset, results)
    if page is not None:
        _deliver(page, output)
        return
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


def sweep_page(name: str, dataset: str | None, preset: str | None, results: Path) -> Path | None:
    """The page of the sweep of that name; of its target too where no finished study is meant. None: there is none.

    Raises:
        BenchError: the sweep has not ended.
    """
    from bench.sweep import journal as sweeps

    known = {folder: sweeps.read(folder)[0] for folder in sweeps.sweeps(results)}
    found = [f for f, sweep in known.items() if name in (f.name, sweep.title)]
    if not found and not _fitting(((c, c.title) for c in concluded(results)), name, dataset, preset):
        found = _fitting(((f, s.title.removeprefix("sweep of ")) for f, s in known.items()), name, dataset, preset)
    if len(found) > 1:
        raise BenchError(f"{len(found)} sweeps fit: give one of {'; '.join(f.name for f in found)}.")
    if not found:
        return None
    page = found[0] / sweeps.REPORT
    if not page.is_file():
        raise BenchError(f"The sweep {found[0].name} has not ended: go on with `{known[found[0]].command} --resume`.")
    return page


def _deliver(page: Path, output: Path | None) -> None:
    if output is not None:
        try:
            shutil.copyfile(page, output)
        except OSError as error:
            raise BenchError(f"The report {output} cannot be written: {error.strerror or error}.") from error
    click.echo(str(output or page))


def _fitting(titled: Iterable[tuple[T, str]], name: str, dataset: str | None, preset: str | None) -> list[T]:
    """Those whose title says this name, data set and preset."""
    return [
        each
        for each, title in titled
        if (match := TITLE.fullmatch(title))
        and match["name"] == name
        and dataset in (None, match["dataset"])
        and preset in (None, match["preset"])
    ]


def finished_study(name: str, dataset: str | None, preset: str | None, results: Path) -> Concluded:
    """The finished study of that name (of its folder, of its title), data set and preset.

    Raises:
        BenchError: none, or several; the sentence lists them.
    """
    every = list(concluded(results))
    exact = [c for c in every if name in (c.folder.name, c.title)]
    fitting = exact or _fitting(((c, c.title) for c in every), name, dataset, preset)
    if len(fitting) == 1:
        return fitting[0]
    if fitting:
        listed = "; ".join(c.folder.name for c in fitting)
        raise BenchError(f"{len(fitting)} finished studies fit: give --dataset, --preset, or one of {listed}.")
    if name not in study.studies() and not _fitting(((c, c.title) for c in every), name, None, None):
        check_target(name)
    if not every:
        raise BenchError(f"No study is finished in {results}: start one with `bench run {name}`.")
    listed = "; ".join(c.folder.name for c in every)
    raise BenchError(f"No finished study fits: start it with `bench run {name}`, or give one of {listed}.")
