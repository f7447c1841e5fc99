"""What a human checks first of a log: whether dataset.toml reads it as it was written."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from bench.diagnose.checks.description.clocks import clocks
from bench.diagnose.checks.description.conventions import conventions
from bench.diagnose.checks.description.mistake import Mistake
from bench.diagnose.checks.description.mounting import mounting
from bench.diagnose.checks.description.recorded import Recorded, flying, of_folder, of_subject
from bench.diagnose.checks.description.sampling import aliased_drive, millivolts, slow_logs, two_levels
from bench.diagnose.checks.description.thrust import thrust
from bench.diagnose.logs.subject import Subject
from bench.diagnose.result import DataProblem
from registry.datasets.folder.dataset import Folder


def check(recorded: Recorded, carried: bool) -> list[Mistake]:
    """Everything that these recordings say against the way they are read; `Mistake.stops` tells what spoils the rest.

    Args:
        recorded: from `of_folder` or `of_subject`.
        carried: whether the vehicle is carried by rotors along its z axis; see `flying`.
    """
    if not recorded.flights:
        return []
    found = conventions(recorded, carried)
    if found and found[-1].reading is not None:
        recorded = replace(recorded, reading=found[-1].reading)
    found += (slow_logs(recorded) or aliased_drive(recorded)) if carried else two_levels(recorded)
    found += millivolts(recorded) if carried else []
    # Clocks are told apart only once signs and axes are right.
    late = clocks(recorded, carried)
    found += late or mounting(recorded)
    return _each_line_once(found + (thrust(recorded) if carried else []))


def _each_line_once(found: Sequence[Mistake]) -> list[Mistake]:
    """Mistakes whose lines do not contradict each other: of a signal that several mend the last has all of it."""
    later: set[str] = set()
    out: list[Mistake] = []
    for m in reversed(found):
        mend = tuple(line for line in m.mend if line.split(" = ")[0] not in later)
        later |= {line.split(" = ")[0] for line in mend}
        out.append(replace(m, mend=mend))
    return out[::-1]


def check_folder(folder: str | Path | Folder) -> list[Mistake]:
    """`check` of a folder with a dataset.toml.

    Raises:
        BenchError: the folder cannot be read.
    """
    source = folder if isinstance(folder, Folder) else Folder(path=str(folder))
    return check(of_folder(source), flying(source.system))


def check_subject(subject: Subject) -> tuple[list[DataProblem], list[DataProblem]]:
    """`check` of what is diagnosed: what stops it, and what goes into the notes."""
    stopping: list[DataProblem] = []
    minor: list[DataProblem] = []
    for m in check(of_subject(subject), flying(subject.system)):
        lines = f" dataset.toml should have: {'; '.join(m.mend)}" if m.mend else ""
        where = m.recordings[0] if m.recordings else subject.logs[0].name
        (stopping if m.stops else minor).append(DataProblem(where, m.signal, m.kind, None, m.detail + lines))
    return stopping, minor
