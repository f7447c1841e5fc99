"""What is asked of every vehicle, and on what a kept answer depends."""

import functools
import hashlib
import inspect
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from importlib.metadata import version
from os.path import abspath
from pathlib import Path
from typing import Any

import torch

from bench.fleet.members import Member
from registry.core import EFFECTS, PHYSICS
from registry.datasets.folder.description import FILE
from registry.errors import BenchError
from registry.regular_file import regular

ROOT = Path(__file__).resolve().parents[2]
SOURCES = (
    "bench/diagnose",
    "registry/contracts",
    "registry/datasets/folder",
    "registry/datasets/reading",
    "registry/dynamics",
    "registry/effects",
    "registry/kernels",
    "registry/physics",
    "registry/terms",
)
"""Folders of the code that an answer depends on."""
PRESENTATION = "bench/diagnose/report"
"""Code in them that changes no answer, but how it is shown."""


@dataclass(frozen=True)
class Options:
    """What is asked of every vehicle: the options of `bench.diagnose`. Plain data."""

    system: str | None = None
    """A registered physics model or "path/to/file.py:Class"; None: what the data name."""
    model: str = ""
    """Path of a model.toml to start from; empty: nominal constants without effects."""
    catalogue: tuple[str, ...] = ()
    """Effects to choose from; none: all that are registered."""
    without: tuple[str, ...] = ()
    """Effects that are left out of them."""
    horizon_s: float | None = None
    ignore: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Paths count from the root, for workers stand elsewhere."""
        file, colon, name = (self.system or "").rpartition(":")
        if file.endswith(".py"):
            object.__setattr__(self, "system", abspath(file) + colon + name)
        if self.model:
            object.__setattr__(self, "model", abspath(self.model))

    @property
    def effects(self) -> list[str] | None:
        """Ids of the effects to choose from; None: all of them."""
        if not self.catalogue and not self.without:
            return None
        return [n for n in (self.catalogue or EFFECTS.outline()) if n not in self.without]

    def content(self) -> dict[str, Any]:
        """With the content of the files in place of their paths.

        Raises:
            BenchError: one cannot be read.
        """
        file, _, name = (self.system or "").rpartition(":")
        system = [_sha256(Path(file)), name] if file.endswith(".py") else self.system
        return {**asdict(self), "system": system, "model": _sha256(Path(self.model)) if self.model else ""}


@functools.cache
def environment() -> Mapping[str, str]:
    """What the bits of an answer depend on beside data and options, on this machine and by this code."""
    return {
        "code": _code(),
        "cpu": torch.backends.cpu.get_cpu_capability(),
        **{name: version(name).partition("+")[0] for name in ("numpy", "scipy", "torch")},
    }


def _code() -> str:
    """SHA-256 of the sources, those of plug-ins among the effects and physics models too."""
    files = {p for folder in SOURCES for p in (ROOT / folder).rglob("*") if p.suffix in (".py", ".cpp", ".h")}
    files = {p for p in files if not p.relative_to(ROOT).as_posix().startswith(PRESENTATION)}
    plugged = {inspect.getsourcefile(r.get(name)) for r in (EFFECTS, PHYSICS) for name in r.names()}
    digest = hashlib.sha256()
    for path in sorted(files | {Path(p) for p in plugged if p and ROOT not in Path(p).parents}):
        digest.update(path.name.encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


def key_of(member: Member, options: Options) -> str:
    """What the answer on a vehicle is filed under.

    Raises:
        BenchError: its files cannot be read.
    """
    data = {f.name: _sha256(f) for f in [Path(member.path) / FILE, *member.folder.files]}
    content = {"member": [member.vehicle, member.date, member.id], "data": data, "asked": options.content()}
    text = json.dumps({**content, "environment": dict(environment())}, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def _sha256(path: Path) -> str:
    try:
        with regular(path).open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise BenchError(f"{path} cannot be read: {error.strerror or error}.") from error
