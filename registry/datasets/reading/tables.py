"""CSV and Parquet files as tables of finite numbers, or a sentence that says where they are not."""

import csv
import gzip
import re
import zlib
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.parquet
from pyarrow import ArrowException

from registry.errors import BenchError, near, unreadable
from registry.regular_file import not_text, regular
from registry.units import unit_of

LONGEST_LINE = 1 << 20
"""Bytes of a line that may hold units."""
COMMENTS = 1000
"""Lines before the header of a CSV file that may begin with "#"."""
LARGEST = 1e60
"""Of a number in a file, whatever its unit: sums of fourth powers of it are finite yet."""
ENDINGS = (".csv", ".csv.gz", ".parquet")


_DATE = re.compile(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d")


class MissingValue(BenchError):
    """There is nothing where a number should be."""


def header(file: Path) -> list[str]:
    """Column names.

    Raises:
        BenchError: the file is empty, damaged or of no known kind.
    """
    return [str(c) for c in read(file, rows=0).columns]


def numbers(
    file: Path, columns: Sequence[str], gaps: Collection[str] = (), time: str = "", tick: float = 1.0
) -> np.ndarray:
    """The ``columns`` (N, len), every one a finite number.

    Args:
        file: a CSV or Parquet file.
        columns: their names.
        gaps: those that may lack values, which are NaN then, but for all of them.
        time: one that becomes seconds: dates (ISO 8601) since the first of them, numbers times ``tick``.
        tick: of the numbers of the time [s].

    Raises:
        MissingValue: the first that is no finite number is NaN or empty.
        BenchError: with file, column and row (as a spreadsheet counts: the header is row 1; in Parquet the first
            record is).
    """
    table = read(file)
    for column in columns:
        if column not in table:
            raise BenchError(f"{file} has no column {column!r}: {near(column, map(str, table.columns))}")
    if len(table) == 0:
        raise BenchError(f"{file} holds no samples, only a header: export it again, or remove it.")
    values = np.empty((len(table), len(columns)))
    for j, column in enumerate(columns):
        raw = table[column]
        number = _seconds(raw, tick) if column == time else _floats(raw)
        bad = ~(np.abs(number) <= LARGEST)  # NaN too
        if column in gaps and not bad.all():
            bad &= ~raw.isna().to_numpy()
        if bad.any():
            i = int(bad.argmax())
            where, absent = f"{file}, column {column!r}, row {first_row(file) + i}", raw.isna()
            if absent.iloc[i]:  # of a list `pd.isna` asks every item
                raise _missing(file, column, int(absent.sum()), len(raw), first_row(file) + i)
            raise BenchError(f"{where}: {str(raw.iloc[i])!r}, not a finite number (of at most {LARGEST:g}).")
        values[:, j] = number
    return values


def _missing(file: Path, column: str, count: int, rows: int, first: int) -> MissingValue:
    if count == rows:
        return MissingValue(
            f"{file}: column {column!r} has no number in any of {rows} rows (NaN or empty): leave the column out of "
            "dataset.toml, or remove the file."
        )
    return MissingValue(
        f"{file}: column {column!r} has no number in {count} of {rows} rows (NaN or empty), first in row {first}: "
        "remove those rows, or fill them in."
    )


def _floats(column: pd.Series) -> np.ndarray:
    """The values (N,), NaN where one is none; dates and spans of time are none, whatever integers they are kept as."""
    if column.dtype.kind in "mM":
        return np.full(len(column), np.nan)
    try:
        return pd.to_numeric(column, errors="coerce").to_numpy(dtype=float, na_value=np.nan)
    except OverflowError:  # a whole number beyond all floats
        return np.array([_float(value) for value in column])


def _seconds(column: pd.Series, tick: float) -> np.ndarray:
    """The times (N,) [s]: dates since the first, or numbers times ``tick``; NaN where one is neither."""
    if not _holds_dates(column):
        return _floats(column) * tick
    dates = pd.to_datetime(column, errors="coerce", utc=True, format="ISO8601")
    return (dates - dates.iloc[0]).dt.total_seconds().to_numpy(dtype=float)


def dated(file: Path, column: str) -> bool:
    """Whether a column of a file begins with a date."""
    table = read(file, rows=1)
    return column in table and _holds_dates(table[column])


def _holds_dates(column: pd.Series) -> bool:
    """Whether a column (N,) begins with a date as ISO 8601 writes it, and not with a number."""
    if column.dtype.kind == "M":
        return True
    first = column.iloc[0] if len(column) else None
    return isinstance(first, str) and _DATE.match(first.strip()) is not None


def _float(value: Any) -> float:
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError):
        return np.nan


def numeric(file: Path) -> dict[str, np.ndarray]:
    """The columns (N,) that hold numbers, NaN where a value is missing; texts among them are left out.

    Raises:
        BenchError: see `read`.
    """
    table = read(file)
    found = {}
    for column in table:
        number = _floats(table[column])
        if np.isfinite(number).any() and not (np.isnan(number) & ~table[column].isna().to_numpy()).any():
            found[str(column)] = number
    return found


def units(file: Path) -> dict[str, str]:
    """The units of the columns, where the second row of a CSV file holds units and no number; else none."""
    names, second = _two_rows(file)
    # A "1" would be a number: what has no unit has "-", or nothing.
    read_as = {name: unit_of(text) if text.strip() != "1" else "" for name, text in zip(names, second, strict=False)}
    found = {name: unit for name, unit in read_as.items() if unit}
    return found if len(second) == len(names) and len(found) == sum(bool(text.strip()) for text in second) else {}


def first_row(file: Path) -> int:
    """The row number of the first sample."""
    return 1 if file.name.endswith(".parquet") else len(_before(_first_lines(file))) + (3 if units(file) else 2)


def read(file: Path, rows: int | None = None, any_ending: bool = False) -> pd.DataFrame:
    """The table in a file, its columns named as they are there.

    Args:
        file: CSV, CSV.gz or Parquet.
        rows: the first ones only.
        any_ending: whether a name that ends otherwise is read as CSV.

    Raises:
        BenchError: the file is absent, no regular file, empty, damaged or of no known kind, has a column twice or rows
            that are longer than its header.
    """
    regular(file)
    if not any_ending and not file.name.endswith(ENDINGS):
        raise BenchError(f"{file} is neither CSV, CSV.gz nor Parquet.")
    try:
        return _parquet(file, rows) if file.name.endswith(".parquet") else _csv(file, rows)
    except FileNotFoundError:
        raise BenchError(f"There is no file {file}.") from None
    except UnicodeDecodeError as error:
        raise not_text(file, _content(file)) from error  # pandas counts bytes within a cell
    except pd.errors.EmptyDataError as error:
        raise BenchError(f"{file} is empty: export it again, or remove it.") from error
    except (gzip.BadGzipFile, zlib.error, EOFError, ArrowException, OSError, ValueError, OverflowError) as error:
        raise unreadable(file, error) from error


def _content(file: Path) -> bytes:
    with gzip.open(file, "rb") if file.name.endswith(".gz") else file.open("rb") as stream:
        content: bytes = stream.read()
    return content


def _parquet(file: Path, rows: int | None) -> pd.DataFrame:
    names = pyarrow.parquet.read_schema(file).names
    _refuse_twice(file, names)
    return pd.DataFrame(columns=names) if rows == 0 else pd.read_parquet(file)


def _csv(file: Path, rows: int | None) -> pd.DataFrame:
    lines = _first_lines(file)
    above = _before(lines)
    options: dict[str, Any] = {"encoding": "utf-8", "skip_blank_lines": False, "skipinitialspace": True}
    if (separator := _separator(lines[len(above) :])) != ",":
        options |= {"sep": separator, "decimal": ","}  # as where commas are in numbers
    first = pd.read_csv(file, **options, header=None, nrows=1, dtype=str, keep_default_na=False, skiprows=len(above))
    _refuse_twice(file, [str(name) for name in first.iloc[0]])
    skipped = [*range(len(above)), *([len(above) + 1] if rows != 0 and units(file) else [])]
    table = pd.read_csv(file, **options, low_memory=False, nrows=rows, skiprows=skipped)
    if not isinstance(table.index, pd.RangeIndex):  # pandas takes the first columns for names of the rows
        raise BenchError(
            f"{file} has rows that are longer than its header of {len(table.columns)} names: name every column, or "
            "remove the commas at the ends of the rows."
        )
    return table


def _two_rows(file: Path) -> list[list[str]]:
    """The cells of the first two lines of a CSV file; none where they cannot be options."""
    if file.name.endswith(".parquet"):
        return [[], []]
    lines = _two_lines(file)
    try:
        rows = list(csv.reader(lines, skipinitialspace=True, delimiter=_separator(lines)))
    except csv.Error:
        return [[], []]
    return rows if len(rows) == 2 else [[], []]


def _two_lines(file: Path) -> list[str]:
    """The header of a CSV file and the line after it; none where they are no text."""
    lines = _first_lines(file)
    return lines[len(_before(lines)) :][:2]


def _before(lines: Sequence[str]) -> list[str]:
    """Of the first lines the comments before the header. Where units or numbers follow them, the last is the header."""
    *comments, first, _ = lines or ["", ""]
    if comments:
        above, cells = (re.split("[,;\t]", line.strip()) for line in (comments[-1], first))
        if all(map(_finite, cells)) or (1 < len(cells) == len(above) and all(map(_unit, cells))):
            comments.pop()
    return comments


def _finite(cell: str) -> bool:
    return bool(np.isfinite(_float(cell.strip() or "0")))


def _unit(cell: str) -> bool:
    return bool(unit_of(cell or "-"))


def _first_lines(file: Path) -> list[str]:
    """The comments that a CSV file begins with, and two lines more; none where they are no text."""
    out: list[str] = []
    try:
        with gzip.open(file, "rb") if file.name.endswith(".gz") else file.open("rb") as stream:
            while len(out) < COMMENTS and (not out or out[-1].startswith("#")):
                out.append(stream.readline(LONGEST_LINE).decode("utf-8-sig"))
            return [*out, stream.readline(LONGEST_LINE).decode("utf-8-sig")]
    except (OSError, ValueError, EOFError, zlib.error):
        return []


def _separator(lines: Sequence[str]) -> str:
    """What stands between columns: a semicolon or tab where the header has no comma."""
    head = lines[0] if lines else ""
    return next((s for s in ";\t" if s in head and "," not in head), ",")


def _refuse_twice(file: Path, names: Sequence[str]) -> None:
    """Raise where a name stands for two columns."""
    seen: set[str] = set()
    for name in names:
        if name in seen and name:
            raise BenchError(f"{file} has two columns named {name!r:.200}: rename one of them.")
        seen.add(name)
