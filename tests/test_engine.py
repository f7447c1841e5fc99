import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from conftest import Toy

from bench.execution import engine
from bench.experiment.config import RunConfig, Training
from bench.experiment.notation import parse
from bench.records import record
from bench.training.predict import load_model, predict_table
from registry.errors import BenchError

TRAINING = Training(updates=30, evaluate_every=10, batch=32)


def runs(spec: str, count: int = 3, **changes: object) -> list[RunConfig]:
    axes = ("roll", "pitch", "yaw")
    base = RunConfig(*parse(spec), Toy(), horizon=6, training=TRAINING)
    base = replace(base, **changes)  # type: ignore[arg-type]
    return [replace(base, seed=i // 3, outputs=(f"euler_rates.{axes[i % 3]}",)) for i in range(count)]


@pytest.mark.parametrize(
    "spec",
    ["LSTM: 1x8 - MLP: 9x10", "LSTM: 2x9 - Washout: 10", "MLFC: 2x8 - Washout: 10", "LSTM TDL: 1x8 - RNN: 9x10"],
)
def test_a_models_record_does_not_depend_on_its_group(spec: str, tmp_path: Path) -> None:
    rates = (5e-3, 5e-3, 1e-3, 2e-2, 1e-3)
    configs = [
        replace(c, training=replace(c.training, learning_rate=rate))
        for c, rate in zip(runs(spec, 5), rates, strict=True)
    ]
    todo = engine.plan(configs, tmp_path / "a")
    assert [len(task.configs) for task in todo.tasks] == [5]
    together = engine.execute(todo, tmp_path / "a")
    for config, grouped in zip(configs, together, strict=True):
        (alone,) = engine.execute(engine.plan([config], tmp_path / "b"), tmp_path / "b")
        assert record.differences(grouped, alone) == []
        assert record.verify(alone) == []


def test_training_learns(tmp_path: Path) -> None:
    config = runs("LSTM: 1x16 - MLP: 16x10", 1, training=Training(updates=300, evaluate_every=50))[0]
    constant = replace(config, predictor=parse("constant")[0], initializer=None)
    learnt, held = engine.execute(engine.plan([config, constant], tmp_path), tmp_path)
    name = "rmsse.euler_rates.roll"
    assert learnt.summary["metrics"][name] < 0.7 * held.summary["metrics"][name]
    assert learnt.curve.validation_loss.iloc[-1] < 0.5 * learnt.curve.validation_loss.iloc[0]


def test_what_is_recorded_is_not_trained_again(tmp_path: Path) -> None:
    configs = runs("MLFC: 1x5 - MLP: 5x10")
    engine.execute(engine.plan(configs[:2], tmp_path), tmp_path)
    todo = engine.plan(configs, tmp_path)
    assert len(todo.done) == 2 and [len(t.configs) for t in todo.tasks] == [1]


def test_divergence_is_a_result_and_spares_the_others(tmp_path: Path) -> None:
    wild = Training(updates=60, evaluate_every=10, batch=16, learning_rate=1.0, clip=1e30, final_rate=1.0)
    calm = runs("LSTM: 1x8 - MLP: 9x10", 1)[0]
    broken = replace(calm, training=wild, predictor=replace(calm.predictor, weight_scale=10.0))  # type: ignore[type-var]
    good, bad = engine.execute(engine.plan([calm, broken], tmp_path), tmp_path)
    assert good.finished
    if not bad.finished:
        assert bad.summary["diverged_at"] >= 1 and bad.summary["metrics"] == {} and bad.steps.empty
        with pytest.raises(BenchError, match="diverged"):
            load_model(bad)


@pytest.mark.parametrize(("models", "start"), [(3, "zero"), (1, "random")])
def test_interrupted_training_goes_on_bit_for_bit(models: int, start: str, tmp_path: Path) -> None:
    base = runs("LSTM: 1x8 - Washout: 10", models)
    configs = [replace(c, initializer=replace(c.initializer, start=start)) for c in base]  # type: ignore[type-var]
    whole = engine.execute(engine.plan(configs, tmp_path / "a"), tmp_path / "a")
    left = iter([True, True, False])

    def stop(cost: float) -> None:
        if not next(left):
            raise InterruptedError

    with pytest.raises(InterruptedError):
        engine.execute(engine.plan(configs, tmp_path / "b"), tmp_path / "b", tick=stop)
    assert list((tmp_path / "b" / ".partial").iterdir())
    again = engine.execute(engine.plan(configs, tmp_path / "b"), tmp_path / "b")
    for a, b in zip(whole, again, strict=True):
        assert record.differences(a, b) == []
    assert not (tmp_path / "b" / ".partial").exists()


def test_a_full_disk_leaves_finished_records_and_no_draft(tmp_path: Path) -> None:
    """RLIMIT_FSIZE stands in for a disk that is full while a record is written."""
    code = (
        "import resource, signal, sys; sys.path.insert(0, sys.argv[2]); from pathlib import Path\n"
        "from test_engine import runs; from bench.execution import engine; from registry.errors import BenchError\n"
        "folder = Path(sys.argv[1]); a, b = runs('MLFC: 1x5 - MLP: 5x10', 2)\n"
        "engine.execute(engine.plan([a], folder), folder)\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN); resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000))\n"
        "try: engine.execute(engine.plan([a, b], folder), folder)\n"
        "except BenchError as error: print(error); sys.exit(2)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path), str(Path(__file__).parent)], capture_output=True, text=True
    )
    assert done.returncode == 2 and "cannot be written" in done.stdout, done.stderr
    (left,) = record.all_records(tmp_path)
    assert record.verify(left) == [] and not list(tmp_path.glob(".draft-*"))


def _study(results: Path, workers: int) -> list[str]:
    """The command that runs one; the toy data set is not known to a fresh process, so it is on an embedded one."""
    asked = ["run", "washout_vs_mlp", "--only", "LSTM: *", "--preset", "smoke", "--no-track", "--workers", str(workers)]
    return [sys.executable, "-m", "bench", *asked, "--results", str(results)]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> list[record.RunRecord]:
    """The records of that study, run to its end in one process."""
    results = tmp_path_factory.mktemp("whole")
    subprocess.run(_study(results, 1), check=True, capture_output=True)
    made = list(record.all_records(results / "runs"))
    assert len(made) == 27
    return made


def test_records_are_the_same_from_other_processes(whole: list[record.RunRecord], tmp_path: Path) -> None:
    subprocess.run(_study(tmp_path, 2), check=True, capture_output=True)
    for a in whole:
        assert record.differences(a, record.RunRecord(tmp_path / "runs" / a.key)) == []


def test_a_study_killed_half_way_ends_in_equal_records(whole: list[record.RunRecord], tmp_path: Path) -> None:
    killed = tmp_path / "killed"
    process = subprocess.Popen(_study(killed, 1), stdout=subprocess.DEVNULL)
    deadline = time.monotonic() + 120
    while len(list(record.all_records(killed / "runs"))) < 4 and time.monotonic() < deadline:
        time.sleep(0.01)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    left = {r.key: r.provenance["finished_ms"] for r in record.all_records(killed / "runs")}
    assert 4 <= len(left) < 27
    subprocess.run(_study(killed, 1), check=True, capture_output=True)
    for a in whole:
        b = record.RunRecord(killed / "runs" / a.key)
        assert record.differences(a, b) == []
        if a.key in left:
            assert b.provenance["finished_ms"] == left[a.key]


def test_a_recorded_model_predicts_new_inputs(tmp_path: Path) -> None:
    config = runs("LSTM: 1x8 - MLP: 9x10", 1)[0]
    (done,) = engine.execute(engine.plan([config], tmp_path), tmp_path)
    example = done.windows[done.windows.window == done.windows.window.iloc[0]]
    flight = next(r for r in Toy().load().recordings if r.name == example.recording.iloc[0])
    start = int(done.windows.window.iloc[0]) * config.test_stride
    table = pd.DataFrame(
        np.concatenate([flight.inputs, flight.outputs], 1), columns=[c.name for c in flight.channels]
    ).iloc[start : start + 16]
    predicted = predict_table(done, table, "table")
    np.testing.assert_allclose(predicted["euler_rates.roll"], example.predicted, rtol=1e-5, atol=1e-6)
    with pytest.raises(BenchError, match=r"no column 'pilot\.rudder'"):
        predict_table(done, table.drop(columns="pilot.rudder"), "table")
    with pytest.raises(BenchError, match="row 3: 'nan'"):
        broken = table.copy()
        broken.iloc[2, 0] = np.nan
        predict_table(done, broken, "table")
