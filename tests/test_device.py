"""Where networks train. There is no GPU here: torch's meta device stands for one, which has shapes but no numbers.

An operation between it and the CPU is an error, as between a GPU and the CPU.
"""

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from conftest import Toy

from bench.experiment.config import RunConfig, Training
from bench.experiment.device import device
from bench.experiment.notation import parse
from bench.experiment.run_key import environment, run_key
from bench.speed.networks import channels
from bench.training import train
from bench.training.data import prepare
from bench.training.gradient import cost_and_gradient
from bench.training.model import build, build_scaled
from registry.contracts import Split
from registry.core import DATASETS
from registry.errors import BenchError
from registry.predictors.load_hybrid import LoadHybridPredictor
from registry.predictors.parts.learned_load import Units

META = torch.device("meta")
OF_A_BODY = ("Hybrid: 1x8", "Hybrid residual: 1x8", "Hybrid unsummed: 1x8", "Cascade: 1x8", "Cascade TDL: 1x8")


def config(spec: str, dataset: str = "toy", **training: object) -> RunConfig:
    return RunConfig(*parse(spec), DATASETS.get(dataset)(), horizon=6, training=Training(**{"batch": 32, **training}))


@pytest.mark.parametrize(
    "spec",
    [
        "LSTM: 2x8 - MLP: 9x10",
        "LSTM TDL: 1x8 - RNN: 9x10",
        "LSTM: 1x8 - Optimized: 10",
        "MLFC: 2x8 - Washout: 10",
        "GRU: 1x8 - MLP: 9x10",
        "NARX: 1x8",
        "TCN: 2x8",
        "LRU: 2x8 - MLP: 9x10",
        "SUBNET: 1x8 - Encoder: 9x10",
        "Neural ODE: 1x8 - MLP: 9x10",
        *(f"{name} - MLP: 9x10" for name in OF_A_BODY),
        "Load hybrid: 1x8",
    ],
)
def test_no_part_of_a_training_step_stays_behind(spec: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(LoadHybridPredictor, "units", lambda self: Units(1000.0, 1.0, 1.0))  # numbers of the scalers
    body = any(name in spec for name in ("Hybrid", "Cascade", "Load"))
    c = config(spec, "pelican_twin" if body else "toy")
    outputs, context = channels("velocity", "body_rates"), channels("attitude", "position")
    model = build(c, channels("rotor_speed"), outputs, context if body else (), 100.0).to(META).train()
    n = len(outputs) + len(context) * body
    shapes = ((32, c.tau, 4), (32, c.tau, n), (32, 6, 4), (32, 6, len(outputs)))
    batch = [torch.zeros(s, device=META) for s in shapes]
    cost = model(*batch, 1.0, 1.0)
    slopes = torch.autograd.grad(cost, list(model.parameters()), torch.ones_like(cost), allow_unused=True)
    assert cost.device == META and any(s is not None for s in slopes)
    model.eval()
    with torch.no_grad():
        assert model(*batch, 1.0, 0.0).device == META


def test_data_and_optimizer_go_with_the_network(monkeypatch: pytest.MonkeyPatch) -> None:
    c = config("LSTM: 1x8 - MLP: 9x10")
    data = prepare(c)
    monkeypatch.setattr(train, "device", lambda config: META)
    group = train.Group([build_scaled(c, data)], [train.RunState(c, data)])
    cost, slopes = cost_and_gradient(group.network, group.parameters, group._batch(), 1.0, 1.0)
    kept = (group.theta, group.m, group.v, group.best, group.gradient, group.train_cost, *group.validation[0][0])
    assert {x.device for x in kept} == {META} == {x.device for x in (*slopes.values(), cost)}


def test_a_wide_network_takes_the_gpu_where_there_is_one(monkeypatch: pytest.MonkeyPatch) -> None:
    thin, wide, solved = (
        config("LSTM: 2x50 - MLP: 60x10"),
        config("LSTM: 4x200 - MLP: 60x10", batch=256),
        config("linear"),
    )
    split = Split(("a",), (), ())
    monkeypatch.delenv("BENCH_DEVICE", raising=False)
    assert {device(c).type for c in (thin, wide, solved)} == {"cpu"} or torch.cuda.is_available()
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "get_device_name", lambda: "A GPU")
    assert [device(c).type for c in (thin, wide, solved)] == ["cpu", "cuda", "cpu"]
    assert environment(wide)["kernel"].endswith(", A GPU") and not environment(thin)["kernel"].endswith("A GPU")
    key = run_key(wide, "data", split)
    monkeypatch.setenv("BENCH_DEVICE", "cpu")
    assert device(wide).type == "cpu" and run_key(wide, "data", split) != key
    monkeypatch.setenv("BENCH_DEVICE", "cuda")
    assert [device(c).type for c in (thin, wide, solved)] == ["cuda", "cuda", "cpu"]


def test_networks_on_a_gpu_train_one_by_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """Side by side their bits would depend on each other."""
    c = config("LSTM: 1x8 - MLP: 9x10")
    data = prepare(c)
    assert train.batchable(c, data)
    monkeypatch.setattr(train, "device", lambda config: torch.device("cuda"))
    assert not train.batchable(c, data)


@pytest.mark.parametrize(("asked", "said"), [("cuda", "finds no GPU"), ("gpu", "Known are auto, cpu, cuda")])
def test_a_device_that_is_not_there_is_one_sentence(asked: str, said: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("BENCH_DEVICE", asked)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(BenchError, match=said):
        device(config("LSTM: 1x8 - MLP: 9x10"))


@pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no GPU")
def test_a_gpu_learns_what_the_cpu_learns(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    c = replace(config("LSTM: 1x16 - MLP: 16x10", updates=60, evaluate_every=20), dataset=Toy())
    found = []
    for where in ("cpu", "cuda"):
        monkeypatch.setenv("BENCH_DEVICE", where)
        found.append(train.train([c], [prepare(c)], checkpoint=tmp_path / where)[0])
    cpu, gpu = found
    assert [u for u, *_ in cpu.curve] == [u for u, *_ in gpu.curve]
    for (_, *a), (_, *b) in zip(cpu.curve, gpu.curve, strict=True):
        assert b == pytest.approx(a, rel=1e-2)
    assert {p.device.type for p in gpu.model.parameters()} == {"cpu"}
