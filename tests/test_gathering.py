"""Which trainings count as evidence where a configuration was trained more than once."""

import json
from collections.abc import Iterable
from pathlib import Path

import pytest

from bench.claims.evidence import FILE
from bench.claims.gathering import counted_runs
from bench.reporting.study_outputs import PUBLISHED

SPEC, LINEAR = "LSTM: 1x4 - MLP: 4x10", "linear"
PAGE = ("s", "toy", "laptop")
OLD, NEW = 2, 3
"""Versions of the code."""


def trained(folder: Path, code: str, seeds: Iterable[int], numerics: int | None = NEW, spec: str = SPEC) -> None:
    """A finished study of one configuration, whose keys are those of this code; None: published without its version."""
    said = dict.fromkeys(PUBLISHED, 0) | {"dataset": "toy", "spec": spec, "outputs": ["y"], "status": "finished"}
    said |= {"metrics": {"rmsse.y": 1.0}} | ({} if numerics is None else {"numerics": numerics})
    runs = [said | {"key": f"{code}-{seed}", "seed": seed} for seed in seeds]
    folder.mkdir(parents=True)
    (folder / FILE).touch()
    (folder / "study.json").write_text(json.dumps({"study": "s", "command": "bench run s", "runs": runs}))


def keys(root: Path) -> list[str]:
    """Of the runs that count, in the order of their seeds."""
    found = counted_runs(root / "published", root / "here")[PAGE]
    return [r.key for r, _ in sorted(found.members, key=lambda m: m[0].seed)]


def said(root: Path) -> str:
    """What is told of those that do not."""
    return " ".join(counted_runs(root / "published", root / "here")[PAGE].superseded)


def test_further_seeds_count_beside_those_before_them_whichever_code_trained_them(tmp_path: Path) -> None:
    trained(tmp_path / "published" / "b", "old", (0, 1, 2), None)
    trained(tmp_path / "published" / "a", "new", (3,))
    trained(tmp_path / "here" / "c", "newer", (4,), NEW + 1)
    assert keys(tmp_path) == ["old-0", "old-1", "old-2", "new-3", "newer-4"] and not said(tmp_path)


@pytest.mark.parametrize("newer", ["a", "z"])
def test_what_newer_code_trained_anew_counts_alone_wherever_it_lies(tmp_path: Path, newer: str) -> None:
    trained(tmp_path / "published" / "m", "old", (0, 1, 2), OLD)
    trained(tmp_path / "published" / "n", "old", (3, 4, 5), OLD)  # of other seeds, and a mixture all the same
    trained(tmp_path / "published" / newer, "new", (0, 1))
    assert keys(tmp_path) == ["new-0", "new-1"]
    assert f"s on toy was trained anew in part: {newer} counts, and m does not, for {SPEC}." in said(tmp_path)
    assert f"{newer} counts, and n does not" in said(tmp_path)


def test_another_configuration_of_the_same_folders_is_not_touched(tmp_path: Path) -> None:
    trained(tmp_path / "published" / "m", "old", (0, 1, 2), OLD, "LSTM: 1x8 - MLP: 4x10")
    trained(tmp_path / "published" / "n", "new", (0, 1))
    assert keys(tmp_path) == ["old-0", "new-0", "old-1", "new-1", "old-2"] and not said(tmp_path)


def test_one_training_takes_the_place_of_no_three(tmp_path: Path) -> None:
    trained(tmp_path / "published" / "m", "old", (0, 1, 2), OLD)
    trained(tmp_path / "here" / "n", "new", (0,))
    assert keys(tmp_path) == ["old-0", "old-1", "old-2"] and "m counts, and n does not" in said(tmp_path)


@pytest.mark.parametrize(("seeds", "counts"), [((0, 1), "there"), ((0, 1, 2), "here")])
def test_of_one_code_most_seeds_count_then_those_made_here(tmp_path: Path, seeds: tuple[int, ...], counts: str) -> None:
    trained(tmp_path / "published" / "z", "there", (0, 1, 2))
    trained(tmp_path / "here" / "a", "here", seeds)  # another processor
    assert keys(tmp_path) == [f"{counts}-{seed}" for seed in range(3)]


def test_the_same_training_in_two_folders_counts_once(tmp_path: Path) -> None:
    trained(tmp_path / "published" / "m", "old", (0, 1, 2), OLD)
    trained(tmp_path / "here" / "n", "old", (0, 1, 2, 3), OLD)
    assert keys(tmp_path) == ["old-0", "old-1", "old-2", "old-3"] and not said(tmp_path)


def test_of_a_baseline_the_newer_counts_and_nothing_is_said(tmp_path: Path) -> None:
    trained(tmp_path / "published" / "m", "new", (0,), NEW, LINEAR)
    trained(tmp_path / "published" / "z", "old", (0,), None, LINEAR)
    assert keys(tmp_path) == ["new-0"] and not said(tmp_path)
