"""Files that are whole or absent, whatever dies meanwhile: written beside under another name, then renamed."""

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from registry.errors import BenchError

NAME_BYTES = 200
"""Of a file's name, that the name of its draft keeps: names end at 255."""


def flush(path: Path) -> None:
    """Have the disk hold what was written to a file, or the names in a folder."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def move(draft: Path, final: Path) -> None:
    """Give a flushed file or folder its name; after a power cut it has the one or the other."""
    os.replace(draft, final)
    flush(final.parent)


@contextmanager
def writing(what: object) -> Iterator[None]:
    """Write inside.

    Args:
        what: is written, as a sentence begins: a path, "The report PATH".

    Raises:
        BenchError: it cannot be written.
    """
    try:
        yield
    except OSError as error:
        raise BenchError(f"{what} cannot be written: {error.strerror or error}.") from error


@contextmanager
def replacing(path: Path, flushed: bool = True) -> Iterator[Path]:
    """A name beside ``path`` for its next content, to be written inside; at the end it takes the place of ``path``.

    Whoever is killed meanwhile leaves ``path`` as it was, and a hidden draft. The folder is made where there is none.

    Args:
        path: of the file.
        flushed: also after a power cut the file is the old or the new one. It takes some ms; without it such a file
            may be torn, which its reader must see.

    Raises:
        OSError: it cannot be written; the draft is removed.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    kept = os.fsencode(path.name)[:NAME_BYTES].decode(errors="ignore")
    draft = path.with_name(f".{kept}.{secrets.token_hex(4)}")
    try:
        yield draft
        if flushed:
            flush(draft)
            move(draft, path)
        else:
            os.replace(draft, path)
    finally:
        draft.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Replace the content of a file."""
    with replacing(path) as draft:
        draft.write_text(text, encoding="utf-8")
