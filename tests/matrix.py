"""Every predictor and every study on every data set with default options but next to no training: a table.

python tests/matrix.py [DATASET|FOLDER ...] [--studies] [--write FILE.md]

A cell says that it ran, or has the number of the sentence that refuses it. Data sets whose files are not at hand are
read from files made in their format (`tests/site_files.py`).
"""

import argparse
import os
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path

from click.testing import CliRunner
from site_files import write_missing

from bench.claims.manifest import entered
from bench.cli import cli
from bench.experiment.study import studies
from registry.cache import cache_folder
from registry.core import DATASETS, PREDICTORS
from registry.errors import BenchError

RAN = "ran"
LITTLE = ("training.updates=20", "training.evaluate_every=20", "training.batch=16", "train_stride=20", "test_stride=50")


HEAD = (
    "# What runs on what",
    "",
    "`python tests/matrix.py --write results/published/matrix.md`",
    "",
    "`bench run PREDICTOR --dataset DATASET` with default options but for small networks and 20 updates. A number is",
    "that of the sentence, below, with which it is refused. *: read from a made-up file in the published format.",
    "",
)


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


def files_of_all(place: Path) -> list[str]:
    """Point `BENCH_DATA` to a folder that has every data set's files; the data sets of which they were made up."""
    before = {n for n in registered() if "download" in attempt("constant", n, place)}
    at_hand = Path(os.environ.get("BENCH_DATA", ""))
    write_missing(place / "data")
    for folder in at_hand.iterdir() if at_hand.name else ():
        if not (place / "data" / folder.name).exists():
            (place / "data" / folder.name).symlink_to(folder)
    os.environ["BENCH_DATA"] = str(place / "data")
    return sorted(before)


def markdown(rows: Iterable[tuple[str, str, str]], made: Iterable[str]) -> list[str]:
    """A table of what was tried (name, data set, outcome) and the numbered sentences."""
    cells = {(name, dataset): said for name, dataset, said in rows}
    names, datasets = (list(dict.fromkeys(key[i] for key in cells)) for i in (0, 1))
    said: dict[str, int] = {}
    lines = ["| |" + "".join(f" {d}{'*' * (d in made)} |" for d in datasets), "|---" * (len(datasets) + 1) + "|"]
    for name in names:
        shown = []
        for dataset in datasets:
            sentence = cells[name, dataset].replace(dataset, "DATASET")
            sentence = sentence.replace(os.environ.get("BENCH_DATA", "$BENCH_DATA"), "$BENCH_DATA")
            sentence = sentence.replace(str(cache_folder()), "the cache folder")
            shown.append(RAN if sentence == RAN else f"[{said.setdefault(sentence, len(said) + 1)}]")
        lines.append(f"| {name} | " + " | ".join(shown) + " |")
    return [*lines, "", *(f"{number}. {sentence}" for sentence, number in said.items()), ""]


def main() -> None:
    """Make the tables and print them as they grow."""
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("datasets", nargs="*")
    asked.add_argument("--studies", action="store_true", help="every study too, preset smoke")
    asked.add_argument("--write", type=Path)
    given = asked.parse_args()
    lines = [*HEAD]
    with tempfile.TemporaryDirectory() as place:
        made = files_of_all(Path(place))
        for make, title in ((single, "Predictors"), (whole, "Studies"))[: 1 + given.studies]:
            rows = []
            for row in make(given.datasets or registered(), Path(place)):
                rows.append(row)
                print("| " + " | ".join(row) + " |", flush=True)
            lines += [f"## {title}", "", *markdown(rows, made)]
    if given.write:
        given.write.write_text("\n".join(lines), encoding="utf-8")
        entered(given.write)


if __name__ == "__main__":
    main()
