"""Trained networks as ONNX files: what onnxruntime says is what `Model.predict` says, of test windows of a run."""

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from click.testing import CliRunner
from conftest import Toy
from test_cascade import ToyFlight
from test_plain import CALM  # registers a plug-in, "plain cell", too

from bench.cli import cli
from bench.experiment.config import RunConfig
from bench.experiment.notation import parse
from bench.records import record
from bench.training.data import prepare
from bench.training.predict import load_model
from bench.training.run import run_group
from registry.contracts import Dataset
from registry.core import DATASETS

HORIZON, UPDATES = 25, 30
SPECS = {
    "LSTM: 2x8 - MLP: 6x10": Toy,
    "LSTM: 1x8 - RNN: 6x10": Toy,
    "LSTM: 1x8 - Washout: 10": Toy,
    "MLFC: 2x8 - MLP: 6x10": Toy,
    "LSTM TDL: 1x8 - MLP: 6x10": Toy,
    "GRU: 2x8 - Washout: 10": Toy,
    "Cascade: 1x8 - RNN: 6x10": ToyFlight,
    "Cascade TDL: 1x6 - Washout own: 10": ToyFlight,
    "Hybrid: 1x8 - MLP: 6x10": DATASETS.get("pelican_twin"),
    "SUBNET: 1x8 - Encoder: 6x10": Toy,
    "Neural ODE: 1x8 - MLP: 6x10": Toy,
    "NARX: 1x8": Toy,
    "TCN: 2x4": Toy,
    "constant": Toy,
    "plain cell - plain linear: 10": Toy,
}
QUICK = ("LSTM: 2x8 - MLP: 6x10", "GRU: 2x8 - Washout: 10", "Hybrid: 1x8 - MLP: 6x10")
REFUSED = {
    "LRU: 1x4 - MLP: 6x10": "complex",
    "linear": "regression",
    "LSTM: 1x8 - Optimized: 10": "gradient",
}


def recorded(results: Path, spec: str, dataset: type[Dataset] = Toy) -> record.RunRecord:
    """A run of a few updates."""
    training = replace(CALM, updates=UPDATES, evaluate_every=UPDATES)
    (outcome,) = run_group([RunConfig(*parse(spec), dataset(), horizon=HORIZON, training=training)])
    return record.write(results / "runs", **vars(outcome))


def said(results: Path, *words: str) -> tuple[int, str]:
    ended = CliRunner().invoke(cli, ["export-model", *words, "--results", str(results)])
    return ended.exit_code, " ".join(ended.output.split()) + (f" {ended.exception}" if ended.exception else "")


@pytest.mark.parametrize(
    "spec", [spec if spec in QUICK else pytest.param(spec, marks=pytest.mark.slow) for spec in SPECS]
)
def test_a_file_says_what_the_run_predicts(spec: str, tmp_path: Path) -> None:
    onnxruntime = pytest.importorskip("onnxruntime", reason="ONNX is not installed: the extra `onnx`")
    pytest.importorskip("onnxscript", reason="ONNX is not installed: the extra `onnx`")
    run = recorded(tmp_path, spec, SPECS[spec])
    file = tmp_path / "network.onnx"
    code, text = said(tmp_path, run.key[:16], "--to", "onnx", "--out", str(file))
    assert code == 0 and "network.onnx" in text, text

    session = onnxruntime.InferenceSession(file)
    told = session.get_modelmeta().custom_metadata_map
    named = json.loads(told["signals"])
    assert told["run"] == run.key and float(told["rate_hz"]) == 100 and int(told["horizon"]) == HORIZON
    assert [s["name"] for s in named["inputs"]] == run.summary["inputs"]
    predicted = run.summary["outputs"][: run.summary["predicted"]]
    assert named["outputs"] == [{"name": n, "unit": run.summary["units"][n]} for n in predicted]
    assert str(Path(__file__).parents[1]) not in file.read_bytes().decode("latin1")  # no folders of the tracing

    model = load_model(run)
    for windows, horizon in ((1, HORIZON), (7, HORIZON), (3, 2 * HORIZON)):  # any number of windows and of steps
        config = RunConfig(*parse(spec), SPECS[spec](), horizon=horizon).resolved()
        data = prepare(config)
        past_u, past_y, u, _ = data.gather(data.test.every(windows).starts)
        expected = model.predict(past_u, past_y, u)
        given = {"past_inputs": past_u, "past_outputs": past_y, "inputs": u}
        names = {i.name for i in session.get_inputs()}
        (got,) = session.run(None, {n: w.numpy() for n, w in given.items() if n in names})
        assert got.shape == expected.shape
        scale = model.predictor.output_scaler.scale.numpy()
        assert np.abs((got - expected.numpy()) / scale).max() < 1e-5
        moved = expected - expected[:, :1]
        assert (
            spec == "constant" or (moved / model.predictor.output_scaler.scale).abs().max() > 1e-2
        )  # it says something


@pytest.mark.parametrize("spec", REFUSED)
def test_what_no_file_can_say_is_refused_in_a_sentence(spec: str, tmp_path: Path) -> None:
    pytest.importorskip("onnxruntime", reason="ONNX is not installed: the extra `onnx`")
    run = recorded(tmp_path, spec)
    code, text = said(tmp_path, run.key, "--to", "onnx", "--out", str(tmp_path / "network.onnx"))
    assert code != 0 and REFUSED[spec] in text and not (tmp_path / "network.onnx").exists()


def test_a_file_that_says_something_else_is_not_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("onnxruntime", reason="ONNX is not installed: the extra `onnx`")
    from bench.training.model import Model

    run = recorded(tmp_path, "constant")
    honest = Model.predict
    monkeypatch.setattr(Model, "predict", lambda *args: honest(*args) + 0.1)
    code, text = said(tmp_path, run.key, "--to", "onnx", "--out", str(tmp_path / "network.onnx"))
    assert code != 0 and "is not written" in text and not list(tmp_path.glob("*.onnx"))


def test_without_the_extra_one_sentence_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run = recorded(tmp_path, "constant")
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    code, text = said(tmp_path, run.key, "--to", "onnx", "--out", str(tmp_path / "network.onnx"))
    assert code != 0 and "pip install onnx onnxruntime onnxscript" in text


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("model.toml", "--to", "onnx"), "numpy or casadi"),
        (("abc", "--to", "numpy"), "--to onnx"),
        (("abc", "--to", "onnx", "--rate", "50"), "--rate is for physics models"),
        (("abc", "--to", "onnx", "--out", "file.py"), ".onnx"),
        (("abc", "--to", "onnx"), "No run in"),
    ],
)
def test_a_mistake_is_said(words: tuple[str, ...], expected: str, tmp_path: Path) -> None:
    code, text = said(tmp_path, *words)
    assert code != 0 and expected in text


def test_an_export_leaves_nothing_behind(tmp_path: Path) -> None:
    pytest.importorskip("onnxruntime", reason="ONNX is not installed: the extra `onnx`")
    run = recorded(tmp_path, "LSTM: 1x8 - Washout: 10")
    data = prepare(RunConfig(*parse("LSTM: 1x8 - Washout: 10"), Toy(), horizon=HORIZON))
    past_u, past_y, u, _ = data.gather(data.test.starts[:5])
    before = load_model(run).predict(past_u, past_y, u)
    assert said(tmp_path, run.key, "--to", "onnx", "--out", str(tmp_path / "network.onnx"))[0] == 0
    assert torch.equal(load_model(run).predict(past_u, past_y, u), before)
