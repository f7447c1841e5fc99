"""Files that are whole or absent, whatever dies meanwhile: written beside, flushed to the disk, renamed."""

import os
from pathlib import Path


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


def write_text(path: Path, text: str) -> None:
    """Replace the content of a file."""
    draft = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        draft.write_text(text, encoding="utf-8")
        flush(draft)
        move(draft, path)
    finally:
        draft.unlink(missing_ok=True)
