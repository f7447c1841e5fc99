"""The MLflow page of a results folder, served on this machine with a small footprint."""

import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType

from bench.tracking.track import VIEW, artifact_root, default_uri, find_experiment
from registry.atomic_io import scratch
from registry.errors import BenchError

_SECONDS_TO_START = 60


def chart_link(base_url: str, experiment_id: str) -> str:
    """The chart page of an experiment, all runs shown: error of every prediction step, one chart a quantity."""
    page = f"{base_url.rstrip('/')}/#/experiments/{experiment_id}/runs"
    return f"{page}?compareRunsMode=CHART&viewStateShareKey={VIEW}&workflowType=machine_learning"


def serve(
    results: Path, uri: str | None = None, host: str = "127.0.0.1", port: int = 5000, study: str | None = None
) -> None:
    """Serve the page until Ctrl-C and print the link to the study's charts (or to those last written).

    A tracking server that already runs (``uri`` is http) is not started again: only its link is printed.

    Raises:
        BenchError: nothing of this study has been tracked, or the server does not start.
    """
    uri = uri or default_uri(results)
    experiment_id = find_experiment(uri, study)
    if experiment_id is None:
        what = f"of {study!r} " if study else ""
        raise BenchError(f"No runs {what}are tracked at {uri} yet: run a study, or `bench sync` its records.")
    if uri.startswith(("http://", "https://")):
        print(f"Charts: {chart_link(uri, experiment_id)}")
        return
    asked: list[int] = []  # an exception raised in a destructor would be lost, and Ctrl-C with it

    def stop(number: int, _: object) -> None:
        asked.append(number)

    with (
        suppress(KeyboardInterrupt),
        server(uri, host, port) as base_url,
        _handled(stop, signal.SIGINT, signal.SIGTERM),
    ):
        print(f"Charts: {chart_link(base_url, experiment_id)}\nCtrl-C stops the server.", flush=True)
        while not asked:  # not `signal.pause`: a Ctrl-C just before it would be waited for, and never seen
            time.sleep(0.2)


@contextmanager
def server(uri: str, host: str = "127.0.0.1", port: int = 5000) -> Iterator[str]:
    """An MLflow server on this database, ready when entered, gone with all its processes when left.

    Args:
        uri: the database, ``sqlite:///…``.
        host: address to listen on.
        port: tried first; the next free one is taken otherwise.

    Yields:
        The address of the server, ``http://host:port``.

    Raises:
        BenchError: no port is free, or the server does not start.
    """
    port = _free_port(host, port)
    if uri.startswith("sqlite:///"):
        uri = f"sqlite:///{Path(uri.removeprefix('sqlite:///')).resolve()}"
    command = [sys.executable, "-P", "-m", "mlflow", "server", "--backend-store-uri", uri, "--host", host]
    command += ["--port", str(port), "--workers", "1", "--artifacts-destination", artifact_root(uri).as_uri()]
    # Four workers and the job runner, MLflow's defaults, take six times the memory.
    settings = {"MLFLOW_SERVER_ENABLE_JOB_EXECUTION": "false", "MLFLOW_DISABLE_TELEMETRY": "true"}
    settings["PYTHONSAFEPATH"] = "1"
    # uvicorn puts the folder in which it starts first on the path, whatever Python was told: an empty one.
    with tempfile.TemporaryFile() as log, scratch() as empty:
        process = subprocess.Popen(
            command,
            env=os.environ | settings,
            cwd=empty,
            stdout=log,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        with _handled(signal.default_int_handler, signal.SIGTERM):  # no server outlives this process
            try:
                base_url = f"http://{host}:{port}"
                if not _ready(process, base_url):
                    log.seek(0)
                    said = log.read().decode(errors="replace").strip().splitlines()
                    raise BenchError(f"The MLflow server did not start: {said[-1] if said else 'it said nothing'}.")
                yield base_url
            finally:
                _stop(process)


def _free_port(host: str, first: int) -> int:
    for port in range(first, min(first + 100, 65536)):
        with socket.socket() as probe, suppress(OSError):
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((host, port))
            return port
    raise BenchError(f"No port from {first} on is free on {host}: give another with --port.")


def _ready(process: "subprocess.Popen[bytes]", base_url: str) -> bool:
    deadline = time.monotonic() + _SECONDS_TO_START
    while process.poll() is None and time.monotonic() < deadline:
        with suppress(OSError), urllib.request.urlopen(f"{base_url}/health", timeout=2):
            return True
        time.sleep(0.2)
    return False


def _stop(process: "subprocess.Popen[bytes]") -> None:
    """End the server's process group: the launcher and the worker under it."""
    for sign in (signal.SIGTERM, signal.SIGKILL):
        with suppress(ProcessLookupError):
            os.killpg(process.pid, sign)
        with suppress(subprocess.TimeoutExpired):
            process.wait(timeout=5)


@contextmanager
def _handled(handler: Callable[[int, FrameType | None], object], *numbers: signal.Signals) -> Iterator[None]:
    """Within it ``handler`` takes these signals; in another thread than the main one nothing changes."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, handler) for number in numbers}
    try:
        yield
    finally:
        for number, old in before.items():
            signal.signal(number, old)
