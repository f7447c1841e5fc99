"""Files that are whole or absent, whatever dies meanwhile: written beside under another name, then renamed."""

import fcntl
import glob
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path

from registry.errors import BenchError

NAME_BYTES = 200
"""Of a file's name, that the name of its draft keeps: names end at 255."""
_DRAFT = ".draft"


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
def drafting(folder: Path, prefix: str) -> Iterator[Path]:
    """An empty folder to write into, locked while inside and removed at the end.

    The lock ends with the process, however that ends: drafts of the same prefix that nobody holds any more were left by
    a kill, and are removed before. Where the file system has no locks they stay.

    Args:
        folder: in which it is made; it must be there.
        prefix: of its name.

    Raises:
        OSError: it cannot be made.
    """
    clear(folder, prefix)
    draft, handle = _locked(folder, prefix)
    try:
        yield draft
    finally:
        shutil.rmtree(draft, ignore_errors=True)
        os.close(handle)


def scratch(prefix: str = "multistep-bench-") -> AbstractContextManager[Path]:
    """A draft where temporary files are."""
    return drafting(Path(tempfile.gettempdir()), prefix)


def clear(folder: Path, prefix: str) -> None:
    """Remove the drafts of processes that were killed."""
    for left in folder.glob(f"{glob.escape(prefix)}*{_DRAFT}"):
        with suppress(OSError):  # somebody else's, or removed meanwhile
            handle = os.open(left, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
            try:
                if os.fstat(handle).st_uid == os.geteuid():
                    fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    shutil.rmtree(left, ignore_errors=True)
            finally:
                os.close(handle)


def remove(path: Path) -> None:
    """Remove a file, or a draft with what is in it, where it is there."""
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


def _locked(folder: Path, prefix: str) -> tuple[Path, int]:
    """A new draft and what holds its lock; another process that clears up may take away one that is not locked yet."""
    while True:
        draft = Path(tempfile.mkdtemp(prefix=prefix, suffix=_DRAFT, dir=folder))
        try:
            handle = os.open(draft, os.O_RDONLY | os.O_DIRECTORY)
        except FileNotFoundError:
            continue
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(handle)
            continue
        except OSError:
            pass  # a file system without locks
        if draft.exists():
            return draft, handle
        os.close(handle)


@contextmanager
def replacing(path: Path, flushed: bool = True) -> Iterator[Path]:
    """A name for the next content of ``path``, to be written inside; at the end it takes the place of ``path``.

    Whoever is killed meanwhile leaves ``path`` as it was, and a hidden draft, which the next to write removes. The
    folder is made where there is none.

    Args:
        path: of the file.
        flushed: also after a power cut the file is the old or the new one. It takes some ms; without it such a file
            may be torn, which its reader must see.

    Raises:
        OSError: it cannot be written; the draft is removed.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    kept = os.fsencode(path.name)[:NAME_BYTES].decode(errors="ignore")
    with drafting(path.parent, f".{kept}.") as folder:
        draft = folder / path.name
        yield draft
        if flushed:
            flush(draft)
            move(draft, path)
        else:
            os.replace(draft, path)


def write_text(path: Path, text: str) -> None:
    """Replace the content of a file."""
    with replacing(path) as draft:
        draft.write_text(text, encoding="utf-8")
