"""A function of several items, done by copies of this process side by side."""

import multiprocessing
import os
import pickle
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any, TypeVar

import torch

from bench.execution.executor import serve_parent

T = TypeVar("T")
R = TypeVar("R")

MOST_PROCESSES = 4
"""At most so many: each needs memory of its own."""
PATIENCE_S = 60.0
"""How long a copy may still take when nothing is left to do here, and four times what that took."""
_PLACE = 4
"""Bytes of a place in a list."""


def side_by_side(function: Callable[[T], R], items: Sequence[T]) -> list[R]:
    """``function`` of each item, in their order.

    Copies of this process (`os.fork`) share the work where there are processors for them. Each takes the next item that
    nobody has, so that the longest should come first. What a copy changes is lost, and what it cannot tell, since it
    failed or was killed, is done here. ``function`` must not ask for a lock that another thread may hold, such as that
    of a progress bar: the calling thread alone is copied. Workers of a pool, which have all processors between them, do
    it alone, and so does a process that cannot well be copied, as on macOS.
    """
    count = min(len(items), _processors())
    if count < 2:
        return [function(x) for x in items]
    context = multiprocessing.get_context("fork")
    left, full = os.pipe()
    os.write(full, b"".join(i.to_bytes(_PLACE, "little") for i in range(len(items))))
    os.close(full)
    told: dict[int, R] = {}
    copies = []
    try:
        for _ in range(count - 1):
            ours, theirs = context.Pipe(duplex=False)
            copy = context.Process(target=_copied, args=(theirs, function, items, left), daemon=True)
            copy.start()
            theirs.close()
            copies.append((copy, ours))
        begun = time.monotonic()
        told |= _done(function, items, left)
        patience = PATIENCE_S + 4 * (time.monotonic() - begun)
        for _, ours in copies:
            with suppress(EOFError, OSError):
                if not ours.poll(patience):
                    continue  # what it waits for never comes
                told |= pickle.loads(ours.recv_bytes())  # noqa: S301 — from a copy of this process
    finally:
        os.close(left)
        for copy, ours in copies:
            ours.close()
            copy.kill()
            copy.join()
    return [told[i] if i in told else function(x) for i, x in enumerate(items)]


def both(first: Callable[[], T], second: Callable[[], R]) -> tuple[T, R]:
    """What two functions return; see `side_by_side`."""
    told: list[Any] = side_by_side(lambda function: function(), [first, second])
    return told[0], told[1]


def _done(function: Callable[[T], R], items: Sequence[T], left: int) -> dict[int, R]:
    """Results, by place, of the items whose places are ``left`` in a pipe."""
    return {place: function(items[place]) for place in iter(lambda: _next(left), None)}


def _next(left: int) -> int | None:
    """A place that nobody has; None: all are taken."""
    place = os.read(left, _PLACE)
    return int.from_bytes(place, "little") if place else None


def _copied(to: Connection, function: Callable[[T], R], items: Sequence[T], left: int) -> None:
    """What a copy does; where it fails it says nothing, and the process that was copied finds the reason."""
    serve_parent()
    torch.set_num_threads(1)  # other threads were not copied
    sys.stdout = sys.stderr = nowhere = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115 — until the copy ends
    for stream in (1, 2):
        os.dup2(nowhere.fileno(), stream)
    try:
        to.send_bytes(pickle.dumps(_done(function, items, left)))
    except BaseException:
        return


def _processors() -> int:
    """How many processes may work side by side."""
    if sys.platform != "linux" or multiprocessing.parent_process() is not None:
        return 1
    return min(MOST_PROCESSES, len(os.sched_getaffinity(0)))
