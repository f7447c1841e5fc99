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
    for path in sorted((results / "studies").glob("*/study.json")):
        try:
            content = json.loads(regular(path).read_text(encoding="utf-8"))
            files = [path.parent / name for name in content["files"]]
            kept = [f for f in files if f.is_file()]
            found = FinishedStudy(
                path.parent, content["title"], content["study"], list(content["keys"]), content["command"], kept
            )
        except (OSError, ValueError, TypeError, LookupError, RecursionError) as error:
            raise BenchError(f"{path} is damaged ({error}): remove it, or run the study again.") from error
        yield found
