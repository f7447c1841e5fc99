"""Finished studies in the results folder, read back."""

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from registry.errors import BenchError
from registry.regular_file import regular


def slug(title: str) -> str:
    """A file name for a title."""
    return re.sub(r"[^A-Za-z0-9.]+", "-", title).strip("-.").lower()


@dataclass(frozen=True)
class FinishedStudy:
    """A study's folder, read back."""

    folder: Path
    title: str
    study: str | None
    keys: list[str]
    command: str
    files: list[Path]


def finished_studies(results: Path) -> Iterator[FinishedStudy]:
    """Every study in the results folder."""
    yield from map(finished_study, sorted((results / "studies").glob("*/study.json")))


def finished_study(path: Path) -> FinishedStudy:
    """The study of one ``study.json``.

    Raises:
        BenchError: it is damaged.
    """
    try:
        content = json.loads(regular(path).read_text(encoding="utf-8"))
        kept = [f for f in (path.parent / name for name in content["files"]) if f.is_file()]
        title, study, command = (content[key] for key in ("title", "study", "command"))
        if not all(isinstance(text, str) for text in (title, study or "", command, *content["keys"])):
            raise ValueError("title, study, command and keys must be texts")
        return FinishedStudy(path.parent, title, study, list(content["keys"]), command, kept)
    except (OSError, ValueError, TypeError, LookupError, RecursionError) as error:
        raise BenchError(f"{path} is damaged ({error}): remove it, or run the study again.") from error
