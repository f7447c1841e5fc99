"""What a study costs beside training: `python tests/scaling.py [--write results/published/scaling.md]`.

Processor time where one process does it all, so that other work on the machine does not count; wall time elsewhere.
"""

import resource
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from bench import engine, executor, run, track
from bench.config import RunConfig, Training
from bench.mirroring import Mirroring
from bench.notation import parse
from registry.core import DATASETS

RUNS, TINY, SECONDS = 100, 400, 2.0
DUMMIES = 1000
"""Records of the memory test."""


def configs(count: int, updates: int) -> list[RunConfig]:
    """Runs that cannot be grouped: the most records for the least training."""
    training = Training(updates=updates, evaluate_every=max(1, updates // 20))
    one = RunConfig(*parse("LSTM: 1x6 - MLP: 6x10"), DATASETS.get("helicopter_twin")(), training=training)
    return [replace(one, seed=s) for s in range(count)]


def inline(folder: Path) -> str:
    """Share of a grid's processor time that is not training."""
    trained, real = [0.0], run.train

    def timed(*args: Any, **kwargs: Any) -> Any:
        began = time.process_time()
        try:
            return real(*args, **kwargs)
        finally:
            trained[0] += time.process_time() - began

    run.train = timed  # type: ignore[assignment]
    grid = configs(RUNS, TINY)
    engine.execute(engine.plan(grid[:1], folder / "warm"), folder / "warm")
    trained[0], began = 0.0, time.process_time()
    engine.execute(engine.plan(grid, folder / "a"), folder / "a")
    total = time.process_time() - began
    run.train = real
    return (
        f"A grid of {RUNS} runs of {trained[0] / RUNS:.2f} s of training each, inline: {1 - trained[0] / total:.1%} of "
        f"its processor time ({1000 * (total - trained[0]) / RUNS:.0f} ms a run) goes into planning, evaluation, "
        "records and checks."
    )


def two_workers(folder: Path) -> str:
    """The same with processes: their wall time that no run accounts for."""
    began = time.monotonic()
    records = engine.execute(engine.plan(configs(RUNS, TINY), folder / "b"), folder / "b", workers=2)
    wall = time.monotonic() - began
    busy = sum(r.provenance["seconds"] for r in records)
    return f"The same grid with `--workers 2`: {1 - busy / (2 * wall):.1%} of {wall:.0f} s, their start included."


@contextmanager
def threads(workers: int) -> Iterator[executor.Crew]:
    """Workers that sleep."""
    with ThreadPoolExecutor(workers) as pool:
        yield executor.Crew(pool.submit, lambda: 2 * workers)


def dummies(folder: Path, count: int, workers: int, seconds: float, seen: Callable[[int], None]) -> float:
    """Wall time of dummy runs, whose outcomes are those of a real one under other keys."""
    (one,) = run.run_group(configs(1, 40))
    real, made = executor._crew, [0]

    def work(key: str) -> list[run.Outcome]:
        time.sleep(seconds)
        return [replace(one, summary={**one.summary, "key": key})]

    executor._crew = lambda *_: threads(workers)  # type: ignore[assignment]
    keys = [f"{i:032x}" for i in range(count)]
    began = time.monotonic()
    for _, outcomes in executor.work_off(((k, work, (k,)) for k in keys), workers, print, str):
        engine.write(outcomes[0], folder)
        made[0] += 1
        seen(made[0])
    executor._crew = real
    return time.monotonic() - began


def memory(folder: Path) -> str:
    """Growth of the driver over many records, MLflow's queue included."""
    peak: dict[int, float] = {}
    mirror = Mirroring(track.default_uri(folder), "memory", None, print)
    began = time.process_time()

    def seen(count: int) -> None:
        mirror.add([folder / f"{count - 1:032x}"])
        peak[count] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024

    dummies(folder / "c", DUMMIES, 8, 0.0, seen)
    mirror.stop()
    spent = time.process_time() - began
    return (
        f"The driver's memory grows by {peak[DUMMIES] - peak[50]:.0f} MB from its 50th to its {DUMMIES}th record; "
        f"a record costs it {1000 * spent / DUMMIES:.0f} ms of processor time."
    )


def saturation(folder: Path) -> list[str]:
    """Throughput with more and more workers that sleep."""
    rows = ["workers | runs a second, at most | done", "--- | --- | ---"]
    for workers in (1, 4, 16, 32, 64):
        count = max(4, min(4 * workers, 160))
        wall = dummies(folder / f"d{workers}", count, workers, SECONDS, lambda n: None)
        rows.append(f"{workers} | {workers / SECONDS:.1f} | {count / wall:.1f}")
    return [f"| {row} |" for row in rows]


def tracking(folder: Path) -> str:
    """Processor time of logging a record, in its own process."""
    records = engine.execute(engine.plan(configs(RUNS, TINY)[:12], folder / "a"), folder / "a")
    uri = track.default_uri(folder / "mlflow")
    track.mirror([records[0].folder, records[1].folder], uri, "e")
    began = time.process_time()
    track.mirror([r.folder for r in records[2:]], uri, "e")
    cost = (time.process_time() - began) / 10
    return (
        f"Logging a record in MLflow (sqlite) takes {1000 * cost:.0f} ms of processor time, in a process of its own: "
        f"less than 5 % of a training of {20 * cost:.0f} s or more. Answers are waited for there too: with a "
        "slow server training goes on as without, and what is left at the end waits for `bench sync`."
    )


def main() -> None:
    """Measure, print and write."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        lines = []
        for measure in (inline, two_workers, tracking, memory):
            lines.append(measure(folder))
            print(lines[-1], flush=True)
        table = saturation(folder)
    command = "python tests/scaling.py --write results/published/scaling.md"
    text = ["# What a study costs beside training", "", f"`{command}`", "", *(f"- {line}" for line in lines), ""]
    text += [f"Dummy runs of {SECONDS:g} s (records of real size) on workers that sleep, one driver:", "", *table, ""]
    print("\n".join(text))
    if "--write" in sys.argv:
        Path(sys.argv[sys.argv.index("--write") + 1]).write_text("\n".join(text))


if __name__ == "__main__":
    main()
