"""Commands killed at random moments: nothing is lost, torn or left, and the same command again ends as if nothing was.

`--kills 200` hits them two hundred times, together with the study of `test_kills`.
"""

import os
import shutil
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from faults.test_cluster import free_port, started
from faults.test_foreign_code import spring
from faults.test_mlflow import statuses
from faults.warm import Warm, alive
from simulated_fleet import vehicle

from bench.diagnose.report.output_folder import MODEL, PAGE, VALUES
from bench.execution import lock
from bench.records import record
from bench.sweep import journal

pytestmark = pytest.mark.faults
SEED = 20
SPEC = "LSTM: 1x6 - MLP: 6x10"
SMALL = ["--dataset", "{data}", "--outputs", "speed", "-T", "6", "--set", "training.evaluate_every=5", "--no-track"]
SMALL += ["--set", "training.updates=20", "--results", "{place}"]
RUN = ["run", SPEC, "--seeds", "3", *SMALL]
SWEEP = ["sweep", SPEC, "--trials", "3", "--objective", "weights", "--search", "predictor.hidden=4:8", *SMALL]
SWEEP += ["--name", "s"]
FORMERLY = ["diagnose", "{data}", "--catalogue", "offset_force", "--no-track", "--out", "{place}"]
DIAGNOSE = [*FORMERLY[:3], "quadratic_drag", *FORMERLY[4:]]
FLEET = ["diagnose", "{fleet}", "--catalogue", "quadratic_drag", "--no-track", "--out", "{place}"]
EXPORT = ["export", "{study}", "-o", "{place}/s.zip", "--results", "{done}"]
UNALIKE = {"provenance.json", "report.html", lock.FILE, ".sync.lock", journal.JOURNAL, "mlflow.db"}
"""Files that hold times, or names by chance."""
QUICK = ("export", "import")
"""Commands that are killed in every run of the tests, once each."""
LATE = 0.02
"""Seconds after a first draft of a file, at most, for kills of what writes."""


@dataclass(frozen=True)
class Case:
    """A command to kill."""

    hit: str
    times: int
    """Of the two hundred, 50 of which are those of `test_kills`."""
    command: list[str]
    again: str = "what it had in hand"


CASES = (
    Case("a study, one process", 12, [*RUN, "--workers", "1"]),
    Case("a study, two workers", 6, [*RUN, "--workers", "2"]),
    Case("a study on a cluster", 6, [*RUN, "--cluster", "{cluster}"]),
    Case("a sweep, one process", 20, [*SWEEP, "--workers", "1"]),
    Case("a sweep, two workers", 4, [*SWEEP, "--workers", "2"]),
    Case("a diagnosis where there was another", 34, DIAGNOSE, "all of it"),
    Case("the diagnosis of a fleet, one process", 12, [*FLEET, "--workers", "1"]),
    Case("the diagnosis of a fleet, two workers", 4, [*FLEET, "--workers", "2"]),
    Case("the export of a study", 22, EXPORT, "all of it"),
    Case("the import of a study", 20, ["import", "{done}/s.zip", "--results", "{place}"], "all of it"),
    Case("`bench sync`", 10, ["sync", "--results", "{place}"], "the run in its hand"),
)


class Site:
    """Where the commands work, and what they are about."""

    def __init__(self, folder: Path) -> None:
        self.place, self.done, self.former = folder / "place", folder / "done", folder / "former"
        self.names = {"place": self.place, "done": self.done, "data": folder / "data", "fleet": folder / "fleet"}
        self.names["cluster"] = f"tcp://127.0.0.1:{(port := free_port())}"
        scheduler = ("dask", "scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard")
        worker = ("dask", "worker", self.names["cluster"], "--nthreads", "1", "--no-nanny", "--no-dashboard")
        self.cluster = [(scheduler, "Scheduler at"), (worker, "Registered to")]
        (folder / "data").mkdir()
        spring(folder / "data")
        for i in range(3):
            vehicle(folder / "fleet" / f"cart_{i}", "quadratic_drag", i, recordings=2, seconds=4.0)
        self.warm = Warm(folder)
        self.warm.run(self.words([word.replace("{place}", "{done}") for word in RUN]))
        (study,) = (self.done / "studies").iterdir()
        self.names["study"] = study.name
        self.warm.run(self.words([word.replace("{place}", "{done}") for word in EXPORT]))
        self.warm.run(self.words(FORMERLY))
        self.place.rename(self.former)

    def words(self, command: list[str]) -> list[str]:
        """The command with its names filled in; a sweep that was begun is resumed."""
        resume = command[0] == "sweep" and (self.place / "sweeps" / "s" / journal.DEFINITION).is_file()
        return [word.format(**self.names) for word in command] + ["--resume"] * resume

    def prepare(self, command: list[str]) -> None:
        """As it was before the command was ever given."""
        shutil.rmtree(self.place, ignore_errors=True)
        if command[0] == "sync":
            shutil.copytree(self.done, self.place)
        elif command == DIAGNOSE:
            shutil.copytree(self.former, self.place)
        self.place.mkdir(exist_ok=True)

    def content(self) -> dict[str, bytes]:
        """What is there for good, by name, and is the same however often it is made."""
        files = {p.relative_to(self.place): p for p in self.place.rglob("*") if p.is_file()}
        return {
            name.as_posix(): path.read_bytes()
            for name, path in files.items()
            if not UNALIKE & set(name.parts) and name.parts[0] != "mlartifacts" and not hidden(name) and not held(name)
        }

    def left(self) -> list[Path]:
        """Drafts of files, here and where temporary files are, and who is said to hold a lock."""
        drafts = [p for p in self.place.rglob("*") if hidden(p.relative_to(self.place))]
        drafts += [p for p in self.place.rglob("*") if p.name.endswith(("-journal", "-wal", "-shm", ".rename"))]
        locked = [p for p in self.place.rglob("*") if held(p) or (p.name == lock.FILE and p.read_text())]
        return [*drafts, *locked, *self.warm.scratch.iterdir()]

    def made(self) -> dict[str, int]:
        """When what was finished was written, by name."""
        finished = [*self.place.glob("runs/*/record.json"), *self.place.glob("vehicles/*/answer.json")]
        return {str(p): p.stat().st_mtime_ns for p in finished if not hidden(p.relative_to(self.place))}

    def trials(self) -> list[tuple[dict[str, object], list[float] | None]]:
        """Those of the sweep that are finished."""
        folder = self.place / "sweeps" / "s"
        if not (folder / journal.JOURNAL).is_file() or not (folder / journal.JOURNAL).read_bytes().strip():
            return []
        with suppress(KeyError):  # no study in it yet
            return [(t.params, t.values) for t in journal.finished(journal.load(folder))]
        return []


def held(name: Path) -> bool:
    """Whether a file is Optuna's lock of a journal, which it removes, and the next driver where a kill has left it."""
    return name.name.startswith(f"{journal.JOURNAL}.lock")


def hidden(name: Path) -> bool:
    """Whether a path in the place is of a draft."""
    return any(part.startswith(".") and part not in UNALIKE for part in name.parts)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    made = Site(tmp_path_factory.mktemp("kills"))
    yield made
    made.warm.close()


def gone(session: int) -> None:
    """Wait for the end of all processes of a killed command."""
    deadline = time.monotonic() + 20
    while left := alive(session):
        assert time.monotonic() < deadline, left
        time.sleep(0.02)


def kill(site: Site, command: list[str], rng: np.random.Generator, takes: float) -> bool:
    """Start it and kill it, or one of its workers, at any moment or while it writes; False: it was quicker."""
    ended = False
    session = site.warm.start(site.words(command))
    if rng.random() < 0.5:
        time.sleep(rng.uniform(0, takes))
    else:
        while not ended and not any(hidden(p.relative_to(site.place)) for p in site.place.rglob(".*")):
            ended = not Path(f"/proc/{session}").exists()
            time.sleep(0.002)
        time.sleep(rng.uniform(0, LATE))
    workers = [process for process, words in alive(session).items() if "spawn_main" in words]
    one = int(rng.choice(workers)) if workers and rng.random() < 1 / 3 else session
    with suppress(ProcessLookupError):
        os.kill(one, signal.SIGKILL)
    code = site.warm.end()
    gone(session)
    assert code in (0, -signal.SIGKILL), site.warm.log.read_text(errors="replace")
    return code == -signal.SIGKILL or one != session


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.hit)
def test_a_command_killed_at_random_moments(
    case: Case, site: Site, request: pytest.FixtureRequest, tmp_path: Path, faults: Callable[..., None]
) -> None:
    asked = request.config.getoption("--kills")
    if not asked and case.command[0] not in QUICK:
        pytest.skip("hit by `tox -e cluster -- --kills 200`")
    times = round(case.times * asked / 200) if asked else 1
    rng = np.random.default_rng([SEED, CASES.index(case)])
    with ExitStack() as cluster:
        if "{cluster}" in case.command:
            for i, (command, says) in enumerate(site.cluster):
                cluster.enter_context(started(*command, says=says, log=tmp_path / str(i)))
        seconds = []
        for _ in range(2):  # the first one imports
            site.prepare(case.command)
            before = site.content()
            seconds.append(site.warm.run(site.words(case.command)))
        whole, trials, made = site.content(), site.trials(), len(site.made())
        assert site.left() == []
        hit = lost = tries = 0
        while hit < times:
            tries += 1
            assert tries < 10 * times + 10
            site.prepare(case.command)
            hit += kill(site, case.command, rng, seconds[1])
            lost += judge(site, case, (before, whole), (trials, made))
    faults(f"{case.hit}, at random moments (kill -9)", hit, lost, 0, case.again)


def judge(
    site: Site,
    case: Case,
    contents: tuple[dict[str, bytes], dict[str, bytes]],
    finished: tuple[list[tuple[dict[str, object], list[float] | None]], int],
) -> int:
    """Look at what a kill has left, repeat the command, look again; how much that was finished was made again."""
    before, whole = contents
    trials, made = finished
    torn = {n for n, now in site.content().items() if now not in (before.get(n), whole.get(n))}
    assert torn <= {"model.previous.toml"}
    of = {name: text for name, text in site.content().items() if name in (PAGE, VALUES, MODEL)}
    assert case.command != DIAGNOSE or of.items() <= before.items() or of.items() <= whole.items()
    for r in record.all_records(site.place / "runs"):
        assert record.verify(r) == []
    kept, known = site.made(), site.trials()
    assert all(trial in trials for trial in known)
    site.warm.run(site.words(case.command))
    now = site.made()
    assert site.content() == whole
    assert len(now) == made and site.trials() == trials
    assert site.left() == []
    if case.command[0] == "sync":
        assert statuses(site.place / "mlflow.db") == ["FINISHED"] * made
    return sum(now[name] != when for name, when in kept.items())
