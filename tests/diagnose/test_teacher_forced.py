"""Each equation by itself, against closed forms of the oscillator."""

from dataclasses import replace

import numpy as np
import pytest
from test_compare import DT, TRUE, flights, subject_of

from bench.diagnose import diagnose, discover
from bench.diagnose.logs.noise import noise_of
from bench.diagnose.logs.smoothing import Smoothing
from bench.diagnose.logs.subject import LogBatch
from bench.diagnose.select.materiality import Weighing
from bench.diagnose.simulate.teacher_forced import equations, increments, noise_increments

STATED = {"smoothing": Smoothing(), "noise": {"displacement": 1e-3, "speed": 0.02}}


def test_what_an_equation_leaves_is_the_integral_of_the_term_that_it_lacks() -> None:
    states, force = flights(samples=1000)
    lacking = replace(TRUE, damping=0.0)
    subject = subject_of(lacking, states, force, **STATED)
    errors, recording, first = increments(lacking, LogBatch.of(subject.logs), noise_of(subject)).over(50, 10)
    moved = states[recording, first + 50, 0] - states[recording, first, 0]
    # The integral of −d v/m over a window is −d/m times the way. The trapezoidal rule misses (ω dt)²/12 of what the
    # spring does to the speed and of what the speed does to the displacement.
    missed = (10 * DT) ** 2 / 12 * 2 * np.abs(states).max((0, 1))
    assert errors[:, 1] == pytest.approx(-0.5 * moved, abs=missed[1])
    assert np.abs(errors[:, 0]).max() < missed[0]
    assert np.abs(0.5 * moved).max() > 10 * missed[1]


def test_only_the_equation_of_the_speed_is_one_of_forces() -> None:
    assert [e.name for e in equations(TRUE, (0, 1))] == ["speed"]


def test_noise_alone_leaves_the_difference_of_two_samples() -> None:
    states, force = flights(samples=3000)
    subject = subject_of(TRUE, states, force, **STATED)
    noise = replace(noise_of(subject), inputs=(0.0,))
    errors, _, _ = noise_increments(TRUE, LogBatch.of(subject.logs), noise).over(5, 1)
    # Beside the two ends, noise of position and speed goes through stiffness and damping over five samples.
    through = np.sqrt(5) * 0.01 * np.array([100.0 * 1e-3, 0.5 * 0.02])
    assert errors[:, 1].std() == pytest.approx(np.sqrt(2 * 0.02**2 + (through**2).sum()), rel=0.05)


def test_what_is_left_of_a_missing_term_is_predictable_and_noise_is_not() -> None:
    states, force = flights(count=6, samples=1500)
    seen = states + np.random.default_rng(1).normal(size=states.shape) * [1e-3, 0.02]
    for damping, predictable in ((0.0, True), (0.5, False)):
        model = replace(TRUE, damping=damping)
        subject = subject_of(model, seen, force, **STATED)
        subject = replace(subject, training=subject.training[:4], held_out=subject.held_out[4:])
        last = Weighing(subject, noise_of(subject), model).errors(model)[-1]
        assert (last.predictable < 0.5 * last.models["extended"]) is predictable
        assert last.predictable > 0.9 * last.floor


@pytest.mark.parametrize("every", [1, 20])
def test_inputs_are_no_noisier_than_the_errors_that_they_leave(every: int) -> None:
    """A force that is another one at every sample looks like noise of 30 N; 3 N of it are, and the rest acts."""
    states, force = flights(count=6, samples=1500, every=every)
    rng = np.random.default_rng(1)
    seen, told = states + rng.normal(size=states.shape) * [1e-3, 0.02], force + rng.normal(0, 3.0, force.shape)
    subject = subject_of(TRUE, seen, told, **STATED)
    noise = noise_of(subject)
    assert noise.inputs[0] == pytest.approx(3.0 if every > 1 else 30.0, rel=0.15)
    bounded = Weighing(subject, noise, TRUE).bounded(TRUE)
    assert bounded.noise.inputs[0] == pytest.approx(3.0, rel=0.15)
    stated = replace(noise, inputs_stated=True)
    assert Weighing(subject, stated, TRUE).bounded(TRUE).noise is stated
    assert all(e.floor < 1.1 * e.models["extended"] for e in discover(subject, []).equations)
    said, _ = diagnose(subject, catalogue=[], brief=True)
    assert any("noise floor of displacement and speed is too high" in n for n in said.evidence.notes) is (every == 1)
