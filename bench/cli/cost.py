"""What `bench run --dry-run` says: how many runs, and how long they would take here."""

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from bench.cli.execution_options import Execution
from bench.cli.job import Job
from bench.cli.progress import clock
from bench.execution.engine import Plan
from bench.execution.estimate import seconds


def estimate(out: Console, jobs: list[tuple[Job, Plan]], execution: Execution) -> None:
    """Print a row a study, or a row a kind of run where there is one study; nothing is trained to the end."""
    workers = execution.processes
    table = Table(title="what it would cost: updates timed on this machine", title_justify="left")
    table.add_column("configuration" if len(jobs) == 1 else "study", max_width=48)
    for name in ("runs", "recorded", "updates", "time on one core"):
        table.add_column(name, justify="right")
    total, seen = 0.0, set[str]()
    with out.status("timing a few updates of every kind of model"):
        for job, todo in jobs:
            tasks = [
                t for t in todo.tasks if not seen & set(t.keys)
            ]  # what an earlier study has made is not made again
            seen |= {k for t in tasks for k in t.keys}
            costs = seconds(tasks)
            total += sum(costs)
            if len(jobs) == 1:
                for task, cost in zip(tasks, costs, strict=True):
                    table.add_row(escape(task.name), str(len(task.keys)), "0", str(task.updates), clock(cost))
                if todo.done:
                    table.add_row("recorded already", "", str(len(todo.done)), "", "")
            else:
                runs = sum(len(t.keys) for t in tasks)
                updates = sum(t.updates * len(t.keys) for t in tasks)
                shared = len(todo.keys) - runs
                table.add_row(escape(job.title), str(runs), str(shared), str(updates), clock(sum(costs)))
    out.print(table)
    out.print(
        f"About {clock(total)} of one core, {clock(total / workers)} with {workers} process(es); early stopping may "
        "end runs sooner, reading data and tests come on top. “recorded”: runs that are there or that an earlier study "
        "makes."
    )
