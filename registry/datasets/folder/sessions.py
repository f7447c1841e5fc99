"""Whose recordings a folder holds and when they were made: the same for all of them, or value by a column of each."""

import datetime
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from registry.datasets.folder.signals import known
from registry.datasets.reading.tables import read
from registry.errors import BenchError, near


@dataclass(frozen=True)
class Mark:
    """How a dataset.toml tells a vehicle or a date; neither text nor column: it does not."""

    text: str = ""
    """Of all recordings; a date as 2026-03-01."""
    column: str = ""
    """Of every file, which holds it in each of its rows."""


UNTOLD = Mark()


@dataclass(frozen=True)
class Session:
    """The recordings of one vehicle, of one day where they are dated."""

    vehicle: str
    """Empty: nobody said."""
    date: str
    """Such as 2026-03-01; empty: nobody said."""
    files: tuple[Path, ...]


def mark(path: Path, table: dict[str, Any], key: str) -> Mark:
    """What the description at ``path`` says under "vehicle" or "date".

    Raises:
        BenchError: it is neither a text (a date) nor {column = "…"}.
    """
    value = table.get(key, "")
    if isinstance(value, dict):
        known(value, ("column",), f"{path} {key}")
        if not isinstance(value.get("column"), str) or not value["column"]:
            raise BenchError(f'{path}: {key} must name a column, {key} = {{column = "…"}}.')
        return Mark(column=value["column"])
    if key == "date" and value != "":
        return Mark(_day(str(value), f"{path}: {key}"))
    if not isinstance(value, str) or (key in table and not value.strip()):
        raise BenchError(f'{path}: {key} must be a text or {{column = "…"}}, not {value!r:.60}.')
    return Mark(value.strip())


def sessions(files: Sequence[Path], vehicle: Mark, date: Mark) -> tuple[list[Session], dict[Path, str]]:
    """Files of one vehicle and day together, in order, by the first row of each.

    Returns:
        The sessions, and the files of which nobody can say whose they are, with a sentence each.
    """
    gathered: dict[tuple[str, str], list[Path]] = {}
    unknown = {}
    for file in files:
        try:
            value = tuple(_value(file, key, m, rows=1) for key, m in (("vehicle", vehicle), ("date", date)))
        except BenchError as error:
            unknown[file] = str(error)
            continue
        gathered.setdefault((value[0], value[1]), []).append(file)
    return [Session(v, d, tuple(of)) for (v, d), of in sorted(gathered.items())], unknown


def refuse_mixed(file: Path, vehicle: Mark, date: Mark) -> None:
    """Raise `BenchError` where a file holds more than one vehicle or day."""
    for key, m in (("vehicle", vehicle), ("date", date)):
        _value(file, key, m)


def _value(file: Path, key: str, of: Mark, rows: int | None = None) -> str:
    """What a file says, by its first rows or (None) all of them."""
    if not of.column:
        return of.text
    table = read(file, rows=rows)
    if of.column not in table:
        raise BenchError(f"{file} has no column {of.column!r}: {near(of.column, map(str, table.columns))}")
    try:
        values = list(dict.fromkeys(_text(v) for v in table[of.column].head(rows or len(table)).unique()))
    except TypeError as error:  # lists and structs, which Parquet has
        raise BenchError(f"{file}, column {of.column!r} holds no texts: it must say the {key}.") from error
    if len(values) > 1:
        raise BenchError(
            f"{file}, column {of.column!r}: {values[0]!r:.60} and {values[1]!r:.60}, where a recording has one "
            f"{key}: split the file."
        )
    if not values or not values[0]:
        raise BenchError(f"{file}, column {of.column!r} is empty: it must say the {key}.")
    return _day(values[0], f"{file}, column {of.column!r}") if key == "date" else values[0]


def _text(value: Any) -> str:
    """A cell as text; a whole number without its point, an empty cell as none."""
    if pd.isna(value):
        return ""
    return str(int(value)) if isinstance(value, float) and value.is_integer() else str(value).strip()


def _day(text: str, where: str) -> str:
    try:
        return datetime.datetime.fromisoformat(text).date().isoformat()
    except ValueError:
        raise BenchError(f"{where}: {text!r:.60} is no date: write it as 2026-03-01.") from None
