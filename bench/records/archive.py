"""A finished study as one zip file, for another machine. The importer trusts nothing of what it reads."""

import json
import re
import shutil
import stat
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.records import record
from bench.records.finished import FinishedStudy, slug
from bench.records.record import RunRecord
from bench.records.record_check import BYTES, check, read_json
from bench.records.record_fields import FILES, KEY, text
from registry import atomic_io
from registry.errors import BenchError
from registry.regular_file import regular

MANIFEST = "study.json"
FORMAT = 1
RUNS = 20_000
"""Most runs of an archive."""
TOTAL = 8 << 30
"""Most bytes that an archive may unpack to."""
_MEMBER = re.compile(rf"runs/({KEY.pattern})/({'|'.join(map(re.escape, FILES))})")
_LONG_AGO = (1980, 1, 1, 0, 0, 0)


@dataclass(frozen=True)
class Imported:
    """What an import has done."""

    title: str
    study: str | None
    command: str
    keys: tuple[str, ...]
    new: tuple[str, ...]
    """Keys that were not there before; the others were kept as they were."""


def write(study: FinishedStudy, runs: Path, target: Path) -> None:
    """Pack a finished study: records, with their configurations and provenance. The same study gives the same bytes.

    Raises:
        BenchError: a run is missing or was altered, or the file cannot be written.
    """
    for key in study.keys:
        if not record.exists(runs, key):
            raise BenchError(
                f"Run {key[:12]} of “{study.title}” is not in {runs}: make it again with `{study.command}`."
            )
        if altered := record.verify(RunRecord(runs / key)):
            prune = f"bench runs prune --results {runs.parent}"
            raise BenchError(f"Run {key[:12]}: {altered[0]} was altered: `{prune}`, then `{study.command}`.")
    about = {"format": FORMAT, "title": study.title, "study": study.study, "command": study.command, "keys": study.keys}
    with (
        atomic_io.writing(target),
        atomic_io.replacing(target) as draft,
        zipfile.ZipFile(draft, "w", zipfile.ZIP_DEFLATED) as packed,
    ):
        packed.writestr(zipfile.ZipInfo(MANIFEST, _LONG_AGO), json.dumps(about, indent=1))
        for key in study.keys:
            for name in FILES:
                packed.writestr(
                    zipfile.ZipInfo(f"runs/{key}/{name}", _LONG_AGO),
                    (runs / key / name).read_bytes(),
                    zipfile.ZIP_DEFLATED,
                )


def read(source: Path, runs: Path) -> Imported:
    """Unpack an archive beside the records, look at every one of them, and move in those that are new.

    Raises:
        BenchError: anything that is not as `write` makes it; nothing is imported then.
    """
    try:
        runs.mkdir(parents=True, exist_ok=True)
        with _opened(source) as packed, atomic_io.drafting(runs, ".import-") as draft:
            members = _members(packed, source)
            about = _manifest(packed, members, source)
            for key in about["keys"]:
                _unpack(packed, members[key], draft / key)
                check(RunRecord(draft / key))
            new = tuple(k for k in about["keys"] if not record.whole(runs, k))
            for key in new:
                if (runs / key).exists():  # damaged from outside
                    shutil.rmtree(runs / key)
                atomic_io.move(draft / key, runs / key)
    except OSError as error:
        raise BenchError(f"{source} cannot be unpacked into {runs}: {error.strerror or error}.") from error
    return Imported(about["title"], about["study"], about["command"], tuple(about["keys"]), new)


@contextmanager
def _opened(source: Path) -> Iterator[zipfile.ZipFile]:
    """The archive; what its parser and decompressor make of damaged bytes is one sentence."""
    try:
        with regular(source).open("rb") as file, zipfile.ZipFile(file) as packed:
            yield packed
    except FileNotFoundError:
        raise BenchError(f"There is no file {source}.") from None
    except (BenchError, OSError):
        raise
    except Exception as error:  # every kind comes out of them
        raise BenchError(f"{source} is no archive that `bench export` wrote, or it was damaged.") from error


def _members(packed: zipfile.ZipFile, source: Path) -> dict[str, dict[str, zipfile.ZipInfo]]:
    """Entries by key and name (the manifest's key is ""), each of which may be there, and none twice."""
    every = packed.infolist()
    if len(every) > 1 + RUNS * len(FILES) or sum(i.file_size for i in every) > TOTAL:
        raise BenchError(f"{source} is larger than {RUNS} runs or {TOTAL >> 30} GiB.")
    found: dict[str, dict[str, zipfile.ZipInfo]] = {}
    for info in every:
        matched = _MEMBER.fullmatch(info.filename)
        key, name = matched.groups() if matched else ("", info.filename)
        if not matched and name != MANIFEST:
            raise BenchError(f"{source} holds {name[:80]!r}, which is no part of a study.")
        if stat.S_IFMT(info.external_attr >> 16) not in (0, stat.S_IFREG) or info.flag_bits & 1:
            raise BenchError(f"{source}: {name[:80]!r} is a link or encrypted.")
        if name in found.setdefault(key, {}):
            raise BenchError(f"{source} holds {info.filename!r} twice.")
        if info.file_size > BYTES[Path(name).suffix]:
            raise BenchError(f"{source}: {info.filename!r} is larger than {BYTES[Path(name).suffix] >> 20} MiB.")
        found[key][name] = info
    return found


def _manifest(
    packed: zipfile.ZipFile, members: Mapping[str, Mapping[str, zipfile.ZipInfo]], source: Path
) -> dict[str, Any]:
    where = f"{source}: {MANIFEST}"
    if MANIFEST not in members.get("", {}):
        raise BenchError(f"{source} has no {MANIFEST}: it is no archive that `bench export` wrote.")
    about = read_json(_content(packed, members[""][MANIFEST]), where)
    if not isinstance(about, dict) or about.get("format") != FORMAT:
        raise BenchError(f"{where} is not of format {FORMAT}: export it again with this version.")
    title, study, command, keys = (about.get(name) for name in ("title", "study", "command", "keys"))
    if not text(title) or not slug(str(title)) or not (study is None or text(study)):
        raise BenchError(f"{where} has no title.")
    if not isinstance(command, str) or len(command) > 4096 or not command.isprintable():
        raise BenchError(f"{where} has no command.")
    if (
        not isinstance(keys, list)
        or not keys
        or not all(isinstance(k, str) for k in keys)
        or len(set(keys)) < len(keys)
    ):
        raise BenchError(f"{where} lists no keys.")
    if set(keys) != set(members) - {""} or any(set(members[k]) != set(FILES) for k in keys):
        raise BenchError(f"{source}: the runs are not those that {MANIFEST} lists, or not whole.")
    return {"title": title, "study": study, "command": command, "keys": keys}


def _unpack(packed: zipfile.ZipFile, files: Mapping[str, zipfile.ZipInfo], folder: Path) -> None:
    """Write the files of a run, flushed; the names are ours."""
    folder.mkdir()
    for name in FILES:
        (folder / name).write_bytes(_content(packed, files[name]))
        atomic_io.flush(folder / name)
    atomic_io.flush(folder)


def _content(packed: zipfile.ZipFile, info: zipfile.ZipInfo) -> bytes:
    """What an entry holds, never more than it says."""
    with packed.open(info) as stream:
        content = stream.read(info.file_size + 1)
    if len(content) != info.file_size:
        raise BenchError(f"{info.filename!r} does not have the size that it states.")
    return content
