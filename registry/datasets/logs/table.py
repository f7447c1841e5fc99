"""Tables of named columns, several of one recording, put together in one file."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd

from registry.errors import BenchError

TIME = "t"
"""Column of the time in the files that are written [s]."""


@dataclass(frozen=True, eq=False)
class Table:
    """Columns that share a clock."""

    t: np.ndarray
    """(N,) [s]."""
    columns: Mapping[str, np.ndarray]
    """(N,) by name, NaN where there is no value, in the units of the log."""
    units: Mapping[str, str] = field(default_factory=dict)
    """Of the columns whose unit the log states."""
    source: str = ""
    """Block, event or variable that it came from."""

    @property
    def rate(self) -> float:
        """Median sample rate [Hz]; 0: there are fewer than two samples."""
        steps = np.diff(self.t)
        steps = steps[steps > 0]
        return float(1 / np.median(steps)) if len(steps) else 0.0


def ordered(table: Table) -> Table:
    """The rows with a time, in its order, the first of those with the same."""
    t, first = np.unique(table.t, return_index=True)
    first = first[np.isfinite(t)]
    columns = {name: x[first] for name, x in table.columns.items()}
    return Table(t[np.isfinite(t)], columns, table.units, table.source)


def same_recording(tables: Iterable[tuple[str, Table]]) -> dict[str, list[Table]]:
    """Named tables as recordings: those with other columns and times that overlap belong together.

    A ground station writes one file for each block of variables that it asks for, all stamped by the vehicle's clock.
    """
    groups: dict[str, list[Table]] = {}
    for name, table in tables:
        for group in groups.values():
            if not any(set(table.columns) & set(other.columns) for other in group) and _overlap(table, group[0]):
                group.append(table)
                break
        else:
            groups[name] = [table]
    return groups


def joined(tables: Sequence[Table]) -> Table:
    """All columns at all times, NaN where a column has no value at that time.

    Raises:
        BenchError: two tables hold a column of one name.
    """
    tables = [ordered(table) for table in tables]
    t = np.unique(np.concatenate([table.t for table in tables]))
    columns: dict[str, np.ndarray] = {}
    for table in tables:
        at = np.searchsorted(t, table.t)
        for name, x in table.columns.items():
            if name in columns:
                raise BenchError(f"Two blocks of one log hold {name!r:.100}: leave one of them out.")
            if name == TIME:
                continue  # another clock
            columns[name] = np.full(len(t), np.nan)
            columns[name][at] = x
    return Table(t, columns, {n: u for table in tables for n, u in table.units.items()})


def write(file: Path, table: Table, common: Collection[str]) -> None:
    """The ``common`` columns of a table as CSV, times from its first, with a row of units where any are known.

    Raises:
        OSError: it cannot be written.
    """
    columns = {name: x for name, x in table.columns.items() if name in common}
    frame = pd.DataFrame({TIME: [f"{t:.6f}" for t in table.t - table.t[0]], **columns})
    with file.open("w", encoding="utf-8", newline="") as stream:
        head = pd.DataFrame([{TIME: "s", **{n: _cell(table.units.get(n, "")) for n in columns}}])
        head[: 1 if any(table.units.get(n) for n in columns) else 0].to_csv(stream, index=False)
        frame.to_csv(stream, index=False, header=False, float_format="%.9g")


def _cell(unit: str) -> str:
    """A unit in a row of units, in which 1 would be a number."""
    return "-" if unit == "1" else unit


def _overlap(a: Table, b: Table) -> bool:
    """Whether two tables were recorded at the same time, for half of the shorter at least."""
    if not len(a.t) or not len(b.t):
        return False
    (first, last), (begin, end) = ((x.t.min(), x.t.max()) for x in (a, b))
    return bool(min(last, end) - max(first, begin) > 0.5 * min(last - first, end - begin))
