"""Progress of long work: a bar with the time left on a terminal, a line now and then elsewhere."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from rich.console import Console, RenderableType
from rich.markup import escape
from rich.progress import (
    BarColumn,
    Progress,
    ProgressColumn,
    SpinnerColumn,
    Task,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from bench.cli.stages import StageProgress, Stages

EVERY = 20.0
"""Seconds between two lines where there is no terminal."""


def clock(seconds: float) -> str:
    """Such as 0:07 or 1:02:03."""
    minutes, s = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{s:02}" if hours else f"{minutes}:{s:02}"


@dataclass
class Meter:
    """How much of the work is done."""

    total: float
    runs: int
    show: Callable[["Meter"], None]
    done: float = 0.0
    finished: int = 0
    current: str = ""
    started: float = field(default_factory=time.monotonic)

    def tick(self, cost: float) -> None:
        """A part of the work is done."""
        self.done = min(self.total, self.done + cost)  # a group that is handed out again is counted again
        self.show(self)

    def record(self) -> None:
        """One more run is recorded."""
        self.finished += 1
        self.show(self)

    def start(self, name: str) -> None:
        """A task begins."""
        self.current = name
        self.show(self)

    @property
    def left(self) -> float | None:
        """Seconds left at the pace so far; None before anything is done."""
        elapsed = time.monotonic() - self.started
        return elapsed * (self.total / self.done - 1) if self.done > 0 else None


@contextmanager
def meter(console: Console, total: float, runs: int, unit: str = "runs") -> Iterator[Meter]:
    """Show progress over work of size ``total`` that ends in ``runs`` new records, which are called ``unit``."""
    if not console.is_terminal:
        last = [0.0]

        def line(m: Meter) -> None:
            now = time.monotonic()
            if now - last[0] >= EVERY:
                last[0] = now
                left = "" if m.left is None else f", about {clock(m.left)} left"
                console.print(f"{m.finished}/{m.runs} {unit}, {m.done / m.total:.0%}{left}: {m.current}", markup=False)

        yield Meter(total, runs, line)
        return
    with Progress(
        BarColumn(30),
        TextColumn("{task.percentage:>3.0f} %  {task.fields[runs]}"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        TextColumn("[dim]{task.description}"),
        console=console,
        transient=True,
    ) as bar:
        task: TaskID = bar.add_task("", total=total, runs="")
        yield Meter(
            total,
            runs,
            lambda m: bar.update(
                task, completed=m.done, description=escape(m.current), runs=f"{m.finished}/{m.runs} {unit}"
            ),
        )


@contextmanager
def announcer(console: Console, stages: Stages | None = None) -> Iterator[Callable[[str], None]]:
    """A function that says what is being done.

    On a terminal beside a bar of the share that is done and the time left, where ``stages`` tell them; a line now and
    then elsewhere.
    """
    started = time.monotonic()
    if not console.is_terminal:
        last = [started]

        def line(what: str) -> None:
            now = time.monotonic()
            if now - last[0] >= EVERY:
                last[0] = now
                console.print(f"{clock(now - started)}: {what}", highlight=False, markup=False)

        yield line
        return
    progress = StageProgress(stages or {})
    done, left = _DrawnColumn(lambda: _bar(progress.share)), _DrawnColumn(lambda: _time_left(progress.left))
    columns = SpinnerColumn(), done, TimeElapsedColumn(), left, TextColumn("[dim]{task.description}")
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("reading", total=None)

        def say(what: str) -> None:
            progress.begin(what)
            bar.update(task, description=escape(what))

        yield say


class _DrawnColumn(ProgressColumn):
    """What a function gives each time that the line is drawn."""

    def __init__(self, draw: Callable[[], RenderableType]) -> None:
        super().__init__()
        self.draw = draw

    def render(self, task: Task) -> RenderableType:
        return self.draw()


def _bar(share: float | None) -> RenderableType:
    """A bar of the share that is done; nothing where it is not known."""
    if share is None:
        return Text()
    bar = Table.grid(padding=(0, 1))
    bar.add_row(ProgressBar(1.0, share, 30), f"{share:>3.0%}")
    return bar


def _time_left(seconds: float | None) -> RenderableType:
    return Text("" if seconds is None else f"about {clock(seconds)} left")
