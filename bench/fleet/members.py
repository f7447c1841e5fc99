"""Which members a fleet has: folders of a folder, what columns of one folder's files say, or its recordings."""

import hashlib
import re
from dataclasses import dataclass
from os.path import abspath
from pathlib import Path

from registry.datasets.folder.dataset import Folder
from registry.datasets.folder.description import FILE, describe
from registry.datasets.folder.sessions import sessions
from registry.errors import BenchError, near
from registry.regular_file import read_toml


@dataclass(frozen=True)
class Member:
    """What is diagnosed by itself: the recordings of a vehicle, of one day where they are dated. Plain data."""

    vehicle: str
    date: str
    """Such as 2026-03-01; empty: nobody said."""
    id: str
    """Of the folder, or vehicle and date: no two are equal."""
    path: str
    """Of the folder with the dataset.toml, from the root: workers stand elsewhere."""
    source: str
    """That folder as the user named it."""
    only: tuple[str, ...] = ()
    """Names of its files; none: all that the description means."""
    problem: str = ""
    """Why it cannot be read, as far as is known before."""
    kind: str = "vehicle"
    """Or "recording": one of a folder, by itself."""

    @property
    def part(self) -> tuple[str, ...]:
        """Words of `bench diagnose SOURCE` that it is a part of; empty: it is all of the source."""
        if self.kind == "recording":
            return ("--each-recording",)
        return ("--vehicle", self.vehicle) if self.only else ()

    @property
    def title(self) -> str:
        """Vehicle and date."""
        return ", ".join(filter(None, (self.vehicle, self.date)))

    @property
    def slug(self) -> str:
        """A name of a folder for it; no two are equal."""
        plain = re.sub(r"[^A-Za-z0-9._-]+", "-", self.id).strip("-.")[:80]
        return plain if plain == self.id else f"{plain}-{hashlib.sha256(self.id.encode()).hexdigest()[:8]}".lstrip("-")

    @property
    def folder(self) -> Folder:
        """Its recordings."""
        return Folder(path=self.path, only=self.only)


@dataclass(frozen=True)
class Members:
    """A fleet before it is diagnosed."""

    name: str
    members: tuple[Member, ...]
    """By vehicle and date."""
    notes: tuple[str, ...] = ()
    """What was left out, in sentences."""

    @property
    def kind(self) -> str:
        """What they are, "vehicle" or "recording"."""
        return self.members[0].kind


def is_fleet(source: str) -> bool:
    """Whether a folder holds vehicles rather than the recordings of one: see `members`."""
    folder = Path(source)
    if (folder / FILE).is_file():
        try:
            told = read_toml(folder / FILE, "").get("vehicle")
        except BenchError:  # said by whoever reads it
            return False
        return isinstance(told, dict)
    return folder.is_dir() and any(_described(folder))


def _described(folder: Path) -> list[Path]:
    try:
        return sorted(p for p in folder.iterdir() if not p.name.startswith(".") and (p / FILE).is_file())
    except OSError as error:
        raise BenchError(f"{folder} cannot be read: {error.strerror or error}.") from error


def members(source: str, vehicles: tuple[str, ...] = ()) -> Members:
    """The vehicles of a fleet.

    Args:
        source: a folder of folders with a dataset.toml each, or a folder whose dataset.toml names the column that
            holds the vehicle.
        vehicles: these only; none: all.

    Raises:
        BenchError: it is no fleet, has one member, or none of such a name.
    """
    folder = Path(source)
    if not is_fleet(source):
        raise BenchError(
            f"{source} is no fleet: give a folder of folders with a dataset.toml each, or one whose dataset.toml says "
            'vehicle = {column = "…"}.'
        )
    found = _of_columns(folder) if (folder / FILE).is_file() else _of_folders(folder)
    if len(found.members) < 2:
        (only,) = found.members
        raise BenchError(
            f"{source} holds one vehicle, {only.id}: `bench diagnose {only.source}` is for one dataset.toml."
        )
    known = list(dict.fromkeys(m.vehicle for m in found.members))
    for name in vehicles:
        if name not in known:
            raise BenchError(f"--vehicle {name}: no vehicle of {source} is called so: {near(name, known)}")
    if vehicles:
        return Members(found.name, tuple(m for m in found.members if m.vehicle in vehicles), found.notes)
    return found


def recordings(source: str, exclude: tuple[str, ...] = ()) -> Members:
    """The recordings of a folder, each as if it were a vehicle.

    Args:
        source: a folder with a dataset.toml.
        exclude: names of recordings that are left out.

    Raises:
        BenchError: there is no dataset.toml, no recording of such a name, or fewer than two are left.
    """
    folder = Path(source)
    if not (folder / FILE).is_file():
        raise BenchError(f"{source} has no {FILE}: recordings are taken one by one of a folder that has one.")
    found = Folder(path=source).files
    files = {f.stem: f.name for f in found}
    if len(files) < len(found):
        raise BenchError(f"{source}: two recordings have one name; rename a file.")
    for name in exclude:
        if name not in files:
            raise BenchError(f"--exclude {name}: no recording of {source} is called so: {near(name, files)}")
    left = {name: file for name, file in files.items() if name not in exclude}
    if len(left) < 2:
        raise BenchError(f"{source} has one recording to take by itself: leave --each-recording out.")
    where = abspath(folder), source
    made = tuple(Member(name, "", name, *where, (file,), kind="recording") for name, file in left.items())
    return Members(describe(folder).name, made)


def _of_folders(folder: Path) -> Members:
    made = []
    for path in _described(folder):
        try:
            told = describe(path)
            made.append(Member(told.vehicle.text or path.name, told.date.text, path.name, abspath(path), str(path)))
        except BenchError as error:
            made.append(Member(path.name, "", path.name, abspath(path), str(path), problem=str(error)))
    left = sorted(p.name for p in folder.iterdir() if p.is_dir() and p.name != "diagnosis" and p.name[0] != ".")
    left = [name for name in left if name not in {m.id for m in made}]
    notes = (f"Folders without a {FILE} are left out: {', '.join(left)}.",) if left else ()
    return Members(folder.resolve().name, tuple(sorted(made, key=lambda m: (m.vehicle, m.date, m.id))), notes)


def _of_columns(folder: Path) -> Members:
    told = describe(folder)
    found, unknown = sessions(Folder(path=str(folder)).files, told.vehicle, told.date)
    where = abspath(folder), str(folder)
    made = [
        Member(s.vehicle, s.date, ", ".join(filter(None, (s.vehicle, s.date))), *where, tuple(f.name for f in s.files))
        for s in found
    ]
    made += [Member(f.name, "", f.name, *where, (f.name,), sentence) for f, sentence in unknown.items()]
    return Members(told.name, tuple(made))
