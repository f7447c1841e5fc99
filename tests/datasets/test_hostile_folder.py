"""What a folder of data may hold that would change an answer without a word, or hold up its reader."""

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from datasets.test_folder import TOML, table

from bench.diagnose.logs.smoothing import stated
from bench.training.predict import read_table
from registry import model_file
from registry.datasets.folder.dataset import check
from registry.datasets.nanobench import Nanobench
from registry.errors import BenchError


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "dataset.toml").write_text(TOML, encoding="utf-8")
    table(400).to_csv(tmp_path / "a.csv", index=False)
    return tmp_path


def rewrite(folder: Path, change: Callable[[pd.DataFrame], object]) -> None:
    data = table(400)
    change(data)
    data.to_csv(folder / "a.csv", index=False)


def test_a_column_that_stands_twice(folder: Path) -> None:
    lines = (folder / "a.csv").read_text().splitlines()
    (folder / "a.csv").write_text("\n".join(line + "," + line.split(",")[1] for line in lines))
    for reader in (check, lambda f: read_table(f / "a.csv")):
        with pytest.raises(BenchError, match="two columns named 'x'"):
            reader(folder)


@pytest.mark.parametrize("more", [",", ",7"])
def test_rows_longer_than_their_header(folder: Path, more: str) -> None:
    """A table reader takes the first column for names then, and every value moves one column on."""
    head, *rows = (folder / "a.csv").read_text().splitlines()
    (folder / "a.csv").write_text("\n".join([head, *(row + more for row in rows)]))
    for reader in (check, lambda f: read_table(f / "a.csv")):
        with pytest.raises(BenchError, match="longer than its header of 18 names"):
            reader(folder)


@pytest.mark.parametrize(
    ("clock", "says"),
    [
        (lambda n: np.cumsum(np.linspace(1.0, 1.3, n)) / 100, "from 78.03 to 98.12 Hz"),
        (lambda n: np.cumsum(np.linspace(0.85, 1.15, n)) / 100, "Hz, worst from row"),
        (lambda n: np.cumsum(np.linspace(1.0, 3.0, n)) / 100, "Hz, worst from row"),
        (lambda n: np.cumsum(np.where(np.arange(n) < 250, 1.0, 0.5)) / 100, "from 100 to 200 Hz"),
        (lambda n: np.cumsum(np.where(np.arange(n) < 250, 1.0, 2.0)) / 100, "from 50 to 100 Hz"),
        (lambda n: np.arange(n) / 4, "come at 4 Hz, which rate_hz = 100 cannot be made of"),
        (lambda n: np.arange(n) / 20000, "come at 20000 Hz, which rate_hz = 100 cannot be made of"),
    ],
)
def test_a_clock_that_contradicts_the_stated_rate(folder: Path, clock: Callable[[int], np.ndarray], says: str) -> None:
    rewrite(folder, lambda d: d.__setitem__("t", clock(len(d))))
    with pytest.raises(BenchError, match=says):
        check(folder)


@pytest.mark.parametrize(("rate", "samples"), [(80, 499), (125, 320)])
def test_a_steady_clock_of_another_rate_is_never_read_without_a_word(folder: Path, rate: int, samples: int) -> None:
    rewrite(folder, lambda d: d.__setitem__("t", np.arange(len(d)) / rate))
    (finding,) = (f for f in check(folder).findings if f.kind == "resampled")
    assert f"logged at {rate} Hz, put on 100 Hz" in finding.detail
    assert len(check(folder).recordings[0]) == samples
    rewrite(folder, lambda d: d.update({"t": np.arange(len(d)) / rate, "vbat": d.vbat.where(d.index != 7)}) or 0)
    (finding,) = (f for f in check(folder).findings if f.kind == "resampled")  # a missing value does not hide it
    assert f"logged at {rate} Hz" in finding.detail


def test_a_clock_that_jitters_about_the_stated_rate_is_read(folder: Path) -> None:
    jitter = np.random.default_rng(0).uniform(-0.15, 0.15, 400) / 100
    rewrite(folder, lambda d: d.__setitem__("t", np.arange(400) / 101 + jitter))
    assert len(check(folder).recordings[0]) == pytest.approx(396, abs=2)


NOISE = "noise = {position = 0.0004}"


@pytest.mark.parametrize(
    ("was", "becomes", "says"),
    [
        ('columns = ["vbat"]', 'columns = ["t"]', "which is the time"),
        *((NOISE, f"noise = {{position = {x}}}", "standard deviation") for x in ("-0.1", "nan", "inf", '"small"')),
        (NOISE, "noise = {position = [0.1, 0.1, 0.1]}", "standard deviation"),
        (NOISE, "noise = {position = 1e308}", "standard deviation"),
        (NOISE, "noise = 3", "must be a table"),
        ('files = "*.csv"', 'files = "."', "files = '.'"),
        ('files = "*.csv"', 'files = ["a.csv"]', "files must be a text"),
        ('input = "rotor_speed"', 'input = ["rotor_speed", 3]', "input must be the name of a signal"),
        ('input = "rotor_speed"', 'input = {a = "rotor_speed"}', "input must be the name of a signal"),
        ('input = "rotor_speed"', 'input = ["rotor_speed", "rotor_speed"]', "a list of different signals"),
        ('input = "rotor_speed"', 'input = "rotor_speed"\ntargets = "velocity"', "targets must be a list"),
        ('input = "rotor_speed"', 'input = "rotor_speed"\ntargets = ["rotor_speed"]', "cannot be one of the targets"),
        ('time = "t"', 'time = "t"\ntime_unit = ["s"]', "time_unit = "),
        ('convention = "euler_zyx"', 'convention = ["euler_zyx"]', "convention and frame must be texts"),
        ("rate_hz = 100", f"rate_hz = {'9' * 400}", "rate_hz must be a number"),
        ("rate_hz = 100", "rate_hz = 1e308", "rate_hz must be a number"),
        ("rate_hz = 100", "rate_hz = 1e-300", "rate_hz must be a number"),
        ("rate_hz = 100", "rate_hz = true", "rate_hz must be a number"),
        ("mass = 0.5", f"mass = {'9' * 400}", "finite number"),
        ("mass = 0.5", f"mass = {'[' * 300}1{']' * 300}", "deep"),
    ],
)
def test_a_description_that_would_change_the_answer(folder: Path, was: str, becomes: str, says: str) -> None:
    assert was in TOML
    (folder / "dataset.toml").write_text(TOML.replace(was, becomes, 1), encoding="utf-8")
    with pytest.raises(BenchError, match=says):
        check(folder)


@pytest.mark.parametrize(
    "smoothing",
    [
        {"kind": "savgol", "window": 10**9 + 1, "order": 3},
        {"kind": "mean", "window": 2003},
        {"kind": "savgol", "window": 2001, "order": 1000},
        {"kind": "savgol", "window": True, "order": 3},
        {"kind": ["savgol"], "window": 9},
    ],
)
def test_a_window_that_no_filter_has(smoothing: dict[str, object]) -> None:
    with pytest.raises(BenchError, match="smoothing"):
        stated({"smoothing": smoothing})


def test_a_circle_of_links(folder: Path) -> None:
    (folder / "loop.csv").symlink_to(folder / "loop.csv")
    (folder / "round").symlink_to(folder)
    with pytest.raises(BenchError, match=r"loop.csv.* cannot be read"):
        check(folder)
    (folder / "loop.csv").unlink()
    (folder / "dataset.toml").write_text(TOML.replace("*.csv", "**/*.csv"))
    assert len(check(folder).recordings) == 1


def test_what_is_no_regular_file_is_not_opened(folder: Path) -> None:
    """Each of these would wait for a writer that never comes."""
    (folder / "a.csv").unlink()
    os.mkfifo(folder / "a.csv")
    for reader in (check, lambda f: read_table(f / "a.csv"), lambda f: model_file.read(f / "a.csv")):
        with pytest.raises(BenchError, match="a pipe, a socket or a device"):
            reader(folder)
    with pytest.raises(BenchError, match="a pipe, a socket or a device"):
        read_table(Path("/dev/zero"))
    (folder / "a.csv").unlink()
    (folder / "a.csv").mkdir()
    with pytest.raises(BenchError, match="a folder, where a file is needed"):
        check(folder)


@pytest.mark.parametrize(("rows", "says"), [(0, "no samples"), (1, "one sample")])
def test_files_of_a_header_alone_or_one_row(folder: Path, rows: int, says: str) -> None:
    table(400)[:rows].to_csv(folder / "a.csv", index=False)
    with pytest.raises(BenchError, match=says):
        check(folder)


def test_a_built_in_set_of_headers(bench_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (whole, *_) = sorted((bench_data / "nanobench").glob("**/*.csv.gz"))
    empty = tmp_path / whole.relative_to(bench_data)
    empty.parent.mkdir(parents=True)
    pd.read_csv(whole, nrows=0).to_csv(empty, index=False)
    monkeypatch.setenv("BENCH_DATA", str(tmp_path))
    with pytest.raises(BenchError, match="header and no samples"):
        Nanobench().load()


@pytest.mark.parametrize("cells", [pd.date_range("2026-01-01", periods=400, freq="10ms"), [[]] * 400])
def test_what_is_no_number_in_parquet(folder: Path, cells: object) -> None:
    (folder / "a.csv").unlink()
    (folder / "dataset.toml").write_text(TOML.replace("*.csv", "*.parquet"))
    table(400).assign(vbat=cells).to_parquet(folder / "a.parquet")
    with pytest.raises(BenchError, match=r"column 'vbat', row 1: .* not a finite number"):
        check(folder)
