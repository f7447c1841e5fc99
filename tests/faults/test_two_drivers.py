"""Two drivers at one study, and a lock that dies with its holder."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from bench.execution import lock
from registry.errors import BenchError

HOLD = (
    "import sys, time; from pathlib import Path; from bench.execution import lock\n"
    "with lock.held(Path(sys.argv[1]), 'a study'): print('held', flush=True); time.sleep(600)\n"
)


def holder(folder: Path) -> subprocess.Popen[str]:
    process = subprocess.Popen([sys.executable, "-c", HOLD, str(folder)], stdout=subprocess.PIPE, text=True)
    assert process.stdout and process.stdout.readline() == "held\n"
    return process


def test_the_second_driver_gets_a_sentence_and_a_dead_one_holds_nothing(
    tmp_path: Path, faults: Callable[..., None]
) -> None:
    folder = tmp_path / "results" / "studies" / "constant-on-pelican-twin"
    first = holder(folder)
    command = [sys.executable, "-m", "bench", "run", "constant", "--no-track"]
    second = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    said = [line for line in second.stderr.strip().splitlines() if not line.startswith("Simulating ")]
    assert second.returncode == 2 and len(said) == 1
    assert f"“constant on pelican_twin” is already being run by process {first.pid} on " in said[0]
    assert not (tmp_path / "results" / "runs").exists()
    pruned = subprocess.run(
        [sys.executable, "-m", "bench", "runs", "prune"], cwd=tmp_path, capture_output=True, text=True
    )
    assert pruned.returncode == 2 and str(first.pid) in pruned.stderr
    first.send_signal(signal.SIGKILL)
    first.wait()
    assert subprocess.run(command, cwd=tmp_path, capture_output=True, text=True).returncode == 0
    assert lock.holders(tmp_path / "results" / "studies") == []
    faults("two drivers at one study; the first killed", 1, 0, 0, "nothing")


def test_the_lock_is_free_after_an_error_and_taken_in_the_same_process(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError), lock.held(tmp_path / "x", "x"):
        _ = 1 / 0
    with lock.held(tmp_path / "x", "x"):
        with pytest.raises(BenchError, match=f"process {os.getpid()} on"), lock.held(tmp_path / "x", "x"):
            pass
        assert len(lock.holders(tmp_path)) == 1
    assert lock.holders(tmp_path) == []
