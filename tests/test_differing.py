"""Recordings that differ in a number are said to, with the numbers of each; those that are alike are not."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from simulated_fleet import vehicle

from bench.diagnose import diagnose
from bench.diagnose.logs.load import subject_of
from bench.diagnose.logs.noise import noise_of
from bench.diagnose.regression.least_squares import Normal
from bench.diagnose.regression.parameters import Entry
from bench.diagnose.report.sentences import explanation, headline
from bench.diagnose.select.differing import _Judged, _Option, _own_inside, _simplest, differing
from bench.diagnose.select.subset import Fit, t_value
from bench.diagnose.settings import CHOOSING, DIFFERING
from registry.core import EFFECTS


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
        # One offset for all of these is hardly more than a hysteresis that remembers where each begins.
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
    assert all(e.id == kind for e in said.effects), "what one number for all leaves is no term of its own"
    assert f"Recordings differ in {kind.replace('_', ' ')}" in explanation(said)
    assert "--each-recording" in explanation(said)
    assert said.verdict != "unknown_effect" or "differ in" in headline(said)


def test_what_all_recordings_have_is_not_what_they_differ_in(tmp_path: Path):
    """Each has an offset of its own; the force that a hardening spring wants more is in what was logged."""
    subject = subject_of(carts(tmp_path, (1, -1, 0.5, -1), "offset_force"))
    logs = (replace(log, inputs=log.inputs + 30 * log.states[:, :1] ** 3) for log in subject.logs)
    subject = replace(subject, logs=tuple(logs))
    hardening = replace(subject.model, effects=(EFFECTS.get("cubic_stiffness")(30.0),))
    told, beside = differing(subject, (hardening, subject.model), noise_of(subject), ["offset_force"])
    assert told is not None and told.effects == ("offset_force",) and beside is hardening


def test_recordings_that_are_alike_do_not_differ(tmp_path: Path):
    """What the catalogue at hand lacks is left in all of them alike."""
    folder = carts(tmp_path, (1, 1, 1, 1), "cubic_stiffness")
    said, _ = diagnose(folder, catalogue=["offset_force", "quadratic_drag", "viscous_friction"], brief=True)
    assert said.verdict == "unknown_effect" and said.differing is None


def test_parts_of_a_recording_are_one_recording(tmp_path: Path):
    """Few long recordings are cut in parts; what differs is the recordings' all the same."""
    for i, size in enumerate((1, -1)):
        vehicle(tmp_path / "all", "offset_force", i, size=size, recordings=1, seconds=60.0)
        (tmp_path / "all" / "run_0.csv").rename(tmp_path / f"run_{i}.csv")
    (tmp_path / "all" / "dataset.toml").rename(tmp_path / "dataset.toml")
    said, _ = diagnose(tmp_path, catalogue=["offset_force", "quadratic_drag", "viscous_friction"], brief=True)
    assert any("cut in parts" in note for note in said.evidence.notes)
    assert said.differing is not None and [*said.differing.by_recording] == ["run_0", "run_1"]
    assert [p["f_0"].value for p in said.differing.by_recording.values()] == pytest.approx([0.4, -0.4], rel=0.05)


BLOCKS, ROWS = 16, 50
"""Of each recording, and of a block."""


def judged(number: Callable[[int, np.ndarray], np.ndarray], noise: float, recordings: int = 4) -> _Judged:
    """One effect in recordings that leave ``number(recording, share of its time)`` times a signal, and noise."""
    random, parts = np.random.default_rng(5), {}
    for recording in range(recordings):
        signal = random.normal(size=BLOCKS * ROWS)
        left = number(recording, np.linspace(0, 1, len(signal))) * signal + noise * random.normal(size=len(signal))
        rows = np.stack([signal, left])
        parts[str(recording)] = [Normal(((np.arange(2), rows),), 2, np.zeros(BLOCKS, int), np.full(BLOCKS, ROWS))]
    fit = Fit(starts=(), columns=(0,), beta=np.zeros(1), misfit=0.0, prior=0.0, parameters=1)
    anything = np.full(1, np.inf)
    told = {"values": lambda b: {"k": b[0]}, "units": {"k": "N"}, "inside": lambda b: True}
    return _Judged(_Option(("pull",), fit, (0,), -anything, anything, **told), parts)  # type: ignore[arg-type]


def test_numbers_that_differ_are_told_with_intervals_that_hold_them():
    told = judged(lambda recording, _: recording - 1.5, noise=2.0)
    assert told.sure
    for recording, numbers in told.numbers.items():
        assert numbers["k"].low < int(recording) - 1.5 < numbers["k"].high
        half = (numbers["k"].high - numbers["k"].low) / 2
        assert half == pytest.approx(1.96 * 2.0 / (BLOCKS * ROWS) ** 0.5, rel=0.6)


def test_what_drifts_within_recordings_is_no_difference_between_them():
    told = judged(lambda recording, time: 0.6 * (recording - 1.5) + 1.5 * (time > 0.5), noise=0.1)
    assert t_value(told.saved) > CHOOSING.significant and not told.sure


def test_what_is_alike_or_noise_is_no_difference():
    assert not judged(lambda recording, _: 0.0, noise=1.0).sure


def test_what_wanders_within_recordings_is_no_difference_between_them():
    """Gusts: their means over recordings differ, and blocks that follow each other are alike."""
    sure = []
    for seed in range(20):
        noise = np.random.default_rng(seed).normal(size=(20, 220))
        gusts = [np.convolve(x, np.ones(60), "valid") / 60**0.5 for x in noise]

        def number(recording: int, time: np.ndarray, of: list[np.ndarray] = gusts) -> np.ndarray:
            return np.interp(time, np.linspace(0, 1, 161), of[recording])

        told = judged(number, noise=0.1, recordings=20)
        assert t_value(told.saved) > CHOOSING.significant, "the blocks between tell that much"
        sure.append(told.sure)
    assert sum(sure) <= 1


def test_what_four_blocks_of_one_recording_show_is_not_sure():
    told = judged(lambda recording, time: 3.0 * (recording == 0) * (abs(time - 0.5) < 0.125), noise=0.1)
    kept = sum(told._transferred(gram) for gram in told.grams.values())
    assert kept > DIFFERING.kept * float(told.saved.sum()) > 0 and not told.sure


@pytest.mark.parametrize(("low", "high", "inside"), [(-2.0, 2.0, True), (0.0, 2.0, True), (-1.0, 2.0, False)])
def test_a_number_at_a_bound_is_none_unless_there_is_no_effect(low: float, high: float, inside: bool):
    """Two recordings have no effect, one hardly any and one the opposite of it, which a drag has not."""
    told = judged(lambda recording, _: (0.0, 1.0, 0.1, -1.5)[recording], noise=0.01)
    k = Entry(0, "k", None, "N", 0.0, 1.0, low, high)
    option = replace(told.option, low=np.array([low]), high=np.array([high]), inside=_own_inside([k]))
    assert _Judged(option, told.parts).inside is inside


def test_the_share_is_of_what_noise_does_not_leave():
    told = judged(lambda recording, _: recording - 1.5, noise=2.0)
    noise = np.array([4.0 * 4 * BLOCKS * ROWS])
    assert told.share(np.zeros(1)) < DIFFERING.most < 0.9 < told.share(noise)


def test_of_effects_that_explain_as_much_the_simplest_is_told():
    one, other = judged(lambda recording, _: recording, 0.1), judged(lambda recording, _: recording, 0.1)
    free = _Option(("free",), other.option.fit, (0, 0), *[np.full(2, np.inf)] * 2, dict, {}, lambda b: True)
    object.__setattr__(other, "option", free)
    object.__setattr__(other, "left", one.left * 0.99)
    assert _simplest([other, one], everything=1e6) == (one, ("free",))
    object.__setattr__(other, "left", one.left - 2e5)
    assert _simplest([other, one], everything=1e6) == (other, ())
