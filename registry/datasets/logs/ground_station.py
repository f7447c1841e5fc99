"""Tables with a time column, such as the CSV files that Bitcraze's cfclient writes, one for each block of variables."""

from pathlib import Path

import numpy as np

from registry.datasets.folder.columns import time_column
from registry.datasets.folder.description import SECONDS
from registry.datasets.folder.draft import time_unit
from registry.datasets.logs.table import Table
from registry.datasets.reading.tables import header, numeric, units
from registry.errors import BenchError


def read_csv(file: Path) -> Table:
    """The columns of a table that hold numbers, and its times [s].

    Raises:
        BenchError: it cannot be read, or no column is named like the time, or there is no other that holds numbers.
    """
    names = header(file)
    time = time_column(names)
    if time is None:
        raise BenchError(f"{file} has no column named like the time: call one t, time or timestamp.")
    columns = numeric(file)
    if time not in columns:
        raise BenchError(f"{file}, column {time!r}: the times are no numbers.")
    t = columns.pop(time)
    if not columns:
        raise BenchError(f"{file} has no column of numbers beside the time: nothing was logged.")
    steps = np.diff(t[np.isfinite(t)])
    stated = units(file)
    unit = stated.get(time, "")
    if unit not in SECONDS:
        unit = time_unit(time, float(np.median(steps))) if len(steps) else "s"
    return Table(t * SECONDS[unit], columns, {n: u for n, u in stated.items() if n in columns}, file.stem)
