"""A Dask cluster: its workers do the jobs of `bench.execution.executor.run_jobs`, wherever they are.

Dask sends functions by name and arguments as pickles between its own processes, so whoever reaches a scheduler can run
code on its machines: a local one listens on 127.0.0.1 unless told otherwise.
"""

import ipaddress
import logging
import queue
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager
from typing import Any

from bench.execution.pool import AHEAD, WorkerPool
from registry.errors import BenchError, not_installed

try:
    import distributed
except ImportError as error:
    raise not_installed("A cluster", "distributed>=2026.1") from error

SECONDS = 10
"""To wait for a scheduler's answer."""

_ALONE = threading.Lock()
_sending = threading.local()


def send_progress(message: Any) -> None:
    """In a worker of a cluster: send something to the driver."""
    distributed.get_worker().log_event(_sending.topic, message)


def _do(topic: str, function: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
    """In a worker: one job at a time in a process, because the random state is the process's."""
    with _ALONE:
        _sending.topic = topic
        try:
            return function(*arguments)
        finally:
            _sending.topic = None


@contextmanager
def connected(address: str, ahead: int = AHEAD) -> Iterator[WorkerPool]:
    """Connect to a scheduler.

    Args:
        address: such as ``tcp://127.0.0.1:8786``.
        ahead: jobs handed out for each worker.

    Raises:
        BenchError: nobody answers there, or the scheduler goes away meanwhile.
    """
    for name in (
        "distributed",
        "distributed.client",
        "asyncio",
    ):  # of a scheduler that goes away they print pages; here it is a sentence
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    try:
        client = distributed.Client(address, timeout=SECONDS, set_as_default=False)
    except (OSError, ValueError, TypeError, ImportError) as error:
        raise BenchError(
            f"No Dask scheduler answers at {address}: `bench cluster start` starts one and says its address."
        ) from error
    try:
        messages: queue.Queue[Any] = queue.Queue()
        topic, executor = f"bench-{client.id}", client.get_executor(pure=False)
        client.subscribe_topic(topic, lambda event: messages.put(event[1]))
        yield WorkerPool(
            lambda function, *arguments: executor.submit(_do, topic, function, arguments),
            lambda: ahead * max(1, len(client.nthreads())),  # workers come and go
            messages,
        )
    except (distributed.client.FutureCancelledError, CancelledError, TimeoutError, OSError) as error:
        raise BenchError(f"The scheduler at {address} is gone: {_KEPT}") from error
    except distributed.scheduler.KilledWorker as error:
        raise BenchError(f"Several workers died at the same job (out of memory?): {_KEPT}") from error
    finally:
        client.close(timeout=SECONDS)


_KEPT = "what was finished is kept, and the same command goes on."


def serve(workers: int, host: str, port: int, ready: Callable[[str], None], warn: Callable[[str], None]) -> None:
    """A scheduler and worker processes on this machine, one thread each, until Ctrl-C or SIGTERM.

    Args:
        workers: processes; one that dies is replaced.
        host: address to listen on.
        port: of the scheduler; 0: any that is free.
        ready: called with the scheduler's address once it takes jobs.
        warn: called with a sentence where others can reach it.

    Raises:
        BenchError: the address cannot be listened on.
    """
    stop = threading.Event()
    for sign in (signal.SIGINT, signal.SIGTERM):
        signal.signal(sign, lambda *_: stop.set())
    try:
        cluster = distributed.LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            processes=True,
            host=host,
            scheduler_port=port,
            dashboard_address=None,
            worker_dashboard_address=None,
            silence_logs=50,
        )
    except (OSError, RuntimeError, ValueError) as error:
        raise BenchError(f"No scheduler can listen on {host}:{port}: choose another --port or --host.") from error
    with cluster:
        if not loopback(host):
            warn(
                f"Warning: {host} is open to the network, without a password: whoever reaches port {port} can run any "
                "code on this machine, as you; keep it behind a firewall."
            )
        ready(cluster.scheduler_address)
        while not stop.wait(1.0):
            pass


def loopback(host: str) -> bool:
    """Whether only this machine can reach it."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
