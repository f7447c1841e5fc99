"""Options that several commands share."""

import math
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click
from typing_extensions import override

from registry.errors import BenchError
from registry.regular_file import regular

MAX_NAME_BYTES = 255
"""Bytes in the name of a file, on every file system in use."""


class Output(click.Path):
    """A file or folder to be written, looked at before the work rather than after it."""

    def __init__(self, folder: bool = False, made: bool = False) -> None:
        """``folder``: it is one; ``made``: the folders above it are made where there are none."""
        super().__init__(path_type=Path)
        self.folder, self.made = folder, made or folder

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """See `click.ParamType.convert`.

        Raises:
            BenchError: it cannot be written, or is something else.
        """
        if not str(value).strip():
            self.fail("it names no file.", param, ctx)
        path = Path(os.fsdecode(super().convert(value, param, ctx)))
        if any(len(os.fsencode(part)) > MAX_NAME_BYTES for part in path.parts):
            raise BenchError(f"{path} cannot be written: no file has so long a name.")
        if os.path.lexists(path):
            if self.folder and not path.is_dir():
                raise BenchError(f"{path} cannot be written: it is no folder.")
            if not self.folder:
                regular(path)
            there = path
        else:
            above = path.absolute().parents
            there = next((p for p in above if os.path.lexists(p)), path) if self.made else above[0]
            if not there.is_dir():
                raise BenchError(f"{path} cannot be written: {there} is no folder.")
        if not os.access(there, os.W_OK):
            raise BenchError(f"{path} cannot be written: {there} is not yours to write to.")
        return path


class Recordings(click.Path):
    """A folder that exists."""

    def __init__(self) -> None:
        super().__init__(path_type=Path, exists=True, file_okay=False)

    @override
    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """See `click.ParamType.convert`.

        Raises:
            BenchError: it is a file.
        """
        if os.path.isfile(value):
            raise BenchError(f"{value} is a file: give the folder that holds it, {Path(value).parent}.")
        return Path(os.fsdecode(super().convert(value, param, ctx)))


class Positive(click.FloatRange):
    """A finite number above zero."""

    def __init__(self, most: float | None = None) -> None:
        super().__init__(min=0, max=most, min_open=True)

    @override
    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        number: float = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value} is not a finite number.", param, ctx)
        return number


class Duration(click.ParamType):
    """A time such as 45m, 1h, 1h30m or 90s, in seconds."""

    name = "duration"

    @override
    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        if isinstance(value, float):
            return value
        found = re.fullmatch(r"(?:(\d{1,4})h)?(?:(\d{1,5})m)?(?:(\d{1,6})s)?", str(value).strip())
        seconds = sum(int(n or 0) * unit for n, unit in zip(found.groups(), (3600, 60, 1), strict=True)) if found else 0
        if not seconds:
            self.fail(f"{value!r} is no time: write it as 45m, 1h or 1h30m.", param, ctx)
        return float(seconds)


results = click.option(
    "--results",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("results"),
    show_default=True,
    help="Folder of records, figures and the MLflow database.",
)
tracking = click.option(
    "--tracking", metavar="URI", help="MLflow server or database; default: sqlite in the results folder."
)
no_track = click.option("--no-track", is_flag=True, help="Leave MLflow alone; `bench sync` can log the runs later.")
workers = click.option(
    "--workers", type=click.IntRange(1, 512), help="Processes, one thread each; default: one a core."
)
cluster = click.option("--cluster", metavar="ADDRESS", help="A Dask scheduler, as `bench cluster start` prints it.")
assignments = click.option(
    "--set",
    "assignments",
    multiple=True,
    metavar="OPTION=VALUE",
    help="Set any option of the run, such as training.updates=3000, predictor.dropout=0.1 or dataset.size=full; "
    "`bench show NAME` lists them. May be repeated.",
)


_Text = TypeVar("_Text", str, tuple[str, ...], None)


def _refuse_empty(otherwise: str) -> Callable[[click.Context, click.Parameter, _Text], _Text]:
    """As a callback: refuse an empty text, also among those of an option that is given several times."""

    def look(ctx: click.Context, param: click.Parameter, value: _Text) -> _Text:
        if value is not None and not all(v.strip() for v in ((value,) if isinstance(value, str) else value)):
            raise click.BadParameter(otherwise, ctx, param)
        return value

    return look


not_empty = _refuse_empty("it is empty: give a name or a folder.")
"""An empty name would mean the default or the working directory."""
not_blank = _refuse_empty("it is empty: every name holds that.")
dataset = click.option(
    "--dataset",
    metavar="NAME",
    callback=not_empty,
    help="A registered data set (`bench list datasets`), or a folder that holds a dataset.toml.",
)
outputs = click.option(
    "--outputs",
    metavar="SIGNALS",
    callback=_refuse_empty("it names no signal."),
    help="What to predict, such as body_rates,velocity or body_rates.p.",
)
horizon = click.option(
    "--horizon", "-T", type=click.IntRange(1, 1_000_000), help="Prediction length in samples (default: 40)."
)


def parsed(assignments: tuple[str, ...]) -> dict[str, str]:
    """ "a.b=c" pairs as a dictionary.

    Raises:
        click.UsageError: no equals sign.
    """
    out = {}
    for text in assignments:
        name, equals, value = text.partition("=")
        if not equals:
            raise click.UsageError(f"--set {text!r} must be OPTION=VALUE, such as training.updates=3000.")
        out[name.strip()] = value.strip()
    return out


def console() -> Any:
    """Where tables go: as wide as the terminal, 100 columns in a pipe."""
    from rich.console import Console

    plain = Console()
    return plain if plain.is_terminal else Console(width=100, highlight=False)
