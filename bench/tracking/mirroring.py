"""MLflow beside a study: a process of its own logs what is finished, so that training never waits for a server.

What a server that is slow or down has not taken when the study ends, `bench sync` logs later.
"""

import multiprocessing
import os
import queue
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bench.execution.executor import interrupts_withheld, serve_parent
from bench.experiment.config import RunConfig

if TYPE_CHECKING:
    from optuna.trial import FrozenTrial

RETRY = 15.0
"""Seconds between two attempts at a server that fails."""
QUIET = 30.0
"""Seconds without a run logged after which a finished study waits no longer."""
MAX_SILENCE = 120.0
"""Seconds that a finished study waits at most, or a tenth of what it has taken."""


class Mirroring:
    """The driver's end. Nothing but `finish` takes longer than putting a name into a queue."""

    def __init__(self, uri: str, experiment: str, study: str | None, say: Callable[[str], None]) -> None:
        """Start the process; ``say`` is called with a sentence when the server first fails."""
        self.say = say
        self.asked, self.done, self.last_sign = 0, 0, time.monotonic()
        self.started, self.reported, self.ready = time.monotonic(), False, False
        context = multiprocessing.get_context("spawn")
        self.inbox, self.outbox = context.Queue(), context.Queue()
        self.process = context.Process(
            target=_serve, args=(self.inbox, self.outbox, uri, experiment, study), daemon=True
        )
        with interrupts_withheld():
            self.process.start()

    def add(self, folders: Iterable[Path]) -> None:
        """Log these records when there is time."""
        self._put(("record", str(folder)) for folder in folders)

    def trials(self, configs: Sequence[RunConfig], finished: "Iterable[FrozenTrial]") -> None:
        """Log these trials of a sweep when there is time."""
        self._put(("trial", (tuple(configs), t)) for t in finished)

    def vehicles(self, folders: Iterable[Path]) -> None:
        """Log these answers of a fleet when there is time."""
        self._put(("vehicle", str(folder)) for folder in folders)

    def _put(self, jobs: Iterable[tuple[str, Any]]) -> None:
        for job in jobs:
            self.asked += 1
            self.inbox.put(job)
        self._listen(0.0)

    def attach(self, files: Iterable[Path]) -> None:
        """Log the figures and the report of the study."""
        self.inbox.put(("files", [str(f) for f in files]))

    def finish(self) -> int:
        """Wait for what is left, within bounds, and end the process.

        Returns:
            How many records and trials are not in MLflow yet.
        """
        self.inbox.put(None)
        self.last_sign = time.monotonic()
        deadline = self.last_sign + max(MAX_SILENCE, 0.1 * (self.last_sign - self.started))
        while self.process.is_alive() and time.monotonic() < deadline:
            self._listen(0.2)
            if self.ready and time.monotonic() > self.last_sign + QUIET:
                break
        self._listen(0.0)
        self.stop()
        return self.asked - self.done

    def stop(self) -> None:
        """End the process at once; a run that is half logged is completed when it is logged again."""
        if self.process.is_alive():
            self.process.kill()
        self.process.join()
        self.inbox.close()
        if self.process.exitcode == 0:
            self.inbox.join_thread()  # all was read; at the interpreter's end this thread would leave semaphores behind
        else:
            self.inbox.cancel_join_thread()  # nobody reads the rest

    def _listen(self, seconds: float) -> None:
        while True:
            try:
                logged, trouble = self.outbox.get(timeout=seconds) if seconds else self.outbox.get_nowait()
            except queue.Empty:
                return
            self.ready = True
            self.done += logged
            self.last_sign = time.monotonic()
            if trouble and not self.reported:
                self.reported = True
                self.say(trouble)


def _serve(inbox: Any, outbox: Any, uri: str, experiment: str, study: str | None) -> None:
    """The process: log what comes in, again and again where a server fails, until the driver has nothing more."""
    serve_parent()
    os.nice(5)  # where there are fewer cores than processes, training goes first
    from bench.tracking import track
    from registry.errors import BenchError

    outbox.put((0, ""))
    waiting: deque[tuple[str, Any]] = deque()
    known: set[str] | None = None
    more = True
    while more or waiting:
        try:
            if known is None:  # a wrong address is said at once
                known = track.whole(uri, experiment, study)
            if more:
                more = _collect(inbox, waiting, 0.0 if waiting else None)
            if not waiting:
                continue
            kind, content = waiting[0]
            if kind == "files":
                track.attach(uri, experiment, study or experiment, [Path(f) for f in content])
            elif kind == "trial":
                track.mirror_trials(uri, experiment, study or experiment, content[0], [content[1]])
            elif kind == "vehicle":
                track.mirror_vehicle(uri, experiment, Path(content), known)
            elif Path(content).name not in known:
                track.mirror([Path(content)], uri, experiment, study)
            outbox.put((int(kind != "files"), ""))
            waiting.popleft()
        except track.TrackingError as error:
            outbox.put((0, str(error)))
            if not more:
                return
            waiting.rotate(-1)
            more = _collect(inbox, waiting, RETRY)
        except BenchError as error:
            outbox.put((0, str(error)))
            if known is None:  # no address at all
                while _collect(inbox, waiting, None):
                    waiting.clear()
                return
            waiting.popleft()  # a record that was damaged meanwhile


def _collect(inbox: Any, waiting: deque[tuple[str, Any]], seconds: float | None) -> bool:
    """Move what has come in, for ``seconds`` (None: until something has); False: the driver has nothing more."""
    deadline = None if seconds is None else time.monotonic() + seconds
    while True:
        try:
            left = None if deadline is None else max(0.0, deadline - time.monotonic())
            item = inbox.get(timeout=left) if left is None or left > 0 else inbox.get_nowait()
        except queue.Empty:
            return True
        if item is None:
            return False
        waiting.append(item)
        if deadline is None:
            deadline = time.monotonic()
