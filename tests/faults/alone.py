"""Functions in a process of their own, to be killed in.

They are forked from a server that has one thread: beside other threads (of a test that went before) a fork may wait for
ever for a lock that nobody holds.
"""

import multiprocessing
from collections.abc import Callable
from multiprocessing.process import BaseProcess
from multiprocessing.synchronize import Event

SECONDS = 120
"""What none of them takes."""

_context = multiprocessing.get_context("forkserver")
_context.set_forkserver_preload(
    ["bench.execution.engine", "bench.diagnose.report.output_folder", "bench.tracking.track"]
)


def started(action: Callable[..., object], *arguments: object) -> BaseProcess:
    """A process that has just begun to do it, with everything imported."""
    begun = _context.Event()
    process = _context.Process(target=_announced, args=(begun, action, arguments))
    process.start()
    assert begun.wait(SECONDS)
    return process


def _announced(begun: Event, action: Callable[..., object], arguments: tuple[object, ...]) -> None:
    begun.set()
    action(*arguments)


def exit_code(action: Callable[..., object], *arguments: object) -> int:
    """How a process that does it ends: −9 where it is killed."""
    process = started(action, *arguments)
    process.join(SECONDS)
    if process.exitcode is None:
        process.kill()
        raise AssertionError(f"{action.__name__} hangs")
    return process.exitcode
