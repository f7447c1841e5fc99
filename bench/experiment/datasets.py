"""From a name or a folder on the command line to a data set."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from registry.core import DATASETS

if TYPE_CHECKING:  # it loads torch, and a wrong name is to be said at once
    from registry.contracts import Dataset


def registered(source: str) -> bool:
    """Whether ``source`` means a registered data set: a folder of that name goes first if it describes data."""
    return source in DATASETS.outline() and not (Path(source) / "dataset.toml").is_file()


def choose(name: str, options: dict[str, str] | None = None, full: bool = False) -> "Dataset":
    """The data set of that name, or the `folder` data set where ``name`` is a folder with a dataset.toml.

    Args:
        name: registered name or path.
        options: field → text, converted to each field's type.
        full: the whole of the data where they come in sizes, unless the options say otherwise.

    Raises:
        BenchError: neither a name nor such a folder, or an unknown option.
    """
    from bench.experiment.config import build_entry

    given: dict[str, Any] = dict(options or {})
    if (Path(name) / "dataset.toml").is_file():
        name, given = "folder", {"path": str(Path(name).resolve()), **given}
    if full and name in DATASETS.names():
        given = {**DATASETS.get(name).in_full, **given}
    made: Dataset = build_entry(DATASETS, name, given)
    return made
