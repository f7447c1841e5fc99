"""What an accelerometer tells of the forces: its model against its definition, and drag in closed form."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from bench.diagnose.learn.axis_series import axis_series
from bench.diagnose.logs.noise import noise_of
from bench.diagnose.logs.smoothing import Smoothing
from bench.diagnose.logs.subject import LogBatch, Subject, log_of
from bench.diagnose.regression import test_functions
from bench.diagnose.regression.linearise import directions
from bench.diagnose.regression.weak import mean_rates
from bench.diagnose.select.materiality import Weighing
from bench.diagnose.select.timing.reading import prepared
from bench.diagnose.simulate.equation_error import Saving
from bench.diagnose.simulate.floor import measure
from registry.contracts import Channel, Recording
from registry.effects.air import LinearDrag
from registry.effects.thrust import ThrustScale
from registry.physics.quadrotor import Quadrotor

MODEL = Quadrotor(
    mass=0.5,
    inertia=(3e-3, 3e-3, 5e-3),
    thrust_coefficient=1.5e-6,
    torque_coefficient=2e-8,
    rotor_positions=((0.1, 0.1, 0.0), (-0.1, 0.1, 0.0), (-0.1, -0.1, 0.0), (0.1, -0.1, 0.0)),
    rotor_directions=(1.0, -1.0, 1.0, -1.0),
)
DRAG, OFFSET, RATE = (0.2, 0.3, 0.1), (0.4, -0.3, 0.2), 100.0


def flight(seed: int, late: float = 0.0) -> Recording:
    """A motion made up, with what an accelerometer with an offset feels on it, filed ``late`` [s]."""
    rng, t = np.random.default_rng(seed), np.arange(1200) / RATE

    def wave(size: float, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Now, and as long ago as what is felt is late."""
        rate, phase = rng.uniform(1.0, 4.0, (count, 4)), rng.uniform(0, 6.28, (count, 4))
        now, then = (size * np.sin(at[:, None, None] * rate + phase).sum(-1) / 2 for at in (t, t - late))
        return now, then

    angles, velocities, speeds = wave(0.3, 3), wave(2.0, 3), wave(60.0, 4)
    turned, velocity, speed = Rotation.from_euler("ZYX", angles[0]), velocities[0], 900 + speeds[0]
    air = Rotation.from_euler("ZYX", angles[1]).inv().apply(velocities[1])
    felt = (1.5e-6 * (900 + speeds[1]) ** 2).sum(1)[:, None] * [0, 0, 1] / 0.5 - np.array(DRAG) * air / 0.5
    columns = {
        "position": np.cumsum(velocity + np.roll(velocity, 1, axis=0), 0) / (2 * RATE),
        "velocity": velocity,
        "attitude": turned.as_quat(),
        "body_rates": wave(0.5, 3)[0],
        "specific_force": felt + OFFSET + rng.normal(size=felt.shape) * 0.05,
    }
    axes = {"attitude": ("qx", "qy", "qz", "qw"), "body_rates": ("p", "q", "r")}
    channels = tuple(Channel(f"{s}.{a}", "1") for s in columns for a in axes.get(s, ("x", "y", "z")))
    driven = tuple(Channel(f"rotor_speed.{i}", "rad/s") for i in range(1, 5))
    valid = np.ones(len(t), dtype=bool)
    return Recording(f"flight{seed}", RATE, speed, np.concatenate(list(columns.values()), 1), driven, channels, valid)


def subject() -> Subject:
    logs = tuple(log_of(flight(i), MODEL, "rotor_speed") for i in range(4))
    return Subject("felt", MODEL, logs, ("flight0", "flight1"), ("flight2", "flight3"))


def test_the_model_feels_the_forces_per_mass_and_no_weight() -> None:
    logs = subject().logs
    rates = mean_rates(MODEL, LogBatch.of(logs)).numpy()
    thrust = 1.5e-6 * (logs[0].inputs.numpy()[:, :4] ** 2).sum(1) / 0.5
    felt = (thrust[1:] + thrust[:-1]) / 2  # summed as what was recorded is
    assert rates.shape[-1] == 16
    assert rates[0, :, 13:] == pytest.approx(felt[:, None] * [0, 0, 1], abs=1e-9)


@pytest.mark.parametrize("late", [0.0, 0.0035])
def test_a_sensor_with_a_clock_of_its_own_is_read_when_it_felt(late: float) -> None:
    logs = tuple(log_of(flight(i, late), MODEL, "rotor_speed") for i in range(4))
    model = replace(MODEL, effects=(LinearDrag(*DRAG),))
    who = Subject("late", model, logs, ("flight0", "flight1"), ("flight2", "flight3"))
    read, _ = prepared(who)
    said = [n.split(" is filed ")[1] for n in read.notes if "specific force" in n]
    assert len(said) == bool(late)
    for note, seen, filed in zip(said, read.logs, logs, strict=False):
        by = float(note.split(" ms")[0]) / 1e3
        assert by == pytest.approx(late, rel=0.1) and "after the motion" in note
        assert seen.sensed is not None and filed.sensed is not None
        at = np.arange(len(filed.sensed)) / RATE
        path = CubicSpline(at, filed.sensed.numpy())(at + by)
        assert seen.sensed.numpy()[3:-3] == pytest.approx(path[3:-3], abs=1e-3)


def test_without_a_velocity_only_the_axes_of_the_torques_are_searched_for_what_swings() -> None:
    """Gyroscope and accelerometer alone, as a flight controller logs them: what forces leave has no rate to show in."""
    whole = [flight(i) for i in range(2)]
    kept = [i for i, c in enumerate(whole[0].output_channels) if c.group in ("body_rates", "specific_force")]
    seen = [
        replace(r, outputs=r.outputs[:, kept], output_channels=tuple(r.output_channels[i] for i in kept)) for r in whole
    ]
    who = Subject("seen", MODEL, tuple(log_of(r, MODEL, "rotor_speed") for r in seen), ("flight0",), ("flight1",))
    assert {series.axis for series in axis_series(who, MODEL, noise_of(who))} == {f"torque_{a}" for a in "xyz"}


def test_drag_shows_in_what_is_felt_whatever_the_offset_of_the_sensor() -> None:
    who = subject()
    weighing = Weighing(who, noise_of(who), MODEL)
    right = replace(MODEL, effects=(LinearDrag(*DRAG),))
    errors = {e.equation: e for e in weighing.errors(right) if e.horizon_s == 0.5}
    felt = errors["accelerations"]
    way = np.stack([log.states.numpy()[:, 3:6] for log in who.of(who.held_out)])
    assert felt.unit == "m/s^2"
    assert 0.2 * np.abs(way).mean() < felt.models["nominal"] < 2 * np.abs(way).max()  # d/m v is .2 to .6 of v
    assert felt.models["extended"] < 0.1 * felt.models["nominal"]
    assert felt.models["extended"] == pytest.approx(felt.floor, rel=0.5)


def test_what_is_left_along_the_axes_of_the_body_is_all_that_is_left() -> None:
    """Pythagoras, whatever the attitude: squares along body axes add up to those of the equation in the world's."""
    who = subject()
    weighing = Weighing(who, noise_of(who), MODEL)
    for horizon in (0.1, 0.5):
        found = [e for e in weighing.by_axis(MODEL) if e.horizon_s == horizon and e.equation == "accelerations"]
        whole, *axes = sorted(found, key=lambda e: e.axis)
        assert [e.axis for e in axes] == ["force x", "force y", "force z"]
        assert sum(e.models["nominal"] ** 2 for e in axes) == pytest.approx(whole.models["nominal"] ** 2)
        assert axes[0].models["nominal"] > 3 * axes[0].predictable  # drag


def test_rows_of_what_is_felt_know_no_offset_of_the_sensor() -> None:
    """Least squares of drag in these rows alone: an offset that stayed would be taken for thrust that is missing."""
    who = subject()
    stack = LogBatch.of(who.logs)
    linear = directions(MODEL, MODEL, {}, stack, [("linear_drag", LinearDrag), ("thrust_scale", ThrustScale)])
    felt = [i for i, c in enumerate(linear.channels) if c >= 13]
    rows = linear.project(test_functions.TestFunctions.over(stack.logs, 6, [Smoothing()] * len(linear.channels)))
    columns = [c for s in linear.starts for c in s.columns]
    x = np.concatenate([_full(log[c], rows.acting[c], rows.width) for log in rows.parts for c in felt])
    found = np.linalg.lstsq(x[:, columns], x[:, -1], rcond=None)[0]
    assert found[:3] == pytest.approx(DRAG, abs=0.01)
    assert found[3] == pytest.approx(0.0, abs=0.01)  # of OFFSET z alone it would be .2 of 9.7


def _full(rows: np.ndarray, acting: np.ndarray, width: int) -> np.ndarray:
    out = np.zeros((len(rows), width + 1))
    out[:, acting] = rows
    return out


def test_an_equation_that_is_lost_speaks_against_what_another_gains() -> None:
    """Shares alone do not tell: a trifle may be many times what can be explained."""
    assert Saving("forces", 0.5, -50.0, -60.0, -40.0, True, ratio=10.0).harms
    assert not Saving("forces", 0.5, -1.0, -1.5, -0.5, False, ratio=1.05).harms
    assert not Saving("forces", 0.5, -50.0, -120.0, 20.0, True, ratio=10.0).harms


def test_a_model_that_diverges_says_nothing_on_the_terminal() -> None:
    """The floor of a free run that has left all bounds is no number, and no warning of numpy's."""
    noise = noise_of(subject())
    states = torch.full((1, 40, 13), 1e300, dtype=torch.float64)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        measure(states * 1e300, noise, MODEL.state_channels, 1 / RATE, np.random.default_rng(0))
