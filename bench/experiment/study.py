"""A study: one comparison of the paper, declared as the runs it consists of."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from registry import outline
from registry.core import entry_points
from registry.errors import BenchError, near

if TYPE_CHECKING:  # they load torch, and a study's name is wanted at once
    from bench.experiment.config import RunConfig
    from registry.contracts import Dataset

PRESETS = ("smoke", "laptop", "evening", "paper")


@dataclass(frozen=True)
class Reference:
    """A simulation error that others published, shown beside those of the runs."""

    dataset: str
    quantity: str
    """Channel and test recording, "level.h@validation"."""
    model: str
    rmse: float
    """Root mean square, SI."""
    source: str
    """Citation."""


@dataclass(frozen=True)
class Study:
    """One comparison."""

    name: str
    title: str
    """One line: what is compared."""
    question: str
    """What the paper claims, in a sentence or two."""
    source: str
    """Section and figure of the paper."""
    default_dataset: str
    runs: "Callable[[str, Dataset], list[RunConfig]]"
    """Preset and data set → every run, baselines included."""
    pairs: tuple[tuple[str, str], ...]
    """(a, b) specs or patterns of them, "LSTM: * - MLP: *", whose errors are compared: does a beat b?"""
    contrasts: tuple[tuple[str, str], ...] = ()
    """(a, b) quantities whose errors are compared within each spec, such as ("velocity", "velocity_forced")."""
    paper_says: str = ""
    """What the paper's figure shows, in words and numbers; a line a paragraph. Empty: the question says it."""
    references: "Callable[[], tuple[Reference, ...]] | None" = None
    """Published figures that its table shows beside the runs; None: there are none."""
    presets: Mapping[str, str] = field(default_factory=dict)
    """What each preset is, in a line."""


def titles() -> dict[str, str]:
    """Name → title of every study, by name; read from the sources as far as they tell."""
    return _by_name("title")


def default_datasets() -> dict[str, str]:
    """Name → default data set of every study, by name; read from the sources as far as they tell."""
    return _by_name("default_dataset")


def _by_name(attribute: str) -> dict[str, str]:
    found: dict[str, str] = {}
    for point in entry_points(group="multistep_bench.studies"):
        told = outline.keywords(outline.source_of(point.module) or "", point.attr)
        if "name" not in told or attribute not in told:  # only importing them tells
            return {name: getattr(s, attribute) for name, s in studies().items()}
        found[told["name"]] = told[attribute]
    return dict(sorted(found.items()))


def studies() -> dict[str, Study]:
    """All studies, by name; third parties add theirs through the entry-point group of the same name."""
    found: dict[str, Study] = {}
    for point in entry_points(group="multistep_bench.studies"):
        try:
            study: Study = point.load()
        except Exception as error:
            raise BenchError(f"The study {point.name!r} ({point.value}) fails to import: {error}.") from error
        if study.name in found:
            raise BenchError(f"Two studies are called {study.name!r}: rename the one of {point.value}.")
        found[study.name] = study
    return dict(sorted(found.items()))


def get(name: str) -> Study:
    """The study called ``name``.

    Raises:
        BenchError: no such study; the message lists the near names.
    """
    if name not in titles():
        raise BenchError(f"There is no study {name!r}: {near(name, titles())}")
    return studies()[name]
