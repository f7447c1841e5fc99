"""Who runs jobs: what the processes of this machine and the workers of a cluster have in common."""

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any

AHEAD = 2
"""Jobs handed out for each worker, so that none waits for the driver."""


@dataclass(frozen=True)
class WorkerPool:
    """Who runs jobs."""

    submit: Callable[..., Future[Any]]
    max_pending: Callable[[], int]
    """How many jobs may be handed out and not ended, now."""
    messages: Any = None
    """A queue of what workers `send_progress`; None where they arrive at once."""
