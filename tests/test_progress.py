"""The share of a diagnosis that is done and the time left, by a clock of our own."""

import io

import pytest
from rich.console import Console

from bench.cli import progress, stages
from bench.cli.stages import DIAGNOSE, EARLY, StageProgress


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    now = [100.0]
    monkeypatch.setattr(stages.time, "monotonic", lambda: now[0])
    return now


@pytest.mark.parametrize("pace", [0.5, 3.0])
def test_stages_that_take_what_they_cost_tell_the_time_left(clock: list[float], pace: float) -> None:
    course, total = StageProgress(DIAGNOSE), sum(seconds for seconds, _ in DIAGNOSE.values())
    course.begin("read")
    assert not course.share
    assert course.left is None
    for name, (seconds, count) in DIAGNOSE.items():
        for i in range(count):
            course.begin(name if i == 0 else f"something {i}")
            done = (clock[0] - 100.0) / pace
            assert course.share == pytest.approx(done / total, abs=1e-9)
            clock[0] += pace * seconds / count
            if done:
                assert course.share == pytest.approx((done + seconds / count) / total, abs=1e-9)
            if done / total > EARLY:
                assert course.left == pytest.approx(pace * (total - done - seconds / count), abs=1e-6)


def test_a_stage_that_takes_long_does_not_pass_its_end(clock: list[float]) -> None:
    course = StageProgress({"first": (1.0, 1), "second": (1.0, 1), "third": (2.0, 1)})
    course.begin("first")
    clock[0] += 1
    course.begin("second")
    clock[0] += 50
    assert course.share == pytest.approx(0.5)
    course.begin("third")
    course.begin("first")  # said again: it goes on from where it is
    assert course.share == pytest.approx(1.0)


def test_the_bar_does_not_go_back(clock: list[float]) -> None:
    course = StageProgress({"first": (1.0, 1), "second": (8.0, 4)})
    course.begin("first")
    clock[0] += 1
    course.begin("second")
    clock[0] += 3
    before = course.share
    course.begin("the next of four")  # sooner than four of them would be done at that pace
    assert before == course.share == pytest.approx(4 / 9)


def test_nothing_is_said_of_what_nobody_foresees(clock: list[float]) -> None:
    course = StageProgress(DIAGNOSE)
    course.begin("noise")
    clock[0] += 1
    course.begin("learned terms")
    assert course.share is course.left is None
    assert StageProgress({}).left is None


@pytest.mark.parametrize("terminal", [True, False])
def test_share_and_time_left_are_shown_on_a_terminal_only(clock: list[float], terminal: bool) -> None:
    out = io.StringIO()
    with progress.announcer(Console(file=out, force_terminal=terminal, width=120), DIAGNOSE) as tick:
        tick("check the data")
        clock[0] += 1
        tick("weigh")
    said = "about 0:" in out.getvalue(), "%" in out.getvalue()
    assert said == (terminal, terminal)
