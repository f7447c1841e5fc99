"""When inputs act: what an actuator does between two samples, and logs that are late, against closed forms."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from scipy.interpolate import CubicSpline
from scipy.linalg import expm
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation, RotationSpline
from test_compare import DT, TRUE, flights, subject_of
from test_problems import flights as vehicle_flights
from test_problems import made

from bench.diagnose import discover
from bench.diagnose.fit import fit_parameters
from bench.diagnose.logs.noise import noise_of
from bench.diagnose.select.search import Search
from bench.diagnose.select.timing.estimate import _shared, shifts_of
from bench.diagnose.select.timing.reading import prepared
from bench.diagnose.select.timing.regression import ShiftRegression, read_at
from bench.score.multirotor.corrupt import Columns
from registry.effects.actuation import MotorLag


def behind_held_commands(tau: float, count: int = 3, samples: int = 2000) -> tuple[np.ndarray, np.ndarray]:
    """States (R, N, 2) and measured forces (R, N, 1) of the oscillator; forces follow commands held for a sample."""
    white = np.random.default_rng(3).normal(0, 100.0, (samples, count))
    command = gaussian_filter1d(white, 3.0, axis=0)
    whole = np.zeros((4, 4))  # position, velocity, force, command
    whole[0, 1], whole[1, :3], whole[2, 2:] = 1, [-100.0, -0.5, 1.0], [-1 / tau, 1 / tau]
    step = expm(whole * DT)
    states, force = np.zeros((count, samples, 2)), np.zeros((count, samples))
    for k in range(1, samples):
        full = np.column_stack([states[:, k - 1], force[:, k - 1], command[k - 1]]) @ step.T
        states[:, k], force[:, k] = full[:, :2], full[:, 2]
    return states, force[..., None]


def noisy(states: np.ndarray) -> np.ndarray:
    return states + np.random.default_rng(1).normal(size=states.shape) * [1e-4, 1e-3]


@pytest.mark.parametrize("tau", [0.004, 0.02])
def test_an_actuator_behind_held_commands_is_read_later_by_what_its_mean_over_a_sample_says(tau: float) -> None:
    states, force = behind_held_commands(tau)
    subject, _ = prepared(subject_of(TRUE, noisy(states), force))
    # Over a sample the force is c + (u_0 − c) exp(−t/τ): its mean is u_0 + w (u_1 − u_0), linear would be w = 1/2.
    passed = 1 - np.exp(-DT / tau)
    shift = 1 / passed - tau / DT - 0.5
    note = next(n for n in subject.notes if "acts" in n)
    told = float(note.split("(")[1].split(" ms, ")[1].split(" ")[0])
    assert told == pytest.approx(shift, abs=0.03)


def test_without_the_shift_an_exact_model_seems_to_lack_something_and_with_it_nothing() -> None:
    states, force = behind_held_commands(0.004)
    subject = subject_of(TRUE, noisy(states), force)
    found = discover(subject)
    assert found.verdict == "nothing" and not found.found
    unread = discover(replace(subject, timed=True), catalogue=[])  # the model without effects errs as much
    for read, as_filed in zip(found.equations, unread.equations, strict=True):
        assert read.models["calibrated"] < 0.5 * as_filed.models["calibrated"]


def test_inputs_that_are_linear_between_samples_are_left_as_they_are() -> None:
    states, force = flights(count=3, samples=2000)
    subject = subject_of(TRUE, noisy(states), force)
    timed, _ = prepared(subject)
    assert all(torch.equal(a.inputs, b.inputs) for a, b in zip(subject.logs, timed.logs, strict=True))
    assert not any("acts" in n for n in timed.notes)


def stepped(fine: int, late: int = 0, count: int = 3, samples: int = 2000) -> tuple[np.ndarray, np.ndarray]:
    """States and held forces of the oscillator as a simulator files them that moves by the new rate, ``fine`` steps a
    sample; forces act ``late`` of these steps late."""
    rng, h = np.random.default_rng(5), DT / fine
    force = np.repeat(rng.normal(0, 100.0, (count, samples // 20)), 20, axis=1)
    states = np.zeros((count, samples, 2))
    x, v = np.zeros(count), np.zeros(count)
    for k in range(samples * fine):
        if k % fine == 0:
            states[:, k // fine] = np.column_stack([x, v])
        v = v + h * (force[:, max(0, k - late) // fine] - 0.5 * v - 100 * x)
        x = x + h * v
    return states, force[..., None]


def test_held_commands_act_earlier_than_filed_where_all_else_is_filed_late() -> None:
    """The rate is that of half a step before, on which a command acts at once."""
    subject = subject_of(replace(TRUE, input_hold="previous"), *stepped(fine=10))
    subject = replace(
        subject, logs=tuple(replace(g, states=torch.from_numpy(noisy(g.states.numpy()))) for g in subject.logs)
    )
    timed, _ = prepared(subject)
    note = next(n for n in timed.notes if "acts" in n)
    assert "earlier than it is filed" in note
    assert float(note.split("(")[1].split(" ms, ")[1].split(" ")[0]) == pytest.approx(0.05, abs=0.011)
    first, read = subject.logs[0].inputs[:, 0], timed.logs[0].inputs[:, 0]
    share = ((read - first)[19] / (first[20] - first[19])).item()  # of the sample before a step
    assert share == pytest.approx(0.05, abs=0.011) and torch.equal(read[:19], first[:19])


def test_held_commands_that_act_late_are_left_to_a_delay() -> None:
    subject = subject_of(replace(TRUE, input_hold="previous"), *stepped(fine=10, late=6))
    timed, _ = prepared(subject)
    assert all(torch.equal(a.inputs, b.inputs) for a, b in zip(subject.logs, timed.logs, strict=True))


def test_every_channel_of_a_vehicle_tells_a_clock_by_itself() -> None:
    """Flights by inverse dynamics, of which the rotor speeds are filed six tenths of a sample early."""
    subject = made(vehicle_flights(3, count=3))
    early = tuple(replace(g, inputs=read_at(g.inputs, 4, 0.6)) for g in subject.logs)
    fit = ShiftRegression(replace(subject, logs=early), noise_of(subject), 0.0)
    steps, errors = fit.apart(np.zeros(4), 0)
    assert len(steps) == 6 and (errors < 0.3).all()  # velocities and body rates
    assert (np.abs(steps + 0.6) < 2 * errors).all()
    assert steps[2:5] == pytest.approx(-0.6, abs=0.05)  # thrust, roll and pitch know it best


def test_torques_that_are_mostly_noise_of_the_rotor_speeds_hide_no_clock() -> None:
    subject, rng = made(vehicle_flights(3, count=3)), np.random.default_rng(0)

    def early(inputs: torch.Tensor) -> torch.Tensor:
        out = read_at(inputs, 4, 0.6)
        out[:, :4] += torch.from_numpy(0.04 * float(inputs[:, :4].mean()) * rng.normal(size=(len(out), 4)))
        return out

    subject = replace(subject, logs=tuple(replace(g, inputs=early(g.inputs)) for g in subject.logs))
    step, error = ShiftRegression(subject, noise_of(subject), 0.0).step(np.zeros(4))
    assert error[0] < 0.2
    assert step[0] == pytest.approx(-0.6, abs=0.2)  # -0.13 ± 0.23 where what is left of such channels counted too


def added_up(log: Columns, ahead: float) -> Columns:
    """A flight whose velocity is what it feels, turned by an attitude ``ahead`` of the one filed [s], and added up."""
    t, gravity = log["t"], np.array([0, 0, 9.81])
    turned, pull = RotationSpline(t, Rotation.from_quat(log["attitude"])), CubicSpline(t, log["velocity"]).derivative()
    fine = np.linspace(t[0], t[-1] - ahead, 10 * len(t))
    push = turned(fine + ahead).apply(turned(fine).inv().apply(pull(fine) + gravity)) - gravity
    velocity = log["velocity"][0] + CubicSpline(fine, push).antiderivative()(t)
    position = log["position"][0] + CubicSpline(t, velocity).antiderivative()(t)
    rng = np.random.default_rng(len(t))
    noise = (rng.normal(0, std, (len(t), 3)) for std in (3e-4, 1e-3))
    return log | {k: x + next(noise) for k, x in (("position", position), ("velocity", velocity))}


@pytest.mark.slow
def test_an_estimator_that_adds_up_what_it_feels_by_another_attitude_than_is_filed_lacks_nothing() -> None:
    """No clock of the inputs is late, yet forces seem to act T ω τ to the side: on slow paths, a drag."""
    logs = [added_up(log, ahead=0.0015) for log in vehicle_flights(3, count=4, noise=0.2)]
    subject = made(logs)
    inputs, _, motion, forces = shifts_of(subject, noise_of(subject))
    assert abs(inputs.value) < 0.02
    assert motion.value == pytest.approx(-0.15, abs=0.02) and motion.low < -0.15 < motion.high
    assert forces.value == pytest.approx(-0.15, abs=0.04)
    told = discover(subject)
    assert told.verdict == "nothing" and not told.found
    as_filed = discover(replace(subject, timed=True))
    assert any(t.axis == "force x" and "body_rates" in t.signal for t in as_filed.traces)


@pytest.mark.parametrize(
    ("alone", "errors", "told"),
    [
        ([-0.9, -1.1, -1.0, np.nan], [0.1, 0.1, 0.05, 0.1], (-1.0, 0.04)),
        ([-4.2, -3.9, -0.2, -1.1], [0.3, 0.2, 0.1, 0.2], (-0.2, 0.1)),
        ([-9.0, 7.0, -0.1], [1.0, 1.0, 0.6], (0.0, np.inf)),
        ([-0.34, -0.22, -0.2], [0.02, 0.01, 0.02], (-3550 / 15000, 15000**-0.5)),
    ],
    ids=["all channels agree", "some lag by more than a clock", "no channel tells", "filters delay some by less"],
)
def test_a_clock_is_late_for_all_channels_alike(
    alone: list[float], errors: list[float], told: tuple[float, float]
) -> None:
    """In an ellipsoid's drag roll and pitch seemed 3.5 samples late, yaw none: an inertia of rotors that had none."""
    fit = SimpleNamespace(apart=lambda shift, which: (np.array(alone) - shift[0], np.array(errors)))
    assert _shared(fit, np.array([-1.0, 0.0, 0.0, 0.0]), 0, 0.04) == pytest.approx(told)  # type: ignore[arg-type]


def test_a_shift_that_cross_correlation_suggests_is_read_only_where_the_regression_tells_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # Of quiet recordings with noisy inputs the correlation says anything: five hovering flights gave 11.5, 2.2, 2.9,
    # 0.1 and 1.5 samples where there is no shift.
    states, force = flights(count=3, samples=600)
    rng = np.random.default_rng(4)
    force = force + rng.normal(0.0, force.std(), force.shape)
    states = states + rng.normal(size=states.shape) * 0.1 * states.std((0, 1))
    monkeypatch.setattr("bench.diagnose.select.timing.estimate._coarse", lambda subject: 1.4)
    monkeypatch.setattr(type(TRUE), "drive_acts_at_once", True)
    subject = subject_of(TRUE, states, force)
    timed, _ = prepared(subject)
    assert all(torch.equal(a.inputs, b.inputs) for a, b in zip(subject.logs, timed.logs, strict=True))


def test_reading_between_samples_is_exact_for_cubics_and_leaves_other_signals_alone() -> None:
    t = torch.arange(20, dtype=torch.float64)
    inputs = torch.stack([t**3, t], dim=1)
    for shift in (-1.3, 0.4, 2.0):
        found = read_at(inputs, 1, shift)[4:-4]
        assert torch.allclose(found[:, 0], (t[4:-4] + shift) ** 3)
        assert torch.equal(found[:, 1], t[4:-4])


def test_a_lag_behind_commands_that_were_given_more_often_than_logged_lies_within_its_interval() -> None:
    tau, often = 0.03, 4
    white = np.random.default_rng(5).normal(0, 100.0, (often * 2000, 3))
    command = gaussian_filter1d(white, 3.0 * often, axis=0) * often**0.5
    whole = np.zeros((4, 4))
    whole[0, 1], whole[1, :3], whole[2, 2:] = 1, [-100.0, -0.5, 1.0], [-1 / tau, 1 / tau]
    step, full = expm(whole * DT / often), np.zeros((len(command), 3, 4))
    for k in range(1, len(command)):
        full[k, :, :3] = (np.column_stack([full[k - 1, :, :3], command[k - 1]]) @ step.T)[:, :3]
    states, given = full[::often, :, :2].swapaxes(0, 1), command[::often].T[..., None]
    model = replace(TRUE, input_hold="previous", effects=(MotorLag(tau_up=0.02, tau_down=0.02),))
    _, numbers = fit_parameters(subject_of(model, noisy(states), given), model)
    for lag in (x for x in numbers if x.entry.name in ("tau_up", "tau_down")):
        assert 0 < tau - lag.value < DT / 2  # (dt − P) / 2 too short
        assert lag.low < tau < lag.high < lag.value + DT


def test_noise_of_inputs_that_are_read_between_their_samples_is_slow_as_before() -> None:
    """Cubic interpolation takes fast noise away; what adds up over a window stays, and is what a torque adds up to."""
    subject, rng = made(vehicle_flights(3, count=3)), np.random.default_rng(0)
    std = 0.01 * float(subject.logs[0].inputs[:, :4].mean())

    def early(inputs: torch.Tensor) -> torch.Tensor:
        out = read_at(inputs, 4, 0.5)
        out[:, :4] += torch.from_numpy(std * rng.normal(size=(len(out), 4)))
        return out

    filed = replace(subject, logs=tuple(replace(g, inputs=early(g.inputs)) for g in subject.logs))
    read, noise = prepared(filed)
    assert any("rotor speed acts" in note for note in read.notes)
    assert noise.inputs[:4] == pytest.approx([std] * 4, rel=0.1)
    search = Search(read, (), lambda what: None, noise)
    assert search.noisy is not None
    drawn = (search.noisy.inputs - search.stack.inputs)[..., :4].numpy()
    length = 25
    summed = drawn[:, : drawn.shape[1] // length * length].reshape(len(drawn), -1, length, 4).sum(2)
    assert summed.std() == pytest.approx(std * length**0.5, rel=0.1)
    assert drawn.std() < 0.85 * std
