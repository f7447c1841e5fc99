"""Recordings that are too short for a free run: left out where others suffice, else said before any work."""

import re
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from conftest import Typed
from simulated_folders import QUADROTOR, describe_quadrotor, save

from bench.diagnose.compare import compare
from bench.diagnose.diagnose import diagnose
from bench.diagnose.discover import discover
from bench.diagnose.fit import fit_parameters
from bench.diagnose.logs.load import excluding, load
from bench.diagnose.logs.noise import noise_of
from bench.diagnose.logs.parts import least_stretch, refuse_short
from bench.diagnose.logs.subject import Subject
from bench.diagnose.regression.generic import Dictionary
from bench.diagnose.simulate.predictable import Signals
from bench.diagnose.simulate.teacher_forced import Increments
from registry.errors import BenchError
from registry.physics.quadrotor import Quadrotor

Write = Callable[[Sequence[int]], Path]
STEPS = (
    ("data", "check"),
    ("compare",),
    ("locate",),
    ("discover",),
    ("extend", "--add", "rotor_drag", "--no-track"),
    ("diagnose",),
)
SHORT = "The longest stretch of valid samples in the recordings to "


@pytest.fixture(scope="module")
def twin() -> Subject:
    return load("pelican_twin")


@pytest.fixture
def write(twin: Subject, tmp_path: Path) -> Write:
    """Flights of so many samples at 100 Hz, as the folder of a user."""
    model = twin.model
    assert isinstance(model, Quadrotor)
    names = ("mass", "inertia", "thrust_coefficient", "torque_coefficient", "rotor_positions", "rotor_directions")

    def flights(counts: Sequence[int]) -> Path:
        folder = tmp_path / "flights"
        for i, count in enumerate(counts):
            log = twin.logs[i]
            assert log.rate == 100
            states, inputs = (x[500 : 500 + count].numpy() for x in (log.states, log.inputs[:, :4]))
            order = [*range(6), 9, 6, 7, 8, *range(10, 13)]
            save(folder, i, np.column_stack([np.arange(count) / 100, states[:, order], inputs]), QUADROTOR)
        physics = {n: getattr(model, n) for n in names}
        physics = {n: list(v) if isinstance(v, tuple) else v for n, v in physics.items()}
        describe_quadrotor(folder, 100, "linear", **physics)
        return folder

    return flights


@pytest.mark.parametrize("count", [2, 3, 6, 11, 21, 41])
def test_every_step_and_the_check_refuse_flights_in_which_no_free_run_fits(
    count: int, write: Write, typed: Typed
) -> None:
    """They had ended with an IndexError, a ValueError or a segmentation fault, and the check had found nothing."""
    folder = write([count] * 4)
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        for words in STEPS:
            code, told, said = typed(*words, folder)
            assert code == 2, (words, said)
            assert said.startswith(f"bench: {SHORT}learn from is {count / 100:.2g} s, and a free run of 0.5 s"), words
            assert said.endswith("record longer.\n") and said.count("\n") == 1 and "Next:" not in told
    assert not (folder / "diagnosis").exists()


def test_from_python_too_short_flights_are_refused(write: Write) -> None:
    subject = load(write([41] * 4))
    for step in (discover, diagnose):
        with pytest.raises(BenchError, match=SHORT):
            step(subject)
    for other in (subject, load(write([3] * 4))):
        with pytest.raises(BenchError, match="No recording to compare with has"):
            compare(other)
    with pytest.raises(BenchError, match=re.escape("No recording to compare with has 0.51 s of valid samples")):
        fit_parameters(subject, subject.model)


def test_what_is_needed_is_a_free_run_and_what_the_filter_reaches(write: Write) -> None:
    subject = load(write([61] * 4))
    half = noise_of(subject).half_width
    assert half > 0 and least_stretch(subject) == 51 + 2 * half
    refuse_short(load(write([51 + 2 * half] * 4)))
    with pytest.raises(BenchError, match=SHORT):
        refuse_short(load(write([50 + 2 * half] * 4)))


def test_short_flights_are_left_out_beside_a_long_one_which_is_cut_in_parts(write: Write, typed: Typed) -> None:
    folder = write([1200, 21, 21, 21])
    subject = load(folder)
    assert subject.left_out == ("run_1", "run_2", "run_3")
    assert [log.name for log in subject.logs] == [f"run_0_{i}of5" for i in range(1, 6)]
    assert set(subject.training) | set(subject.held_out) == {log.name for log in subject.logs}
    note = "3 recordings are left out, without the 0."
    assert sum(note in n for n in subject.notes) == 1
    for words in (("data", "check"), ("compare",)):
        code, told, said = typed(*words, folder)
        assert code == 0 and (told + said).count(note) == 1 and ": run_1, run_2, run_3.\n" in told + said
    assert {f.id for f in discover(subject, ["wind", "rotor_drag"]).found} <= {"wind", "rotor_drag"}


def test_others_are_parted_anew_where_those_to_test_on_are_too_short(write: Write) -> None:
    subject = load(write([400, 400, 21, 21]))
    assert subject.left_out == ("run_2", "run_3")
    assert sorted((*subject.training, *subject.held_out)) == ["run_0", "run_1"]
    assert subject.training and subject.held_out and subject.folder is not None
    assert subject.folder.names == ["run_0", "run_1"]
    assert excluding(subject, ["run_3"]) is subject  # it is left out already
    with pytest.raises(BenchError, match="no recording has this name"):
        excluding(subject, ["run_7"])


def test_one_flight_beside_short_ones_is_cut_where_its_parts_hold_a_free_run(write: Write) -> None:
    subject = load(write([400, 21, 21, 21]))
    assert subject.left_out == ("run_1", "run_2", "run_3") and len(subject.logs) == 5
    refuse_short(subject)


def test_one_flight_whose_parts_would_be_too_short_is_refused(write: Write) -> None:
    with pytest.raises(BenchError, match=f"{SHORT}learn from is 0.4 s"):
        refuse_short(load(write([200, 21, 21, 21])))


def test_enough_flights_are_left_as_they_are(write: Write) -> None:
    subject = load(write([200] * 4))
    assert subject.left_out == () and len(subject.logs) == 4
    refuse_short(subject)


def test_equations_are_not_judged_over_windows_that_do_not_fit() -> None:
    ones = np.ones((1, 1, 9))
    words = Dictionary((), ones, ones[..., None], (np.arange(1),), ("force x",), np.ones(1))
    left = Increments(np.ones((1, 9, 1)), np.ones((1, 9), dtype=bool))
    assert len(Signals(words, (0,), 0.01).folds(left, 9)) == 1
    with pytest.raises(BenchError, match=re.escape("No recording has 0.1 s of valid samples in a row")):
        Signals(words, (0,), 0.01).folds(left, 10)
