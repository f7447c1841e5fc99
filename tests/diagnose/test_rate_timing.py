"""A rate that is filed late against the signal of which it is the derivative."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from undriven import undriven

from bench.diagnose import diagnose
from bench.diagnose.logs.consistency import pairs
from bench.diagnose.logs.rate_timing import rates_in_time, shift_of
from bench.diagnose.logs.subject import Subject
from registry.core import EFFECTS

DT, DAMPING = 0.01, 0.1


def swings(late: float) -> Subject:
    """Six swings of a damped pendulum (l = 1 m), their rates filed ``late`` samples late."""
    starts = np.random.default_rng(1).uniform(-1.5, 1.5, (6, 2)).tolist()
    subject = undriven("pendulum", [EFFECTS.get("viscous_friction")(f_v=DAMPING)], starts, DT, 1500, 1e-4)
    logs = []
    for log in subject.logs:
        states, at = log.states.clone(), np.arange(len(log))
        states[:, 1] = states.new_tensor(CubicSpline(at, states[:, 1].numpy())(at - late))
        logs.append(replace(log, states=states))
    return replace(subject, logs=tuple(logs))


@pytest.mark.parametrize("late", [-0.7, 0.0, 0.5, 2.0])
def test_a_rate_is_read_when_it_was_what_it_says(late: float) -> None:
    subject = swings(late)
    (pair,) = pairs(subject.model, subject.logs[0].measured)
    for log in subject.logs:
        assert shift_of(log, pair) == pytest.approx(late, abs=0.02)
    read = rates_in_time(subject)
    if not late:
        assert read.notes == subject.notes
    for seen, true in zip(read.logs, swings(0.0).logs, strict=True):
        inside = slice(4, -4)
        assert seen.states[inside, 1].numpy() == pytest.approx(true.states[inside, 1].numpy(), abs=0.02)
        assert seen.states[:, 0].equal(true.states[:, 0])


def test_a_late_rate_hides_no_damping() -> None:
    """Half a sample, as of differences to the sample before, makes g/l · 5 ms = .05 1/s of the damping of .1 vanish."""
    said, _ = diagnose(swings(0.5), brief=True)
    assert (said.verdict, [e.id for e in said.effects]) == ("named", ["viscous_friction"])
    found = said.effects[0].parameters["f_v"]
    assert found.low <= DAMPING <= found.high and found.value == pytest.approx(DAMPING, rel=0.05)
