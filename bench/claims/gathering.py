"""Which runs count as evidence: those that were published and those made here, each configuration's from one making."""

import json
import shlex
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from bench.claims.evidence import FILE, NAMES, Evidence, StudyRun
from bench.experiment.notation import label
from bench.experiment.study import PRESETS
from registry.errors import BenchError

FEWEST = 2
"""Seeds with which evidence first says anything: one training says nothing about the next."""


def _command(text: str) -> tuple[str, str]:
    """Preset of a `bench run` command, and the options by which its runs are not the study's own: more than the data,
    the number of seeds and which of its configurations are chosen.
    """
    words = [w for word in shlex.split(text) for w in word.split("=", 1 if word.startswith("--") else 0)]
    preset = words[words.index("--preset") + 1] if "--preset" in words else "laptop"
    own = ("--preset", "--dataset", "--seeds", "--only")
    return preset, ", ".join(dict.fromkeys(w for w in words if w.startswith("-") and w not in own))


@dataclass(frozen=True)
class Folder:
    """One study's folder: its runs and where its curves are."""

    path: Path
    study: str
    preset: str
    altered: str
    """Why its runs are not those of the study as it is declared, in a few words; empty where they are."""
    runs: tuple[StudyRun, ...]

    @property
    def comparable(self) -> bool:
        """The study as it is declared, and not its smoke test."""
        return not self.altered


def folders(root: Path) -> Iterator[Folder]:
    """Every study's folder below ``root``.

    Raises:
        BenchError: a ``study.json`` that cannot be read.
    """
    for path in sorted(root.rglob("study.json")):
        try:
            content = json.loads(path.read_text())
            if not content.get("study"):
                continue
            runs = tuple(StudyRun.of(run) for run in content["runs"])
            preset, options = _command(content["command"])
        except (ValueError, TypeError, LookupError, ArithmeticError, AttributeError, OSError, RecursionError) as error:
            raise BenchError(f"{path} is damaged ({error}): remove it, or run the study again.") from error
        altered = f"it was run with {options}" if options else ""
        altered = altered or ("" if preset in PRESETS[1:] else f"the preset {preset} only tries the study out")
        yield Folder(path.parent, content["study"], preset, altered, runs)


def left_out(local: Path) -> list[str]:
    """Which studies that were run here are no evidence, and why: a sentence each."""
    return [f"{f.path.name} is no evidence on {f.study}: {f.altered}." for f in folders(local) if f.altered]


Source = tuple[str, str, str]
"""Study, data set, preset."""


def gather(published: Path, local: Path) -> list[Evidence]:
    """All evidence: that of the published folder and what was run here, as far as it counts (`counted_runs`).

    Of several presets of one study on one data set the largest counts. It was first looked at with the fewest seeds of
    any folder.
    """
    found = counted_runs(published, local)
    largest: dict[tuple[str, str], str] = {}
    for study, dataset, preset in found:
        largest[study, dataset] = max(largest.get((study, dataset), ""), preset, key=("", *PRESETS).index)
    return [_assemble(s, found[s]) for s in ((*where, preset) for where, preset in sorted(largest.items()))]


@dataclass(frozen=True)
class Counted:
    """The runs of one source that count as evidence, and the folder of each."""

    members: tuple[tuple[StudyRun, Path], ...]
    first: int
    superseded: tuple[str, ...]


def counted_runs(published: Path, local: Path | None = None) -> dict[Source, Counted]:
    """The runs that count, published or made here. Seeds of one configuration come from as many folders as there are,
    but where folders hold the same seed with other keys it was trained anew, and one of them speaks for the
    configuration: see `_together`.
    """
    made: dict[Source, dict[Any, dict[Path, list[StudyRun]]]] = {}
    first: dict[Source, int] = {}
    for folder in (*folders(published), *(folders(local) if local else ())):
        if folder.comparable and (folder.path / FILE).is_file():
            for run in folder.runs:
                group = made.setdefault((folder.study, run.dataset, folder.preset), {})
                group.setdefault((run.spec, run.outputs, run.horizon), {}).setdefault(folder.path, []).append(run)
            for dataset in {run.dataset for run in folder.runs}:
                there = 1 + max(run.seed for run in folder.runs if run.dataset == dataset)
                source = (folder.study, dataset, folder.preset)
                first[source] = min(there, first.get(source, there))
    found = {}
    for source, configurations in made.items():
        members: list[tuple[StudyRun, Path]] = []
        out: dict[tuple[Path, Path], set[str]] = {}
        for (spec, *_), makings in configurations.items():
            kept = _together(makings, local)
            members += {r.seed: (r, path) for path in reversed(kept) for r in makings[path]}.values()
            for path in makings.keys() - set(kept):
                if label(spec).history is not None:
                    out.setdefault((path, kept[0]), set()).add(spec)
        said = [_superseded(source, *pair, specs, (published, local)) for pair, specs in sorted(out.items())]
        found[source] = Counted(tuple(members), max(first[source], FEWEST), tuple(said))
    return found


def _together(makings: Mapping[Path, Sequence[StudyRun]], local: Path | None) -> list[Path]:
    """The folders whose trainings of one configuration count together, the one that speaks for it first.

    That is the one of the newest code, but no single training in place of several; of one code that with most seeds,
    then one made here, then the later path. One that holds a seed of another with another key does not count beside it;
    nor does, if there is one such, what older code trained: it would be a mixture of two.
    """
    paths = list(makings)
    code = {path: min(r.numerics for r in makings[path]) for path in paths}
    keys = {path: {r.seed: r.key for r in makings[path]} for path in paths}

    def rank(path: Path) -> tuple[int, int, int, bool, int]:
        here = local is not None and path.is_relative_to(local)
        return min(len(keys[path]), FEWEST), code[path], len(keys[path]), here, paths.index(path)

    def agree(a: Path, b: Path) -> bool:
        return all(keys[a][seed] == keys[b][seed] for seed in keys[a].keys() & keys[b].keys())

    best, *others = sorted(paths, key=rank, reverse=True)
    anew = not all(agree(best, other) for other in others)
    kept = [best]
    for other in others:
        if all(agree(other, k) for k in kept) and not (anew and code[other] < code[best]):
            kept.append(other)
    return kept


def _superseded(source: Source, out: Path, kept: Path, specs: Collection[str], roots: Sequence[Path | None]) -> str:
    def named(path: Path) -> str:
        return next((path.relative_to(r).as_posix() for r in roots if r and path.is_relative_to(r)), path.name)

    study, dataset, _ = source
    return (
        f"{study} on {dataset} was trained anew in part: {named(kept)} counts, and {named(out)} does not, for "
        f"{', '.join(sorted(specs))}."
    )


def _assemble(source: Source, counted: Counted) -> Evidence:
    tables, members = [], counted.members
    for path in dict.fromkeys(path for _, path in members):
        try:
            table = pq.read_table(path / FILE, read_dictionary=list(NAMES))
            wanted, keys = {run.key for run, source in members if source == path}, table["key"].combine_chunks()
            counts = np.array([key in wanted for key in keys.dictionary.to_pylist()])
            tables.append(table if counts.all() else table.filter(pa.array(counts[keys.indices.to_numpy()])))
        except (OSError, ValueError, KeyError, pa.ArrowException) as error:
            raise BenchError(f"{path / FILE} is damaged: run the study again.") from error
    steps = pa.concat_tables(tables).unify_dictionaries().to_pandas()
    return Evidence(*source, tuple(run for run, _ in members), steps, counted.first, counted.superseded)
