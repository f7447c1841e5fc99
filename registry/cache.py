"""Where what can be made again is kept between commands."""

import os
from pathlib import Path

from registry.errors import BenchError


def cache_folder() -> Path:
    """``multistep-bench`` in the user's cache folder.

    ``$XDG_CACHE_HOME`` counts where it is absolute, as its specification has it: a relative one, such as a ``~`` that
    no shell has replaced, would make a cache in every folder that a command is typed in, and load libraries from there.

    Raises:
        BenchError: the user has no home folder.
    """
    named = os.environ.get("XDG_CACHE_HOME", "")
    if os.path.isabs(named):
        return Path(named) / "multistep-bench"
    try:
        return Path.home() / ".cache" / "multistep-bench"
    except RuntimeError as error:
        raise BenchError("There is no home folder to keep a cache in: set XDG_CACHE_HOME to a folder.") from error
