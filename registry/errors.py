"""The one exception that a user is meant to read."""

import difflib
import shlex
import sys
from collections.abc import Iterable
from unicodedata import category

MAX_LENGTH = 2000
"""Characters of a message."""

HIDDEN = {"Cc", "Cf", "Cs", "Zl", "Zp"}
"""Kinds of characters that are no text: control, format, surrogate, ends of lines and paragraphs."""


class BenchError(Exception):
    """Something the user can mend; the message is one sentence that says what to do. Exit code 2.

    What a broken file says of itself may be long: the middle of such a message is left out. Line ends and what would
    steer a terminal, in a name that is quoted, are written as escapes.
    """

    def __init__(self, message: str = "") -> None:
        message = visible(message)
        super().__init__(message if len(message) <= MAX_LENGTH else f"{message[: MAX_LENGTH - 300]} … {message[-297:]}")


def visible(text: str) -> str:
    """The text in one line, with control and formatting characters as Python writes them."""
    if text.isprintable():
        return text
    return "".join(c.encode("unicode_escape").decode() if category(c) in HIDDEN else c for c in text)


def not_installed(what: str, *libraries: str) -> BenchError:
    """The error where an optional library is absent: what needs it, and the command that installs it here."""
    command = shlex.join([sys.executable, "-m", "pip", "install", *libraries])
    return BenchError(f"{what} needs {' and '.join(n.partition('=')[0].rstrip('<>~') for n in libraries)}: {command}")


def unreadable(path: object, error: Exception) -> BenchError:
    """The error where a file cannot be read: its path once, and the system's or the reader's reason in a line."""
    if isinstance(error, PermissionError):
        return BenchError(f"{path} may not be read: permission denied.")
    said = (isinstance(error, OSError) and error.strerror) or (str(error).splitlines() or [type(error).__name__])[0]
    return BenchError(f"{path} cannot be read: {said:.300}.")


def meant(name: str, known: Iterable[str]) -> str:
    """The one of these names that another is but for a letter or two; empty: none is."""
    return next(iter(difflib.get_close_matches(name, known, n=1, cutoff=0.85)), "")


def near(name: str, known: Iterable[str]) -> str:
    """The tail of an error about an unknown name: the near ones first, then all of them (the first 20)."""
    names = sorted(known)
    lower = {n.lower(): n for n in names}
    close = [lower[n] for n in difflib.get_close_matches(name.lower(), lower, n=3, cutoff=0.5)]
    more = f", and {len(names) - 20} more" if len(names) > 20 else ""
    lead = f"did you mean {' or '.join(close)}? Known are" if close else "known are"
    return f"{lead} {', '.join(names[:20]) or 'none'}{more}."
