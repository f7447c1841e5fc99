"""Sweeps of cheap models on the toy data; what they should find is planted or worked out by hand."""

import json
import os
import re
import signal
import sqlite3
import subprocess
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np
import optuna
import pytest
from click.testing import CliRunner, Result
from conftest import Toy
from optuna.trial import TrialState

from bench import track, train
from bench.cli import cli
from bench.config import RunConfig, Training
from bench.notation import parse
from bench.sweep import finalists, search
from bench.sweep import journal as sweep
from bench.sweep import page as sweep_page
from bench.sweep.space import default_params, default_space, parse_search
from registry.contracts import Loaded, Predictor, PredictorEntry, Split, StateLayout
from registry.core import DATASETS, PREDICTORS, option
from registry.errors import BenchError


class HeldOff(Predictor):
    """The last sample, off by a distance."""

    def __init__(self, problem, distance):
        super().__init__(problem)
        self.layout, self.history, self.distance = StateLayout(self.n_outputs, 0, 0), 1, distance

    def fill(self, inputs, outputs):
        return outputs[..., -1, : self.n_outputs]

    def rollout(self, inputs, state, feedback=None):
        shape = (*inputs.shape[:-1], self.n_outputs)
        return (state.unsqueeze(-2) + self.distance).expand(shape), state


@PREDICTORS.register("planted")
@dataclass(frozen=True)
class Planted(PredictorEntry):
    """Right where x = 7.3 and rate = 0.02 alone; for tests."""

    training: ClassVar[str] = "none"
    stateful: ClassVar[bool] = False
    x: float = option(1.0, "place", low=0.0, high=10.0, search=(0.0, 10.0))
    rate: float = option(1.0, "rate", low=1e-4, high=10.0, log=True, search=(1e-4, 10.0))

    def build(self, problem):
        return HeldOff(problem, 10 * (abs(self.x - 7.3) / 10 + abs(np.log10(self.rate / 0.02)) / 5))


@DATASETS.register("poisoned toy")
@dataclass(frozen=True)
class PoisonedToy(Toy):
    """The toy with garbage in its test recording; for tests."""

    def read(self) -> Loaded:
        *kept, last = super().read().recordings
        rng = np.random.default_rng(1)
        noise = {name: 1e3 * rng.normal(size=getattr(last, name).shape) for name in ("inputs", "outputs")}
        return Loaded((*kept, replace(last, **noise)), ())


@DATASETS.register("toy without validation")
@dataclass(frozen=True)
class NoValidation(Toy):
    """The toy with two parts; for tests."""

    def split(self, names):
        return Split(tuple(names[:-1]), (), (names[-1],))


TRAINING = Training(updates=40, evaluate_every=4, batch=32)


RATES = "1e-5:2e-2:log"
"""Learning rates of which half learn nothing in so few updates."""


def toy(spec: str = "LSTM: 1x8 - MLP: 9x10", dataset: Toy | None = None) -> RunConfig:
    return RunConfig(*parse(spec), dataset or Toy(), horizon=6, training=TRAINING)


def swept(
    folder: Path, config: RunConfig, trials: int, objectives: tuple[str, ...] = ("rmsse",), **searched: str
) -> tuple[sweep.Sweep, optuna.Study]:
    """A sweep in this process; ``predictor_hidden="8:16"`` searches an option."""
    space = default_space([config])
    if "predictor.hidden" in space:
        searched = {"predictor_hidden": "8:16", "predictor_layers": "1,2", "initializer_hidden": "9:16"} | searched
    space |= dict(parse_search(f"{path.replace('_', '.', 1)}={v}", [config]) for path, v in searched.items())
    asked = sweep.Sweep("toy sweep", (config,), space, objectives, 0, "bench sweep toy")
    study = sweep.begin(asked, folder, resume=True)
    search.search(asked, study, folder, trials)
    return asked, study


def essence(study: optuna.Study) -> list[tuple]:
    return [(t.params, t.state, t.values, t.user_attrs.get("curve")) for t in sweep.told(study)]


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
    code = (
        "import sys; sys.path.insert(0, sys.argv[2]); from pathlib import Path; from test_sweep import swept, toy\n"
        "swept(Path(sys.argv[1]), toy(), 10)\n"
    )
    process = subprocess.Popen([sys.executable, "-c", code, str(killed / "s"), str(Path(__file__).parent)])
    deadline = time.monotonic() + 90
    while time.monotonic() < deadline and not _under_way(killed / "s", 4):
        time.sleep(0.005)
    os.kill(process.pid, signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    with (killed / "s" / sweep.JOURNAL).open("a") as journal:
        journal.write('{"op_code": 6, "wor')  # torn by the kill
    lock = killed / "s" / (sweep.JOURNAL + ".lock")
    if not lock.is_symlink():  # the kill has left it by itself
        lock.symlink_to(killed / "s" / sweep.JOURNAL)
    _, resumed = swept(killed / "s", toy(), 10)
    assert essence(resumed) == essence(unbroken)
    again = [t.user_attrs["again"] for t in resumed.trials if "again" in t.user_attrs]
    assert len(again) == len(set(again)) == len(resumed.trials) - 10 == 1
    assert sorted(p.name for p in (killed / "s").iterdir()) == [sweep.JOURNAL, sweep.DEFINITION]


def _under_way(folder: Path, told: int) -> bool:
    """Whether a trial is in the middle: after ``told`` others, its first looks are in the journal, its end is not."""
    if not (folder / sweep.JOURNAL).is_file():
        return False
    lines = (folder / sweep.JOURNAL).read_bytes().split(b"\n")[:-1]
    codes = [json.loads(line)["op_code"] for line in lines]
    ends = [i for i, code in enumerate(codes) if code == 6 and b'"state":0' not in lines[i]]
    return len(ends) >= told and codes[ends[-1] :].count(7) >= 2


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
    assert len(sweep.told(study)) == len(study.trials) == 6


def test_the_space_comes_from_the_entries_and_holds_the_default() -> None:
    config = toy("LSTM: 3x300 - Washout: 4")
    space = default_space([config], fixed=["training.learning_rate"])
    assert list(space) == ["predictor.layers", "predictor.hidden", "initializer.history"]
    assert (space["predictor.hidden"].high, space["initializer.history"].low) == (300, 4)  # type: ignore[attr-defined]
    assert default_params(space, [config]) == dict(zip(space, (3, 300, 4), strict=True))
    two = [toy(), toy("LSTM: 1x8 - Washout: 10")]
    assert list(default_space(two)) == ["spec", "training.learning_rate"]


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("predictor.hiden=1:9", "did you mean predictor.hidden"),
        ("horizon=5:9", "would change what is measured"),
        ("training.evaluate_every=5:9", "would change what is measured"),
        ("predictor.hidden=9:1", "smaller value first"),
        ("predictor.hidden=0:9", "must be from 1 to 2000"),
        ("predictor.dropout=0:0.5:log", "above 0"),
        ("predictor.hidden=1:9:lin", "not understood"),
        ("predictor.hidden", "not understood"),
        ("training.batch=32,many", "must be an integer"),
    ],
)
def test_a_wrong_range_is_one_sentence(text: str, sentence: str) -> None:
    with pytest.raises(BenchError, match=re.escape(sentence)):
        parse_search(text, [toy()])


def test_a_sweep_that_cannot_begin_is_one_sentence(tmp_path: Path) -> None:
    asked, _ = swept(tmp_path, toy("planted"), 2)
    with pytest.raises(BenchError, match=r"go on with --resume, or give this one another --name\.$"):
        sweep.begin(asked, tmp_path, resume=False)
    with pytest.raises(BenchError, match="begun with other seed: repeat its command"):
        sweep.begin(replace(asked, seed=1), tmp_path, resume=True)
    with pytest.raises(BenchError, match="no validation part"):
        replace(asked, configs=(toy(dataset=NoValidation()),)).check()
    with pytest.raises(BenchError, match="nothing to search"):
        replace(asked, space={}).check()
    (tmp_path / "file").write_text("")
    with pytest.raises(BenchError, match="cannot be written"):
        sweep.begin(asked, tmp_path / "file" / "s", resume=False)


def test_finalists_are_judged_on_both_parts_and_the_page_escapes_names(tmp_path: Path) -> None:
    from bench import engine

    evil = '<script>alert("x")</script>'
    asked, study = swept(tmp_path / "s", toy(), 8)
    asked = replace(asked, title=evil, command=f"bench sweep {evil}")
    best, default = finalists.finalists(asked, study)
    assert {c.seed for c in (*best, *default)} == {1, 2, 3}
    records = engine.execute(engine.plan([*best, *default], tmp_path / "runs"), tmp_path / "runs")
    verdicts = finalists.judge(records[:3], records[3:])
    assert [v.part for v in verdicts] == ["validation", "test"]
    # One output scale for all: the RMSSE of the record, in SI, from that of the page.
    scale = np.concatenate([r.outputs for r in Toy().load().recordings[:3]]).std(0)
    axes = ("roll", "pitch", "yaw")
    for record, (mine,) in zip(records[:3], verdicts[1].best, strict=True):
        si = np.array([record.summary["metrics"][f"rmsse.euler_rates.{a}"] for a in axes])
        assert mine == pytest.approx(np.sqrt(np.mean((si / scale) ** 2)), rel=1e-4)
    swapped = finalists.judge(records[3:], records[:3])
    assert swapped[0].comparison.ratio == pytest.approx(1 / verdicts[0].comparison.ratio)
    page = sweep_page.render(sweep_page.Content(asked, study, verdicts, records[:3], records[3:]))
    assert evil not in page and "&lt;script&gt;" in page
    assert not re.search("https?://", page) and all(v.sentence in page for v in verdicts)
    finalists.write(tmp_path / "result.json", asked, study, records, verdicts)
    assert json.loads((tmp_path / "result.json").read_text())["verdicts"]["test"]["trainings"] == 3


def test_trials_are_mirrored_once_with_every_look(tmp_path: Path) -> None:
    asked, study = swept(tmp_path / "s", toy(), 9)
    uri = track.default_uri(tmp_path)
    for _ in range(2):
        track.mirror_trials(uri, asked.title, "s", asked.configs, sweep.told(study))
    with sqlite3.connect(tmp_path / "mlflow.db") as database:
        statuses = dict(database.execute("SELECT status, count(*) FROM runs GROUP BY status").fetchall())
        looks = database.execute("SELECT count(*) FROM metrics WHERE key = 'learning/validation_rmsse'").fetchone()[0]
        errors = database.execute("SELECT value FROM metrics WHERE key = 'validation/rmsse'").fetchall()
        rates = {float(v) for (v,) in database.execute("SELECT value FROM params WHERE key = 'training.learning_rate'")}
        studies = database.execute("SELECT DISTINCT value FROM tags WHERE key = 'study'").fetchall()
    states = [t.state for t in study.trials]
    assert statuses == {"FINISHED": states.count(TrialState.COMPLETE), "KILLED": states.count(TrialState.PRUNED)}
    assert looks == sum(len(t.user_attrs["curve"]) for t in study.trials)
    assert sorted(v for (v,) in errors) == sorted(
        t.values[0] for t in study.trials if t.values and t.user_attrs["status"] == "finished"
    )
    assert rates == {t.params["training.learning_rate"] for t in study.trials}
    assert studies == [("s",)]


def test_two_workers_from_the_command_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The toy is not known to a fresh process, so this uses an embedded data set and a model that is quick to fit."""
    args = ["sweep", "linear", "--dataset", "pelican_twin", "--name", "ridge", "--results", str(tmp_path), "--no-track"]
    monkeypatch.setattr(sys, "argv", ["bench", *args])

    def bench(*more: str) -> Result:
        return CliRunner().invoke(cli, [*args, *more])

    assert (first := bench("--trials", "3", "--workers", "2")).exit_code == 0, first.exception
    assert "--resume" in str(bench("--trials", "5").exception)
    more = bench("--trials", "5", "--workers", "1", "--resume")
    assert more.exit_code == 0 and "5 trials, 3 told" in more.stdout, more.exception
    folder = tmp_path / "sweeps" / "ridge"
    study = sweep.load(folder)
    assert [t.state for t in study.trials] == [TrialState.COMPLETE] * 5
    result = json.loads((folder / sweep.RESULT).read_text())
    assert result["trials"] == 5 and result["best"]["rmsse"] == min(t.values[0] for t in study.trials)
    assert "bench sweep linear" in (folder / sweep.REPORT).read_text()
    for name in ("ridge", "linear"):
        told = CliRunner().invoke(cli, ["report", name, "--results", str(tmp_path), "-o", str(tmp_path / "copy.html")])
        assert told.exit_code == 0 and (tmp_path / "copy.html").read_text() == (folder / sweep.REPORT).read_text()
        (tmp_path / "copy.html").unlink()
    (folder / sweep.REPORT).unlink()
    unfinished = CliRunner().invoke(cli, ["report", "ridge", "--results", str(tmp_path)])
    assert "has not ended: go on with `bench sweep linear" in str(unfinished.exception)
    kept, keys = sweep.read(folder)
    written = json.loads((folder / sweep.DEFINITION).read_text())
    assert written.pop("command") == "bench sweep linear --dataset pelican_twin --name ridge"
    assert kept.definition == written and keys == result["keys"]
