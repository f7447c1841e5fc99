"""`bench settle` on its way: the plan, seeds added one by one, and what they settled."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from bench.claims.estimate import OPEN, number
from bench.claims.judge import Row
from bench.cli.execution_options import Execution
from bench.cli.job import Job, carry_out
from bench.cli.progress import clock
from bench.execution import engine, estimate
from bench.execution.engine import Plan
from bench.settle.sources import Run, Scope, Source, added_runs, group, published_runs, seedless, sources, unchanged
from registry.errors import BenchError


@dataclass
class Step:
    """A source of evidence, what it costs to add to it, and what was added."""

    source: Source
    initial: Source
    """As it was at the beginning."""
    seconds: float = 0.0
    """That one more seed of all that its claims are about is expected to take."""
    stopped: str = ""
    """Why nothing is added, or no more: a clause."""
    spent: float = 0.0
    trainings: int = 0
    rows: list[Row] = field(default_factory=list)
    """The verdicts on all its claims, as they are since seeds were added."""

    @property
    def settled(self) -> list[Row]:
        """What was open and is not any more."""
        was, still = ({r.claim.id for r in s.rows} for s in (self.initial, self.source))
        return [r for r in self.rows if r.claim.id in was - still]

    def reachable(self, max_seeds: int) -> list[Row]:
        """The claims that are expected to be settled by so many seeds."""
        return [] if self.stopped else self.source.within(max_seeds)

    def left(self, max_seeds: int) -> float:
        """Seconds until they are."""
        return self.seconds * max((r.needed - self.source.seeds for r in self.reachable(max_seeds)), default=0)


def plan(out: Console, scope: Scope, execution: Execution) -> list[Step]:
    """Every source with open claims, what is soonest settled first; a few updates of every model are timed."""
    steps = []
    with out.status("timing a few updates of every kind of model"):
        for source in sources(scope.rows()):
            step = Step(source, source)
            if source.within(scope.max_seeds):
                try:
                    asked = group(source, source.seeds + 1, published_runs(source, scope.published))
                    step.seconds = _expected(engine.plan(asked.configs, execution.runs), execution)
                except BenchError as error:
                    step.stopped = str(error).rstrip(".")
            steps.append(step)
    return sorted(steps, key=lambda s: (not s.reachable(scope.max_seeds), s.left(scope.max_seeds)))


def _expected(todo: Plan, execution: Execution) -> float:
    """Seconds of all processes together."""
    return sum(estimate.seconds(todo.tasks)) / min(execution.processes, max(1, len(todo.tasks)))


def show_plan(out: Console, steps: Sequence[Step], scope: Scope, execution: Execution) -> None:
    """A row an open claim: where, how many seeds there are, what would settle it, how long that takes."""
    table = Table(box=None, header_style="bold", pad_edge=False)
    for name, justify in (("claim", "left"), ("study and data", "left"), ("seeds", "right")):
        table.add_column(name, justify=justify, no_wrap=name == "claim")  # type: ignore[arg-type]
    table.add_column("to settle it", ratio=1)
    table.add_column("time", justify="right")
    for step in steps:
        for row in step.source.rows:
            what = row.outlook + (f"; beyond --max-seeds {scope.max_seeds}" if row.needed > scope.max_seeds else "")
            cost = clock(step.seconds * (row.needed - row.seeds)) if row in step.reachable(scope.max_seeds) else ""
            text = escape(step.stopped or what)
            table.add_row(row.claim.id, escape(step.source.name), str(row.seeds), text, cost)
    out.print(table)
    reachable = sum(len(s.reachable(scope.max_seeds)) for s in steps)
    count = sum(len(s.source.rows) for s in steps)
    total = clock(sum(s.left(scope.max_seeds) for s in steps))
    out.print(
        f"\n{count} open claim{'s' if count != 1 else ''}; more seeds are expected to settle {reachable} of them"
        + (f", in about {total} with {execution.processes} process(es)." if reachable else "."),
        highlight=False,
    )
    if reachable:
        out.print(
            "Forecasts of seeds are about as often too low as too high; reading data and tests come on top. Published "
            "seeds count as they are where the baselines come out as published.",
            style="dim",
            highlight=False,
        )


def settle(out: Console, steps: Sequence[Step], scope: Scope, execution: Execution, budget: float) -> None:
    """Add seeds, one more of every configuration that open claims are about at a time, and judge again after each.

    Args:
        out: where it is said.
        steps: from `plan`; they say afterwards what was added.
        scope: what is to be settled.
        execution: where results go, and what carries the work out.
        budget: seconds; a group of trainings that is not expected to end within it is not begun.

    Raises:
        BenchError: the budget is too small for anything, or what `carry_out` raises.
    """
    deadline = time.monotonic() + budget
    for step in steps:
        if step.reachable(scope.max_seeds):
            _settle(out, step, scope, execution, deadline)
    waiting = [s for s in steps if s.reachable(scope.max_seeds)]
    if waiting and not any(s.rows for s in steps):
        raise BenchError(
            f"One more seed of {waiting[0].source.name} takes about {clock(waiting[0].seconds)}, and the budget is "
            f"{clock(budget)}: give a longer --budget."
        )


def _settle(out: Console, step: Step, scope: Scope, execution: Execution, deadline: float) -> None:
    """Add seeds one by one, until the claims of a source are settled, no more are expected to be, or time is over."""
    there = _reusable_runs(out, step, scope, execution)
    while step.reachable(scope.max_seeds):
        started, seeds = time.monotonic(), step.source.seeds + 1
        asked = group(step.source, seeds, there, added_runs(step.source, execution.results))
        todo = engine.plan(asked.configs, execution.runs)
        step.seconds = _expected(todo, execution)
        if started + step.seconds > deadline:
            return
        left = clock(deadline - started)
        out.print(
            f"\nSeed {seeds} of [bold]{escape(step.source.name)}[/]: about {clock(step.seconds)}; {left} of the budget "
            "are left.",
            highlight=False,
        )
        carry_out(out, Job(asked, step.source.command(asked)), todo, execution, tables=False)
        step.trainings += sum(len(t.configs) for t in todo.tasks)
        step.spent += time.monotonic() - started
        open_before = {r.claim.id for r in step.source.rows}
        _judge_again(step, scope)
        for row in step.rows:
            if row.claim.id in open_before or row.judgement.verdict == OPEN:
                out.print(f"  {_verdict_line(row)}", highlight=False)


def _reusable_runs(out: Console, step: Step, scope: Scope, execution: Execution) -> dict[Run, object]:
    """The published runs, if baselines made here have their errors; else none, and every seed is trained."""
    published = published_runs(step.source, scope.published)
    if not published:
        return {}
    asked = seedless(group(step.source, 1, published))
    made = engine.execute(engine.plan(asked.configs, execution.runs), execution.runs)
    if unchanged(made, published):
        return dict(published)
    out.print(
        f"The baselines of {escape(step.source.name)} do not come out as published: its data are read otherwise now. "
        "All seeds are trained here.",
        highlight=False,
    )
    return {}


def _judge_again(step: Step, scope: Scope) -> None:
    """Judge all claims of the source again."""
    old = step.source
    where = (old.study, old.dataset, old.preset)
    step.rows = [r for r in scope.rows() if (r.claim.study, r.dataset, r.preset) == where]
    seeds = {r.claim.id: r.seeds for r in step.rows}
    settled = replace(old, seeds=min(seeds[r.claim.id] for r in old.rows), rows=())
    step.source = next(iter(sources(step.rows)), settled)


def _verdict_line(row: Row) -> str:
    """A verdict, and what it takes if it is none."""
    j = row.judgement
    found = f"{number(j.value)} ({number(j.low)} to {number(j.high)})"
    return f"{row.claim.id}: {j.label}, {found}" + (f"; to settle it: {row.outlook}" if row.outlook else "")


def show_result(out: Console, steps: Sequence[Step], scope: Scope) -> None:
    """What was added, what that settled, what it cost; then every claim that was settled."""
    touched = [s for s in steps if s.rows]
    table = Table(box=None, header_style="bold", pad_edge=False)
    for name in ("study and data", "seeds", "trainings", "time", "settled", "still open"):
        table.add_column(name, justify="left" if name == "study and data" else "right")
    for s in touched:
        was = {r.claim.id for r in s.initial.rows}
        grown = f"{s.initial.seeds} → {max(r.seeds for r in s.rows if r.claim.id in was)}"
        counts = (s.trainings, clock(s.spent), len(s.settled), len(s.source.rows))
        table.add_row(escape(s.source.name), grown, *map(str, counts))
    out.print()
    out.print(table)
    for s in touched:
        for row in s.settled:
            out.print(f"{_verdict_line(row)} on {row.dataset}", highlight=False)
    waiting = [s.source.name for s in steps if s.reachable(scope.max_seeds)]
    if waiting:
        out.print(f"The budget is used up before {', '.join(waiting)}: the same command goes on.", highlight=False)
    out.print("`bench check` counts what was added.", style="dim", highlight=False)
