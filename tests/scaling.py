"""What a study costs beside training: `python tests/scaling.py [--write results/published/scaling.md]`.

Ratios are of processor time where one process does it all, so that other work on the machine does not count. Dummy
runs have the record of a real one; their workers are threads that sleep.
"""

import multiprocessing
import os
import pickle
import resource
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager
from dataclasses import replace
from http.client import HTTPConnection
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import Any
from urllib.parse import urlsplit

from bench.claims.manifest import entered
from bench.execution import engine, executor
from bench.execution.pool import AHEAD, WorkerPool
from bench.experiment.config import RunConfig, Training
from bench.experiment.notation import parse
from bench.tracking.mirroring import Mirroring
from bench.training import run
from registry.core import DATASETS

RUNS, TINY = 100, 400
"""Runs of the grid, and their updates."""
DUMMIES = 1000
"""Records of the memory test."""
TRACKED, SECONDS = 12, 10.0
"""Dummy runs that are logged, two at a time, and how long each takes."""
ANSWER = 0.2
"""Seconds that the slow server takes to answer."""
LOG = "SCALING_LOG"
"""Environment variable with the file to which workers append the wall and processor time of every training."""

_train = run.train


def timed(*args: Any, **kwargs: Any) -> Any:
    """`bench.training.train.train`, with its times noted."""
    wall, cpu = time.monotonic(), time.process_time()
    made = _train(*args, **kwargs)
    if LOG in os.environ:
        with Path(os.environ[LOG]).open("a") as log:
            log.write(f"{time.monotonic() - wall} {time.process_time() - cpu}\n")
    return made


run.train = timed  # in the workers as well, which import this file


def configs(count: int, updates: int) -> list[RunConfig]:
    """Runs that cannot be grouped: the most records for the least training."""
    training = Training(updates=updates, evaluate_every=max(1, updates // 20))
    one = RunConfig(*parse("LSTM: 1x6 - MLP: 6x10"), DATASETS.get("helicopter_twin")(), training=training)
    return [replace(one, seed=s) for s in range(count)]


def ended() -> float:
    """Processor time of all processes that were started here and have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def grid(folder: Path, workers: int) -> tuple[float, float, float, float]:
    """Wall and processor time of training, then of the whole grid."""
    os.environ[LOG] = str(folder / f"{workers}.log")
    wall, cpu = time.monotonic(), time.process_time() + ended()
    runs = folder / f"grid{workers}"
    engine.execute(engine.plan(configs(RUNS, TINY), runs), runs, workers)
    while multiprocessing.active_children():  # the workers are ending
        time.sleep(0.01)
    wall, cpu = time.monotonic() - wall, time.process_time() + ended() - cpu
    trained = [tuple(map(float, line.split())) for line in Path(os.environ.pop(LOG)).read_text().splitlines()]
    assert len(trained) == RUNS
    return sum(w for w, _ in trained), sum(c for _, c in trained), wall, cpu


def overhead(folder: Path) -> Iterator[str]:
    """Share of a grid's time that is not training."""
    engine.execute(engine.plan(configs(1, TINY), folder / "warm"), folder / "warm")
    _, trained, _, total = grid(folder, 1)
    yield (
        f"A grid of {RUNS} runs of {trained / RUNS:.2f} s of training each, inline: {1 - trained / total:.1%} of its "
        f"processor time ({1000 * (total - trained) / RUNS:.0f} ms a run) goes into planning, evaluation and records."
    )
    training, trained, wall, total = grid(folder, 2)
    yield (
        f"The same grid with `--workers 2`: {1 - trained / total:.1%} of its processor time, the start of the workers "
        f"included; they train {training / (2 * wall):.1%} of the time (wall time: other work on the machine counts)."
    )


def dummies(
    folder: Path, count: int, workers: int, seconds: float, seen: Callable[[Path], None] = lambda path: None
) -> float:
    """Wall time of dummy runs until the last record is written."""
    (one,) = run.run_group(configs(1, 40))
    real = executor._pool

    def work(key: str) -> bytes:
        time.sleep(seconds)
        return pickle.dumps([replace(one, summary={**one.summary, "key": key})])

    @contextmanager
    def pool(*_: Any) -> Iterator[WorkerPool]:
        with ThreadPoolExecutor(workers) as pool:
            yield WorkerPool(pool.submit, lambda: AHEAD * workers)

    executor._pool = pool  # type: ignore[assignment]
    began = time.monotonic()
    with closing(executor.run_jobs(((k, work, (f"{k:032x}",)) for k in range(count)), workers, print, str)) as done:
        for _, outcomes in done:
            seen(engine.write(pickle.loads(outcomes)[0], folder).folder)
    executor._pool = real
    return time.monotonic() - began


def resident() -> float:
    """Memory of this process [MB]."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() / 2**20


def memory(folder: Path) -> Iterator[str]:
    """Growth of the driver over many records, while MLflow is down and everything waits to be logged."""
    sizes: list[float] = []
    mirror = Mirroring("http://127.0.0.1:9", "memory", None, lambda trouble: None)

    def seen(path: Path) -> None:
        mirror.add([path])
        sizes.append(resident())

    cpu = time.process_time()
    wall = dummies(folder / "memory", DUMMIES, 8, 0.0, seen)
    cpu = time.process_time() - cpu
    mirror.stop()
    yield (
        f"The driver's memory grows by {max(sizes) - sizes[49]:.0f} MB from its 50th to its {DUMMIES}th record, with "
        f"an MLflow server that is down. A record costs it {1000 * cpu / DUMMIES:.0f} ms of processor time; with "
        f"workers that are always done it writes {DUMMIES / wall:.0f} a second."
    )


def logged(folder: Path, uri: str | None, runs: int = TRACKED) -> tuple[float, float, float]:
    """Seconds until the last of some dummy runs is recorded, from then to the end, processor time of the logging."""
    cpu = ended()
    mirror = Mirroring(uri, "study", "study", print) if uri else None
    recorded = dummies(folder, runs, 2, SECONDS, lambda path: mirror.add([path]) if mirror else None)
    last = time.monotonic()
    if mirror:
        assert mirror.finish() == 0
    return recorded, time.monotonic() - last, ended() - cpu


@contextmanager
def slow(address: str) -> Iterator[str]:
    """Address of the server at ``address`` that takes its time."""

    class Handler(BaseHTTPRequestHandler):
        def forward(self) -> None:
            body = self.rfile.read(int(self.headers.get("Content-Length") or 0))
            time.sleep(ANSWER)
            asked = HTTPConnection(urlsplit(address).netloc)
            asked.request(self.command, self.path, body, {**self.headers, "Host": urlsplit(address).netloc})
            answer = asked.getresponse()
            content = answer.read()
            self.send_response(answer.status)
            self.send_header("Content-Type", answer.getheader("Content-Type", ""))
            self.send_header("Content-Length", str(len(content)))
            self.end_headers()
            self.wfile.write(content)

        do_GET = do_POST = do_PUT = do_PATCH = forward

        def log_message(self, *args: Any) -> None:
            pass

    proxy = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    Thread(target=proxy.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{proxy.server_port}"
    proxy.shutdown()


def tracking(folder: Path) -> Iterator[str]:
    """What logging in MLflow adds to the time of a study, and the processor time that it takes from the workers."""
    from bench.tracking import track  # not above: workers import this file
    from bench.tracking.ui import server

    without, _, _ = logged(folder / "plain", None)

    def cost(name: str, uri: str, what: str) -> str:
        _, _, start = logged(folder / f"{name} start", uri, 0)
        recorded, left, cpu = logged(folder / name, uri)
        each = (cpu - start) / TRACKED
        return (
            f"{TRACKED} runs of {SECONDS:.0f} s, two at a time, logged {what}: {1000 * each:.0f} ms of processor time "
            f"a run, {each / SECONDS:.1%} of its own, in a process beside that takes {start:.1f} s to start; the last "
            f"record is there {recorded / without - 1:+.1%} later than without, all is logged {left:.1f} s after it."
        )

    database = track.default_uri(folder / "sqlite")
    track.prepare(database)
    yield cost("in sqlite", database, "in sqlite")
    (folder / "server").mkdir()
    with server(track.default_uri(folder / "server")) as base, slow(base) as address:
        yield cost("slow", address, f"with a server that answers in {1000 * ANSWER:.0f} ms")


def saturation(folder: Path) -> Iterator[str]:
    """Throughput of one driver with more and more workers."""
    lengths, crews, most = (10.0, 2.0, 0.5), (8, 16, 32, 64), 0.0
    yield "| workers | " + " | ".join(f"runs of {s:g} s" for s in lengths) + " |"
    yield "| --- " * (1 + len(lengths)) + "|"
    for workers in crews:
        cells = []
        for seconds in lengths:
            rounds = max(2, round(10 / seconds))
            rate = rounds * workers / dummies(folder / f"{workers}-{seconds}", rounds * workers, workers, seconds)
            cells.append(f"{rate:.1f} ({rate * seconds / workers:.0%})")
            most = max(most, rate)
        yield f"| {workers} | " + " | ".join(cells) + " |"
    yield ""
    yield (
        f"It saturates at about {most:.0f} runs a second: {crews[-1]} workers keep it busy with runs of "
        f"{crews[-1] / most:.1f} s."
    )


def main() -> None:
    """Measure, print and write."""
    text = ["# What a study costs beside training", ""]
    text += ["`python tests/scaling.py --write results/published/scaling.md`", ""]
    with tempfile.TemporaryDirectory() as name:
        for measure in (memory, overhead, tracking):
            for line in measure(Path(name)):
                text.append(f"- {line}")
                print(line, flush=True)
        text += ["", "Dummy runs a second that one driver gets done, and the share of the time that workers work:", ""]
        for line in saturation(Path(name)):
            text.append(line)
            print(line, flush=True)
    if "--write" in sys.argv:
        target = Path(sys.argv[sys.argv.index("--write") + 1])
        target.write_text("\n".join(text) + "\n", encoding="utf-8")
        entered(target)


if __name__ == "__main__":
    main()
