"""A rate that is filed late against the signal of which it is the derivative."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from test_problems import flights, made
from undriven import undriven

from bench.diagnose import diagnose
from bench.diagnose.logs.consistency import pairs
from bench.diagnose.logs.rate_timing import rates_in_time, shift_of
from bench.diagnose.logs.subject import Subject
from bench.diagnose.select.timing.reading import prepared
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
    assert shift_of(subject.logs, pair) == pytest.approx(late, abs=0.02)
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


def late_vehicle(**late: float) -> Subject:
    """Three flights by inverse dynamics, some of whose signals are filed so many samples late."""
    logs = flights(3, count=3)
    for log in logs:
        at = np.arange(len(log["t"]))
        for signal, by in late.items():
            values = CubicSpline(at, log[signal])(np.clip(at - by, 0, len(at) - 1))
            log[signal] = values / np.linalg.norm(values, axis=1, keepdims=True) if signal == "attitude" else values
    return made(logs)


def told(subject: Subject, what: str) -> list[float]:
    """The milliseconds in what is noted of ``what``."""
    return [float(n.split(" ms")[0].split(" ")[-1]) for n in prepared(subject)[0].notes if what in n]


def test_the_clocks_of_a_vehicle_are_told_apart() -> None:
    """An attitude that is .3 samples late, and an estimator whose position and velocity come .5 samples late."""
    assert not [n for n in prepared(late_vehicle())[0].notes if "clock" in n]
    subject = late_vehicle(attitude=0.3, position=0.5, velocity=0.5)
    assert told(subject, "clock of the attitude") == [pytest.approx(3.0, abs=0.2)]
    assert told(subject, "Position and velocity are filed") == [pytest.approx(2.0, abs=0.4)]  # 3 ms with the attitude
    read, true = prepared(subject)[0].logs[0].states[10:-10], late_vehicle().logs[0].states[10:-10]
    for group, within in ((slice(0, 6), 0.02), (slice(6, 10), 0.002)):
        off, was = (((x - true)[:, group] ** 2).mean() ** 0.5 for x in (read, subject.logs[0].states[10:-10]))
        assert off < 0.3 * was and off < within


def test_rates_that_were_made_of_the_pose_have_no_clock_of_their_own() -> None:
    subject = late_vehicle(attitude=0.3)
    assert told(replace(subject, differences=("body_rates",)), "clock of the attitude") == []
