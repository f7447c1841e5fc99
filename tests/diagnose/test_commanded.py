"""A measured drive beside its commands, against motors simulated here and against the posterior in closed form."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from torch import Tensor

from bench.diagnose.logs.load import load
from bench.diagnose.logs.subject import Subject, log_of
from bench.diagnose.select.timing.acting_noise import acts, share_acting
from bench.diagnose.select.timing.commanded import Follower, Series, as_commanded, followers
from bench.diagnose.select.timing.reading import prepared
from bench.diagnose.settings import COMMANDING
from registry.contracts import Channel, Recording
from registry.dynamics import constant
from registry.physics.state_space import Mechanical
from registry.units import Signal

STEP, LAG, NOISE = 0.01, 0.03, 4.0
"""[s], [s], [rad/s]"""


def motor(seed: int, samples: int = 2000, own: float = 0.0, gain: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Speed (N,) and held commands (N,) of a motor that follows them exactly, but for steps of its own (1σ)."""
    rng = np.random.default_rng(seed)
    commands = 800 + np.repeat(rng.normal(0, 80, samples // 5), 5) + 150 * np.sin(0.02 * np.arange(samples))
    speed, decay = np.empty(samples), np.exp(-STEP / LAG)
    speed[0] = gain * commands[0]
    for k in range(1, samples):
        speed[k] = decay * speed[k - 1] + (1 - decay) * gain * commands[k - 1] + own * rng.normal()
    return speed, commands


def measured(speed: np.ndarray, seed: int, noise: float = NOISE) -> np.ndarray:
    return speed + noise * np.random.default_rng(1000 + seed).normal(size=len(speed))


def follower(series: Sequence[Series]) -> Follower | None:
    """Of one channel."""
    found = followers([series])
    return None if found is None else found[0]


@pytest.mark.parametrize("own", [0.0, 1.5])
def test_the_lag_and_both_noises_are_told_and_the_speed_is_nearer_than_either_says(own: float) -> None:
    true = [motor(seed, own=own, gain=0.9) for seed in range(4)]
    series = [(measured(speed, i), commands) for i, (speed, commands) in enumerate(true)]
    found = follower(series)
    assert found is not None
    assert -STEP / np.log(found.decay) == pytest.approx(LAG, rel=0.05)
    assert found.sensor**0.5 == pytest.approx(NOISE, rel=0.05)
    assert found.own**0.5 == pytest.approx(own, abs=0.4)  # over twelve draws .2 ± .2 and 1.48 ± .07
    left = np.concatenate([found.smoothed(s) - x for s, (x, _) in zip(series, true, strict=True)])
    assert left.std() == pytest.approx(found.gains[2] ** 0.5, abs=0.35)
    assert left.std() < (0.1 if own == 0 else 0.6) * NOISE


@pytest.mark.parametrize(
    ("gain", "bent", "as_asked", "parabola"), [(1, 0, True, False), (0.9, 0, False, False), (0.5, 3e-4, False, True)]
)
def test_no_more_is_fitted_than_the_recordings_ask_for(
    gain: float, bent: float, as_asked: bool, parabola: bool
) -> None:
    series = []
    for seed in range(4):
        _, asked = motor(seed)
        speed, decay = np.empty(len(asked)), np.exp(-STEP / LAG)
        speed[0] = asked[0]
        for k in range(1, len(asked)):
            wanted = gain * asked[k - 1] + bent * asked[k - 1] ** 2
            speed[k] = decay * speed[k - 1] + (1 - decay) * wanted
        series.append((measured(speed, seed), asked))
    found = follower(series)
    assert found is not None
    linear, squares, offset = found.commanded[:4], found.commanded[4:8], found.commanded[8]
    assert (squares != 0).any() == parabola
    exact = offset == 0 and linear.sum() == pytest.approx((1 - found.decay) * found.scale, rel=1e-9)
    assert exact == as_asked


def hover(lag: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Speed (N,) and slow commands (N,) of a motor that a hover hardly moves, by 1 rad/s of 1500."""
    rng = np.random.default_rng(seed)
    commands = 1500 + np.convolve(rng.normal(size=2600), np.hanning(200) / 9, "valid")
    speed, decay = commands.copy(), np.exp(-STEP / lag)
    for k in range(1, len(speed)):
        speed[k] = decay * speed[k - 1] + (1 - decay) * commands[k - 1]
    return speed, commands


def test_motors_of_one_kind_are_told_together_where_little_moves() -> None:
    true = [hover(LAG, seed) for seed in range(4)]
    channels = [[(measured(speed, i, noise=1.5), commands)] for i, (speed, commands) in enumerate(true)]
    found = followers(channels)
    assert found is not None and len(set(map(id, found))) == 1
    left = np.concatenate([f.smoothed(c[0]) - x for f, c, (x, _) in zip(found, channels, true, strict=True)])
    assert left.std() < 0.1
    assert found[0].left ** 0.5 == pytest.approx(left.std(), abs=0.05) and found[0].left > 0


def test_motors_that_differ_are_told_each_by_itself() -> None:
    lags, channels = (0.02, 0.04, 0.06, 0.08), []
    for i, lag in enumerate(lags):
        commands = motor(i)[1]
        speed, decay = commands.copy(), np.exp(-STEP / lag)
        for k in range(1, len(speed)):
            speed[k] = decay * speed[k - 1] + (1 - decay) * commands[k - 1]
        channels.append([(measured(speed, i), commands)])
    found = followers(channels)
    assert found is not None
    assert [-STEP / np.log(f.decay) for f in found] == pytest.approx(lags, rel=0.05)


@pytest.mark.parametrize(("own", "settled"), [(2.0, 12), (0.001, 0)])
def test_a_smoother_says_what_least_squares_over_all_samples_would(own: float, settled: int) -> None:
    speed, commands = motor(7, samples=80, own=own)
    y, decay = measured(speed, 7), float(np.exp(-STEP / LAG))
    lagged = np.zeros(9)
    lagged[1] = (1 - decay) * 1000  # the command before, which is scaled
    told = Follower(decay, lagged, 1000.0, NOISE**2, own**2)
    drive = (1 - decay) * commands[:-1]
    change = np.eye(80)[1:] - decay * np.eye(80)[:-1]
    a = np.concatenate([np.eye(80) / NOISE, change / own])
    exact = np.linalg.lstsq(a, np.concatenate([y / NOISE, drive / own]), rcond=None)[0]
    # A settled filter weighs the first samples as all others.
    assert told.smoothed((y, commands))[settled:] == pytest.approx(exact[settled:], abs=0.01)


def test_a_drive_that_goes_its_own_way_stays_as_it_was_measured() -> None:
    wandering = np.cumsum(np.random.default_rng(3).normal(0, 30, 3000))
    y = measured(wandering, 3, noise=1.0)
    found = follower([(y, motor(3, samples=3000)[1])])
    assert found is None or np.abs(found.smoothed((y, motor(3, samples=3000)[1])) - y).std() < 1.0


def test_a_drive_without_noise_and_commands_filed_twice_stay_as_they_are() -> None:
    speed, commands = motor(1)
    for drive in (speed, commands):
        assert follower([(drive, commands)]) is None
    subject = fan(noise=0.0)
    assert as_commanded(subject) is subject


def test_commands_that_never_change_say_nothing() -> None:
    assert follower([(measured(np.zeros(500), 1), np.zeros(500))]) is None


@dataclass(frozen=True)
class Fan(Mechanical):
    """A beam that a fan turns, whose speed is measured beside what it was asked for."""

    mass: Any = constant(0.02, "J", "kg m^2", low=1e-6)

    state_channels: ClassVar[tuple[Channel, ...]] = (Channel("angle.q", "rad"), Channel("angle_rate.q", "rad/s"))
    input_signals: ClassVar[tuple[str, ...]] = ("fan",)
    signals: ClassVar[dict[str, Signal]] = {"fan": Signal("rad/s", ("",))}
    equation: ClassVar[str] = "J d²q/dt² = 10⁻⁶ N m s u"

    def own_force(self, state: Tensor, inputs: Tensor) -> Tensor:
        """Torque (…, 1) [N m]."""
        return 1e-6 * inputs[..., :1]


def fan(
    commands: str = "asked",
    hold: str = "linear",
    own: float = 0.0,
    spare: int = 0,
    noise: float = NOISE,
    unasked: float = 0.0,
    seen: float = 1e-4,
) -> Subject:
    """A beam whose fan's speed has noise and what no logged command asked for (1σ), states ``seen`` with noise."""
    made, model = [], Fan(input_hold=hold)
    for seed in range(3):
        speed, asked = motor(seed, own=own)
        speed = speed + unasked * np.random.default_rng(90 + seed).normal(size=len(speed))
        rate = np.cumsum(1e-6 * speed) * STEP / 0.02
        rng = np.random.default_rng(50 + seed)
        states = np.column_stack([np.cumsum(rate) * STEP, rate]) + rng.normal(0, seen, (len(speed), 2))
        made.append(
            Recording(
                f"run_{seed}",
                1 / STEP,
                measured(speed, seed, noise)[:, None],
                np.column_stack([states, asked, *[np.zeros_like(asked)] * spare]),
                (Channel("fan", "rad/s"),),
                (*Fan.state_channels, *(Channel(f"asked.{i}", "rad/s") for i in range(1 + spare))),
                np.ones(len(speed), bool),
            )
        )
    logs, names = tuple(log_of(r, model, "fan") for r in made), tuple(r.name for r in made)
    signals = ("angle", "angle_rate", "fan")
    stated = {"fan": NOISE}
    return Subject("fan", model, logs, names[:-1], names[-1:], None, stated, {}, signals, commands=commands)


@pytest.mark.parametrize("spare", [0, 2])
def test_what_was_measured_and_the_commands_are_read_together(spare: int) -> None:
    subject = fan(spare=spare)  # an autopilot logs more outputs than there are motors
    read = as_commanded(subject)
    for seed, (log, before) in enumerate(zip(read.logs, subject.logs, strict=True)):
        error = log.inputs[:, 0].numpy() - motor(seed)[0]
        assert error.std() < 0.2 * (before.inputs[:, 0].numpy() - motor(seed)[0]).std()
    assert subject.noise == {"fan": NOISE}  # as stated
    lag, noise, left = map(float, re.findall(r"[\d.]+(?= ms| rad/s|\.$)", read.notes[-1]))
    assert (lag, noise) == pytest.approx((1e3 * LAG, NOISE), rel=0.05) and left < 0.2 * NOISE
    assert read.noise["fan"] == pytest.approx(left, rel=0.05)
    assert prepared(subject)[1].inputs == (read.noise["fan"],)


def test_what_no_logged_command_asked_for_stays_where_the_beam_answers_it() -> None:
    """A controller asks twice a sample and every second command is logged: the rest looks like white noise."""
    subject = fan(noise=0.5, unasked=NOISE, seen=2e-7)
    read = as_commanded(subject)
    assert all(a is b for a, b in zip(read.logs, subject.logs, strict=True)) and read.noise == subject.noise
    share, error = map(float, re.findall(r"answer ([\d.]+) ± ([\d.]+)", read.notes[-1])[0])
    # All but the sensor's noise, less what three intervals hold of a motion that the fan makes within each.
    assert 0.8 < share < NOISE**2 / (NOISE**2 + 0.5**2) + error and error <= 0.2


@pytest.mark.parametrize("seen", [1e-6, 1e-4])
def test_noise_of_the_sensor_moves_nothing(seen: float) -> None:
    subject = fan(seen=seen)
    read = as_commanded(subject)
    assert "commands say together" in read.notes[-1]
    share, error = share_acting(subject, read)
    assert abs(share) < 3 * error and not acts(share, error)


def test_a_long_recording_is_told_by_a_part_of_it(monkeypatch: pytest.MonkeyPatch) -> None:
    kinds = COMMANDING.__class__
    monkeypatch.setattr("bench.diagnose.select.timing.commanded.COMMANDING", kinds(enough=1500))
    true = [motor(seed) for seed in range(4)]
    (found,) = followers([[(measured(speed, i), commands) for i, (speed, commands) in enumerate(true)]]) or [None]
    assert found is not None and found.told_by < 1500
    assert -STEP / np.log(found.decay) == pytest.approx(LAG, rel=0.1)


def test_without_commands_and_of_commands_nothing_is_read_anew() -> None:
    for subject in (fan(commands=""), fan(hold="previous")):
        assert as_commanded(subject) is subject


def test_commands_that_would_leave_most_of_the_noise_change_nothing() -> None:
    subject = fan(own=30.0)
    assert as_commanded(subject) is subject


def test_a_folder_says_which_signal_asked_for_its_drive(tmp_path: Path) -> None:
    for seed in range(3):
        speed, asked = motor(seed)
        table = np.column_stack([np.arange(len(speed)) * STEP, speed, speed, measured(speed, seed), asked])
        np.savetxt(tmp_path / f"run_{seed}.csv", table, delimiter=",", header="t,q,v,u,asked", comments="", fmt="%.9g")
    (tmp_path / "dataset.toml").write_text("""
name = "rail"
system = "mass_on_rail"
rate_hz = 100
files = "*.csv"
time = "t"
input = "voltage"
commands = "asked"
[signals]
displacement = {columns = ["q"], unit = "m"}
speed = {columns = ["v"], unit = "m/s"}
voltage = {columns = ["u"], unit = "V"}
asked = {columns = ["asked"], unit = "V"}
[physics]
mass = 95.1
force_gain = 35.15
""")
    assert "is read as what was measured and the commands say together" in as_commanded(load(tmp_path)).notes[-1]


def test_what_is_not_valid_stays_as_it_was_filed() -> None:
    subject = fan()
    valid = subject.logs[0].valid.clone()
    valid[500:560] = False
    first = replace(subject.logs[0], valid=valid)
    read = as_commanded(replace(subject, logs=(first, *subject.logs[1:])))
    assert (read.logs[0].inputs[500:560] == first.inputs[500:560]).all()
    assert not (read.logs[0].inputs[:500] == first.inputs[:500]).all()
