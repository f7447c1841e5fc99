"""`bench diagnose FLEET`: many vehicles, one after the other or side by side; what is finished is kept."""

import shlex
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click
from rich.console import Console
from rich.markup import escape

from bench.cli import options
from bench.cli.execution_options import Execution, portable
from bench.cli.names import check_system
from bench.cli.progress import announcer, clock, meter
from bench.experiment.datasets import registered
from registry.core import EFFECTS
from registry.errors import BenchError

if TYPE_CHECKING:
    from bench.fleet.fleet import Plan
    from bench.fleet.members import Member, Members
    from bench.fleet.options import Options
    from bench.fleet.stored import Stored


def fleet_of(
    source: str, vehicles: Sequence[str], execution: Execution, exclude: Sequence[str], each_recording: bool
) -> "Members | None":
    """The vehicles of a folder of several, or its recordings one by one; None: it is to be taken as a whole.

    Raises:
        BenchError: an option is for one vehicle where there are several, or the other way round.
    """
    if Path(source).is_dir() and not registered(source):
        from bench.fleet import members

        if each_recording:
            if vehicles:
                raise BenchError("--vehicle is for a fleet; of recordings, --exclude leaves out some.")
            return members.recordings(source, tuple(exclude))
        if members.is_fleet(source):
            if exclude:
                raise BenchError("--exclude names a recording of one data set, not of a fleet: take its file away.")
            return members.members(source, tuple(vehicles))
    if each_recording:
        raise BenchError(f"--each-recording is for a folder with a dataset.toml, which {source} is not.")
    if vehicles or execution.workers or execution.cluster:
        raise BenchError(f"{source} is no fleet: --vehicle, --workers and --cluster are for several vehicles.")
    return None


def fleet_options(
    system: str | None,
    model_file: Path | None,
    horizon: float | None,
    catalogue: Sequence[str],
    without: Sequence[str],
    ignore: Sequence[str],
) -> "Options":
    """The options of the command, as every vehicle gets them.

    Raises:
        BenchError: a physics model, effect or file that does not exist.
    """
    from bench.diagnose.result import check_kinds
    from bench.fleet.options import Options

    check_system(system)
    for name in (*catalogue, *without):
        EFFECTS.check(name)
    check_kinds(ignore)
    return Options(system, str(model_file or ""), tuple(catalogue), tuple(without), horizon, tuple(ignore))


def diagnose_fleet(
    source: str, fleet: "Members", chosen: "Options", folder: Path, to_json: Path | None, execution: Execution
) -> None:
    """Diagnose what is not kept yet, write the fleet's page, print the summary.

    Raises:
        BenchError: vehicles are left without an answer (said at the end), the folder cannot be written, or another
            driver is at it.
    """
    from bench.cli.job import mirroring
    from bench.diagnose.result import write_text
    from bench.execution import lock
    from bench.fleet import stored, summary
    from bench.fleet.fleet import PAGE, VALUES, conclude, plan

    out = options.console()
    with lock.held(folder, f"the fleet {source}"), mirroring(execution, f"fleet: {fleet.name}", None) as mirror:
        stored.tidy(folder)
        with announcer(out) as tick:
            todo = plan(fleet, chosen, folder, lambda m: tick(f"look at {m.id}"))
        for note in fleet.notes:
            click.echo(f"note: {note}", err=True)
        ready = list(todo.done.values())
        many = f"{len(fleet.members)} {fleet.kind}s, {len(ready)} already diagnosed, {len(todo.todo)} to do."
        out.print(f"[bold]{escape(fleet.name)}[/]: {many}")
        _carry_out(out, todo, execution, lambda answer: mirror.vehicles([answer.folder]) if mirror else None)
        command = shlex.join(["bench", *portable(sys.argv[1:])])
        found = conclude(todo, command)
        if to_json is not None:
            write_text(to_json, found.json_text())
        summary.print_summary(found, out)
        out.print(
            f"\nWrote {folder / PAGE}, {folder / VALUES} and a folder a {fleet.kind} beside them",
            markup=False,
            soft_wrap=True,
        )
        if mirror:
            mirror.vehicles(answer.folder for answer in ready)
            _print_mirrored(mirror.finish(), fleet.name)
    if todo.problems:
        name, sentence = next(iter(todo.problems.items()))
        raise BenchError(
            f"{len(todo.problems)} of {len(fleet.members)} {fleet.kind}s could not be diagnosed, such as {name}: "
            f"{sentence}"
        )


def _carry_out(out: Console, todo: "Plan", execution: Execution, log: "Callable[[Stored], None]") -> None:
    from bench.fleet.fleet import execute

    if not todo.todo:
        return
    left, workers = len(todo.todo), execution.processes
    with meter(out, sum(todo.sizes.values()) or 1.0, left, f"{todo.fleet.kind}s") as progress:

        def finished(member: "Member", answer: "Stored | None") -> None:
            progress.done += todo.sizes[member.id]
            progress.record()
            if answer is not None:
                log(answer)

        execute(todo, workers, execution.cluster, lambda m: progress.start(m.id), finished)
    by = f"on {execution.cluster}" if execution.cluster else f"with {min(workers, left)} process(es)"
    out.print(f"{left} {todo.fleet.kind}s in {clock(time.monotonic() - progress.started)} {escape(by)}.")


def _print_mirrored(missing: int, name: str) -> None:
    if missing:
        click.echo(f"{missing} vehicles are not in MLflow yet: the same command logs them.")
    else:
        click.echo(f"MLflow: experiment {f'fleet: {name}'!r}, one run a vehicle; `bench ui` shows them.")
