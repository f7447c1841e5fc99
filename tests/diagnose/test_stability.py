"""Answers on real recordings stay where they are when what was taken for granted changes (`tests/stability.py`).

EMPS is in `test_emps`. What does not hold, and is not asserted: on nanodrone the names stay, and drag and flapping go
with the stated mass, since accelerations tell forces over the mass only.
"""

import pytest
from stability import CHANGES, moved

from bench.diagnose import discover, load
from bench.diagnose.logs.subject import Subject
from bench.diagnose.select.discovery import Discovery

Answer = tuple[Subject, Discovery]
CONSTANTS = ("every second constant 20 % higher, the others lower", "the other way round")


@pytest.fixture(scope="module")
def tanks(bench_data: object) -> Answer:
    subject = load("cascaded_tanks")
    return subject, discover(subject)


@pytest.mark.data
@pytest.mark.slow
@pytest.mark.parametrize("change", [*CONSTANTS, "every second sample"])
def test_the_overflow_of_both_tanks_stays(tanks: Answer, change: str) -> None:
    subject, before = tanks
    assert [f.id for f in before.found] == ["overflow"]
    assert not moved(before, discover(CHANGES[change](subject)))
