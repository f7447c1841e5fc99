"""Commands as a user types them: what they print, and one sentence and exit code 2 for every mistake."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from conftest import Typed

from bench.records import record


def bench(*args: str, cwd: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "bench", *args],
        cwd=cwd,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=600,  # the first use of a twin flies it: half a minute of CPU
    )


@pytest.fixture
def here(typed: Typed, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Typed:
    """`bench`, typed in ``tmp_path``."""
    monkeypatch.chdir(tmp_path)
    return typed


def test_every_entry_is_listed_and_explained(here: Typed) -> None:
    listed = here("list")[1]
    for name in ("LSTM TDL", "MLFC", "linear", "Washout", "RNN", "nanodrone", "pelican_twin", "washout_vs_mlp"):
        assert name in listed
    shown = here("show", "washout")[1]
    for part in ("history", "10", "samples", "measured | own", "Jaeger 2002"):
        assert part in shown
    both = here("show", "LSTM: 1x50 - MLP: 60x10")[1]
    assert both.index("LSTM  (predictors)") < both.index("MLP  (initializers)")
    assert "driven by: force [N]" in here("show", "oscillator")[1]
    drag = here("show", "rotor_drag")[1]
    assert "acts in: quadrotor\n" in drag and "to see it: " in drag


@pytest.mark.parametrize(
    ("command", "says"),
    [
        (("rnu",), "did you mean run"),
        (("run", "washout_vs_mpl"), "did you mean washout_vs_mlp"),
        (("run", "LSTN: 1x50 - MLP: 60x10"), "did you mean LSTM"),
        (("run", "LSTM: 1x5o - MLP: 60x10"), "character 9"),
        (("run", "constant", "--dataset", "nanodron"), "did you mean nanodrone"),
        (("run", "constant", "--dataset", "nanodrone"), "download them from https://"),
        (("run", "constant", "--dataset", "pelican"), "AscTec_Pelican_Flight_Dataset.mat"),
        (("run", "constant", "--set", "training.updtes=3"), "did you mean training.updates"),
        (("run", "constant", "--set", "horizon"), "must be OPTION=VALUE"),
        (("run", "constant", "--physics", "file"), "constant has no physics"),
        (("run", "constant", "--outputs", "body_rate"), "did you mean body_rates"),
        (("run", "constant", "--dataset", "folder", "--set", "dataset.path=nowhere"), "nowhere"),
        (("run", "constant", "--results", "file/below"), "cannot be written"),
        (("run", "constant", "--outputs", " "), "names no signal"),
        (("run", "constant", "--preset", "smoke"), "--preset belongs to a study"),
        (("sweep", "LSTM: 1x8 - MLP: 8x10", "--preset", "smoke"), "--preset belongs to a study"),
        (("sweep", "LSTM: 1x8 - MLP: 8x10", "--name", "../elsewhere"), "is no name of a folder"),
        (("sweep", "LSTM: 1x8 - MLP: 8x10", "--name", "other", "--resume"), "There is no sweep in results"),
        (("ui", "--results", "reslts"), "There is no folder reslts"),
        (("sync", "--results", "reslts"), "There is no folder reslts"),
        (("show", "LSMT"), "did you mean LSTM"),
        (("show", "LSMT: 1x5 - MLP: 5x5"), "did you mean LSTM"),
        (("report", "washout_vs_mpl"), "did you mean washout_vs_mlp"),
        (("report", "washout_vs_mlp"), "start one with `bench run washout_vs_mlp`"),
        (("list", "predictor"), "did you mean predictors"),
        (("runs", "show", "abc"), "No run in"),
        (("predict", "abc", "--input", "x.csv"), "No run in"),
        (("data", "inspect", "nanobnch"), "did you mean nanobench"),
        (("data", "check", "."), "dataset.toml"),
        (("data", "check", "file"), "file is a file: give the folder that holds it"),
        (("score-discovery", "--case", "single-wind-"), "Ids that contain it: "),
    ],
)
def test_a_mistake_is_one_sentence(
    command: tuple[str, ...], says: str, tmp_path: Path, here: Typed, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("")
    before = sorted(tmp_path.rglob("*"))
    monkeypatch.setenv("BENCH_DATA", "")
    monkeypatch.setenv("XDG_CACHE_HOME", _cache(tmp_path, command))
    code, stdout, stderr = here(*command)
    assert code == 2, stdout + stderr
    assert says in stderr and len(stderr.strip().splitlines()) <= 2
    left = [p for p in sorted(tmp_path.rglob("*")) if p not in before and "cache" not in p.parts]
    assert left == []


def _cache(tmp_path: Path, command: tuple[str, ...]) -> str:
    """The user's own cache where the embedded twin is read, so that it is simulated once; else an empty one."""
    real = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return str(tmp_path / "cache") if "--dataset" in command else real


@pytest.mark.parametrize("command", [(), ("data",)])
def test_no_command_shows_the_help(command: tuple[str, ...], here: Typed) -> None:
    code, _, stderr = here(*command)
    assert code == 2 and stderr.startswith("Usage: ")


def test_one_configuration_from_data_to_prediction(tmp_path: Path, here: Typed) -> None:
    done = bench(
        "run", "MLFC: 1x8 - MLP: 9x10", "-T", "5", "--set", "training.updates=20", "--set", "test_stride=100",
        "--no-track", cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    for part in ("MLFC: 1x8 - MLP: 9x10", "constant", "linear", "deg/s"):
        assert part in done.stdout
    (folder,) = (tmp_path / "results" / "studies").iterdir()
    assert {"error_per_step.png", "table.md", "steps.parquet", "study.json"} <= {p.name for p in folder.iterdir()}
    runs = list(record.all_records(tmp_path / "results" / "runs"))
    assert len(runs) == 3
    assert "MLFC: 1x8" in here("runs", "list")[1]
    code, _, stderr = here("runs", "list", "--dataset", "pelican_twn")
    assert code == 2 and "did you mean pelican_twin" in stderr
    keys = [r.key[:8] for r in runs]
    errors = here("runs", "errors", keys[0], "--at", "1,5", "--si")[1]
    mean = runs[0].error("body_rates", "euclidean") * np.pi / 180
    assert f"{mean[5]:.4f}" in errors and f"{mean.sum():.2f}" in errors and "rad/s" in errors
    assert "as written" in here("runs", "show", keys[0])[1]
    assert "config.predictor.name" in here("runs", "diff", keys[0], keys[1])[1]
    _, again, _ = here("run", "MLFC: 1x8 - MLP: 9x10", "-T", "5", "--set", "training.updates=20",
                       "--set", "test_stride=100", "--no-track")  # fmt: skip
    assert "3 already recorded, 0 to do" in " ".join(again.split())


def test_an_altered_record_is_found_and_pruned(tmp_path: Path, here: Typed) -> None:
    here("run", "constant", "-T", "5", "--set", "test_stride=100", "--no-track")
    run = next(record.all_records(tmp_path / "results" / "runs"))
    (run.folder / "steps.parquet").write_bytes(b"broken")
    assert "altered" in here("runs", "show", run.key[:8])[1]
    assert "Removed" in here("runs", "prune", "--yes")[1]
    assert run.key not in [r.key for r in record.all_records(tmp_path / "results" / "runs")]
