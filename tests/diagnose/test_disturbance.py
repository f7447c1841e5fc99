"""The disturbance observer against the best forecast that there is, in closed form."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import nnls

from bench.diagnose.compare import compare
from bench.diagnose.logs.noise import noise_of
from bench.diagnose.logs.smoothing import Smoothing
from bench.diagnose.logs.subject import Subject, log_of
from bench.diagnose.settings import OBSERVING
from bench.diagnose.simulate.disturbance import Observer
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
    return measured(np.stack(states, axis=1), MODEL)


def measured(states: np.ndarray, model: Oscillator) -> Subject:
    """Undriven recordings of states (R, N, 2) of ``model``; the first five are learned from."""
    valid, force = np.ones(states.shape[1], bool), np.zeros((states.shape[1], 1))
    logs = tuple(
        log_of(
            recording(f"run_{i}", 1 / DT, {"force": force}, {"displacement": x[:, :1], "speed": x[:, 1:]}, valid),
            model,
            "force",
        )
        for i, x in enumerate(states)
    )
    names = tuple(log.name for log in logs)
    still = {"displacement": 1e-9, "speed": 1e-8}
    return Subject("test", model, logs, names[:5], names[5:], smoothing=Smoothing(), noise=still)


def free(model: Oscillator, force: np.ndarray | None = None) -> np.ndarray:
    """Rates (2, 2) of displacement and speed; with the rates of a hidden force (f, f), of which the first one acts."""
    own = np.array([[0.0, 1.0], [-model.stiffness, -model.damping]]) / np.array([[1.0], [model.mass]])
    if force is None:
        return own
    beside = np.zeros((2, len(force)))
    beside[1, 0] = 1 / model.mass
    return np.block([[own, beside], [np.zeros_like(beside.T), force]])


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


PERIOD = 0.9
"""Of a force that turns round within the horizon [s]."""


def swung(model: Oscillator) -> Subject:
    """Five recordings of 40 s under a harmonic force that nobody logged, exact."""
    omega, rng = 2 * np.pi / PERIOD, np.random.default_rng(1)
    step = expm(free(model, np.array([[0.0, omega], [-omega, 0.0]])) * DT)
    phase = rng.uniform(0, 2 * np.pi, 5)
    state, states = np.column_stack([np.zeros((5, 2)), np.cos(phase), np.sin(phase)]), []
    for _ in range(4000):
        states.append(state[:, :2])
        state = state @ step.T
    return measured(np.stack(states, axis=1), model)


def phasors() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of a harmonic disturbance that is 1 now: its steps ahead (N,), their means over the parts, and the filters' z."""
    turn = 2j * np.pi * DT / PERIOD
    ahead = np.exp(turn * (np.arange(STEPS) + 0.5))
    spans = OBSERVING.fastest * STEPS * OBSERVING.ratio ** np.arange(OBSERVING.filters)
    forgets = np.exp(-1 / spans)
    filtered = (1 - forgets) * np.exp(-turn / 2) / (1 - forgets * np.exp(-turn))
    return ahead, ahead.reshape(OBSERVING.parts, -1).mean(1), filtered


def best_gains() -> np.ndarray:
    """β (filters, parts) nearest to a harmonic force ahead, none negative."""
    _, means, filtered = phasors()
    plane = np.stack([filtered.real, filtered.imag])
    return np.stack([nnls(plane, np.array([m.real, m.imag]))[0] for m in means], axis=1)


def best_trust(model: Oscillator) -> float:
    """γ of least squares: free runs of the forecast against those of the force itself, over all its phases."""
    ahead, _, filtered = phasors()
    step = expm(free(model) * DT)

    def run(push: np.ndarray) -> np.ndarray:
        state, states = np.zeros(2, complex), []
        for k in range(STEPS):
            state = step @ state + np.array([0.0, push[k]])
            states.append(state)
        every = STEPS // OBSERVING.points
        return np.array(states)[every - 1 :: every]

    error, moved = run(ahead), run(np.repeat(filtered @ best_gains(), STEPS // OBSERVING.parts))
    size = np.abs(error) ** 2
    return float(((error * moved.conj()).real / size).sum() / (np.abs(moved) ** 2 / size).sum())


def observer_of(subject: Subject) -> Observer:
    observer = Observer.learned(subject.model, subject.of(subject.training), noise_of(subject), STEPS)
    assert observer is not None
    return observer


def test_of_a_force_that_turns_round_it_forecasts_what_fades_and_nothing_negative() -> None:
    wanted = best_gains()
    assert wanted[0, :2] == pytest.approx([0.87, 0.37], abs=0.01) and not wanted[1:].any() and not wanted[:, 2:].any()
    assert observer_of(swung(MODEL)).gains[0] == pytest.approx(wanted, abs=0.01)


@pytest.mark.parametrize(("stiffness", "trust"), [(4.0, 0.847), (100.0, 1.0)])
def test_it_is_trusted_as_far_as_free_runs_err_least_and_no_further(stiffness: float, trust: float) -> None:
    model = replace(MODEL, stiffness=stiffness)
    assert min(best_trust(model), 1.0) == pytest.approx(trust, abs=1e-3)
    assert observer_of(swung(model)).trust == pytest.approx([trust], abs=0.01)


def test_it_knows_every_measurement_up_to_now_and_none_that_comes_later() -> None:
    step, noise = discrete(correlated=True)
    smoothing = Smoothing("savgol", 9, 3)
    subject = replace(disturbed(step, noise), smoothing=smoothing)
    observer, log, now = observer_of(subject), subject.logs[-1], 1000

    def forecast(first: int) -> np.ndarray:
        """From ``now``, where all that was measured from the sample ``first`` on had been otherwise."""
        states = log.states.clone()
        states[first:, 0] += 1.0
        return observer.drift([replace(log, states=states)], [np.array([now])]).numpy()

    assert np.array_equal(forecast(now + 1), forecast(len(log)))
    assert np.abs(forecast(now) - forecast(len(log))).max() > 1e-3 * np.abs(forecast(len(log))).max()
