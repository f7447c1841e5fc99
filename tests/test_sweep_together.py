"""Trials that train side by side: the bits of those that train alone, whatever becomes of the others."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import optuna
import pytest
from optuna.trial import TrialState
from synthetic_sweep import RATES, TRAINING, essence, swept, toy

from bench.experiment.config import RunConfig
from bench.sweep import journal as sweep
from bench.sweep import search, trial
from bench.sweep.space import configured, parse_search
from bench.training import train


def rates_swept(folder: Path, trials: int, **more: Any) -> tuple[sweep.Sweep, optuna.Study]:
    """A sweep over the learning rate alone, which half of the trials cannot do anything with."""
    config = toy()
    asked = sweep.Sweep("rates", (config,), dict([parse_search(f"training.learning_rate={RATES}", [config])]))
    study = sweep.begin(asked, folder, resume=True)
    search.search(asked, study, folder, trials, **more)
    return asked, study


@pytest.fixture
def sizes(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """How many trials each job had."""
    seen, real = [], trial.run

    def counted(configs: Sequence[RunConfig], *more: Any) -> list[trial.Outcome]:
        seen.append(len(configs))
        return real(configs, *more)

    monkeypatch.setattr(trial, "run", counted)
    return seen


@pytest.fixture
def updates(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """How many models each update trained."""
    seen, step = [], train.Group.step

    def counted(self: train.Group) -> None:
        seen.append(len(self.active))
        step(self)

    monkeypatch.setattr(train.Group, "step", counted)
    return seen


def test_trials_side_by_side_have_the_bits_of_trials_alone(
    tmp_path: Path, sizes: list[int], updates: list[int]
) -> None:
    asked, study = rates_swept(tmp_path, 14)
    assert sizes == [9, 5]
    assert sum(updates) == sum(t.user_attrs["updates"] for t in study.trials) < 14 * TRAINING.updates
    assert {t.state for t in study.trials[9:]} == {TrialState.COMPLETE, TrialState.PRUNED}
    assert len({t.params["training.learning_rate"] for t in study.trials}) == 14
    for t in study.trials:
        (alone,) = trial.run([configured(asked.configs, t.params)])
        curve = [list(look) for look in alone.curve]
        if t.state == TrialState.COMPLETE:
            assert t.values == [alone.rmsse] and t.user_attrs["curve"] == curve
        else:
            assert t.user_attrs["updates"] < TRAINING.updates
            assert t.user_attrs["curve"] == curve[: len(t.user_attrs["curve"])]


@pytest.mark.parametrize("trials", [14, 16])
def test_a_group_killed_at_work_goes_on_and_another_group_starts_over(
    trials: int, tmp_path: Path, sizes: list[int], updates: list[int]
) -> None:
    """The driver dies when one trial of the second group has been stopped and the others are past another look."""
    _, unbroken = rates_swept(tmp_path / "whole", 14)
    needed = sum(updates)
    updates.clear()

    def die(share: float) -> None:
        if len(sizes) == 4 and updates[-1] < 5 and updates[-TRAINING.evaluate_every] < 5:
            raise InterruptedError

    with pytest.raises(InterruptedError):
        rates_swept(tmp_path / "killed", 14, tick=die)
    _, resumed = rates_swept(tmp_path / "killed", trials)
    assert sizes == [9, 5, 9, 5, trials - 9]
    assert essence(resumed)[:14] == essence(unbroken)
    assert (sum(updates) == needed) == (trials == 14)
    assert sorted(p.name for p in (tmp_path / "killed").iterdir()) == [sweep.JOURNAL, sweep.DEFINITION]


def test_a_group_is_a_workers_share_of_what_is_left(
    tmp_path: Path, sizes: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Jobs as three workers, or those of a cluster, would get them, done in this process."""
    real = search.run_jobs

    def inline(jobs: Iterator[Any], workers: int, hear: Callable[..., None], *more: Any, **others: Any) -> Any:
        return real(jobs, 1, hear, str)

    monkeypatch.setattr(search, "run_jobs", inline)
    rates_swept(tmp_path / "three", 7, workers=3)
    assert sizes == [3, 2, 1, 1]
    sizes.clear()
    rates_swept(tmp_path / "cluster", 2, cluster="tcp://127.0.0.1:1")
    swept(tmp_path / "shapes", toy(), 2)
    assert sizes == [1, 1, 1, 1]
