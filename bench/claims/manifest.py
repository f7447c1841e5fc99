"""Whether published files are as they were published: one list of their hashes, as `sha256sum -c` reads it."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from bench.records.record import sha256
from registry import atomic_io
from registry.errors import BenchError

FILE = "SHA256SUMS"
SEAL = "bench check --seal"
_LINE = re.compile(r"([0-9a-f]{64})  (\S.*)")


@dataclass(frozen=True)
class Spoilt:
    """A published file that is not as it was published."""

    name: str
    """Path within the folder."""
    how: str
    """ "altered", "missing" or "not published"."""


def sealed(published: Path) -> bool:
    """Whether the folder has a list."""
    return (published / FILE).is_file()


def seal(published: Path) -> int:
    """List every file of the folder as it is now, after results were published; returns how many there are.

    Raises:
        BenchError: the folder cannot be read or written, or holds nothing.
    """
    names = _names(published)
    if not names:
        raise BenchError(f"{published} holds no files to list: name the folder with --published.")
    with atomic_io.writing(published / FILE):
        _write(published, {name: sha256(published / name) for name in names})
    return len(names)


def entered(path: Path) -> Path:
    """A file just written, entered in the list of the published folder around it where there is one; else untouched.

    Raises:
        BenchError: the list is damaged or cannot be written.
    """
    here = path.absolute()
    root = next((folder for folder in here.parents if sealed(folder)), None)
    if root is not None:
        with atomic_io.writing(root / FILE):
            _write(root, {**_read(root), here.relative_to(root).as_posix(): sha256(here)})
    return path


def spoilt(published: Path) -> list[Spoilt]:
    """What is not as the list has it, by name.

    Raises:
        BenchError: there is no list, or it is damaged.
    """
    listed, there = _read(published), set(_names(published))
    found = [Spoilt(name, "missing") for name in listed if name not in there]
    found += [Spoilt(name, "not published") for name in there if name not in listed]
    try:
        found += [Spoilt(n, "altered") for n in there & set(listed) if sha256(published / n) != listed[n]]
    except OSError as error:
        raise BenchError(f"{published} cannot be read: {error.strerror or error}.") from error
    return sorted(found, key=lambda s: s.name)


def _names(published: Path) -> list[str]:
    found: Sequence[Path] = sorted(p for p in published.rglob("*") if p.is_file())
    return [p.relative_to(published).as_posix() for p in found if p.name != FILE and not p.name.startswith(".")]


def _read(published: Path) -> dict[str, str]:
    path = published / FILE
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except FileNotFoundError as error:
        raise BenchError(
            f"{path} does not exist: run this where results/ is, or name another with --published; where it "
            f"is gone, restore it, or list what you published with `{SEAL}`."
        ) from error
    except (OSError, UnicodeDecodeError) as error:
        raise BenchError(f"{path} cannot be read: restore it, or list what you published with `{SEAL}`.") from error
    matched = [_LINE.fullmatch(line) for line in lines]
    listed = {m[2]: m[1] for m in matched if m}
    if len(listed) < len(lines):
        raise BenchError(f"{path} is damaged: restore it, or list what you published with `{SEAL}`.")
    return listed


def _write(published: Path, listed: dict[str, str]) -> None:
    atomic_io.write_text(published / FILE, "".join(f"{listed[name]}  {name}\n" for name in sorted(listed)))
