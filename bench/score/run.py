"""Diagnose many cases in several processes; what is finished is kept, line by line."""

import functools
import hashlib
import json
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, suppress
from dataclasses import asdict, dataclass
from math import ceil
from pathlib import Path
from typing import Any

import torch

from bench.execution.executor import run_jobs
from bench.score.attempt import Answer, attempt, to_json
from bench.score.case import Case
from bench.score.chains import shares
from bench.score.judge import ERROR, FAILED
from bench.score.tie import distance
from bench.score.unknown import attempt as unknown
from bench.score.unknown.condition import UnknownCase
from registry.errors import BenchError

ROOT = Path(__file__).resolve().parents[2]
DIAGNOSIS, ALTERNATIVES = "diagnosis", "alternatives"
COST = {DIAGNOSIS: 1.0, ALTERNATIVES: 0.3}
"""Of one job, relative (for progress only)."""
COMPARED = ("single", "pair", "triple", "nothing", "gusts")
"""Conditions on which the alternatives are tried: they have no answer to the others."""
_PRESENTATION = ("page*.py", "story.py", "run.py", "judge.py", "table.py", "show.py")
"""Code that changes no answer."""


@dataclass(frozen=True)
class Job:
    """One case, and what is done with it."""

    case: Case
    kind: str

    @property
    def key(self) -> tuple[str, str]:
        """What an answer is filed under."""
        return self.case.id, self.kind


def sources(kind: str) -> list[Path]:
    """The files of the code that an answer depends on."""
    folders = (
        "bench/diagnose",
        "bench/score",
        "registry/dynamics",
        "registry/effects",
        "registry/physics",
        "registry/terms",
    )
    files = sorted(p for f in folders for p in (ROOT / f).rglob("*.py"))
    told = [p for p in files if not any(p.match(pattern) for pattern in _PRESENTATION)]
    return [p for p in told if kind == ALTERNATIVES or p.name != "alternatives.py"]


def digest(kind: str) -> str:
    """Of the code that an answer depends on."""
    code = hashlib.sha256()
    for path in sources(kind):
        code.update(path.relative_to(ROOT).as_posix().encode() + b"\0" + path.read_bytes())
    return code.hexdigest()[:16]


def jobs(cases: Sequence[Case], alternatives: bool) -> list[Job]:
    """All there is to do, mixed: whatever part is finished stands for the whole."""
    found = [Job(c, DIAGNOSIS) for c in cases]
    if alternatives:
        found += [Job(c, ALTERNATIVES) for c in cases if c.condition in COMPARED]
    return sorted(found, key=lambda job: _shuffled(job.case.id))


def part(cases: Sequence[Case], fraction: float) -> list[Case]:
    """The same ``fraction`` of every condition; a smaller one lies inside a larger."""
    by: dict[str, list[Case]] = {}
    for c in cases:
        by.setdefault(c.condition, []).append(c)
    kept = {c.id for of in by.values() for c in sorted(of, key=lambda c: _shuffled(c.id))[: ceil(len(of) * fraction)]}
    return [c for c in cases if c.id in kept]


def _shuffled(name: str) -> str:
    return hashlib.sha256(name.encode()).hexdigest()


class Store:
    """Finished answers: a line of JSON each, appended whole."""

    def __init__(self, results: Path) -> None:
        self.path = results / "discovery" / "answers.jsonl"
        self.codes = {kind: digest(kind) for kind in COST}

    def read(self) -> dict[tuple[str, str], dict[str, Any]]:
        """By (case id, kind) what was found by the code as it was when this object was made."""
        found = {}
        for line in self.path.read_bytes().splitlines() if self.path.exists() else ():
            try:
                one = json.loads(line)
                if self.codes.get(one["kind"]) == one["digest"]:
                    found[one["id"], one["kind"]] = one["found"]
            except (ValueError, KeyError, TypeError):
                continue  # a line that a power cut left half written
        return found

    def append(self, job: Job, found: dict[str, Any]) -> None:
        """Keep one answer.

        Raises:
            BenchError: the folder cannot be written.
        """
        line = json.dumps({"id": job.case.id, "kind": job.kind, "digest": self.codes[job.kind], "found": found}) + "\n"
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            handle = os.open(self.path, os.O_RDWR | os.O_APPEND | os.O_CREAT, 0o644)
            try:
                size = os.fstat(handle).st_size
                whole = size == 0 or os.pread(handle, 1, size - 1) == b"\n"
                os.write(handle, (line if whole else "\n" + line).encode())
                os.fsync(handle)
            finally:
                os.close(handle)
        except OSError as error:
            raise BenchError(f"{self.path} cannot be written: {error.strerror or error}.") from error


def work(job: Job, cache: Path) -> dict[str, Any]:
    """Do one job; a case that fails is an answer too."""
    try:
        if job.kind == ALTERNATIVES:
            from bench.score.alternatives import attempt_all

            return {name: asdict(said) for name, said in attempt_all(job.case, cache).items()}
        if isinstance(job.case, UnknownCase):
            return unknown.attempt(job.case, cache)
        said = to_json(attempt(job.case, cache))
        said["extra"] |= {"shares": shares(job.case, cache)}
        said["extra"] |= {"distance": distance(job.case, said["named"], said["rivals"], cache)}
        return said
    except Exception as error:
        if job.kind == ALTERNATIVES:
            return {FAILED: f"{type(error).__name__}: {error}"}
        said = to_json(failed(job.case, error))
        with suppress(Exception):  # its flights may be what failed
            said["extra"] |= {} if isinstance(job.case, UnknownCase) else {"shares": shares(job.case, cache)}
        return said


def failed(case: Case, error: Exception) -> Answer:
    """The answer of a case that raised."""
    truth = {k: dict(v) for k, v in case.effects.items()}
    about = (case.id, case.condition, case.vehicle, case.style, case.noise, truth)
    return Answer(*about, ERROR, {}, {}, (), {}, notes=(f"{type(error).__name__}: {error}",))


def run(
    todo: Sequence[Job],
    store: Store,
    cache: Path,
    workers: int = 1,
    starting: Callable[[Job], None] = lambda job: None,
    finished: Callable[[Job], None] = lambda job: None,
    do: Callable[[Job, Path], dict[str, Any]] = work,
) -> None:
    """Do the jobs that ``store`` does not hold yet.

    Args:
        todo: from `jobs`.
        store: where answers are kept.
        cache: folder of the flights.
        workers: processes, one thread each; 1 stays in this one.
        starting: called when a job is handed out.
        finished: called when its answer is kept.
        do: the work; must be importable by name.

    Raises:
        BenchError: the results cannot be written, workers die again and again, or code was changed while they started.
    """
    held = store.read()
    waiting = [job for job in todo if job.key not in held]

    def handed() -> Iterator[tuple[Job, Callable[..., tuple[str, dict[str, Any]]], tuple[Any, ...]]]:
        for job in waiting:
            starting(job)
            yield job, _in_worker, (do, job, cache)

    processes = min(workers, len(waiting))
    with closing(run_jobs(handed(), processes, lambda message: None, lambda job: job.case.id, ahead=1)) as done:
        for job, (code, found) in done:
            if code != store.codes[job.kind]:
                raise BenchError("The code was changed while the workers started: start again.")
            store.append(job, found)
            finished(job)


@functools.cache
def _loaded() -> dict[str, str]:
    """Digests of the code of this process, all of it loaded, so that what is changed later does not mix with it."""
    import bench.score.alternatives  # noqa: F401

    return {kind: digest(kind) for kind in COST}


def _in_worker(do: Callable[[Job, Path], dict[str, Any]], job: Job, folder: Path) -> tuple[str, dict[str, Any]]:
    torch.set_num_threads(1)
    return _loaded()[job.kind], do(job, folder)
