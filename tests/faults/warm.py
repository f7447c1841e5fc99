"""`bench` with everything imported: a command is a fork, in a session of its own, that has nothing to load first.

As a program it is the server that forks: a line in is a command, lines out are its process and how that has ended. It
imports what the commands before have imported, so that a kill at a random moment hits work, not a library's loading.
"""

import importlib
import json
import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path

SECONDS = 300
"""What no command here takes."""


class Warm:
    """The server."""

    def __init__(self, folder: Path) -> None:
        self.scratch, self.log = folder / "scratch", folder / "log"
        self.scratch.mkdir()
        here = os.environ | {"TMPDIR": str(self.scratch), "BENCH_DATA": ""}
        self.server = subprocess.Popen(
            [sys.executable, __file__], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=here
        )

    def start(self, command: list[str]) -> int:
        """The id of the process, and of its session, that has just begun."""
        assert self.server.stdin and self.server.stdout
        self.server.stdin.write(json.dumps([command, str(self.log)]) + "\n")
        self.server.stdin.flush()
        return int(self.server.stdout.readline())

    def end(self) -> int:
        """How the process that was started last ends."""
        assert self.server.stdout
        return int(self.server.stdout.readline())

    def run(self, command: list[str]) -> float:
        """Seconds that a command takes; it must end well."""
        began = time.monotonic()
        self.start(command)
        assert self.end() == 0, (command, self.log.read_text(errors="replace")[-3000:])
        return time.monotonic() - began

    def close(self) -> None:
        """End it."""
        assert self.server.stdin
        self.server.stdin.close()
        self.server.wait(SECONDS)


def alive(session: int) -> dict[int, str]:
    """The processes of a session that run, each with its command line."""
    found = {}
    for path in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            state, *_, of = (path / "stat").read_text().rpartition(")")[2].split()[:4]
            if int(of) == session and state != "Z":
                found[int(path.name)] = (path / "cmdline").read_text().replace("\0", " ")
    return found


def _work(command: list[str], log: str, told: int) -> int:
    """In the fork; how it ends."""
    os.setsid()
    out = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    for stream, file in ((0, os.open(os.devnull, os.O_RDONLY)), (1, out), (2, out)):
        os.dup2(file, stream)
    signal.alarm(SECONDS)
    before = set(sys.modules)
    code = 0
    try:
        from bench.cli import main

        sys.argv = ["bench", *command]
        main()
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 1
    with suppress(OSError), os.fdopen(told, "w") as names:
        names.write("\n".join(name for name in sys.modules if name not in before))
    return code


def _serve() -> None:
    for line in sys.stdin:
        command, log = json.loads(line)
        reading, told = os.pipe()
        process = os.fork()
        if process == 0:
            os.close(reading)
            sys.exit(_work(command, log, told))  # as a program ends: what it registered for its end is done
        os.close(told)
        print(process, flush=True)
        with os.fdopen(reading) as names:
            new = names.read().split("\n")
        code = os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])
        for name in new:
            with suppress(Exception):
                importlib.import_module(name)
        assert threading.active_count() == 1
        print(code, flush=True)


if __name__ == "__main__":
    _serve()
