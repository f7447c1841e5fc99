"""Options of every step of a diagnosis: which recordings, and which model of them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bench.cli import options
from bench.cli.names import check_system
from bench.experiment.asked import Asked
from bench.experiment.datasets import choose, registered
from registry.core import DATASETS
from registry.errors import BenchError, near

if TYPE_CHECKING:
    from bench.diagnose.logs.subject import Subject
    from registry.dynamics import PhysicsModel


@dataclass(frozen=True)
class DataOptions:
    """What is diagnosed, as it was typed."""

    source: str
    """A folder or the name of a data set."""
    settings: tuple[str, ...] = ()
    """Options of the data set, "gyroscope=true"."""
    system: str | None = None
    """As `bench.diagnose.logs.load.load`."""
    model_file: Path | None = None
    """A model.toml to start from."""
    exclude: tuple[str, ...] = ()
    """Names of recordings that are left out."""

    def load(self) -> "tuple[Subject, PhysicsModel | None]":
        """The measurements with the nominal model, and the model in the file if one was given.

        Raises:
            BenchError: no such data, system, model or recording; recordings too short to judge a model by.
        """
        refuse_file(self.source)
        if not Path(self.source).is_dir() and self.source not in DATASETS.outline():
            hint = "" if Path(self.source).exists() else " (it does not exist)"
            raise BenchError(
                f"{self.source}{hint} is neither a folder with a dataset.toml nor a data set: "
                f"{near(self.source, DATASETS.outline())} `bench data init FOLDER` drafts a dataset.toml."
            )
        check_system(self.system)
        given = options.parsed(self.settings)

        from bench.diagnose.logs.load import excluding, load, starting_from
        from bench.diagnose.logs.parts import refuse_short

        subject = load(choose(self.source, given) if given else self.source, self.system)
        for sentence in subject.resampled:
            click.echo(f"note: {sentence}", err=True)
        subject = excluding(subject, self.exclude)
        refuse_short(subject)
        return subject, None if self.model_file is None else starting_from(subject, self.model_file)

    def measured(self, catalogue: Sequence[str]) -> "Subject":
        """The measurements with the model that is diagnosed, to which these effects can be added.

        Raises:
            BenchError: as `load`; an effect that the system does not have.
        """
        subject, model = self.load()

        from bench.diagnose.select.catalogue import check_catalogue

        check_catalogue(subject, model or subject.model, catalogue)
        return subject if model is None else replace(subject, model=model)

    def asked(self, out: Path | None = None, **own: Sequence[str]) -> Asked:
        """What the next commands need again; ``own``: of `bench diagnose` alone, by name of the option."""
        words = [w for name, values in own.items() for v in values for w in (f"--{name.replace('_', '-')}", v)]
        model = "" if self.model_file is None else str(self.model_file)
        given = "" if out is None else str(out)
        return Asked(self.system or "", model, given, tuple(words), self.settings, self.exclude)

    def next_command(self, name: str, *more: str) -> str:
        """`bench NAME` of the same data with ``more`` words, as a shell runs it."""
        return self.asked().command(name, self.source, *more)


def refuse_file(source: str) -> None:
    """Raise `BenchError` where a file is given in the place of its folder."""
    if Path(source).is_file() and not registered(source):
        raise BenchError(f"{source} is a file: give the folder that holds it, {Path(source).parent}.")


def data_options(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command these options, gathered in its argument ``data``, and --json as ``to_json``."""
    return _gathering(command, _model("nominal constants, no effects"))


def data_options_after_diagnosis(command: Callable[..., None]) -> Callable[..., None]:
    """The same, for a command that goes out from the model that a diagnosis wrote."""
    return _gathering(command, _model("the model.toml that the diagnosis wrote"))


def _gathering(command: Callable[..., None], model: Callable[..., Any]) -> Callable[..., None]:
    @wraps(command)
    def gathered(
        *args: Any,
        source: str,
        settings: tuple[str, ...],
        system: str | None,
        model_file: Path | None,
        exclude: tuple[str, ...],
        **others: Any,
    ) -> None:
        command(*args, data=DataOptions(source, settings, system, model_file, exclude), **others)

    for add in (_json, exclude_option, model, _system, _set, _source):
        gathered = add(gathered)
    return gathered


def _model(otherwise: str) -> Callable[..., Any]:
    return click.option(
        "--model",
        "model_file",
        type=click.Path(path_type=Path, dir_okay=False),
        help=f"Start from this model.toml, such as an extended one; default: {otherwise}.",
    )


_source = click.argument("source", metavar="DATA", callback=options.not_empty)
_set = click.option(
    "--set",
    "settings",
    multiple=True,
    metavar="OPTION=VALUE",
    help="Set an option of the data set, such as gyroscope=true of nanobench; `bench show DATA` lists them. "
    "Repeatable.",
)
_system = click.option(
    "--system",
    metavar="NAME|FILE.py:CLASS",
    help="Physics model: one of `bench list physics`, or your own class; default: what the data name.",
)
exclude_option = click.option(
    "--exclude", multiple=True, metavar="RECORDING", help="Leave this recording out. Repeatable."
)
ignore_option = click.option(
    "--ignore-problem", "ignore", multiple=True, metavar="KIND", help="Go on although the data have this. Repeatable."
)
_json = click.option(
    "--json", "to_json", type=options.Output(made=True), help="Also write the numbers as JSON to this file."
)
