"""Options of every command that trains: where results go, in how many processes or on which cluster."""

import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import Any

from bench.cli import options
from registry.errors import BenchError


@dataclass(frozen=True)
class Execution:
    """Where results go, and what carries the work out."""

    results: Path
    tracking: str | None
    """MLflow address; None: the database in the results folder."""
    no_track: bool
    workers: int | None
    """Processes; None: one a core, as far as there is work for them."""
    cluster: str | None = None
    """Address of a Dask scheduler whose workers do it instead."""

    def __post_init__(self) -> None:
        if self.workers and self.cluster:
            raise BenchError(
                "--workers are processes on this machine, --cluster has workers of its own: give one of them."
            )

    @property
    def processes(self) -> int:
        """As asked, or one a core."""
        return self.workers or os.cpu_count() or 1

    @property
    def runs(self) -> Path:
        """Folder of the records."""
        return self.results / "runs"


def execution_options(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command these options, gathered in its argument ``execution``."""

    @wraps(command)
    def gathered(
        *args: Any,
        results: Path,
        tracking: str | None,
        no_track: bool,
        workers: int | None,
        cluster: str | None,
        **others: Any,
    ) -> None:
        command(*args, execution=Execution(results, tracking, no_track, workers, cluster), **others)

    for add in (options.no_track, options.tracking, options.results, options.cluster, options.workers):
        gathered = add(gathered)
    return gathered


def portable(arguments: list[str]) -> list[str]:
    """The command line without what belongs to this machine alone: where results go, how many processes."""
    kept, skip = [], False
    for argument in arguments:
        local = argument.partition("=")[0] in ("--results", "--tracking", "--workers", "--cluster")
        if not skip and not local and argument not in ("--no-track", "--resume"):
            kept.append(argument)
        skip = local and "=" not in argument
    return kept
