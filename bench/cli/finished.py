"""What was finished in a results folder, looked up by the name that a user gives it."""

import re
from collections.abc import Iterable
from pathlib import Path
from typing import TypeVar

from bench.cli.names import check_target
from bench.experiment import study
from bench.records.finished import FinishedStudy, finished_studies
from registry.errors import BenchError

T = TypeVar("T")
TITLE = re.compile(r"(?P<name>.+) on (?P<dataset>.+?)(?: \((?P<preset>\w+)\))?(?:, .*)?")
"""Of a finished study, as `bench run` makes it: what, on which data, preset, options."""


def sweep_page(name: str, dataset: str | None, preset: str | None, results: Path) -> Path | None:
    """The page of the sweep of that name; of its target too where no finished study is meant. None: there is none.

    Raises:
        BenchError: the sweep has not ended.
    """
    from bench.sweep import journal as sweeps

    known = {folder: sweeps.read(folder)[0] for folder in sweeps.sweeps(results)}
    found = [f for f, sweep in known.items() if name in (f.name, sweep.title)]
    if not found and not _fitting(((c, c.title) for c in finished_studies(results)), name, dataset, preset):
        found = _fitting(((f, s.title.removeprefix("sweep of ")) for f, s in known.items()), name, dataset, preset)
    if len(found) > 1:
        raise BenchError(f"{len(found)} sweeps fit: give one of {'; '.join(f.name for f in found)}.")
    if not found:
        return None
    page = found[0] / sweeps.REPORT
    if not page.is_file():
        raise BenchError(f"The sweep {found[0].name} has not ended: go on with `{known[found[0]].command} --resume`.")
    return page


def _fitting(titled: Iterable[tuple[T, str]], name: str, dataset: str | None, preset: str | None) -> list[T]:
    """Those whose title says this name, data set and preset."""
    return [
        each
        for each, title in titled
        if (match := TITLE.fullmatch(title))
        and match["name"] == name
        and dataset in (None, match["dataset"])
        and preset in (None, match["preset"])
    ]


def finished_study(name: str, dataset: str | None, preset: str | None, results: Path) -> FinishedStudy:
    """The finished study of that name (of its folder, of its title), data set and preset.

    Raises:
        BenchError: none, or several; the sentence lists them.
    """
    every = list(finished_studies(results))
    exact = [c for c in every if name in (c.folder.name, c.title)]
    fitting = exact or _fitting(((c, c.title) for c in every), name, dataset, preset)
    if len(fitting) == 1:
        return fitting[0]
    if fitting:
        listed = "; ".join(c.folder.name for c in fitting)
        raise BenchError(f"{len(fitting)} finished studies fit: give --dataset, --preset, or one of {listed}.")
    if name not in study.titles() and not _fitting(((c, c.title) for c in every), name, None, None):
        check_target(name)
    if not every:
        raise BenchError(f"No study is finished in {results}: start one with `bench run {name}`.")
    listed = "; ".join(c.folder.name for c in every)
    raise BenchError(f"No finished study fits: start it with `bench run {name}`, or give one of {listed}.")
