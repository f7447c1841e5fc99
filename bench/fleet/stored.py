"""Answers on vehicles on disk: a folder each, written whole or not at all, its files with their hashes."""

import hashlib
import json
import os
import shutil
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from bench.diagnose.report.output_folder import FORMER, MODEL, PAGE, VALUES
from bench.fleet.members import Member
from registry import atomic_io
from registry.errors import BenchError
from registry.regular_file import regular

ANSWER, VEHICLES = "answer.json", "vehicles"
_DRAFT = ".draft-"


@dataclass(frozen=True)
class Stored:
    """A finished answer in its folder."""

    folder: Path

    @cached_property
    def told(self) -> dict[str, Any]:
        """``answer.json``: key, vehicle, date, id, and the SHA-256 of every other file; empty: it is damaged."""
        try:
            told = dict(json.loads(regular(self.folder / ANSWER).read_text(encoding="utf-8")))
            files = dict(told["files"])
            whole = all(_sha256(regular(self.folder / name).read_bytes()) == digest for name, digest in files.items())
            return told if whole and {PAGE, VALUES} <= set(files) else {}
        except (OSError, ValueError, TypeError, LookupError, RecursionError, BenchError):
            return {}

    @property
    def key(self) -> str:
        """What it was filed under; empty: there is none, or it is damaged."""
        return str(self.told.get("key", ""))

    @cached_property
    def values(self) -> dict[str, Any]:
        """``diagnosis.json``."""
        return dict(json.loads((self.folder / VALUES).read_text(encoding="utf-8")))


def place(out: Path, member: Member) -> Stored:
    """Where the answer on a vehicle lies, or will."""
    return Stored(out / VEHICLES / member.slug)


def write(out: Path, member: Member, key: str, files: Mapping[str, str]) -> Stored:
    """Keep an answer in place of a former one; a model of that which differs stays as model.previous.toml.

    Args:
        out: folder of the fleet's answers.
        member: whose answer it is.
        key: from `key_of`.
        files: texts by name.

    Raises:
        BenchError: the folder cannot be written; nothing is left behind.
    """
    final, draft = place(out, member).folder, None
    try:
        final.parent.mkdir(parents=True, exist_ok=True)
        draft = Path(tempfile.mkdtemp(prefix=_DRAFT, dir=final.parent))
        content = {name: text.encode("utf-8", errors="replace") for name, text in files.items()}
        for name, data in content.items():
            (draft / name).write_bytes(data)
        who = {"vehicle": member.vehicle, "date": member.date, "id": member.id}
        told = {**who, "key": key, "files": {name: _sha256(data) for name, data in content.items()}}
        (draft / ANSWER).write_text(json.dumps(told, indent=1, sort_keys=True) + "\n", encoding="utf-8")
        before = final / MODEL
        if before.is_file() and before.read_bytes() != content.get(MODEL):
            shutil.copyfile(before, draft / FORMER)
        draft.chmod(0o755)
        for path in [*draft.iterdir(), draft]:
            atomic_io.flush(path)
        if final.exists():
            os.rename(final, draft.with_name(f"{draft.name}-former"))
        atomic_io.move(draft, final)
        shutil.rmtree(draft.with_name(f"{draft.name}-former"), ignore_errors=True)
    except OSError as error:
        raise BenchError(f"{out} cannot be written: {error.strerror or error}.") from error
    finally:
        if draft is not None:
            shutil.rmtree(draft, ignore_errors=True)
    return Stored(final)


def tidy(out: Path) -> None:
    """Remove what a killed driver has left half written."""
    for left in (out / VEHICLES).glob(f"{_DRAFT}*"):
        shutil.rmtree(left, ignore_errors=True)


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
