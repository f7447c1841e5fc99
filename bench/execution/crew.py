"""Who works: what the processes of this machine and the workers of a cluster have in common."""

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any

AHEAD = 2
"""Jobs handed out for each worker, so that none waits for the driver."""


@dataclass(frozen=True)
class Crew:
    """Those who work."""

    submit: Callable[..., Future[Any]]
    hands: Callable[[], int]
    """How many jobs to hand out at once, now."""
    messages: Any = None
    """A queue of what workers `tell`; None where it is heard at once."""
