"""CSV and Parquet files as tables of finite numbers, or a sentence that says where they are not."""

import gzip
import zlib
from collections.abc import Collection, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet
from pyarrow import ArrowException

from registry.errors import BenchError, near

ENDINGS = (".csv", ".csv.gz", ".parquet")


def header(file: Path) -> list[str]:
    """Column names.

    Raises:
        BenchError: the file is empty, damaged or of no known kind.
    """
    return [str(c) for c in _read(file, rows=0).columns]


def numbers(file: Path, columns: Sequence[str], gaps: Collection[str] = ()) -> np.ndarray:
    """The ``columns`` (N, len), every one a finite number.

    Args:
        file: a CSV or Parquet file.
        columns: their names.
        gaps: those that may lack values, which are NaN then, but for all of them.

    Raises:
        BenchError: with file, column and row (as a spreadsheet counts: the header is row 1; in Parquet the first
            record is).
    """
    table = _read(file)
    for column in columns:
        if column not in table:
            raise BenchError(f"{file} has no column {column!r}: {near(column, map(str, table.columns))}")
    if len(table) == 0:
        raise BenchError(f"{file} holds no samples.")
    values = np.empty((len(table), len(columns)))
    for j, column in enumerate(columns):
        raw = table[column]
        number = pd.to_numeric(raw, errors="coerce").to_numpy(dtype=float, na_value=np.nan)
        bad = ~np.isfinite(number)
        if column in gaps and not bad.all():
            bad &= ~raw.isna().to_numpy()
        if bad.any():
            i = int(bad.argmax())
            what = "no number (NaN or empty)" if pd.isna(raw.iloc[i]) else f"{str(raw.iloc[i])!r}, not a finite number"
            raise BenchError(f"{file}, column {column!r}, row {first_row(file) + i}: {what}.")
        values[:, j] = number
    return values


def first_row(file: Path) -> int:
    """The row number of the first sample."""
    return 1 if file.name.endswith(".parquet") else 2


def _read(file: Path, rows: int | None = None) -> pd.DataFrame:
    try:
        if file.name.endswith(".parquet"):
            if rows == 0:
                return pd.DataFrame(columns=pyarrow.parquet.read_schema(file).names)
            return pd.read_parquet(file)
        if not file.name.endswith(ENDINGS):
            raise BenchError(f"{file} is neither CSV, CSV.gz nor Parquet.")
        return pd.read_csv(
            file, encoding="utf-8", skip_blank_lines=False, skipinitialspace=True, low_memory=False, nrows=rows
        )
    except UnicodeDecodeError as error:
        raise BenchError(f"{file} is not UTF-8 text (byte {error.start}).") from error
    except pd.errors.EmptyDataError as error:
        raise BenchError(f"{file} is empty.") from error
    except (gzip.BadGzipFile, zlib.error, EOFError, ArrowException, OSError, ValueError) as error:
        raise BenchError(f"{file} cannot be read: {str(error).splitlines()[0]}.") from error
