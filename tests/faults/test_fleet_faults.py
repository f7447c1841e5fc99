"""A fleet on a real scheduler: a worker and the driver are killed, and all is as one process makes it."""

import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from simulated_fleet import KINDS, answers, vehicle
from test_cluster import free_port, started, until

pytest.importorskip("distributed", reason="the cluster extra is not installed")
VEHICLES = 6


@pytest.fixture
def fleet(tmp_path: Path) -> Path:
    """Small vehicles of several kinds."""
    kinds = [kind for kind in KINDS if kind != "nothing"]  # which takes longest
    for i in range(VEHICLES):
        vehicle(tmp_path / "fleet" / f"cart_{i}", kinds[i % len(kinds)], i, recordings=3, seconds=6.0)
    return tmp_path / "fleet"


def content(out: Path) -> dict[str, bytes]:
    return {p.relative_to(out).as_posix(): p.read_bytes() for p in out.rglob("*") if p.is_file() and p.name != ".lock"}


@pytest.mark.faults
def test_kills_of_a_fleet_lose_only_what_was_in_hand(fleet: Path, tmp_path: Path, faults: Callable[..., None]) -> None:
    only = [word for kind in KINDS["two"] for word in ("--catalogue", kind)] + ["--catalogue", "offset_force"]
    command = ["diagnose", str(fleet), *only, "--no-track"]
    address = f"tcp://127.0.0.1:{(port := free_port())}"
    scheduler = ("dask", "scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard")
    worker = ("dask", "worker", address, "--nthreads", "1", "--no-nanny", "--no-dashboard")
    out = fleet / "diagnosis"
    with (
        started(*scheduler, says="Scheduler at", log=tmp_path / "s"),
        started(*worker, says="Registered to", log=tmp_path / "a") as first,
        started(*worker, says="Registered to", log=tmp_path / "b"),
    ):
        with started("bench", *command, "--cluster", address, log=tmp_path / "d") as driver:
            until(lambda: len(answers(fleet)) >= 1, driver)
            first.send_signal(signal.SIGKILL)
            until(lambda: len(answers(fleet)) >= 3, driver)
            driver.send_signal(signal.SIGKILL)
            driver.wait()
        left = answers(fleet)
        again = subprocess.run(
            [sys.executable, "-m", "bench", *command, "--cluster", address], capture_output=True, text=True, timeout=600
        )
    assert again.returncode == 0, again.stderr
    assert f"{len(left)} already diagnosed, {VEHICLES - len(left)} to do" in again.stdout
    now = answers(fleet)
    assert len(now) == VEHICLES and all(now[name] == when for name, when in left.items())
    assert not list((out / "vehicles").glob(".*"))
    whole = [sys.executable, "-m", "bench", *command, "--workers", "2", "--out", str(tmp_path / "whole")]
    assert subprocess.run(whole, timeout=600).returncode == 0
    a, b = content(out), content(tmp_path / "whole")
    assert {n: t for n, t in a.items() if n != "fleet.html"} == {n: t for n, t in b.items() if n != "fleet.html"}
    faults("a cluster worker, then the driver of a fleet (kill -9), started again", 1, 0, 0, "the vehicles in hand")
