"""Few long recordings are cut in parts, so that what one of them alone shows is learnt and tested."""

from pathlib import Path

import numpy as np
import pytest
from hardening import CUBIC, carts

from bench.diagnose import diagnose
from bench.diagnose.logs.load import load
from bench.diagnose.logs.parts import in_parts
from registry.errors import BenchError


@pytest.fixture(scope="module")
def three(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three recordings, of which the second alone, by name the one in the middle, moves far."""
    return carts(tmp_path_factory.mktemp("few") / "carts", {"a": 0.05, "b": 2.0, "c": 0.05}, 40.0)


def test_what_one_of_three_recordings_shows_is_found(three: Path) -> None:
    told, _ = diagnose(three, brief=True)
    assert [e.id for e in told.effects] == ["cubic_stiffness"]
    (number,) = told.effects[0].parameters.values()
    assert number.low < CUBIC < number.high
    assert number.high - number.low < 0.1 * CUBIC


def test_every_recording_is_learnt_from_and_tested(three: Path) -> None:
    whole = load(three)
    cut = in_parts(whole)
    learnt, tested = ({n.split("_")[0] for n in names} for names in (cut.training, cut.held_out))
    assert learnt == tested == {"a", "b", "c"}
    assert not set(cut.training) & set(cut.held_out)
    assert in_parts(cut) is cut
    for log in whole.logs:  # no sample is lost, moved or used twice
        parts = [p for p in cut.logs if p.name.startswith(log.name)]
        for of, own in ((log.states, "states"), (log.inputs, "inputs"), (log.valid, "valid")):
            assert np.array_equal(np.concatenate([getattr(p, own) for p in parts]), of)
        assert np.array_equal(np.concatenate([p.recording.outputs for p in parts]), log.recording.outputs)


@pytest.mark.parametrize(("count", "seconds"), [(6, 40.0), (3, 25.0)], ids=["enough recordings", "too short to cut"])
def test_whole_recordings_are_held_out(tmp_path: Path, count: int, seconds: float) -> None:
    subject = load(carts(tmp_path / "carts", dict.fromkeys("abcdef"[:count], 0.5), seconds))
    assert in_parts(subject).logs is subject.logs


def test_the_clock_runs_on_through_the_parts_of_a_single_recording(tmp_path: Path) -> None:
    one = load(carts(tmp_path / "one", {"a": 1.0}, 40.0))
    assert len(one.logs) == 5
    time = np.concatenate([log.inputs[:, one.model.extras.index("time") + 1] for log in one.logs])
    np.testing.assert_allclose(time, np.arange(len(time)) / one.logs[0].rate, atol=1e-9)


def test_a_single_short_recording_is_learnt_from_and_tested(tmp_path: Path) -> None:
    one = load(carts(tmp_path / "one", {"a": 1.0}, 4.0))
    assert len(one.logs) == 5 and one.training and one.held_out
    assert sum(map(len, one.logs)) < 500
    assert "cut into 5 parts" in one.notes[0]
    with pytest.raises(BenchError, match="one recording of fewer than 500 samples"):
        load(carts(tmp_path / "none", {"a": 1.0}, 0.8))
