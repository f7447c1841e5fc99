"""What `bench speed` measures: its reference computes the paper's equations, and its gates say what the rows say."""

import json
from pathlib import Path

import oracle
import pytest
import torch
from click.testing import CliRunner
from networks import noise, redrawn, weights

from bench.cli.commands.speed import speed_command
from bench.execution.parallel import MOST_PROCESSES
from bench.experiment.config import RunConfig, Training
from bench.experiment.device import device
from bench.experiment.notation import parse
from bench.speed import gpu
from bench.speed.floor import floating_operations
from bench.speed.gates import GATES
from bench.speed.measure import Measured
from bench.speed.naive import NaiveLSTM, NaiveMLFC
from bench.speed.rows import ROWS, Row
from bench.speed.timing import Effort, interleaved
from registry import PREDICTORS
from registry.contracts import Problem
from registry.core import DATASETS
from registry.errors import BenchError
from registry.kernels.native.library import core
from registry.kernels.native.products import Products


@pytest.mark.parametrize(("name", "delays"), [("LSTM", 1), ("LSTM TDL", 3), ("MLFC", 1)])
@pytest.mark.parametrize("layers", [1, 3])
def test_the_reference_is_the_oracle(name: str, delays: int, layers: int) -> None:
    options = {"delays": delays} if name == "LSTM TDL" else {}
    predictor = PREDICTORS.get(name)(layers=layers, hidden=4, **options).build(Problem.plain(3, 2, 9, 5)).double()
    redrawn(predictor)
    naive = NaiveMLFC(3, 2, layers, 4) if name == "MLFC" else NaiveLSTM(3, 2, layers, 4, delays)
    u, state = noise(5, 9, 3, seed=1), noise(5, predictor.layout.size, seed=2)
    outputs = naive.double().load(predictor.state_dict())(u, state)
    arrays = weights(predictor)
    more = {} if name == "MLFC" else {"delays": delays}
    want, _ = (oracle.mlfc_rollout if name == "MLFC" else oracle.lstm_rollout)(arrays, u.numpy(), state.numpy(), **more)
    torch.testing.assert_close(outputs, torch.from_numpy(want), rtol=1e-12, atol=1e-12)


def test_the_floor_counts_what_the_equations_multiply() -> None:
    """Weights of `weight_count`'s products without biases, peepholes and read-outs."""
    for row, want in (
        (Row("LSTM", 2, 50, 190, 256), 200 * 57 + 200 * 100),
        (Row("LSTM TDL", 1, 50, 190, 256), 200 * 120),
        (Row("MLFC", 2, 100, 190, 256), 2 * 100 * 207),
    ):
        assert floating_operations(row.products, 256) == 6 * want * 190 * 256


def test_the_native_products_are_products() -> None:
    if (native := core()) is None:
        pytest.skip("there is no native kernel")
    alone = Products(native, columns=57, rows=200, batch=40, steps=2, backward=True)
    alone()
    torch.testing.assert_close(alone.out, alone.weight @ alone.x[-1], rtol=1e-5, atol=1e-4)
    torch.testing.assert_close(alone.dx, alone.weight.mT @ alone.g[-1], rtol=1e-5, atol=1e-4)


def test_slow_work_is_told_from_quick_work_whatever_runs_beside() -> None:
    a = torch.randn(150, 150)
    work = {"once": lambda: a @ a, "thrice": lambda: [a @ a for _ in range(3)]}
    found = interleaved(work, Effort(rounds=5, fewest=3, shortest=0.01, budget=5))
    assert 2 < found["thrice"] / found["once"] < 4


def test_gates_read_the_rows() -> None:
    row = Row("LSTM", 4, 200, 190, 256)
    plain = [Measured(row, 2000.0, 1500.0, 1400.0, 1000.0, 950.0).plain()]
    said = {(g.what, round(v, 3), g.holds(v)) for g in GATES if (v := g.value(plain)) is not None}
    assert said == {
        ("of its time is products", 0.95, True),
        ("times the reference's speed", 2.0, True),
        ("of nn.LSTM's time", 0.667, True),
        ("times the reference's speed, PyTorch kernel", 1.429, False),
    }
    limits = {(g.what, round(v, 3)) for g in GATES if (v := g.limit(plain)) is not None}
    assert limits == {
        ("times the reference's speed", 2.105),
        ("of nn.LSTM's time", 0.633),
        ("times the reference's speed, PyTorch kernel", 2.105),
    }
    two = Measured(Row("LSTM", 1, 50, 40, 64, processes=2), native_ms=10.0, more={"one_process_ms": 9.0})
    assert [g.value([two.plain()]) for g in GATES if g.over == "one_process_ms"] == [1.8]
    every = [
        {**Measured(r, 1, 1, 1, 1, 1, {"parts_ms": 1, "networks_ms": 1, "one_process_ms": 1}).plain()} for r in ROWS
    ]
    assert all(g.value(every) is not None for g in GATES), "a gate without a row"


def test_a_quick_run_measures_every_kind_of_row(tmp_path: Path) -> None:
    done = CliRunner().invoke(speed_command, ["--quick", "--json", str(tmp_path / "speed.json")])
    assert done.exit_code == 0, done.output
    rows = json.loads((tmp_path / "speed.json").read_text())["rows"]
    for r in rows:
        assert r["torch_ms"] > 0 and r["floor_ms"] > 0 and r["threads"] == 1 and r["dtype"] == "float32"
        assert (r["naive_ms"] is None) == (r["task"] == "step" or r["model"] == "Hybrid") == (r["library_ms"] is None)
    assert {r["model"] for r in rows} == {"LSTM", "LSTM TDL", "MLFC", "Hybrid"}
    assert 0 <= next(r for r in rows if r["task"] == "step")["outside_share"] < 1
    assert "Milliseconds of one step" in done.output


def test_only_chooses_among_networks(tmp_path: Path) -> None:
    done = CliRunner().invoke(speed_command, ["--diagnose", "--only", "LSTM"])
    assert isinstance(done.exception, BenchError) and "--only" in str(done.exception)


@pytest.mark.slow  # half a minute
def test_the_cost_of_a_diagnosis_is_that_of_a_process_that_named_an_effect(tmp_path: Path) -> None:
    done = CliRunner().invoke(speed_command, ["--diagnose", "--quick", "--json", str(tmp_path / "speed.json")])
    assert done.exit_code == 0, done.output
    (cost,) = json.loads((tmp_path / "speed.json").read_text())["diagnoses"]
    assert cost["samples"] == 18_000 and cost["cpu_s"] > 5 and cost["peak_mb"] > 200
    assert cost["cpu_s"] < MOST_PROCESSES * cost["wall_s"]
    assert "rotor_drag" in cost["effects"] and "rotor_drag" in done.output


def test_a_gpu_that_is_not_there_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    done = CliRunner().invoke(speed_command, ["--gpu"])
    assert isinstance(done.exception, BenchError) and "finds no GPU here" in str(done.exception)


def test_rows_beside_a_gpu_say_where_training_takes_place(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.delenv("BENCH_DEVICE", raising=False)
    where = {}
    for row in gpu.ROWS:
        config = RunConfig(*parse(row.spec), DATASETS.get("toy")(), training=Training(batch=row.batch))
        where[row.name] = {"cpu": "CPU", "cuda": "GPU"}[device(config).type]
    assert where == {row.name: gpu.OnBoth(row, 1.0, 1.0).taken for row in gpu.ROWS}
    assert set(where.values()) == {"CPU", "GPU"}


@pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no GPU")
def test_updates_on_a_gpu_are_measured(tmp_path: Path) -> None:
    done = CliRunner().invoke(speed_command, ["--gpu", "--quick", "--json", str(tmp_path / "speed.json")])
    assert done.exit_code == 0, done.output
    rows = json.loads((tmp_path / "speed.json").read_text())["rows"]
    assert len(rows) == 2 and all(r["cpu_ms"] > 0 and r["gpu_ms"] > 0 for r in rows)
