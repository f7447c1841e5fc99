"""`bench report`: a finished study or sweep as one HTML file."""

import shutil
from pathlib import Path

import click

from bench.cli import options
from bench.experiment import study
from registry.atomic_io import writing
from registry.errors import BenchError


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
    from bench.cli.finished import finished_study, sweep_page
    from bench.records import record
    from bench.reporting import study_page
    from bench.reporting.study_outputs import REPORT

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


def _deliver(page: Path, output: Path | None) -> None:
    if output is not None:
        with writing(f"The report {output}"):
            shutil.copyfile(page, output)
    click.echo(str(output or page))
