"""What a sweep ends in: the best beside the default, a page, runs in MLflow, files."""

import json
import re
import sqlite3
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result
from conftest import Toy
from optuna.trial import TrialState
from synthetic_sweep import swept, toy

from bench.cli import cli
from bench.sweep import finalists
from bench.sweep import journal as sweep
from bench.sweep import page as sweep_page
from bench.tracking import track


def test_finalists_are_judged_on_both_parts_and_the_page_escapes_names(tmp_path: Path) -> None:
    from bench.execution import engine

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
        track.mirror_trials(uri, asked.title, "s", asked.configs, sweep.finished(study))
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
    assert "use letters and digits" in str(bench("--name", "../").exception)
    more = bench("--trials", "5", "--workers", "1", "--resume")
    assert more.exit_code == 0 and "5 trials, 3 finished" in more.stdout, more.exception
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
