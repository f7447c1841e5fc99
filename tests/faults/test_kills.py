"""Drivers killed at random moments and at every step of writing a record."""

import os
import signal
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import Toy
from faults.alone import exit_code, started

from bench.execution import engine
from bench.execution.executor import run_jobs
from bench.experiment.config import RunConfig, Training
from bench.experiment.notation import parse
from bench.records import record
from registry import atomic_io
from registry.errors import BenchError

KILLS = 50


def study(seeds: int = 8) -> list[RunConfig]:
    """Trainings too thin to be grouped, so that there is a record to write every few moments."""
    training = Training(updates=20, evaluate_every=5, batch=32)
    one = RunConfig(*parse("LSTM: 1x6 - MLP: 6x10"), Toy(samples=200), horizon=6, training=training)
    return [replace(one, seed=s) for s in range(seeds)]


def run(configs: list[RunConfig], runs: Path) -> list[record.RunRecord]:
    return engine.execute(engine.plan(configs, runs), runs)


def sound(runs: Path) -> dict[str, int]:
    """Every record reads and is as it was written; when each was made."""
    made = {}
    for r in record.all_records(runs):
        assert record.verify(r) == []
        assert len(r.steps) and len(r.curve) and len(r.windows) and r.weights() and r.config
        made[r.key] = r.provenance["started_ms"]
    return made


@pytest.mark.faults
def test_kills_at_random_moments_leave_whole_records(
    tmp_path: Path, faults: Callable[..., None], capsys: pytest.CaptureFixture[str]
) -> None:
    configs = study()
    driver, began = started(run, configs, tmp_path / "whole"), time.monotonic()
    driver.join()
    takes = time.monotonic() - began
    whole = run(configs, tmp_path / "whole")
    rng = np.random.default_rng(0)
    kills, again, rounds, made = 0, 0, 0, dict[str, int]()
    runs = tmp_path / "killed"
    while kills < KILLS:
        if len(made) == len(configs):  # the study is through: once more, from nothing
            runs, made, rounds = tmp_path / f"killed{rounds}", {}, rounds + 1
        driver = started(run, configs, runs)
        time.sleep(rng.uniform(0.02, takes))
        driver.kill()
        driver.join()
        kills += driver.exitcode == -signal.SIGKILL
        now = sound(runs)
        assert all(now[key] == when for key, when in made.items())  # nothing that was finished is made again
        again += len(now) < len(configs)
        made = now
    finished = run(configs, runs)
    assert rounds or made
    for a, b in zip(whole, finished, strict=True):
        assert record.differences(a, b) == []
    assert not (runs / ".partial").exists()
    faults("the driver, at random moments of a small study (kill -9)", KILLS, 0, 0, "what it had in hand")


def die(*_: object) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def run_until_recorded(configs: list[RunConfig], runs: Path) -> None:
    engine.execute(engine.plan(configs, runs), runs, finished=die)


def run_until_a_file_is_replaced(configs: list[RunConfig], runs: Path) -> None:
    os.replace = die  # type: ignore[assignment]
    run(configs, runs)


def test_the_checkpoint_of_a_driver_killed_between_record_and_checkpoint_is_removed(tmp_path: Path) -> None:
    """All is recorded, so the next driver has nothing to train and still clears up."""
    configs, runs = study(1), tmp_path / "runs"
    assert exit_code(run_until_recorded, configs, runs) == -signal.SIGKILL
    assert list((runs / ".partial").iterdir()) and len(sound(runs)) == 1
    run(configs, runs)
    assert not (runs / ".partial").exists()


def test_a_driver_killed_while_it_writes_a_checkpoint_leaves_no_draft(tmp_path: Path) -> None:
    configs, runs = study(1), tmp_path / "runs"
    assert exit_code(run_until_a_file_is_replaced, configs, runs) == -signal.SIGKILL and sound(runs) == {}
    (draft,) = (runs / ".partial").iterdir()
    assert draft.suffix != ".safetensors" and draft.stat().st_size > 0
    run(configs, runs)
    assert len(sound(runs)) == 1 and not (runs / ".partial").exists()


STEPS = 10
"""Seven files and their folder flushed, the folder renamed, the folder around it flushed."""


def dying(real: Callable[..., Any], left: list[int]) -> Callable[..., Any]:
    """``real``, and the process is killed instead at the call that ``left`` counts down to."""

    def call(*arguments: object, **named: object) -> Any:
        if left[0] == 0:
            die()
        left[0] -= 1
        return real(*arguments, **named)

    return call


def write_until(step: int, runs: Path, whole: Path) -> None:
    (done,) = record.all_records(whole)
    left = [step]
    atomic_io.flush = dying(atomic_io.flush, left)  # type: ignore[assignment]
    os.replace = dying(os.replace, left)  # type: ignore[assignment]
    record.write(runs, *content_of(done))


def content_of(done: record.RunRecord) -> tuple[Any, ...]:
    tables = {"steps": done.steps, "curve": done.curve, "windows": done.windows}
    return done.summary, done.config, tables, done.weights(), done.provenance


def test_a_kill_at_any_step_of_writing_leaves_a_whole_record_or_none(tmp_path: Path) -> None:
    (done,) = run(study(1), tmp_path / "whole")
    for step in range(STEPS + 1):
        runs = tmp_path / str(step)
        code = exit_code(write_until, step, runs, tmp_path / "whole")
        assert code == (-signal.SIGKILL if step < STEPS else 0)
        assert len(sound(runs)) == (step >= STEPS - 1)
        assert record.differences(done, record.write(runs, *content_of(done))) == []


def test_a_worker_that_dies_is_replaced(tmp_path: Path) -> None:
    """The job kills its own process the first time."""
    jobs = [(i, _fragile, (str(tmp_path / str(i)), i)) for i in range(3)]
    with closing(run_jobs(iter(jobs), 2, lambda message: None, str)) as done:
        assert sorted(done) == [(0, 0), (1, 10), (2, 20)]
    with pytest.raises(BenchError, match="died 3 times in a row, the last one at 7"):
        list(run_jobs(iter([(7, os.abort, ())]), 2, lambda message: None, str))


def test_ctrl_c_reaches_no_worker_not_even_one_that_imports_still() -> None:
    """A terminal sends it to all processes; a worker would tell of the line that it was at."""
    jobs = [(0, signal.pthread_sigmask, (signal.SIG_BLOCK, ()))]
    with closing(run_jobs(iter(jobs), 2, lambda message: None, str)) as done:
        assert signal.SIGINT in dict(done)[0]
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())


def _fragile(mark: str, i: int) -> int:
    if i == 1 and not Path(mark).exists():
        Path(mark).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return 10 * i
