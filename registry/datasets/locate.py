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
    cache = cache_folder()
    roots = [Path(os.environ["BENCH_DATA"])] if os.environ.get("BENCH_DATA") else []
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
