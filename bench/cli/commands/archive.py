"""`bench export` and `bench import`: a finished study as one file."""

from pathlib import Path

import click
from rich.markup import escape

from bench.cli import options
from bench.experiment import study
from registry.errors import BenchError


@click.command("export")
@click.argument("name", metavar="STUDY|SPEC")
@options.dataset
@click.option("--preset", type=click.Choice(study.PRESETS), help="Size of the study.")
@click.option("-o", "--output", required=True, type=options.Output(), help="The zip file.")
@options.results
def export_command(name: str, dataset: str | None, preset: str | None, output: Path, results: Path) -> None:
    """Pack a finished STUDY, with every record, configuration and provenance, into one zip file.

    \b
    bench export washout_vs_mlp -o washout.zip
    bench import washout.zip                     on another machine

    The same study gives the same file. Paths of your own that are options of a run (a folder of data, a model.toml)
    are part of its configuration.
    """
    from bench.cli.finished import finished_study
    from bench.records import archive

    found = finished_study(name, dataset, preset, results)
    archive.write(found, results / "runs", output)
    click.echo(f"{len(found.keys)} runs of “{found.title}” are in {output}.")


@click.command("import")
@click.argument("file", type=click.Path(path_type=Path, dir_okay=False))
@options.results
def import_command(file: Path, results: Path) -> None:
    """Take in a study that `bench export` packed, from anybody: nothing in FILE is run, all of it is checked.

    Runs that are here already are kept as they are. Table, figures and report are made anew.
    (`bench data import` is for flight logs.)
    """
    from bench.execution import lock
    from bench.records import archive
    from bench.records.finished import slug
    from bench.records.record import RunRecord
    from bench.reporting import study_outputs

    out = options.console()
    done = archive.read(file, results / "runs")
    kept = len(done.keys) - len(done.new)
    out.print(f"{len(done.new)} runs of “{escape(done.title)}” are new here, {kept} were here already and are kept.")
    folder = results / "studies" / slug(done.title)
    if (folder / "study.json").is_file():
        out.print(f"The study is finished here already ({escape(str(folder))}): its report is kept, too.")
        return
    records = [RunRecord(results / "runs" / key) for key in done.keys]
    with lock.held(folder, done.title):
        try:
            found = study.studies().get(done.study or "")
            study_outputs.write_outputs(out, records, done.title, found, done.command, folder)
        except BenchError:
            raise
        except Exception as error:  # records that fit one by one and make no study together
            raise BenchError(f"The runs are in, but no report can be made of them ({error!r:.120}).") from error
    out.print(f"Figure and tables: {escape(str(folder))}")
