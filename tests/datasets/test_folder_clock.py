"""Logs with gaps, missing samples and several rates: what is made of them, against the motion that was logged."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner

from bench.cli import cli
from bench.cli.data_options import DataOptions
from registry.contracts import RecordingSet
from registry.datasets.folder.clock import pace
from registry.datasets.folder.dataset import Folder, check
from registry.errors import BenchError

TOML = 'name = "x"\nrate_hz = {rate}\nfiles = "*.csv"\ntime = "t"\ninput = "u"\ninput_hold = "previous"\n[signals]\n'
SIGNALS = 'y = {columns = ["y"], unit = "mm"}\nu = {columns = ["u"], unit = "V"}\n'


def motion(t: np.ndarray) -> np.ndarray:
    return np.sin(2 * np.pi * t)


def logged(
    folder: Path, rate: float, change: Callable[[pd.DataFrame], pd.DataFrame], wanted: float | None = None
) -> RecordingSet:
    """Two seconds at ``rate``, changed, read at the rate that is wanted."""
    t = np.arange(round(2 * rate)) / rate
    table = pd.DataFrame({"t": t, "y": motion(t), "u": np.floor(4 * t)})
    change(table).to_csv(folder / "a.csv", index=False)
    (folder / "dataset.toml").write_text(TOML.format(rate=wanted or rate) + SIGNALS)
    return check(folder)


def kept(loaded: RecordingSet) -> tuple[np.ndarray, np.ndarray]:
    """Output (N,) of the only recording and its mask."""
    (r,) = loaded.recordings
    return r.outputs[:, 0], r.valid


def test_a_gap_is_left_out_and_said(tmp_path: Path) -> None:
    loaded = logged(tmp_path, 200, lambda d: d.drop(index=range(100, 110)))
    y, valid = kept(loaded)
    assert len(y) == 400 and not valid[100:110].any() and valid.sum() == 390
    assert y[valid] == pytest.approx(motion(np.arange(400) / 200)[valid], abs=1e-9)
    assert "10 samples missing in 1 place(s), at most 0.055 s apart" in loaded.findings[0].detail


def test_a_short_gap_is_bridged(tmp_path: Path) -> None:
    loaded = logged(tmp_path, 200, lambda d: d.drop(index=[50, 51]))
    y, valid = kept(loaded)
    assert valid.all() and y == pytest.approx(motion(np.arange(400) / 200), abs=1e-2)
    assert "bridged by straight lines" in loaded.findings[0].detail


def test_several_rates_in_one_log_meet_on_one_grid(tmp_path: Path) -> None:
    def slower(d: pd.DataFrame) -> pd.DataFrame:
        return d.assign(y=d.y.where(d.index % 4 == 0), u=d.u.where(d.index % 50 == 0))

    loaded = logged(tmp_path, 200, slower)
    y, valid = kept(loaded)
    inside = slice(0, 397)  # behind the last sample nothing is known
    assert y[inside] == pytest.approx(motion(np.arange(397) / 200), abs=2e-3)
    u = loaded.recordings[0].inputs[:, 0]
    assert u[:351].tolist() == np.floor(4 * np.arange(351) / 200).tolist()  # a command stays until the next
    assert valid[:351].all() and not valid[-1]
    assert {f.kind for f in loaded.findings} == {"missing"} and "y has samples at 50 Hz" in loaded.findings[0].detail


def test_what_lacks_samples_too_long_is_left_out_and_said(tmp_path: Path) -> None:
    loaded = logged(tmp_path, 200, lambda d: d.assign(y=d.y.where((d.index < 100) | (d.index > 149))))
    assert (~loaded.recordings[0].valid).sum() == 50
    (finding,) = loaded.findings
    assert finding.detail.endswith("none in 50 of 400 rows: 50 samples (0.25 s) far from any are left out")


def test_the_rate_wanted_need_not_be_that_of_the_log(tmp_path: Path) -> None:
    loaded = logged(tmp_path, 200, lambda d: d, 80)
    y, valid = kept(loaded)
    assert len(y) == 160 and valid.all() and y == pytest.approx(motion(np.arange(160) / 80), abs=2e-4)
    assert "logged at 200 Hz, put on 80 Hz" in loaded.findings[0].detail
    almost = logged(tmp_path, 200, lambda d: d, 199.999)
    assert len(kept(almost)[0]) == 400 and not almost.findings


def late(t: np.ndarray) -> np.ndarray:
    """Every fiftieth sample is stamped three periods late, and those after it at once."""
    period = t[1] - t[0]
    return np.array(t) + period * np.select([np.arange(len(t)) % 50 == i for i in range(4)], [3.0, 2.2, 1.4, 0.6], 0.0)


@pytest.mark.parametrize(
    "change",
    [
        lambda d: d.drop(index=np.random.default_rng(1).choice(np.arange(1, 399), 40, replace=False)),
        lambda d: d.assign(t=late(d.t.to_numpy())),
        lambda d: d.assign(t=(d.index // 3) * 3 / 200 + 1e-3 * (d.index % 3)),
        lambda d: d.assign(t=d.t + np.random.default_rng(2).uniform(-0.3, 0.3, len(d)) / 200),
        lambda d: d.assign(t=d.t + 30.0 * (d.index > 220)),
    ],
    ids=["dropped", "late", "stamped in threes", "jittering", "paused"],
)
def test_a_clock_that_stumbles_does_not_drift(tmp_path: Path, change: Callable[[pd.DataFrame], pd.DataFrame]) -> None:
    loaded = logged(tmp_path, 200, change)
    assert not [f for f in loaded.findings if f.kind == "resampled"]


def test_what_is_done_about_a_jittering_clock_is_said(tmp_path: Path) -> None:
    shaken = np.random.default_rng(2).uniform(-0.1, 0.1, 400)
    loaded = logged(tmp_path, 200, lambda d: d.assign(t=d.t + shaken / 200))
    largest = np.abs(np.diff(shaken)).max()
    (found,) = loaded.findings
    off = f"steps of the clock differ from 0.005 s by up to {100 * largest:.2g} %"
    assert found.detail == f"{off}: put on 200 Hz by straight lines between samples"
    assert loaded.made == (f"{found.recording}: {found.detail}.",)
    assert not logged(tmp_path, 200, lambda d: d).findings


def test_a_clock_that_stumbles_and_drifts_is_refused(tmp_path: Path) -> None:
    drifting = np.cumsum(np.linspace(0.9, 1.1, 400)) / 200
    lost = np.random.default_rng(1).choice(np.arange(1, 399), 40, replace=False)
    for change in (
        lambda d: d.assign(t=drifting).drop(index=lost),
        lambda d: d.assign(t=late(drifting)),
        lambda d: d.assign(t=drifting, y=d.y.where(d.index % 4 == 0)),
    ):
        with pytest.raises(BenchError, match="the clock runs from"):
            logged(tmp_path, 200, change)


def test_samples_that_came_irregularly_are_taken_at_their_times_where_that_is_said(tmp_path: Path) -> None:
    """A computer reads a robot when it has time: slower for a while, and each time is true."""
    t = np.cumsum(np.where(np.arange(400) // 100 % 2, 1.2, 0.9)) / 200

    def read(d: pd.DataFrame) -> pd.DataFrame:
        return d.assign(t=t, y=motion(t), u=np.floor(4 * t))

    with pytest.raises(BenchError, match=r"say clock = .exact. if the samples were taken at just these times"):
        logged(tmp_path, 200, read)
    (tmp_path / "dataset.toml").write_text('clock = "exact"\n' + TOML.format(rate=200) + SIGNALS)
    loaded = check(tmp_path)
    (finding,) = (f for f in loaded.findings if f.kind == "irregular")
    assert "samples come at 166.7 to 222.2 Hz, put on 200 Hz" in finding.detail
    y = np.concatenate([r.outputs[:, 0] for r in loaded.recordings])
    np.testing.assert_allclose(y, motion(t[0] + np.arange(len(y)) / 200), atol=1e-3)


@pytest.mark.parametrize("seed", range(20))
def test_dropouts_of_an_irregular_clock_are_gaps_and_no_other_rate(seed: int) -> None:
    """A reading that leaves out the stretches with the gaps has fewer left, and by chance the smaller range."""
    rng = np.random.default_rng(seed)
    step = 0.01 * (1 + rng.uniform(-0.1, 0.1, 6000))
    step[rng.choice(6000, 4, replace=False)] = 0.12
    found = pace(np.concatenate([[0.0], np.cumsum(step)]))
    assert found.gaps.sum() == 4 and not found.odd.any()


def test_the_little_that_runs_at_another_rate_is_left_out_and_said(tmp_path: Path) -> None:
    """A computer that has just started is slow for a moment; a log that is slow for long is refused."""

    def slow(samples: int) -> Callable[[pd.DataFrame], pd.DataFrame]:
        step = np.where(np.arange(2000) < samples, 1.3 + 0.2 * (np.arange(2000) % 9 == 4), 1.0)
        return lambda d: d.assign(t=np.cumsum(step) / 1000)

    loaded = logged(tmp_path, 1000, slow(60))
    valid = np.concatenate([r.valid for r in loaded.recordings])
    (finding,) = (f for f in loaded.findings if f.kind == "odd rate")
    assert not valid[:75].any() and valid[140:].all()
    assert "samples from 0 s on run at" in finding.detail and finding.detail.endswith("Hz: left out")
    with pytest.raises(BenchError, match="the clock runs from 7"):
        logged(tmp_path, 1000, slow(500))


def test_what_was_made_of_a_log_is_said_wherever_it_is_used(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in "ab":
        t = np.arange(300) / 80
        data = pd.DataFrame({"t": t, "q": motion(t + (name == "b")), "w": 2 * np.pi * np.cos(2 * np.pi * t)})
        data.to_csv(tmp_path / f"{name}.csv", index=False)
    (tmp_path / "dataset.toml").write_text(
        'name = "x"\nsystem = "pendulum"\nrate_hz = 100\nfiles = "*.csv"\ntime = "t"\n[signals]\n'
        'angle = {columns = ["q"], unit = "rad"}\nangle_rate = {columns = ["w"], unit = "rad/s"}\n'
        "[physics]\nlength = 0.5\n"
    )
    said = "logged at 80 Hz, put on 100 Hz"
    for command in (["data", "check", tmp_path], ["run", "constant", "--dataset", tmp_path, "-T", 20, "--dry-run"]):
        assert said in CliRunner().invoke(cli, list(map(str, command))).output.replace("\n", " ")
    subject, _ = DataOptions(str(tmp_path)).load()
    assert said in capsys.readouterr().err and any(said in note for note in subject.notes)


def test_one_recording_is_cut_into_parts_and_two_are_enough(tmp_path: Path) -> None:
    loaded = logged(tmp_path, 250, lambda d: d)
    assert [(r.name, len(r)) for r in loaded.recordings] == [(f"a_{i}of5", 100) for i in (1, 2, 3, 4, 5)]
    assert np.concatenate([r.outputs[:, 0] for r in loaded.recordings]) == pytest.approx(motion(np.arange(500) / 250))
    assert loaded.findings[0].kind == "cut"
    split = Folder(path=str(tmp_path)).split(loaded.names)
    assert (split.train, split.validation, split.test) == (("a_1of5", "a_2of5", "a_3of5"), ("a_4of5",), ("a_5of5",))
    pair = Folder().split(["b", "a"])
    assert (pair.train, pair.validation, pair.test) == (("a",), (), ("b",))


def test_two_rows_of_one_time_are_one_sample(tmp_path: Path) -> None:
    """A stamp that came a sample late, and rows that hold a part of the signals each."""
    late = logged(tmp_path, 100, lambda d: d.assign(t=d.t.where(d.index != 9, d.t[10])))
    (twice, gap) = late.findings[:2]
    assert (twice.kind, twice.count, gap.kind) == ("twice", 1, "gap")
    assert twice.detail == "1 row has the time of the row before and other values: the later one stays"
    whole = np.concatenate([r.outputs[:, 0] for r in late.recordings])
    assert whole == pytest.approx(motion(np.arange(len(whole)) / 100), abs=2e-3)

    def in_parts(d: pd.DataFrame) -> pd.DataFrame:
        columns = [c for c in d if c != "t"]
        parts = [d.assign(**{c: np.nan for c in columns if c != kept}) for kept in columns]
        return pd.concat(parts).sort_values("t", kind="stable")

    apart = logged(tmp_path, 100, in_parts)
    assert "twice" not in {f.kind for f in apart.findings}
    assert np.concatenate([r.outputs[:, 0] for r in apart.recordings]) == pytest.approx(
        motion(np.arange(len(whole)) / 100)
    )


def test_a_clock_that_stands_or_leaps_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BenchError, match="row 3: the clock goes on by 0 s"):
        logged(tmp_path, 200, lambda d: d.assign(t=np.floor(d.t / 0.02) * 0.02))
    with pytest.raises(BenchError, match="jumps by 1000 s"):
        logged(tmp_path, 200, lambda d: d.assign(t=d.t + 1000.0 * (d.index >= 10)))
