"""Copies of a process that share its work: all that was asked for comes back, whatever becomes of them."""

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from bench.execution import parallel
from bench.execution.parallel import both, side_by_side

HERE = os.getpid()
"""Of the process that the tests run in, or of a worker that imports them."""


@pytest.fixture(autouse=True)
def _two(monkeypatch: pytest.MonkeyPatch) -> None:
    if sys.platform != "linux":
        pytest.skip("processes are copied on Linux only")
    monkeypatch.setattr(os, "sched_getaffinity", lambda who: {0, 1})


def test_results_come_in_the_order_of_the_items_from_two_processes() -> None:
    met, each_has_one = list[int](), multiprocessing.get_context("fork").Barrier(2)

    def both_here(x: float) -> tuple[int, np.ndarray]:
        if not met:
            met.append(each_has_one.wait(30))
        return os.getpid(), np.full(100_000, x)

    told = side_by_side(both_here, [0.0, 1.0, 2.0, 3.0])
    assert len({who for who, _ in told}) == 2
    assert all((values == x).all() for x, (_, values) in enumerate(told))


def test_what_a_killed_copy_had_is_done_again() -> None:
    far, copied = multiprocessing.Pipe(duplex=False)

    def dies_elsewhere(x: int) -> int:
        if os.getpid() != HERE:
            copied.send(x)
            os.kill(os.getpid(), signal.SIGKILL)
        assert far.poll(30)
        return x * x

    assert side_by_side(dies_elsewhere, range(5)) == [0, 1, 4, 9, 16]


def test_a_copy_that_waits_for_ever_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    far, copied = multiprocessing.Pipe(duplex=False)
    monkeypatch.setattr(parallel, "PATIENCE_S", 0.1)

    def waits_elsewhere(x: int) -> int:
        if os.getpid() != HERE:
            copied.send(x)
            signal.pause()
        assert far.poll(30)
        return x * x

    assert side_by_side(waits_elsewhere, range(5)) == [0, 1, 4, 9, 16]
    assert not multiprocessing.active_children()


def test_an_error_in_a_copy_is_raised_here_and_nothing_of_it_is_printed(capfd: pytest.CaptureFixture[str]) -> None:
    far, copied = multiprocessing.Pipe(duplex=False)

    def fails(x: int) -> int:
        if os.getpid() != HERE:
            print("a copy speaks", flush=True)
            copied.send(x)
        assert far.poll(30)
        if x == 1:
            raise ValueError("of item 1")
        return x

    with pytest.raises(ValueError, match="of item 1"):
        side_by_side(fails, [0, 1])
    assert capfd.readouterr() == ("", "")


def test_two_functions() -> None:
    assert both(lambda: "one", lambda: 2) == ("one", 2)


def _who(x: int) -> list[int]:
    return side_by_side(lambda _: os.getpid(), range(x))


def test_workers_of_a_pool_do_their_work_alone() -> None:
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        assert len(set(pool.submit(_who, 8).result(60))) == 1


def test_no_copy_is_left_when_the_work_here_is_stopped() -> None:
    def stopped(x: int) -> None:
        if os.getpid() == HERE:
            raise KeyboardInterrupt
        signal.pause()

    with pytest.raises(KeyboardInterrupt):
        side_by_side(stopped, [1, 2])
    assert not multiprocessing.active_children()


_WORK = """
import os, sys, time
from pathlib import Path
from bench.execution.parallel import side_by_side
os.sched_getaffinity = lambda who: {0, 1}
def lasts(x):
    Path(sys.argv[1], str(os.getpid())).touch()
    time.sleep(600)
side_by_side(lasts, [1, 2])
"""


def test_a_copy_ends_with_the_process_that_was_copied(tmp_path: Path) -> None:
    with subprocess.Popen([sys.executable, "-c", _WORK, tmp_path]) as work:
        deadline = time.monotonic() + 60
        while len(both_at_it := [int(p.name) for p in tmp_path.iterdir()]) < 2 and time.monotonic() < deadline:
            time.sleep(0.05)
        work.kill()
    (copy,) = {*both_at_it} - {work.pid}
    while _runs(copy) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not _runs(copy)


def _runs(who: int) -> bool:
    """Whether there is such a process, and not only what is left of it."""
    try:
        return Path(f"/proc/{who}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


def test_one_processor_copies_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda who: {0})
    assert parallel._processors() == 1
    assert side_by_side(lambda x: os.getpid(), [1, 2]) == [HERE, HERE]
