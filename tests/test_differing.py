"""Recordings that differ in a number are said to, with the numbers of each; those that are alike are not."""

from pathlib import Path

import pytest
from simulated_fleet import vehicle

from bench.diagnose import diagnose
from bench.diagnose.report.sentences import explanation, headline


def carts(folder: Path, sizes: tuple[float, ...], kind: str) -> Path:
    """Recordings of one cart with one hidden effect, of another size in each."""
    for i, size in enumerate(sizes):
        vehicle(folder / "all", kind, i, size=size, recordings=1, seconds=12.0)
        (folder / "all" / "run_0.csv").rename(folder / f"run_{i}.csv")
    (folder / "all" / "dataset.toml").rename(folder / "dataset.toml")
    return folder


@pytest.mark.parametrize(
    ("kind", "parameter", "scale", "sizes", "near"),
    [
        ("offset_force", "f_0", 0.4, (1, -1, 0.5, -1), 0.05),
        ("offset_force", "f_0", 0.4, (1, -1, 0.5, -1, 2, 1), 0.05),
        # The damping that all have in common was fitted beside one drag for all, and shares what it does.
        ("quadratic_drag", "c", 0.5, (0.2, 1.5, 0.2, 1.5), 0.2),
    ],
)
def test_each_recording_has_a_number_of_its_own(
    tmp_path: Path, kind: str, parameter: str, scale: float, sizes: tuple[float, ...], near: float
):
    said, _ = diagnose(carts(tmp_path, sizes, kind), brief=True)
    told = said.differing
    assert told is not None and told.effects == (kind,) and told.share > 0.9
    found = [told.by_recording[f"run_{i}"][parameter] for i in range(len(sizes))]
    assert [p.value for p in found] == pytest.approx([scale * s for s in sizes], rel=near, abs=0.01)
    assert all(p.low <= p.value <= p.high for p in found)
    assert not any(e.learned for e in said.effects), "what one number for all leaves is no term of its own"
    assert f"Recordings differ in {kind.replace('_', ' ')}" in explanation(said)
    assert "--each-recording" in explanation(said)
    assert said.verdict != "unknown_effect" or "differ in" in headline(said)


def test_recordings_that_are_alike_do_not_differ(tmp_path: Path):
    """What the catalogue at hand lacks is left in all of them alike."""
    folder = carts(tmp_path, (1, 1, 1, 1), "cubic_stiffness")
    said, _ = diagnose(folder, catalogue=["offset_force", "quadratic_drag", "viscous_friction"], brief=True)
    assert said.verdict == "unknown_effect" and said.differing is None
