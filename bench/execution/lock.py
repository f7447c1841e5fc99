"""One driver a study: a lock on a file in the study's folder, gone with the process that holds it, however it ends."""

import fcntl
import json
import os
import shlex
import socket
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from registry.atomic_io import writing
from registry.errors import BenchError

FILE = ".lock"


@contextmanager
def held(folder: Path, what: str) -> Iterator[None]:
    """Keep every other driver off a folder while inside.

    Args:
        folder: made where it does not exist.
        what: the name of the study, for the sentence that another driver gets.

    Raises:
        BenchError: another process holds it (the sentence says which), or the folder cannot be written.
    """
    with _opened(folder / FILE) as handle:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise BenchError(
                f"“{what}” is already being run {_holder(folder)}: let it finish, or stop it and start again."
            ) from None
        except OSError:
            pass  # a file system without locks: records are safe with two drivers, only time is lost
        with suppress(OSError):  # a full disk: the lock holds, its holder stays unnamed
            os.ftruncate(handle, 0)
            os.pwrite(handle, json.dumps(_ourselves()).encode(), 0)
        yield
        with suppress(OSError):
            os.ftruncate(handle, 0)


@contextmanager
def turn(folder: Path, name: str, say: Callable[[str], None]) -> Iterator[None]:
    """Wait until nobody else is inside, then keep them out while inside.

    Args:
        folder: of the lock's file; made where it does not exist.
        name: of the file.
        say: called with a sentence where there is somebody to wait for.

    Raises:
        BenchError: the folder cannot be written.
    """
    with _opened(folder / name) as handle:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            say(f"waiting for another command that is at work in {folder}")
            fcntl.flock(handle, fcntl.LOCK_EX)
        except OSError:
            pass  # a file system without locks
        yield


@contextmanager
def _opened(path: Path) -> Iterator[int]:
    """A file to lock, made with its folder where there is none.

    It stays: removing it would let two drivers lock two files of one name.
    """
    with writing(f"The results folder {path.parent}"):
        path.parent.mkdir(parents=True, exist_ok=True)
        handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
    try:
        yield handle
    finally:
        os.close(handle)


def holders(folders: Path) -> list[str]:
    """Who is at work in the folders below this one, a phrase each."""
    found = []
    for path in sorted(folders.glob(f"*/{FILE}")):
        with suppress(OSError), path.open() as file:
            try:
                fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
            except BlockingIOError:
                found.append(f"{path.parent.name} {_holder(path.parent)}")
    return found


def _ourselves() -> dict[str, str | int]:
    return {
        "pid": os.getpid(),
        "host": socket.gethostname(),
        "command": shlex.join(["bench", *sys.argv[1:]]),
        "since": time.strftime("%Y-%m-%d %H:%M:%S"),
    }


def _holder(folder: Path) -> str:
    """Such as: by process 4711 on lab7 since 2026-01-31 09:00:00 (`bench run washout_vs_mlp`)."""
    try:
        by = json.loads((folder / FILE).read_text())
        return f"by process {by['pid']} on {by['host']} since {by['since']} (`{by['command']}`)"
    except (OSError, ValueError, TypeError, KeyError):
        return "by another process"
