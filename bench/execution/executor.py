"""Jobs over `concurrent.futures.Executor`: in this process, in others on this machine, or on a Dask cluster."""

import ctypes
import multiprocessing
import os
import queue
import signal
import sys
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, contextmanager
from typing import Any, TypeVar

from bench.execution.pool import AHEAD, WorkerPool
from bench.execution.threads import one_thread_by_default
from registry.errors import BenchError

T = TypeVar("T")
R = TypeVar("R")
OnMessage = Callable[[Any], None]

MAX_DEATHS = 3
"""Deaths of worker processes, without a job finished in between, after which the rest is given up."""


def run_jobs(
    jobs: Iterator[tuple[T, Callable[..., R], tuple[Any, ...]]],
    workers: int,
    on_message: OnMessage,
    name: Callable[[T], str],
    cluster: str | None = None,
    ahead: int = AHEAD,
) -> Generator[tuple[T, R], None, None]:
    """Hand out jobs, the next one when one has ended, and give back each with its result as it ends.

    The jobs of a worker that dies are handed out again. Close it (`contextlib.closing`) to stop the workers, whatever
    they are doing.

    Args:
        jobs: what is given back, the function that a worker calls, its arguments; asked for one at a time, after
            everything that had ended was given back. On a cluster the function is sent by name, the arguments must be
            plain data.
        workers: processes on this machine; 1 stays in this one.
        on_message: called with what workers `send_progress`.
        name: of a job, for messages.
        cluster: address of a Dask scheduler whose workers do it instead.
        ahead: jobs handed out for each worker; 1 where a job is a function of what came of those before.

    Raises:
        BenchError: workers die again and again, or the cluster cannot be reached.
    """
    waiting: list[tuple[T, Callable[..., R], tuple[Any, ...]]] = []
    deaths, more = 0, True
    while more or waiting:
        with _pool(workers, cluster, on_message, ahead) as pool:
            pending: dict[Future[R], tuple[T, Callable[..., R], tuple[Any, ...]]] = {}
            try:
                while more or waiting or pending:
                    while (more or waiting) and len(pending) < pool.max_pending():
                        if not waiting:
                            job = next(jobs, None)
                            more = job is not None
                            waiting += [job] if job is not None else []
                        if waiting:
                            _, function, arguments = waiting[0]
                            pending[pool.submit(function, *arguments)] = waiting[0]
                            del waiting[0]
                    done, _ = wait(pending, timeout=0.5, return_when=FIRST_COMPLETED)
                    _drain(pool.messages, on_message)
                    failed = [f for f in done if f.cancelled() or f.exception()]
                    for future in sorted(done, key=failed.__contains__):  # what is good is kept before one raises
                        result = future.result()
                        item = pending.pop(future)[0]
                        deaths = 0
                        yield item, result
            except BrokenProcessPool:
                waiting += pending.values()
                deaths += 1
                if deaths == MAX_DEATHS:
                    raise BenchError(
                        f"Worker processes died {MAX_DEATHS} times in a row, the last one at {name(waiting[0][0])} "
                        "(out of memory?): what was finished is kept, start again with fewer --workers."
                    ) from None


_messages: Any = None


def send_progress(message: Any) -> None:
    """In a worker: send something to the driver."""
    if _messages is not None:
        _messages.put(message)
        return
    from bench.execution import cluster

    cluster.send_progress(message)


@contextmanager
def interrupts_withheld() -> Iterator[None]:
    """No Ctrl-C reaches the processes that are started in here, not even while they import; this one gets it after."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def serve_parent() -> None:
    """Leave Ctrl-C to the process that started this one, and be killed when that ends, however it ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG
    parent = multiprocessing.parent_process()
    if parent is not None and not parent.is_alive():  # it was quicker
        os._exit(1)


def _pool(workers: int, cluster: str | None, on_message: OnMessage, ahead: int) -> AbstractContextManager[WorkerPool]:
    if cluster is not None:
        from bench.execution.cluster import connected

        return connected(cluster, ahead)
    return _inline(on_message) if workers <= 1 else _processes(workers, ahead)


class _Inline(Executor):
    """Runs a job when it is submitted, in this process."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


class _Direct:
    """Stands in for the queue when jobs run in this process."""

    def __init__(self, on_message: OnMessage) -> None:
        self.put = on_message


@contextmanager
def _inline(on_message: OnMessage) -> Iterator[WorkerPool]:
    global _messages
    _messages = _Direct(on_message)
    yield WorkerPool(_Inline().submit, lambda: 1)


@contextmanager
def _processes(workers: int, ahead: int) -> Iterator[WorkerPool]:
    context = multiprocessing.get_context("spawn")
    messages = context.Queue()
    executor = ProcessPoolExecutor(workers, context, _start_worker, (messages,))
    others = multiprocessing.active_children()

    def submit(*job: Any) -> Future[Any]:
        with interrupts_withheld():  # it starts processes
            return executor.submit(*job)

    try:
        yield WorkerPool(submit, lambda: ahead * workers, messages)
    finally:
        for process in multiprocessing.active_children():
            if process not in others:
                process.terminate()
        executor.shutdown(wait=False, cancel_futures=True)


def _start_worker(messages: Any) -> None:
    global _messages
    _messages = messages
    one_thread_by_default()
    serve_parent()


def _drain(messages: Any, on_message: OnMessage) -> None:
    while messages is not None:
        try:
            on_message(messages.get_nowait())
        except queue.Empty:
            return
