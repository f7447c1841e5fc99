"""Changes of a recording that would change the answer: what is read is still the truth, or something is said of it."""

import csv
import io
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from fuzz.inputs import cases, in_time
from hypothesis import given
from hypothesis import strategies as st

from registry.datasets.folder.dataset import check
from registry.errors import BenchError

RATE, N = 100, 200
TOML = """name = "x"
rate_hz = 100
files = "*.csv"
time = "t"
[signals]
a = {columns = ["a"], unit = "m"}
b = {columns = ["b"], unit = "V"}
"""
Rows = list[list[str]]


def truth(t: np.ndarray) -> np.ndarray:
    """Two smooth signals (N, 2) that are never equal: interpolated at 25 Hz or more they are true to .03."""
    return np.stack([np.sin(3 * t), 5 + np.cos(4 * t)], axis=1)


def whole() -> Rows:
    t = np.arange(N) / RATE
    return [["t", "a", "b"], *([f"{x:.9g}" for x in (s, *y)] for s, y in zip(t, truth(t), strict=True))]


def with_cell(row: int, column: int, text: str) -> Callable[[Rows], object]:
    return lambda rows: rows[row].__setitem__(column, text)


def each(change: Callable[[int, list[str]], object]) -> Callable[[Rows], object]:
    return lambda rows: [change(i, row) for i, row in enumerate(rows)]


ROW, COLUMN = st.integers(1, N), st.integers(0, 2)
CHANGES = st.one_of(
    st.builds(
        with_cell,
        ROW,
        COLUMN,
        st.sampled_from(["", "nan", "inf", "-", "1,5", "x", "NaN", "1e999", "True", "1_0", "0x1", "١", "--1"]),
    ),
    st.builds(lambda c: each(lambda i, row: row.append(row[c])), COLUMN),
    st.builds(lambda text: each(lambda i, row: row.append(text) if i else None), st.sampled_from(["", "7"])),
    st.builds(lambda a, b: lambda rows: rows.__setitem__(slice(a, b), rows[a:b][::-1]), ROW, ROW),
    st.builds(lambda a, n: lambda rows: rows.__delitem__(slice(a, a + n)), ROW, st.integers(1, 60)),
    st.builds(lambda a, n: lambda rows: rows.__setitem__(slice(a, a), rows[a : a + n]), ROW, st.integers(1, 60)),
    st.builds(
        lambda f: each(lambda i, row: row.__setitem__(0, f"{float(row[0]) * f:.9g}") if i else None),
        st.floats(0.01, 100),
    ),
    st.builds(
        lambda f: each(lambda i, row: row.__setitem__(0, f"{float(row[0]) * (1 + f * i / N):.9g}") if i else None),
        st.floats(0.1, 2),
    ),
    st.builds(
        lambda a, b: each(lambda i, row: row.__setitem__(slice(None), [row[a], *row[1:b], *row[b:]])), COLUMN, COLUMN
    ),
    st.builds(lambda a: lambda rows: rows.insert(a, list(rows[0])), ROW),
    st.builds(lambda a: lambda rows: rows.insert(a, []), ROW),
    st.builds(lambda a, n: lambda rows: rows.__setitem__(a, rows[a][:n]), ROW, st.integers(1, 2)),
    st.builds(lambda names: with_cell(0, 1, names), st.sampled_from(["b", "t", "A", " b ", "a.1", ""])),
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    here = tmp_path_factory.mktemp("silent")
    (here / "dataset.toml").write_text(TOML)
    return here


def said_or_true(folder: Path, content: str, first: int = 0, samples: int = N) -> None:
    """Samples from the ``first`` one on are read as they were, unless something is said."""
    (folder / "r.csv").write_text(content, encoding="utf-8")
    try:
        with in_time():
            read = check(folder)
    except BenchError:
        return
    (recording,) = read.recordings if len(read.recordings) == 1 else (None,)
    if any(f.kind != "cut" for f in read.findings) or recording is None:
        return
    t = (first + np.arange(len(recording))) / recording.rate
    assert len(recording) == samples, len(recording)
    np.testing.assert_allclose(recording.outputs[recording.valid], truth(t)[recording.valid], atol=0.03)


@cases(300)
@given(changes=st.lists(CHANGES, min_size=1, max_size=2))
def test_what_changes_the_answer_is_said(folder: Path, changes: list[Callable[[Rows], object]]) -> None:
    rows = whole()
    for change in changes:
        try:
            change(rows)
        except (ValueError, IndexError):  # it does not fit what the one before has left
            return
    text = io.StringIO()
    csv.writer(text).writerows(rows)
    kept = {row[1]: i for i, row in enumerate(whole()[1:])}  # what is cut off at an end is missed by nobody
    here = [kept[row[1]] for row in rows[1:] if len(row) > 1 and row[1] in kept] or [0]
    said_or_true(folder, text.getvalue(), min(here), max(here) - min(here) + 1)


@cases(60)
@given(
    begin=st.sampled_from(["", "\ufeff", "\n", "# flight 3\n", "sep=,\n"]),
    end=st.sampled_from(["\n", "\r\n", "\r", "\n\n"]),
    between=st.sampled_from([",", ";", "\t", ", ", " ", "|"]),
    quote=st.booleans(),
)
def test_the_same_table_written_otherwise(folder: Path, begin: str, end: str, between: str, quote: bool) -> None:
    mark = '"' if quote else ""
    said_or_true(folder, begin + end.join(between.join(f"{mark}{c}{mark}" for c in row) for row in whole()))
