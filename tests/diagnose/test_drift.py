"""What drifts with the time in a system that is no vehicle: learned as a function of the time, and added."""

from dataclasses import replace

import numpy as np
import torch
from scipy.signal import StateSpace, lsim

from bench.diagnose import compare
from bench.diagnose.learn.learn import learn
from bench.diagnose.logs.subject import Subject, log_of
from bench.diagnose.select.timing.reading import prepared
from registry.contracts import Channel, Recording
from registry.effects.learned_term import LearnedTerm
from registry.physics.oscillator import Oscillator

SLOPE, STEP, COUNT = -0.6, 0.01, 1000


def drifting(number: int) -> Subject:
    """1 kg, 0.5 N s/m, 100 N/m, pushed by a logged force and by one of −0.6 N/s that is not, by scipy alone."""
    model, logs, t = Oscillator(), [], np.arange(COUNT) * STEP
    plant = StateSpace([[0, 1], [-100, -0.5]], [[0.0], [1.0]], np.eye(2), np.zeros((2, 1)))
    for i in range(6):
        rng = np.random.default_rng([number, i])
        drive = lsim(([1.0], [0.04, 1.0]), rng.normal(size=COUNT) * 60, t)[1]
        seen = lsim(plant, drive + SLOPE * t, t, rng.normal(size=2) * [0.05, 0.3])[1]
        seen = seen + rng.normal(size=seen.shape) * 1e-3 * seen.std(0)
        valid = np.ones(COUNT, dtype=bool)
        made = Recording(
            f"run_{i}", 1 / STEP, drive[:, None], seen, (Channel("force", "N"),), model.state_channels, valid
        )
        logs.append(log_of(made, replace(model, extras=("time",)), "force"))
    names = tuple(log.name for log in logs)
    signals = ("displacement", "speed", "force")
    return Subject(
        "drifting", replace(model, extras=("time",)), tuple(logs), names[:4], names[4:], None, {}, {}, signals
    )


def test_a_force_that_grows_with_the_time_is_learned_and_forecasts_with_it_meet_the_noise() -> None:
    subject, noise = prepared(drifting(1))
    (term,) = learn(subject, subject.model, noise)
    assert (term.axis, term.signals, term.shape) == ("speed.q", ("time",), "linear")
    assert abs(term.values[0] / SLOPE - 1) < 0.01
    extended = replace(subject.model, effects=(term,))
    found = compare(subject, {"extended": extended}, noise=noise)
    for group, floor in found.error("floor").items():
        assert found.error("nominal")[group].rmse > 3 * floor.rmse
        assert found.error("extended")[group].rmse < 1.1 * floor.rmse


def test_a_term_of_the_time_is_what_it_says_beside_a_drive() -> None:
    """The time comes after what drives the system; a term along the drive acts as that does."""
    plain = Oscillator(extras=("time",))
    state, inputs = torch.tensor([0.1, -0.2], dtype=torch.float64), torch.tensor([3.0, 7.0], dtype=torch.float64)
    term = LearnedTerm("speed.q", ("time",), "linear", (SLOPE,), (), (0.0, 10.0))
    added = replace(plain, effects=(term,)).derivative(state, inputs) - plain.derivative(state, inputs)
    np.testing.assert_allclose(added.numpy(), [0.0, SLOPE * 7.0], atol=1e-12)
