"""A diagnosis of every vehicle of a fleet, by one process, several or a cluster, and what they say together."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bench.diagnose.result import write_text
from bench.execution import lock
from bench.execution.executor import run_jobs
from bench.fleet import stored
from bench.fleet.findings import drifts, quantities
from bench.fleet.members import Member, Members, members, recordings
from bench.fleet.options import Options, environment, key_of
from bench.fleet.read_answers import answer_of, failed
from bench.fleet.result import FleetDiagnosis
from bench.fleet.stored import Stored
from bench.fleet.work import Diagnose, Outcome, diagnose_member, work
from registry.core import EFFECTS
from registry.errors import BenchError

PAGE, VALUES = "fleet.html", "fleet.json"


@dataclass
class Plan:
    """What there is to do."""

    fleet: Members
    options: Options
    out: Path
    keys: dict[str, str] = field(default_factory=dict)
    """Of the answers, by the member's id."""
    done: dict[str, Stored] = field(default_factory=dict)
    """Answers that are kept and still hold, by id."""
    todo: list[Member] = field(default_factory=list)
    problems: dict[str, str] = field(default_factory=dict)
    """By id, why a vehicle cannot be diagnosed."""
    sizes: dict[str, int] = field(default_factory=dict)
    """Bytes of the data of what there is to do, by id."""

    def answers(self) -> FleetDiagnosis:
        """What is known so far."""
        found = tuple(
            answer_of(m, self.done[m.id]) if m.id in self.done else failed(m, self.problems.get(m.id, "not done yet"))
            for m in self.fleet.members
        )
        about = quantities(found), drifts(found), self.fleet.notes
        return FleetDiagnosis(self.fleet.name, found, *about, self.fleet.kind, folder=self.out)


def plan(fleet: Members, options: Options, out: Path, tick: Callable[[Member], None] = lambda member: None) -> Plan:
    """See which answers are kept: of the same data, options and code, undamaged.

    Args:
        fleet: from `members`.
        options: what is asked of each.
        out: folder of the answers.
        tick: called with every vehicle that is looked at.

    Raises:
        BenchError: a file that was asked for cannot be read.
    """
    made = Plan(fleet, options, out)
    options.content()
    for member in fleet.members:
        tick(member)
        try:
            if member.problem:
                raise BenchError(member.problem)
            key = made.keys[member.id] = key_of(member, options)
            found = stored.place(out, member)
            if found.key == key:
                made.done[member.id] = found
                continue
            made.sizes[member.id] = sum(f.stat().st_size for f in member.folder.files)
        except (BenchError, OSError) as error:
            made.problems[member.id] = str(error)
            continue
        made.todo.append(member)
    made.todo.sort(key=lambda m: -made.sizes[m.id])  # the longest first, so that no core waits at the end
    return made


def execute(
    todo: Plan,
    workers: int = 1,
    cluster: str | None = None,
    starting: Callable[[Member], None] = lambda member: None,
    finished: Callable[[Member, Stored | None], None] = lambda member, answer: None,
    do: Diagnose = diagnose_member,
) -> None:
    """Diagnose what is not kept, and keep each answer as it comes.

    Args:
        todo: from `plan`; it is brought up to date.
        workers: processes; 1 stays in this one.
        cluster: address of a Dask scheduler whose workers do it instead.
        starting: called with a vehicle when it is handed out.
        finished: called with it when its answer is kept; None: there is none.
        do: the diagnosis of one vehicle; must be importable by name.

    Raises:
        BenchError: the folder cannot be written, workers die again and again, or would give other results.
    """
    same = dict(environment())

    def jobs() -> Iterator[tuple[Member, Callable[..., Outcome], tuple[Any, ...]]]:
        for member in todo.todo:
            starting(member)
            yield member, work, (do, member, todo.options, todo.keys[member.id], same)

    processes = min(workers, len(todo.todo))
    with closing(run_jobs(jobs(), processes, lambda message: None, lambda m: m.id, cluster)) as done:
        for member, (sentence, files) in done:
            if sentence:
                todo.problems[member.id] = sentence
                finished(member, None)
                continue
            todo.done[member.id] = stored.write(todo.out, member, todo.keys[member.id], files)
            finished(member, todo.done[member.id])
    todo.todo.clear()


def conclude(done: Plan, command: str) -> FleetDiagnosis:
    """Write the page and ``fleet.json``.

    Args:
        done: after `execute`.
        command: what to type to repeat it.

    Raises:
        BenchError: they cannot be written.
    """
    from bench.fleet import page  # it brings what draws, which no diagnosis needs

    found = done.answers()
    write_text(done.out / VALUES, found.json_text())
    write_text(done.out / PAGE, page.render(found, command))
    return found


def fleet(
    source: str | Path,
    system: str | None = None,
    *,
    model: str | Path | None = None,
    vehicles: Sequence[str] = (),
    each_recording: bool = False,
    exclude: Sequence[str] = (),
    catalogue: Sequence[str] = (),
    horizon_s: float | None = None,
    ignore: Sequence[str] = (),
    out: str | Path | None = None,
    workers: int = 1,
    cluster: str | None = None,
) -> FleetDiagnosis:
    """Diagnose every vehicle of a fleet, and say which lack what, which differ and which drift.

    Vehicles whose answer is kept in ``out`` are not diagnosed again. MLflow is left alone.

    Args:
        source: a folder of folders with a dataset.toml each, or one whose dataset.toml says ``vehicle = {column = …}``.
        system: a registered physics model or "path/to/file.py:Class"; default: what the data name.
        model: a model.toml to start from; default: nominal constants without effects.
        vehicles: these only; none: all.
        each_recording: take every recording of a folder with a dataset.toml by itself, as if each were a vehicle.
        exclude: recordings that are left out then.
        catalogue: ids of the effects to choose from; none: all that are registered.
        horizon_s: longest horizon of the comparisons [s].
        ignore: kinds of data problems that are noted and do not stop the analysis.
        out: folder of the answers and the page; default: ``diagnosis`` in the fleet's folder.
        workers: processes; more than 1 wants the caller's module to be importable (``if __name__ == "__main__"``).
        cluster: address of a Dask scheduler whose workers do it instead.

    Returns:
        All answers; one that failed has the verdict "failed" and a sentence.

    Raises:
        BenchError: it is no fleet, an option is wrong, or the folder cannot be written.
    """
    for name in catalogue:
        EFFECTS.check(name)
    options = Options(system, str(model or ""), tuple(catalogue), horizon_s=horizon_s, ignore=tuple(ignore))
    if exclude and not each_recording:
        raise BenchError("exclude names recordings of one data set: it is for each_recording.")
    folder = Path(out) if out is not None else Path(source) / "diagnosis"
    with lock.held(folder, f"the fleet {source}"):
        stored.tidy(folder)
        found = recordings(str(source), tuple(exclude)) if each_recording else members(str(source), tuple(vehicles))
        todo = plan(found, options, folder)
        execute(todo, workers, cluster)
        return conclude(todo, f"bench.fleet({str(source)!r})")
