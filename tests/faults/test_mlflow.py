"""An MLflow server that hangs, is killed, comes back: training does not notice; `bench sync` brings what is missing."""

import io
import os
import signal
import socket
import sqlite3
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest
from faults.alone import exit_code
from faults.test_cluster import bench, free_port, made, started, until
from rich.console import Console
from sqlalchemy import event
from sqlalchemy.engine import Engine
from synthetic_records import synthetic_record

from bench.cli.execution_options import Execution
from bench.cli.job import browse
from bench.tracking import mirroring, track
from bench.tracking.mirroring import Mirroring

RUN = ["run", "LSTM: 1x6 - MLP: 6x10", "--seeds", "4", "--dataset", "helicopter_twin", "--set", "training.updates=200"]
RUNS = 6


def statuses(database: Path) -> list[str]:
    with sqlite3.connect(database) as open_one:
        return [s for (s,) in open_one.execute("SELECT status FROM runs WHERE name NOT LIKE 'Report%'")]


def test_a_server_that_never_answers_costs_no_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mirroring, "MAX_SILENCE", 3.0)
    said: list[str] = []
    with socket.socket() as silent:
        silent.bind(("127.0.0.1", 0))
        silent.listen()
        mirror = Mirroring(f"http://127.0.0.1:{silent.getsockname()[1]}", "e", None, said.append)
        began = time.monotonic()
        mirror.add(tmp_path / str(i) for i in range(5000))
        mirror.attach([tmp_path / "x.png"])
        assert time.monotonic() - began < mirroring.MAX_SILENCE
        assert mirror.finish() == 5000
        assert time.monotonic() - began < 60 and not mirror.process.is_alive()


@pytest.mark.parametrize(
    ("address", "says"), [("http://127.0.0.1:{}", "run `bench sync` later."), ("nonsense", "or http://HOST:PORT.")]
)
def test_a_dead_server_is_said_once(address: str, says: str, tmp_path: Path) -> None:
    said: list[str] = []
    before = set(threading.enumerate())
    mirror = Mirroring(address.format(free_port()), "e", None, said.append)
    mirror.add(tmp_path / f"{i:0100}" for i in range(1000))  # more than a pipe holds
    assert mirror.finish() == 1000
    (sentence,) = said
    assert sentence.endswith(says)
    # A thread that is alive when the interpreter ends leaves a semaphore, and Python prints a warning.
    assert set(threading.enumerate()) <= before


def test_the_way_to_what_is_missing_names_the_server() -> None:
    out = Console(file=io.StringIO(), width=200)
    browse(out, 2, "t", Execution(Path("a b"), "http://127.0.0.1:5001", False, None))
    browse(out, 0, "t", Execution(Path("r"), None, False, None))
    missing, whole = out.file.getvalue().splitlines()  # type: ignore[attr-defined]
    assert "bench sync --results 'a b' --tracking http://127.0.0.1:5001 logs" in missing
    assert "bench ui --results r (opens" in whole


def prepare_until_a_table_is_copied(folder: Path) -> None:
    def kill(_: object, __: object, statement: str, *___: object) -> None:
        if statement.startswith("INSERT INTO _alembic_tmp"):
            os.kill(os.getpid(), signal.SIGKILL)

    event.listen(Engine, "before_cursor_execute", kill)
    track.prepare(track.default_uri(folder))


def test_a_kill_while_the_database_is_made_leaves_none(tmp_path: Path) -> None:
    """MLflow goes through all its migrations; the kill comes while one copies a table. The next to write clears up."""
    assert exit_code(prepare_until_a_table_is_copied, tmp_path) == -signal.SIGKILL
    assert not (tmp_path / "mlflow.db").exists()
    track.prepare(track.default_uri(tmp_path))
    assert [p.name for p in tmp_path.iterdir()] == ["mlflow.db"]


def test_what_a_killed_driver_left_running_is_repaired(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    uri, runs = track.default_uri(tmp_path), tmp_path / "runs"
    kept, pruned = synthetic_record(runs), synthetic_record(runs, seed=1)
    with monkeypatch.context() as patch:
        patch.setattr("bench.tracking.records._dataset", lambda summary: (_ for _ in ()).throw(KeyboardInterrupt))
        for r in (kept, pruned):
            with pytest.raises(KeyboardInterrupt):
                track.mirror([r.folder], uri, "e", "s")
    assert statuses(tmp_path / "mlflow.db") == ["RUNNING", "RUNNING"] and track.whole(uri, "e", "s") == set()
    os.rename(pruned.folder, tmp_path / "elsewhere")
    assert track.repair(uri, runs, own=False) == 1
    assert sorted(statuses(tmp_path / "mlflow.db")) == ["FINISHED", "RUNNING"]
    assert track.repair(uri, runs, own=True) == 1 and track.repair(uri, runs, own=True) == 0
    assert track.whole(uri, "e", "s") == {kept.key} and track.whole(uri, "e", "other") == set()
    os.rename(tmp_path / "elsewhere", pruned.folder)
    track.mirror([pruned.folder], uri, "e", "s")
    assert track.whole(uri, "e", "s") == {kept.key, pruned.key}


@pytest.mark.faults
def test_a_server_killed_and_started_again_misses_nothing_after_sync(
    tmp_path: Path, faults: Callable[..., None]
) -> None:
    results, database, port = tmp_path / "results", tmp_path / "server" / "mlflow.db", free_port()
    database.parent.mkdir()
    serve = f"""
import sys, time
from bench.tracking.ui import server
with server("sqlite:///{database}", port={port}) as base:
    print(base, flush=True)
    time.sleep(600)
"""
    (tmp_path / "serve_mlflow.py").write_text(serve)
    address = f"http://127.0.0.1:{port}"
    track.prepare(f"sqlite:///{database}")

    @contextmanager
    def serving() -> Iterator["subprocess.Popen[str]"]:
        command = [sys.executable, str(tmp_path / "serve_mlflow.py")]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        try:
            assert process.stdout and process.stdout.readline().strip() == address
            yield process
        finally:
            process.send_signal(signal.SIGTERM)
            process.wait()

    with ExitStack() as server:
        server.enter_context(serving())
        with started("bench", *RUN, "--tracking", address, "--results", str(results), log=tmp_path / "d") as driver:
            until(lambda: len(made(results)) >= 1 and len(statuses(database)) >= 1, driver)
            server.close()
            assert driver.wait(600) == 0
    assert len(made(results)) == RUNS
    with serving():
        synced = bench("sync", "--tracking", address, results=results)
        assert synced.returncode == 0, synced.stderr
        assert sorted(statuses(database)) == ["FINISHED"] * RUNS
    faults("the MLflow server mid-study, started again, then `bench sync`", 1, 0, 0, "nothing")
