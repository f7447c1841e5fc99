"""What a study would cost: updates are timed once a kind of model, and nothing is written."""

from dataclasses import replace
from pathlib import Path

import pytest
from conftest import Toy

from bench.execution import engine, estimate
from bench.experiment.config import RunConfig, Training
from bench.experiment.notation import parse


def configs(spec: str, updates: int) -> list[RunConfig]:
    run = RunConfig(*parse(spec), Toy(), horizon=5, training=Training(updates=updates))
    return [replace(run, outputs=(f"euler_rates.{a}",), seed=s) for a in ("roll", "pitch", "yaw") for s in range(6)]


def test_every_kind_is_timed_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    timed = []

    def two_seconds(models: tuple[RunConfig, ...]) -> float:
        timed.append((models[0].spec, len(models)))
        return 2.0

    monkeypatch.setattr(estimate, "per_update", two_seconds)
    runs = [*configs("LSTM: 1x8 - MLP: 8x10", 100), *configs("MLFC: 1x8 - MLP: 8x10", 7), *configs("constant", 1)[:1]]
    todo = engine.plan(runs, tmp_path / "runs")
    found = estimate.seconds(todo.tasks)
    assert sorted(found) == [0.0, 14.0, 14.0, 200.0, 200.0]  # 18 runs of a kind are two groups of nine
    assert sorted(timed) == [("LSTM: 1x8 - MLP: 8x10", 9), ("MLFC: 1x8 - MLP: 8x10", 9)]


def test_an_update_takes_time_and_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert estimate.per_update(tuple(configs("LSTM: 1x8 - MLP: 8x10", 10_000)[:2])) > 0
    assert not list(tmp_path.iterdir())
