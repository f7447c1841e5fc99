"""Plug-ins of plain PyTorch modules, which know nothing of model dimensions, beside the networks of the suite."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import pandas as pd
import pytest
import torch
from conftest import Toy
from torch import nn

from bench.execution import engine
from bench.experiment.config import RunConfig, Training
from bench.experiment.notation import parse
from bench.records import record
from bench.training.run import run_group
from registry.contracts import Initializer, InitializerEntry, Predictor, PredictorEntry, StateLayout
from registry.core import INITIALIZERS, PREDICTORS, option


class CellPredictor(Predictor):
    """A GRU cell that is fed its own output, read out by a linear layer."""

    def __init__(self, problem, hidden):
        super().__init__(problem)
        self.cell = nn.GRUCell(self.n_inputs + self.n_outputs, hidden)
        self.out = nn.Linear(hidden, self.n_outputs)
        self.layout = StateLayout(self.n_outputs, hidden, 0)

    def init_buffers(self, inputs, outputs):
        return outputs[..., -1, : self.n_outputs]

    def rollout(self, inputs, state, feedback=None):
        y, h, _ = self.layout.split(state)
        steps = []
        for u in inputs.unbind(-2):
            h = self.cell(torch.cat([u, y], -1), h)
            y = self.out(h)
            steps.append(y)
        return torch.stack(steps, -2), torch.cat([y, h], -1)

    def readout(self, state, inputs):
        return self.out(self.layout.split(state)[1])


@PREDICTORS.register("plain cell")
@dataclass(frozen=True)
class Cell(PredictorEntry):
    """`CellPredictor`; for tests."""

    hidden: int = option(8, "units", low=1)

    def build(self, problem):
        return CellPredictor(problem, self.hidden)


class LinearInitializer(Initializer):
    """A linear map of the history."""

    def __init__(self, predictor, history):
        super().__init__()
        self.map = nn.Linear(history * (predictor.n_inputs + predictor.n_outputs), predictor.layout.size)

    def initialize(self, predictor, inputs, outputs):
        return self.map(torch.cat([inputs, outputs], -1).flatten(-2))


@INITIALIZERS.register("plain linear")
@dataclass(frozen=True)
class LinearEntry(InitializerEntry):
    """`LinearInitializer`; for tests."""

    sized: ClassVar[bool] = False
    history: int = option(10, "τ", unit="samples", low=1)

    def build(self, predictor, problem):
        return LinearInitializer(predictor, self.history)


@pytest.mark.parametrize(
    "spec",
    ["plain cell - plain linear: 10", "plain cell - MLP: 8x10", "LSTM: 1x8 - plain linear: 10"],
)
def test_modules_of_plain_pytorch_are_trained(spec: str, tmp_path: Path) -> None:
    training = Training(updates=150, evaluate_every=50, batch=32)
    config = RunConfig(*parse(spec), Toy(), horizon=6, training=training)
    todo = engine.plan([config, replace(config, seed=1)], tmp_path)
    assert [len(task.configs) for task in todo.tasks] == [1, 1]
    for learnt in engine.execute(todo, tmp_path):
        assert learnt.summary["status"] == "finished"
        assert learnt.curve.validation_loss.iloc[-1] < 0.7 * learnt.curve.validation_loss.iloc[0]
        assert record.verify(learnt) == []


CALM = Training(updates=400, evaluate_every=1, patience=1, batch=32)
WILD = Training(updates=60, evaluate_every=20, batch=32, alpha=1e12)  # its first cost is beyond all bounds


@pytest.mark.parametrize(("training", "status"), [(CALM, "finished"), (WILD, "diverged")])
def test_a_run_of_its_own_ends_before_its_budget(training: Training, status: str, tmp_path: Path) -> None:
    config = RunConfig(*parse("plain cell - plain linear: 10"), Toy(), horizon=6, training=training)
    (ended,) = run_group([config], checkpoint=tmp_path / "state")
    assert ended.summary["status"] == status
    assert 0 < ended.summary["updates"] < training.updates
    if status == "finished":  # the killed driver's next one finds a checkpoint of a run that has ended
        (again,) = run_group([config], checkpoint=tmp_path / "state")
        pd.testing.assert_frame_equal(again.tables["steps"], ended.tables["steps"])
        curve = ended.tables["curve"]
        assert ended.summary["best_update"] == curve["update"].iloc[-2]
        assert again.summary == ended.summary
