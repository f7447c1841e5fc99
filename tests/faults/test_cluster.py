"""A real scheduler and worker processes on 127.0.0.1, killed one after the other."""

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import optuna
import pytest
from conftest import Typed
from optuna.trial import TrialState

from bench.experiment.config import RunConfig, Training
from bench.experiment.notation import parse
from bench.records import record
from bench.sweep import journal as sweep
from bench.sweep.search import search
from bench.sweep.space import parse_search
from registry.core import DATASETS

pytest.importorskip("distributed", reason="the cluster extra is not installed")
RUN = ["run", "LSTM: 1x6 - MLP: 6x10", "--seeds", "8", "--no-track", "--dataset", "helicopter_twin"]
RUN += ["--set", "training.updates=200", "--set", "training.evaluate_every=20"]
"""Eight trainings, too thin to be grouped, and two baselines."""
RUNS = 10


@contextmanager
def started(*command: str, says: str = "", log: Path) -> Iterator[subprocess.Popen[bytes]]:
    with log.open("wb") as out:
        process = subprocess.Popen([sys.executable, "-m", *command], stdout=out, stderr=subprocess.STDOUT)
        try:
            until(lambda: says in log.read_text(errors="replace"), process)
            yield process
        finally:
            process.kill()
            process.wait()


def until(true: Callable[[], bool], process: "subprocess.Popen[bytes]", seconds: float = 300) -> None:
    deadline = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < deadline and process.poll() is None
        time.sleep(0.02)


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def made(results: Path) -> dict[str, int]:
    found = list(record.all_records(results / "runs"))
    assert all(record.verify(r) == [] for r in found)
    return {r.key: r.provenance["finished_ms"] for r in found}


def bench(*arguments: str, results: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "bench", *arguments, "--results", str(results)]
    return subprocess.run(command, capture_output=True, text=True, timeout=600)


@pytest.mark.faults
def test_kills_on_a_cluster_lose_only_what_was_in_hand(tmp_path: Path, faults: Callable[..., None]) -> None:
    whole, results, two = tmp_path / "whole", tmp_path / "results", tmp_path / "two"
    for folder, workers in ((whole, "1"), (two, "2")):
        assert bench(*RUN, "--workers", workers, results=folder).returncode == 0
    address = f"tcp://127.0.0.1:{(port := free_port())}"
    scheduler = ("dask", "scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard")
    worker = ("dask", "worker", address, "--nthreads", "1", "--no-nanny", "--no-dashboard")
    driver = ("bench", *RUN, "--cluster", address, "--results", str(results))
    with (
        started(*scheduler, says="Scheduler at", log=tmp_path / "s") as manager,
        started(*worker, says="Registered to", log=tmp_path / "a") as first,
        started(*worker, says="Registered to", log=tmp_path / "b"),
    ):
        with started(*driver, log=tmp_path / "d") as killed:
            until(lambda: len(made(results)) >= 2, killed)
            first.send_signal(signal.SIGKILL)
            with started(*worker, says="Registered to", log=tmp_path / "c"):
                more = len(made(results)) + 3
                until(lambda: len(made(results)) >= more, killed)
                killed.send_signal(signal.SIGKILL)
                killed.wait()
                left = made(results)
                again = bench(*RUN, "--cluster", address, results=results)
        assert again.returncode == 0, again.stderr
        assert f"{len(left)} already recorded, {RUNS - len(left)} to do" in again.stdout
        with started(*driver[:-1], str(tmp_path / "gone"), log=tmp_path / "e") as orphan:
            until(lambda: len(made(tmp_path / "gone")) >= 2, orphan)
            manager.send_signal(signal.SIGKILL)
            assert orphan.wait(300) == 2
        said = (tmp_path / "e").read_text()
        assert "is gone: what was finished is kept" in said and "Traceback" not in said
        assert len(made(tmp_path / "gone")) >= 2
    done = made(results)
    assert len(done) == RUNS == len(made(whole)) and all(done[k] == when for k, when in left.items())
    for a in record.all_records(whole / "runs"):
        for other in (results, two):
            assert record.differences(a, record.RunRecord(other / "runs" / a.key)) == []
    faults("one of two cluster workers mid-study, another added (kill -9)", 1, 0, 0, "the run in its hand")
    faults("the driver of a cluster (kill -9), started again", 1, 0, 0, "the runs in hand")
    faults("the scheduler of a cluster (kill -9)", 1, 0, 0, "the runs in hand")


@pytest.mark.faults
def test_a_sweep_on_a_cluster_is_that_of_one_process(tmp_path: Path, faults: Callable[..., None]) -> None:
    """One worker, killed in the middle of a trial, then another: proposals, errors and finalists are the same."""
    command = ["sweep", "LSTM: 1x6 - MLP: 6x10", "--dataset", "helicopter_twin", "--no-track", "--name", "s"]
    command += ["--trials", "4", "--objective", "weights", "--set", "training.updates=200"]
    command += ["--search", "predictor.hidden=6:12", "--search", "predictor.layers=1:2"]
    whole, results = tmp_path / "whole", tmp_path / "results"
    assert bench(*command, "--workers", "1", results=whole).returncode == 0
    address = f"tcp://127.0.0.1:{(port := free_port())}"
    scheduler = ("dask", "scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard")
    worker = ("dask", "worker", address, "--nthreads", "1", "--no-nanny", "--no-dashboard")

    def told(folder: Path) -> int:
        journal = folder / "sweeps" / "s" / sweep.JOURNAL
        return len(sweep.finished(sweep.load(journal.parent))) if journal.is_file() and journal.stat().st_size else 0

    with (
        started(*scheduler, says="Scheduler at", log=tmp_path / "s"),
        started(*worker, says="Registered to", log=tmp_path / "a") as first,
        started("bench", *command, "--cluster", address, "--results", str(results), log=tmp_path / "d") as driver,
    ):
        until(lambda: told(results) >= 2, driver)
        partial = results / "sweeps" / "s" / ".partial"
        until(lambda: any(partial.glob("*.safetensors")), driver)
        first.send_signal(signal.SIGKILL)
        with started(*worker, says="Registered to", log=tmp_path / "b"):
            assert driver.wait(300) == 0, (tmp_path / "d").read_text()
    a, b = (sweep.load(folder / "sweeps" / "s") for folder in (whole, results))
    assert [(t.params, t.values) for t in a.trials] == [(t.params, t.values) for t in b.trials]
    assert len(b.trials) == 4 and set(made(whole)) == set(made(results))
    for record_a in record.all_records(whole / "runs"):
        assert record.differences(record_a, record.RunRecord(results / "runs" / record_a.key)) == []
    faults(
        "the worker of a cluster in the middle of a sweep's trial (kill -9)",
        1,
        0,
        0,
        "the updates since its checkpoint",
    )


@pytest.mark.faults
def test_a_trial_that_is_not_worth_it_stops_on_a_cluster(tmp_path: Path) -> None:
    """A pruner that stops everything stands in for a trial that is worse than the others."""
    training = Training(updates=20_000, evaluate_every=50)
    config = RunConfig(*parse("LSTM: 1x6 - MLP: 6x10"), DATASETS.get("helicopter_twin")(), training=training)
    space = dict([parse_search("training.learning_rate=1e-3:2e-3", [config])])
    asked = sweep.Sweep("stopped", (config,), space)
    study = sweep.begin(asked, tmp_path / "s", resume=False)
    study.pruner = optuna.pruners.ThresholdPruner(upper=0.0)
    address = f"tcp://127.0.0.1:{(port := free_port())}"
    scheduler = ("dask", "scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard")
    worker = ("dask", "worker", address, "--nthreads", "1", "--no-nanny", "--no-dashboard")
    with (
        started(*scheduler, says="Scheduler at", log=tmp_path / "scheduler"),
        started(*worker, says="Registered to", log=tmp_path / "worker"),
    ):
        search(asked, study, tmp_path / "s", trials=2, cluster=address)
    assert [t.state for t in study.trials] == [TrialState.PRUNED] * 2
    assert all(t.user_attrs["updates"] < training.updates / 2 for t in study.trials)
    assert sorted(p.name for p in (tmp_path / "s").iterdir()) == [sweep.JOURNAL, sweep.DEFINITION]


@pytest.mark.faults
def test_bench_starts_a_cluster_and_stops_it(tmp_path: Path) -> None:
    port, log = free_port(), tmp_path / "log"
    with started("bench", "cluster", "start", "--workers", "1", "--port", str(port), says="Ctrl-C", log=log) as process:
        assert f"--cluster tcp://127.0.0.1:{port}" in log.read_text() and "Warning" not in log.read_text()
        taken = subprocess.run(
            [sys.executable, "-m", "bench", "cluster", "start", "--port", str(port), "--workers", "1"],
            capture_output=True, text=True, timeout=120,
        )  # fmt: skip
        assert taken.returncode == 2 and "choose another --port" in taken.stderr.splitlines()[-1]
        process.send_signal(signal.SIGINT)
        assert process.wait(30) == 0


def test_what_others_can_reach_is_known(tmp_path: Path) -> None:
    from bench.execution.cluster import loopback

    assert [loopback(h) for h in ("127.0.0.1", "localhost", "::1", "0.0.0.0", "10.0.0.7", "lab7")] == [
        True, True, True, False, False, False,
    ]  # fmt: skip


def test_no_scheduler_is_one_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from bench.execution import cluster
    from registry.errors import BenchError

    monkeypatch.setattr(cluster, "SECONDS", 1)
    for address in (f"tcp://127.0.0.1:{free_port()}", "nonsense://x", f"{os.getpid()}"):
        with pytest.raises(BenchError, match="bench cluster start"), cluster.connected(address):
            pass


def test_a_sweep_without_a_scheduler_ends_before_it_begins(typed: Typed, tmp_path: Path) -> None:
    results, address = tmp_path / "results", f"tcp://127.0.0.1:{free_port()}"
    code, _, stderr = typed("sweep", "linear", "--dataset", "pelican_twin", "--cluster", address, "--results", results)
    assert code == 2 and "No Dask scheduler" in stderr and len(stderr.strip().splitlines()) <= 2
    assert not results.exists()
