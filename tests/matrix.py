"""Every predictor and every study on every data set with default options but next to no training: a table.

python tests/matrix.py [DATASET|FOLDER ...]
"""

import sys
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path

from click.testing import CliRunner

from bench.cli import cli
from bench.experiment.study import studies
from registry.core import DATASETS, PREDICTORS
from registry.errors import BenchError

RAN = "ran"
LITTLE = ("training.updates=20", "training.evaluate_every=20", "training.batch=16", "train_stride=20", "test_stride=50")


def registered() -> list[str]:
    """Data sets that need no folder."""
    return [n for n in DATASETS.names() if n not in ("folder", "toy")]


def spec(predictor: str) -> str:
    """A small configuration of a predictor."""
    kind = PREDICTORS.get(predictor)
    size = ": 1x4" if kind.network else ""
    return f"{predictor}{size}" + (" - MLP: 4x10" if kind.stateful else "")


def attempt(target: str, dataset: str, results: Path, *more: str) -> str:
    """`RAN`, or the sentence that says why not.

    Raises:
        AssertionError: there is no sentence, or no figure.
    """
    command = ["run", target, "--dataset", dataset, *more, "--no-track", "--workers", "1", "--results", str(results)]
    done = CliRunner().invoke(cli, command)
    if done.exception is None:
        assert "Figure and tables" in done.output, (target, dataset, done.output)
        return RAN
    said = str(done.exception)
    assert isinstance(done.exception, BenchError), (target, dataset, repr(done.exception))
    assert said.endswith((".", "?")) and "\n" not in said, (target, dataset, said)
    return said


def single(datasets: Iterable[str], results: Path) -> Iterator[tuple[str, str, str]]:
    """Predictor, data set, outcome."""
    little = [word for option in LITTLE for word in ("--set", option)]
    for dataset in datasets:
        for predictor in PREDICTORS.names():
            with tempfile.TemporaryDirectory(dir=results) as own:
                yield predictor, dataset, attempt(spec(predictor), dataset, Path(own), *little)


def whole(datasets: Iterable[str], results: Path) -> Iterator[tuple[str, str, str]]:
    """Study, data set, outcome."""
    for dataset in datasets:
        for study in studies():
            with tempfile.TemporaryDirectory(dir=results) as own:
                yield study, dataset, attempt(study, dataset, Path(own), "--preset", "smoke")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as place:
        for make in (single, whole):
            for row in make(sys.argv[1:] or registered(), Path(place)):
                print("| " + " | ".join(row) + " |", flush=True)
