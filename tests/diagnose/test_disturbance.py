"""The disturbance observer against the best forecast that there is, in closed form."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from bench.diagnose.compare import compare
from bench.diagnose.logs.smoothing import Smoothing
from bench.diagnose.logs.subject import Subject, log_of
from registry.datasets.signals import recording
from registry.physics.oscillator import Oscillator

DT, STEPS = 0.01, 50
MODEL = Oscillator(mass=1.0, damping=0.5, stiffness=4.0)
DECAY = 0.8
"""Time constant of the force that nobody logged [s]."""


def discrete(correlated: bool) -> tuple[np.ndarray, np.ndarray]:
    """Transition and noise covariance (Van Loan) of displacement, speed and a hidden force over a sample.

    The force has a standard deviation of 1 N and relaxes, or it is white and so no state.
    """
    a, q = np.zeros((3, 3)), np.zeros((3, 3))
    a[0, 1], a[1] = 1.0, [-4.0, -0.5, 1.0]
    if correlated:
        a[2, 2], q[2, 2] = -1 / DECAY, 2 / DECAY
    else:
        a[1, 2], q[1, 1] = 0.0, 0.01
    block = expm(np.block([[-a, q], [np.zeros((3, 3)), a.T]]) * DT)
    step = block[3:, 3:].T
    return step, step @ block[:3, 3:]


def best(step: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Standard deviations of displacement and speed after the horizon, everything known at its beginning."""
    covariance = np.zeros((3, 3))
    for _ in range(STEPS):
        covariance = step @ covariance @ step.T + noise
    return np.sqrt(np.diag(covariance)[:2])


def disturbed(step: np.ndarray, noise: np.ndarray, offset: float = 0.0) -> Subject:
    """Ten undriven recordings of 40 s, of which five are learned from."""
    rng = np.random.default_rng(0)
    draw = np.linalg.cholesky(noise + 1e-18 * np.eye(3))
    state = np.column_stack([rng.normal(0, 0.01, 10), rng.normal(0, 0.1, 10), rng.normal(0, 1, 10) + offset])
    states = []
    for _ in range(4000):
        states.append(state[:, :2])
        state = state @ step.T + rng.normal(size=(10, 3)) @ draw.T
    force = np.zeros((4000, 1))
    logs = tuple(
        log_of(
            recording(
                f"run_{i}", 1 / DT, {"force": force}, {"displacement": x[:, :1], "speed": x[:, 1:]}, np.ones(4000, bool)
            ),
            MODEL,
            "force",
        )
        for i, x in enumerate(np.stack(states, axis=1))
    )
    names = tuple(log.name for log in logs)
    still = {"displacement": 1e-9, "speed": 1e-8}
    return Subject("test", MODEL, logs, names[:5], names[5:], smoothing=Smoothing(), noise=still)


def errors(subject: Subject, line: str) -> np.ndarray:
    error = compare(subject, horizon_s=STEPS * DT).error(line)
    return np.array([error[g].rmse for g in ("displacement", "speed")])


def test_a_slow_force_that_nobody_logged_is_forecast_nearly_as_well_as_can_be() -> None:
    step, noise = discrete(correlated=True)
    subject = disturbed(step, noise)
    ratio = errors(subject, "disturbance") / best(step, noise)
    assert np.all(ratio > 0.93)  # as far as chance goes: nothing looks ahead
    assert np.all(ratio < 1.12)
    assert np.all(errors(subject, "nominal") > 1.5 * best(step, noise))


def test_a_constant_force_is_forecast_wholly() -> None:
    step, _ = discrete(correlated=True)
    step[2, 2], still = 1.0, 1e-16 * np.eye(3)
    subject = disturbed(step, still, offset=2.0)
    left = errors(subject, "disturbance") / errors(subject, "nominal")
    # Of a hundred windows a recording the one from its first sample on has no past.
    assert left == pytest.approx([0.1, 0.1], rel=0.05)


def test_nothing_is_forecast_of_what_is_white() -> None:
    step, noise = discrete(correlated=False)
    subject = disturbed(step, noise)
    nominal = errors(subject, "nominal")
    assert nominal == pytest.approx(best(step, noise), rel=0.05)
    assert errors(subject, "disturbance") == pytest.approx(nominal, rel=0.02)


def test_it_learns_from_training_recordings_only() -> None:
    step, noise = discrete(correlated=True)
    subject = disturbed(step, noise)
    alone = replace(subject, training=())
    assert not compare(alone, names=subject.held_out, horizon_s=0.5).error("disturbance")
