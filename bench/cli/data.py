"""`bench data`: look at recordings, describe a folder of one's own, check it."""

from pathlib import Path
from typing import Any

import click

from bench.cli import options
from bench.cli.datasets import choose
from registry.errors import BenchError


@click.group("data")
def data_command() -> None:
    """Recordings: inspect a data set, describe and check a folder of your own."""


@data_command.command("inspect")
@click.argument("name", metavar="DATASET|FOLDER")
@options.assignments
def inspect_command(name: str, assignments: tuple[str, ...]) -> None:
    """Per recording: samples, rate, seconds, what cleaning found, ranges with units; then every finding."""
    from registry.datasets.inspect import inspect

    given = {k.removeprefix("dataset."): v for k, v in options.parsed(assignments).items()}
    _render(inspect(choose(name, given)))


@data_command.command("init")
@click.argument("folder", type=click.Path(path_type=Path, exists=True, file_okay=False))
def init_command(folder: Path) -> None:
    """Draft FOLDER/dataset.toml from the headers of its CSV or Parquet files."""
    from registry.datasets.folder import draft

    target = folder / "dataset.toml"
    if target.exists():
        raise BenchError(f"{target} exists already: edit it, or move it away to draft a new one.")
    text = draft(folder)
    try:
        target.write_text(text)
    except OSError as error:
        raise BenchError(f"{target} cannot be written: {error.strerror}.") from error
    click.echo(f"Wrote {target}. Complete the lines marked TODO, then: bench data check {folder}")


@data_command.command("check")
@click.argument("folder", type=click.Path(path_type=Path, exists=True, file_okay=False))
def check_command(folder: Path) -> None:
    """Read everything that FOLDER/dataset.toml describes and say what is wrong."""
    from registry.datasets.folder import check

    loaded = check(folder)
    seconds = sum(r.seconds for r in loaded.recordings)
    click.echo(f"{len(loaded.recordings)} recording(s), {seconds:.1f} s in all, read without an error.")
    for f in loaded.findings:
        click.echo(f"  {f.recording}: {f.detail}")
    click.echo(f'Next: bench run "LSTM: 1x50 - MLP: 60x10" --dataset {folder}')


def _render(summary: dict[str, Any]) -> None:
    raise NotImplementedError
