"""Commands at once, killed while they write, or with a clock that is set back."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import pytest
from diagnose.samples import named
from faults.alone import exit_code
from faults.test_kills import dying, study

from bench.diagnose.report import output_folder
from bench.diagnose.result import Diagnosis
from bench.execution import lock
from bench.training import run
from registry.physics.quadrotor import Quadrotor


def test_who_comes_second_waits_for_the_first(tmp_path: Path) -> None:
    order, said = list[str](), list[str]()

    def second() -> None:
        with lock.turn(tmp_path, ".lock", said.append):
            order.append("second")

    with lock.turn(tmp_path, ".lock", said.append):
        waiting = threading.Thread(target=second)
        waiting.start()
        while not said:
            time.sleep(0.01)
        order.append("first")
    waiting.join(timeout=10)
    assert order == ["first", "second"] and "waiting for another command" in said[0]


@pytest.mark.faults
def test_three_syncs_at_once(tmp_path: Path) -> None:
    bench = [sys.executable, "-m", "bench"]
    results = ["--results", str(tmp_path / "results")]
    one = ["run", "LSTM: 1x6 - MLP: 6x10", "--dataset", "helicopter_twin", "--set", "training.updates=20"]
    subprocess.run([*bench, *one, "--no-track", *results], check=True, capture_output=True)
    started = [
        subprocess.Popen([*bench, "sync", *results], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        for _ in range(3)
    ]
    said = [p.communicate(timeout=300) for p in started]
    assert [p.returncode for p in started] == [0, 0, 0], said


def of_one(folder: Path) -> set[str]:
    """Which diagnoses the files of a folder are of."""
    told = set()
    for name in (output_folder.PAGE, output_folder.VALUES, output_folder.MODEL):
        if (folder / name).is_file():
            text = (folder / name).read_text()
            told |= {word for word in ("first_name", "second_name") if word in text}
            if name == output_folder.MODEL:
                told.add("first_name" if "mass = 0.5 " in text else "second_name")
    return told


def made(name: str) -> Diagnosis:
    return replace(named(), dataset=name)


def write_until(step: int, folder: Path) -> None:
    left = [step]
    for name in ("replace", "unlink"):
        setattr(os, name, dying(getattr(os, name), left))
    output_folder.write(folder, made("second_name"), Quadrotor(mass=0.7))


@pytest.mark.parametrize("step", range(9))
def test_a_diagnosis_killed_at_any_step_of_writing_leaves_files_of_one(step: int, tmp_path: Path) -> None:
    output_folder.write(tmp_path, made("first_name"), Quadrotor(mass=0.5))
    assert of_one(tmp_path) == {"first_name"}
    assert exit_code(write_until, step, tmp_path) in (0, -signal.SIGKILL)
    assert len(of_one(tmp_path)) <= 1
    output_folder.write(tmp_path, made("second_name"), Quadrotor(mass=0.7))
    assert of_one(tmp_path) == {"second_name"}
    assert not list(tmp_path.glob(".diagnosis-*"))
    assert json.loads((tmp_path / output_folder.VALUES).read_text())["dataset"] == "second_name"


def test_a_clock_that_is_set_back_gives_no_negative_times(monkeypatch: pytest.MonkeyPatch) -> None:
    wall = iter(range(2_000_000_000, 0, -1000))
    monkeypatch.setattr(run.time, "time", lambda: float(next(wall)))
    (outcome,) = run.run_group([study(1)[0]])
    told = outcome.provenance
    assert told["finished_ms"] >= told["started_ms"] and told["seconds"] >= 0
