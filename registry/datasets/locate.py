"""Where measured data lie on this machine."""

import os
from pathlib import Path

from registry.cache import cache_folder
from registry.errors import BenchError
from registry.regular_file import regular


def locate(folder: str, pattern: str, address: str, checksum: str) -> list[Path]:
    """The data files, sorted: under ``$BENCH_DATA``, else under the user's cache folder.

    Args:
        folder: the data set's own folder.
        pattern: of the file names.
        address: where the files can be had.
        checksum: a clause with the SHA-256 to expect, for the message.

    Raises:
        BenchError: no such file in either place.
    """
    *roots, cache = _roots()
    for root in (*roots, cache):
        try:
            found = sorted((root / folder).glob(pattern))
        except (OSError, ValueError):  # no name of a folder
            continue
        if found:
            return [regular(file) for file in found]
    set_aside = "" if roots else " (or set BENCH_DATA to the folder above it)"
    raise BenchError(
        f"No {pattern} in {' or '.join(str(r / folder) for r in (*roots, cache))}: "
        f"download them from {address} into it{set_aside}; {checksum}."
    )


def has_files(folder: str) -> bool:
    """Whether the data set's own folder is in either place and holds anything; imports no data set."""
    for root in _roots():
        try:
            if any((root / folder).iterdir()):
                return True
        except (OSError, ValueError):
            continue
    return False


def _roots() -> list[Path]:
    set_aside = os.environ.get("BENCH_DATA")
    return [*([Path(set_aside)] if set_aside else []), cache_folder()]
