"""The search of a sweep: what it finds, what it looks at, what it stops, and what a kill leaves of it."""

import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import Toy
from optuna.trial import TrialState
from synthetic_sweep import RATES, TRAINING, NoValidation, Planted, PoisonedToy, essence, swept, toy

from bench.sweep import journal as sweep
from bench.training import train
from registry.errors import BenchError


def test_a_planted_optimum_is_found_and_chance_does_not_find_it(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    x, rate = rng.uniform(0, 10, (4000, 40)), 10 ** rng.uniform(-4, 1, (4000, 40))
    chance = (abs(x - 7.3) / 10 + abs(np.log10(rate / 0.02)) / 5).min(1)
    _, study = swept(tmp_path, toy("planted"), 40)
    best = sweep.best(study).params
    off = abs(best["predictor.x"] - 7.3) / 10 + abs(np.log10(best["predictor.rate"] / 0.02)) / 5
    assert off < np.quantile(chance, 0.2)
    assert study.trials[0].params == {"predictor.x": 1.0, "predictor.rate": 1.0}
    assert len(study.trials) == 40


def test_the_error_is_that_of_the_validation_recording(tmp_path: Path) -> None:
    """Holding the last sample, worked out from the recordings in numpy; prediction starts lie on a grid of ten."""
    config = toy("planted")
    config = replace(config, predictor=Planted(7.3, 0.02))
    _, study = swept(tmp_path, config, 1)
    train_part, validation = Toy().load().recordings[:3], Toy().load().recordings[3]
    scale = np.concatenate([r.outputs for r in train_part]).std(0)
    starts = [k for k in range(10, len(validation) - 6 + 1, 10)]
    errors = [validation.outputs[k : k + 6] - validation.outputs[k - 1] for k in starts]
    expected = np.sqrt(np.mean((np.array(errors) / scale) ** 2))
    assert study.trials[0].values == [pytest.approx(expected, rel=1e-4)]


def test_the_test_part_is_not_looked_at(tmp_path: Path) -> None:
    _, clean = swept(tmp_path / "a", toy(), 12, training_learning_rate=RATES)
    _, poisoned = swept(tmp_path / "b", toy(dataset=PoisonedToy()), 12, training_learning_rate=RATES)
    assert essence(clean) == essence(poisoned)
    assert {t.state for t in clean.trials} == {TrialState.COMPLETE, TrialState.PRUNED}


def test_a_stopped_trial_trains_no_further(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    steps = [0]
    step = train.Group.step

    def counted(self: train.Group) -> None:
        steps[0] += 1
        step(self)

    monkeypatch.setattr(train.Group, "step", counted)
    _, study = swept(tmp_path, toy(), 14, training_learning_rate=RATES)
    pruned = [t for t in study.trials if t.state == TrialState.PRUNED]
    assert len(pruned) >= 2
    assert all(t.user_attrs["updates"] < TRAINING.updates for t in pruned)
    assert steps[0] == sum(t.user_attrs["updates"] for t in study.trials) < 14 * TRAINING.updates


def test_a_driver_killed_at_work_ends_in_the_same_sweep(tmp_path: Path) -> None:
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    _, unbroken = swept(whole / "s", toy(), 10)
    code = """
import os, signal, sys
from pathlib import Path
sys.path.insert(0, sys.argv[2])
from bench.training import train
from synthetic_sweep import swept, toy

look, looks = train.Group._validate, []

def dying(group, since):
    looks.append(since)
    if len(looks) == 45:  # in the middle of the fifth trial
        os.kill(os.getpid(), signal.SIGKILL)
    look(group, since)

train.Group._validate = dying
swept(Path(sys.argv[1]), toy(), 10)
"""
    process = subprocess.run([sys.executable, "-c", code, str(killed / "s"), str(Path(__file__).parent)])
    assert process.returncode == -signal.SIGKILL
    with (killed / "s" / sweep.JOURNAL).open("a") as journal:
        journal.write('{"op_code": 6, "wor')  # torn by the kill
    lock = killed / "s" / (sweep.JOURNAL + ".lock")
    for left in (lock, lock.with_name(f"{lock.name}0.rename")):  # killed while holding it, and while giving it up
        left.symlink_to(killed / "s" / sweep.JOURNAL)
    _, resumed = swept(killed / "s", toy(), 10)
    assert essence(resumed) == essence(unbroken)
    again = [t.user_attrs["again"] for t in resumed.trials if "again" in t.user_attrs]
    assert len(again) == len(set(again)) == len(resumed.trials) - 10 == 1
    assert [sweep.place(resumed, t) for t in sweep.finished(resumed)] == [t.number for t in unbroken.trials]
    assert sorted(p.name for p in (killed / "s").iterdir()) == [sweep.JOURNAL, sweep.DEFINITION]


def test_two_objectives_give_the_front_and_stop_nothing(tmp_path: Path) -> None:
    _, study = swept(tmp_path, toy(), 12, ("rmsse", "weights"))
    assert {t.state for t in study.trials} == {TrialState.COMPLETE}
    values = np.array([t.values for t in study.trials])
    beaten = [((values <= v).all(1) & (values < v).any(1)).any() for v in values]
    assert {t.number for t in study.best_trials} == {i for i, b in enumerate(beaten) if not b}
    first = study.trials[0]  # 8 cells on 4 inputs and 3 outputs; 9 neurons on 10 samples of all 7
    assert first.params["predictor.hidden"] == 8
    assert first.values[1] == (4 * 8 * (7 + 8 + 1) + 3 * 8 + 3 * 9) + (9 * 71 + 16 * 10)


def test_what_cannot_be_is_a_failed_trial(tmp_path: Path) -> None:
    _, study = swept(tmp_path, toy("planted"), 6, history="10,5000")
    states = {t.params["history"]: t for t in study.trials}
    assert states[10].state == TrialState.COMPLETE and states[5000].state == TrialState.FAIL
    assert "shorten the horizon" in states[5000].user_attrs["problem"]
    assert len(sweep.finished(study)) == len(study.trials) == 6


def test_the_default_is_tried_although_a_kill_came_before_it_had_its_parameters(tmp_path: Path) -> None:
    asked, unbroken = swept(tmp_path / "whole", toy("planted"), 2)
    study = sweep.begin(asked, tmp_path / "killed", resume=False)
    assert study.ask().params == {}  # running, and no parameter is suggested yet
    for _ in range(2):  # killed just there twice
        study = sweep.begin(asked, tmp_path / "killed", resume=True)
        study.ask()
    again = sweep.begin(asked, tmp_path / "killed", resume=True).ask(asked.space)
    assert again.params == unbroken.trials[0].params
    assert again.user_attrs["first"] == 0


def test_what_a_kill_left_beside_a_sweep_is_removed(tmp_path: Path) -> None:
    asked, _ = swept(tmp_path, toy("planted"), 2)
    left = tmp_path / f".{sweep.DEFINITION}.x.draft"
    left.mkdir()
    (left / sweep.DEFINITION).write_text("{")
    sweep.begin(asked, tmp_path, resume=True)
    assert not left.exists() and (tmp_path / sweep.DEFINITION).is_file()


def test_a_sweep_that_cannot_begin_is_one_sentence(tmp_path: Path) -> None:
    asked, _ = swept(tmp_path, toy("planted"), 2)
    with pytest.raises(BenchError, match=r"go on with --resume, or give this one another --name\.$"):
        sweep.begin(asked, tmp_path, resume=False)
    with pytest.raises(BenchError, match="begun with other --seed: repeat its command"):
        sweep.begin(replace(asked, seed=1), tmp_path, resume=True)
    with pytest.raises(BenchError, match="no validation part"):
        replace(asked, configs=(toy(dataset=NoValidation()),)).check()
    with pytest.raises(BenchError, match="nothing to search"):
        replace(asked, space={}).check()
    (tmp_path / "file").write_text("")
    with pytest.raises(BenchError, match="cannot be written"):
        sweep.begin(asked, tmp_path / "file" / "s", resume=False)
