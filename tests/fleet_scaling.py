"""What the driver of a fleet costs: `python tests/fleet_scaling.py [--write results/published/fleet_scaling.md]`.

Workers are threads that are always done, answers have the size of real ones: what is left is the driver's own work, of
which follows how long a vehicle must take for one driver to keep 64 workers busy.
"""

import importlib
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import known_fleet
import numpy as np

from bench.claims.manifest import entered
from bench.execution import executor
from bench.execution.pool import AHEAD, WorkerPool
from bench.fleet import page
from bench.fleet.findings import drifts, quantities
from bench.fleet.members import members
from bench.fleet.options import Options, environment
from bench.fleet.result import Answer, ErrorBetween, FleetDiagnosis, Number
from bench.fleet.work import work

driver = importlib.import_module("bench.fleet.fleet")  # the package has a function of that name
KEPT, SAID, WORKERS = 400, 10_000, 64
"""Vehicles whose answers are written, vehicles that are put together, and workers."""
PAGE_BYTES = 250_000
"""Of a vehicle's page, as of a cart of `simulated_fleet`."""
DATA = 8_000_000
"""Bytes of 28 recordings of 30 s at 100 Hz, ten columns of text."""


@contextmanager
def always_done(*_: Any) -> Iterator[WorkerPool]:
    """In place of processes."""
    with ThreadPoolExecutor(WORKERS) as pool:
        yield WorkerPool(pool.submit, lambda: AHEAD * WORKERS)


def kept(folder: Path) -> Iterator[str]:
    """The driver before the start, and while answers come."""
    for i in range(KEPT):
        known_fleet.folder(folder / "fleet" / f"n{i}", 0.3 + i / 1e4)
    cpu = time.process_time()
    todo = driver.plan(members(str(folder / "fleet")), Options(), folder / "out")
    looked = (time.process_time() - cpu) / KEPT
    (folder / "data").write_bytes(b"0123456789" * (DATA // 10))
    cpu = time.process_time()
    driver.key_of.__globals__["_sha256"](folder / "data")
    hashed = time.process_time() - cpu
    yield (
        f"Before the start a vehicle takes {1000 * looked:.1f} ms of processor time, and {1000 * hashed:.0f} ms for "
        f"{DATA / 1e6:.0f} MB of data that are hashed: {SAID * (looked + hashed):.0f} s for {SAID:,} vehicles."
    )
    same, answers = dict(environment()), {}
    for m in todo.todo:
        sentence, files = work(known_fleet.read, m, Options(), todo.keys[m.id], same)
        answers[m.id] = sentence, {n: t.ljust(PAGE_BYTES) if n.endswith(".html") else t for n, t in files.items()}
    executor._pool, driver.work = always_done, lambda do, member, *_: answers[member.id]  # type: ignore[assignment]
    wall, cpu = time.monotonic(), time.process_time()
    driver.execute(todo, WORKERS)
    wall, cpu = time.monotonic() - wall, time.process_time() - cpu
    assert len(todo.done) == KEPT
    rate = KEPT / wall
    yield (
        f"With workers that are always done one driver keeps {rate:.0f} answers a second, {1000 * cpu / KEPT:.0f} ms "
        f"of processor time each; the rest waits for the disk, which is to hold six files and two folders before the "
        f"next. It saturates there: {WORKERS} workers keep it busy with vehicles of less than {WORKERS / rate:.1f} s. "
        f"{SAID:,} vehicles of 40 s take {WORKERS} workers {SAID * 40 / WORKERS / 3600:.1f} h, of which the driver "
        f"works {SAID / rate / 60:.0f} minutes; vehicles of 1 s are bound by the driver."
    )


def said(folder: Path) -> Iterator[str]:
    """What is put together at the end."""
    random, answers = np.random.default_rng(0), []
    for i in range(SAID):
        numbers = tuple(
            Number(effect, "c", value, value - 0.01, value + 0.01, "kg/m")
            for effect in ("quadratic_drag", "viscous_friction")
            for value in [float(0.3 + 0.02 * random.normal())]
        )
        errors = tuple(ErrorBetween(g, "m", 0.5, 0.2, 0.1, 0.09) for g in ("displacement", "speed"))
        about = f"n{i}", f"n{i}", "2026-01-01", "falling_body", "named", "", f"vehicles/n{i}/diagnosis.html"
        answers.append(Answer(*about[:6], page=about[6], numbers=numbers, errors=errors))
    cpu = time.process_time()
    found = FleetDiagnosis("fleet", tuple(answers), quantities(answers), drifts(answers))
    tested = time.process_time() - cpu
    text = page.render(found, "bench diagnose fleet")
    shown = time.process_time() - cpu - tested
    yield (
        f"At the end {SAID:,} vehicles with two numbers each are compared in {tested:.0f} s (each against all others: "
        f"the square of their number), and shown on a page of {len(text) / 1e6:.0f} MB in {shown:.0f} s."
    )


def main() -> None:
    """Measure, print and write."""
    text = ["# What the driver of a fleet costs", ""]
    text += ["`python tests/fleet_scaling.py --write results/published/fleet_scaling.md`", ""]
    with tempfile.TemporaryDirectory() as name:
        for measure in (kept, said):
            for line in measure(Path(name)):
                text.append(f"- {line}")
                print(line, flush=True)
    if "--write" in sys.argv:
        target = Path(sys.argv[sys.argv.index("--write") + 1])
        target.write_text("\n".join(text) + "\n", encoding="utf-8")
        entered(target)


if __name__ == "__main__":
    main()
