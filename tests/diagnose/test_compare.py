"""Step 1: free runs of models against measurements, and the noise floor."""

import math
import sys
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.signal import savgol_filter

from bench.diagnose.compare import compare
from bench.diagnose.logs.differences import centred
from bench.diagnose.logs.noise import noise_of
from bench.diagnose.logs.smoothing import Smoothing
from bench.diagnose.logs.subject import Subject, log_of
from bench.diagnose.settings import COMPARING
from bench.diagnose.simulate.floor import floor
from bench.diagnose.simulate.free_run import groups
from registry.datasets.signals import recording
from registry.dynamics import PhysicsModel
from registry.errors import BenchError
from registry.physics.oscillator import Oscillator

DT = 0.01
SAVGOL = Smoothing("savgol", 9, 3, derived=True)
TRUE = Oscillator(mass=1.0, damping=0.5, stiffness=100.0)


def flights(count: int = 2, samples: int = 3000, seed: int = 0, every: int = 20) -> tuple[np.ndarray, np.ndarray]:
    """Exact states (R, N, 2) and forces (R, N, 1) of the oscillator, by the matrix exponential, not the simulator.

    The force bends at random ``every`` so many samples.
    """
    rng = np.random.default_rng(seed)
    coarse = rng.normal(0, 30, (count, samples // every + 2))
    force = np.stack([np.interp(np.arange(samples) / every, np.arange(len(c)), c) for c in coarse])
    # With u linear between samples: x, u and the slope of u make one autonomous linear system.
    whole = np.zeros((4, 4))
    whole[0, 1], whole[1, :3], whole[2, 3] = 1, [-100.0, -0.5, 1.0], 1
    step = expm(whole * DT)
    states = np.zeros((count, samples, 2))
    states[:, 0] = rng.normal(0, [0.3, 3.0], (count, 2))
    for k in range(1, samples):
        slope = (force[:, k] - force[:, k - 1]) / DT
        full = np.column_stack([states[:, k - 1], force[:, k - 1], slope])
        states[:, k] = (full @ step.T)[:, :2]
    return states, force[..., None]


def subject_of(model: PhysicsModel, states: np.ndarray, force: np.ndarray, **how: object) -> Subject:
    logs = []
    for i, (x, u) in enumerate(zip(states, force, strict=True)):
        signals = {"displacement": x[:, :1]} | ({"speed": x[:, 1:]} if x.shape[1] > 1 else {})
        made = recording(f"run_{i}", 1 / DT, {"force": u}, signals, np.ones(len(x), dtype=bool))
        logs.append(log_of(made, model, "force"))
    names = tuple(log.name for log in logs)
    return Subject("test", model, tuple(logs), names, names, **how)  # type: ignore[arg-type]


def smoothed(states: np.ndarray, sigma: float, how: Smoothing = SAVGOL, seed: int = 1) -> np.ndarray:
    """The position with noise, smoothed, and the velocity that is read from it."""
    q = states[..., 0] + np.random.default_rng(seed).normal(0, sigma, states.shape[:2])
    if how.kind == "savgol":
        return np.stack([savgol_filter(q, how.window, how.order, deriv=d, delta=DT, axis=1) for d in (0, 1)], axis=-1)
    q = np.apply_along_axis(np.convolve, 1, q, np.ones(how.window) / how.window, "same")
    return np.stack([q, np.gradient(q, DT, axis=1)], axis=-1)


def test_the_floor_of_a_linear_system_is_the_closed_form() -> None:
    sigma = np.array([0.01, 0.2])
    states, force = flights()
    subject = subject_of(TRUE, states, force, smoothing=Smoothing(), noise={"displacement": 0.01, "speed": 0.2})
    noise = replace(noise_of(subject), inputs=(0.0,))
    at = [np.arange(0, 2900, 20)] * 2  # as few windows as a comparison has: chance must not show
    found = floor(TRUE, subject.logs, at, 50, noise, groups(TRUE.state_channels, (True, True)))
    matrix = np.array([[0, 1], [-100.0, -0.5]])
    for k in (1, 10, 25, 50):
        through = expm(matrix * k * DT)
        exact = (through**2) @ sigma**2 + sigma**2
        assert found[:, :, k].mean((0, 1)).sqrt().numpy() == pytest.approx(np.sqrt(exact), rel=0.03)


@pytest.mark.parametrize("how", [SAVGOL, Smoothing("mean", 5, 0, derived=True), Smoothing()])
def test_noise_and_filter_are_found_in_the_data_and_the_floor_is_the_error_of_the_true_model(
    how: Smoothing, monkeypatch: pytest.MonkeyPatch
) -> None:
    every_sample = replace(COMPARING, free_runs=10**6)  # for a sharp figure
    monkeypatch.setattr(sys.modules["bench.diagnose.compare"], "COMPARING", every_sample)
    states, force = flights()
    if how.derived:
        seen = smoothed(states, 0.004, how)[:, 10:-10]
    else:
        seen = (states + np.random.default_rng(1).normal(size=states.shape) * [0.004, 0.04])[:, 10:-10]
    subject = subject_of(TRUE, seen, force[:, 10:-10])
    noise = noise_of(subject)
    assert (noise.smoothing.kind, noise.smoothing.window, noise.smoothing.derived) == (
        how.kind,
        how.window,
        how.derived,
    )
    assert noise.raw[0] == pytest.approx(0.004, rel=0.05)
    lines = compare(subject, {}).lines
    for group in ("displacement", "speed"):
        assert lines["floor"][group].rmse == pytest.approx(lines["nominal"][group].rmse, rel=0.08)


def test_noise_of_inputs_that_were_smoothed_counts_as_the_low_notes_it_left_behind() -> None:
    states, force = flights()
    drawn = savgol_filter(np.random.default_rng(2).normal(0, 8.0, force.shape), 9, 3, axis=1)
    subject = subject_of(TRUE, smoothed(states, 0.0005)[:, 10:-10], (force + drawn)[:, 10:-10])
    noise = noise_of(subject)
    assert (noise.input_smoothing.kind, noise.input_smoothing.window) == ("savgol", 9)
    assert noise.inputs[0] == pytest.approx(8.0, rel=0.1)
    lines = compare(subject, {}).lines
    for group in ("displacement", "speed"):
        assert lines["floor"][group].rmse[-1] == pytest.approx(lines["nominal"][group].rmse[-1], rel=0.15)
    white = noise_of(
        subject_of(TRUE, smoothed(states, 0.0005), force + np.random.default_rng(2).normal(0, 8.0, force.shape))
    )
    assert white.input_smoothing == Smoothing()


def test_differences_to_the_sample_before_are_brought_to_their_time() -> None:
    states, force = flights(samples=600)
    position = states[..., 0] + np.random.default_rng(1).normal(0, 0.002, states.shape[:2])
    late = np.diff(position, axis=1, prepend=position[:, :1]) / DT
    found = centred(subject_of(TRUE, np.stack([position, late], axis=-1), force))
    for log, q in zip(found.logs, position, strict=True):
        assert log.states[1:-1, 1].numpy() == pytest.approx(np.gradient(q, DT)[1:-1], abs=1e-9)
        assert not log.valid[-1] and log.valid[:-1].all()
    assert "half a sample (5 ms)" in found.notes[0]


@pytest.mark.parametrize("how", ["central", "savgol", "sensor"])
def test_rates_at_their_own_time_are_left_alone(how: str) -> None:
    states, force = flights(samples=600)
    noisy = states + np.random.default_rng(1).normal(size=states.shape) * [0.002, 0.05]
    central = np.stack([noisy[..., 0], np.gradient(noisy[..., 0], DT, axis=1)], axis=-1)
    seen = {"central": central, "savgol": smoothed(states, 0.002), "sensor": noisy}[how]
    subject = subject_of(TRUE, seen, force)
    assert centred(subject) is subject


def test_what_is_stated_is_not_estimated() -> None:
    states, force = flights(samples=600)
    subject = subject_of(TRUE, states, force, smoothing=SAVGOL, noise={"displacement": 0.02})
    noise = noise_of(subject)
    slope = np.linalg.norm(savgol_filter(np.eye(9), 9, 3, deriv=1, delta=DT, axis=0)[4])
    assert noise.raw == (0.02, 0.0)
    assert noise.processed[1] == pytest.approx(0.02 * slope)


def test_the_error_is_that_of_a_free_run_from_the_measured_states() -> None:
    states, force = flights(samples=1500)
    wrong = replace(TRUE, stiffness=90.0)
    subject = subject_of(wrong, states, force * 0, smoothing=Smoothing())
    made = compare(subject, {"true": TRUE}, horizon_s=0.3)
    assert made.horizon_s == pytest.approx([0.03 * i for i in range(1, 11)])
    at = np.arange(0, 1500 - 30, round(made.every_s / DT))
    through = expm(np.array([[0, 1], [-90.0, -0.5]]) * 0.3)
    each = [((x[at] @ through.T - x[at + 30]) ** 2).mean(0) ** 0.5 for x in states]
    line = made.lines["nominal"]["displacement"]
    assert made.starts == 2 * len(at)
    assert [line.recordings[f"run_{i}"][-1] for i in (0, 1)] == pytest.approx([e[0] for e in each], rel=1e-3)
    assert line.rmse[-1] == pytest.approx(np.sqrt((each[0][0] ** 2 + each[1][0] ** 2) / 2), rel=1e-3)
    assert line.low[-1] < line.rmse[-1] < line.high[-1]
    assert made.error("nominal")["speed"].rmse == made.curves["speed"].lines["nominal"].rmse[-1]
    assert set(made.curves["speed"].lines) == {"nominal", "disturbance", "floor"}


def test_a_model_that_diverges_has_an_infinite_error_and_the_floor_is_another_ones() -> None:
    states, force = flights(samples=600)
    made = compare(subject_of(TRUE, states, force), {"extended": replace(TRUE, stiffness=-1e9)})
    line = made.lines["extended"]["speed"]
    assert line.rmse[-1] == line.high[-1] == line.recordings["run_0"][-1] == math.inf
    assert all(math.isfinite(v) for name in ("nominal", "floor") for v in made.lines[name]["speed"].rmse)


def test_intervals_rest_on_recordings_where_there_are_eight_and_on_blocks_below() -> None:
    states, force = flights(8, 500)
    wrong = replace(TRUE, stiffness=90.0)
    many = compare(subject_of(wrong, states, force, smoothing=Smoothing()), {})
    few = compare(subject_of(wrong, states[:3], force[:3], smoothing=Smoothing()), {})
    assert "8 recordings" in many.basis and "blocks" in few.basis and "3 recordings" in few.basis
    # The spread that whole recordings show, of which a bootstrap's standard deviation is the standard error.
    line = many.lines["nominal"]["speed"]
    squares = np.array([line.recordings[f"run_{i}"][-1] ** 2 for i in range(8)])
    half = 1.96 * squares.std() / np.sqrt(8)
    assert line.high[-1] ** 2 - line.low[-1] ** 2 == pytest.approx(2 * half, rel=0.25)


def test_states_that_were_not_measured_are_not_judged() -> None:
    states, force = flights(samples=400)
    made = compare(subject_of(TRUE, states[..., :1], force), {})
    assert [g.name for g in made.groups] == ["displacement"]


def test_recordings_that_are_too_short_are_said_to_be() -> None:
    states, force = flights(samples=20)
    with pytest.raises(BenchError, match="give a shorter horizon"):
        compare(subject_of(TRUE, states, force), {})
