"""Files that are files: opening a pipe or a device waits for ever, or never ends."""

import os
import stat
import tomllib
from pathlib import Path
from typing import Any

from registry.errors import BenchError, unreadable

DEEPEST = 20
"""Tables and lists within each other, of any description."""


def regular(path: Path) -> Path:
    """The path, unless there is something there that is no regular file; one that is absent is left to its reader.

    Raises:
        BenchError: a folder, a pipe, a device, a circle of links, or a name that cannot be one.
    """
    try:
        mode = os.stat(path).st_mode
    except FileNotFoundError:
        return path
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise BenchError(f"{str(path)!r:.300} cannot be read: {reason}.") from error
    if not stat.S_ISREG(mode):
        kind = "a folder" if stat.S_ISDIR(mode) else "a pipe, a socket or a device"
        raise BenchError(f"{path} is {kind}, where a file is needed: give a regular file.")
    return path


def not_text(path: Path, content: bytes) -> BenchError:
    """The error where the content of a file is not UTF-8: the line and the character of the first such byte."""
    try:
        content.decode("utf-8")
        where = ""
    except UnicodeDecodeError as error:
        before = content[: error.start]
        lines = before.split(b"\n")
        where = f" (line {len(lines)}, character {len(lines[-1].decode('utf-8')) + 1})"
    return BenchError(f"{path} is not UTF-8 text{where}: save it as UTF-8.")


def read_toml(path: Path, absent: str) -> dict[str, Any]:
    """A TOML file as a table.

    Args:
        path: of the file.
        absent: a sentence on what makes it, for one that does not exist.

    Raises:
        BenchError: absent, unreadable, not TOML, or nested deeper than any description is.
    """
    try:
        table = tomllib.loads(regular(path).read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise BenchError(f"{path} does not exist: {absent}.") from error
    except UnicodeDecodeError as error:
        raise not_text(path, path.read_bytes()) from error
    except (ValueError, OSError, RecursionError) as error:  # numbers of thousands of digits are a ValueError
        raise unreadable(path, error) from error
    level: list[Any] = [table]
    for _ in range(DEEPEST):
        level = [x for v in level for x in (v.values() if isinstance(v, dict) else v if isinstance(v, list) else ())]
    if level:
        raise BenchError(f"{path} holds tables or lists within each other, more than {DEEPEST} deep: flatten them.")
    return table
