"""Machines whose encoder tells places, and whose rates nobody measured."""

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
import torch
from scipy.linalg import expm
from scipy.ndimage import correlate1d
from torch import Tensor

from bench.diagnose import diagnose, load
from bench.diagnose.checks import shifts as check
from bench.diagnose.logs.meant import as_meant
from bench.diagnose.logs.noise import impulse_response, noise_of
from bench.diagnose.logs.sample import shortened
from bench.diagnose.logs.slopes import with_missed, with_slopes
from bench.diagnose.logs.smoothing import Slope, Smoothing
from bench.diagnose.logs.subject import LogBatch, log_of
from bench.diagnose.regression.test_functions import TestFunctions
from bench.diagnose.regression.weak import mean_rates
from bench.diagnose.select.simulated import by_simulation
from bench.diagnose.settings import SHIFTING
from bench.diagnose.simulate.floor import measure
from bench.diagnose.simulate.unmeasured import hidden
from registry.contracts import Channel, Recording
from registry.dynamics import constant, tensor
from registry.physics.quadrotor import Quadrotor
from registry.physics.state_space import Mechanical, StateSpace
from registry.physics.tanks import Tanks
from registry.units import Signal

INERTIA, WEIGHT, VISCOUS, COULOMB = 0.152, 2.9, 0.03, 0.12
RATE, FINER, COUNT = 200, 40, 2 * np.pi / 4096
GIVEN = (Channel("torque", "N m"),)

SYSTEM = '''
from dataclasses import dataclass
from typing import Any

import torch

from registry.contracts import Channel
from registry.dynamics import constant, tensor
from registry.physics.state_space import Mechanical, StateSpace
from registry.units import Signal


@dataclass(frozen=True)
class Swing(Mechanical):
    """A pendulum on the shaft of a motor."""

    mass: Any = constant(0.15, "J", "kg m^2", low=1e-6, uncertainty=0.05)
    weight: Any = constant(2.98, "m g l", "N m", low=0, uncertainty=0.05)
    state_channels = (Channel("tilt.shaft", "rad"), Channel("turning.shaft", "rad/s"))
    input_signals = ("torque",)
    signals = {
        "torque": Signal("N m", ("",)),
        "tilt": Signal("rad", ("shaft",)),
        "turning": Signal("rad/s", ("shaft",)),
    }
    equation = "J d²q/dt² = u − m g l sin q"

    def own_force(self, state, inputs):
        return inputs[..., :1] - tensor(self.weight, state).unsqueeze(-1) * torch.sin(state[..., :1])
'''
DESCRIPTION = """
name = "swing"
rate_hz = 200
files = "*.csv"
time = "t"
input = "torque"
input_hold = "previous"

[signals]
torque = {columns = ["u"], unit = "N m"}
tilt = {columns = ["q"], unit = "rad"}
"""


@cache
def swung(seconds: float = 15.0, recordings: int = 3) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Angle, its rate and held torque (recordings, N) of a pendulum with dry and viscous friction, which sticks too."""
    rng, samples = np.random.default_rng(4), round(seconds * RATE)
    tones, phases = rng.uniform(0.1, 1.3, (recordings, 6, 1)), rng.uniform(0, 2 * np.pi, (recordings, 6, 1))
    torque = 0.9 * np.cos(2 * np.pi * tones * np.arange(samples) / RATE + phases).sum(1)
    q, v, step, path = np.zeros(recordings), np.zeros(recordings), 1 / RATE / FINER, []
    for u in torque.T:
        path.append((q, v))
        for _ in range(FINER):
            q = q + step / 2 * v
            push = u - WEIGHT * np.sin(q) - VISCOUS * v
            dry = np.where(v == 0, np.clip(-push, -COULOMB, COULOMB), -COULOMB * np.sign(v))
            after = v + step * (push + dry) / INERTIA
            v = np.where(after * v < 0, 0.0, after)
            q = q + step / 2 * v
    return (*np.array(path).transpose(1, 2, 0), torque)


@pytest.fixture(scope="module")
def swing(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A folder of it with what an encoder of 4096 counts a turn says, and a model that knows no friction."""
    folder = tmp_path_factory.mktemp("swing")
    for i, (q, _, u) in enumerate(zip(*swung(), strict=True)):
        table = np.stack([np.arange(len(q)) / RATE, u, np.round(q / COUNT) * COUNT], axis=1)
        np.savetxt(folder / f"run_{i}.csv", table, "%.9g", ",", header="t,u,q", comments="")
    (folder / "dataset.toml").write_text(DESCRIPTION)
    (folder / "swing.py").write_text(SYSTEM)
    return folder, f"{folder / 'swing.py'}:Swing"


@dataclass(frozen=True)
class Drive(StateSpace):
    """A motor and a load on one elastic shaft."""

    state_channels: ClassVar[tuple[Channel, ...]] = tuple(
        Channel(f"{group}.{axis}", unit)
        for group, unit in (("angle", "rad"), ("angle_rate", "rad/s"))
        for axis in ("motor", "load")
    )
    input_signals: ClassVar[tuple[str, ...]] = ("torque",)
    signals: ClassVar[dict[str, Signal]] = {"torque": Signal("N m", ("motor",))}

    def own_rate(self, state: Tensor, inputs: Tensor) -> Tensor:
        twist = (state[..., :1] - state[..., 1:2]) * tensor((-30.0, 10.0), state)
        return torch.cat([state[..., 2:], twist + inputs * tensor((20.0, 0.0), state)], dim=-1)


def test_of_two_joints_one_may_have_an_encoder_alone_and_the_other_a_tachometer() -> None:
    """A part of a signal was read in whatever unit it came, and of an encoder beside a tachometer no rate was made."""
    t, noise = np.arange(2000) / 500, np.random.default_rng(0).normal(size=(2000, 2)) * 1e-4
    angle, rate = np.stack([np.sin(2 * t), np.cos(3 * t)], 1), np.stack([2 * np.cos(2 * t), -3 * np.sin(3 * t)], 1)
    outputs = np.concatenate([np.degrees(angle + noise), rate[:, :1] * 30 / np.pi], axis=1)
    channels = (Channel("angle.motor", "deg"), Channel("angle.load", "deg"), Channel("angle_rate.motor", "rpm"))
    log = Recording("r", 500, np.zeros((2000, 1)), outputs, GIVEN, channels, np.ones(2000, bool))
    model = Drive(input_hold="previous")
    sloped = with_slopes([as_meant(log, Drive)], model, None)
    assert {j: s.of for j, s in sloped.slopes.items()} == {3: 1}
    assert sloped.notes[0].startswith("The angle rate of load was not measured: it is the slope of the angle")
    made = log_of(sloped.recordings[0], model, "torque")
    inside = made.valid.numpy()
    assert made.measured == (True,) * 4 and inside.mean() > 0.9
    np.testing.assert_allclose(made.states.numpy()[inside, 2], rate[inside, 0], atol=1e-12)
    np.testing.assert_allclose(made.states.numpy()[inside, 3], rate[inside, 1], atol=0.05)


def test_friction_is_named_although_only_an_encoder_was_logged(swing, monkeypatch) -> None:
    monkeypatch.setattr(by_simulation, "discover", None)  # which fits simulations, for minutes
    subject = load(*swing)
    assert hidden(subject.logs) == () and "turning" in subject.signals
    assert any("The turning was not measured: it is the slope of the tilt" in note for note in subject.notes)
    said, _ = diagnose(subject, brief=True)
    assert said.verdict == "named"
    found = {e.id: e.parameters for e in said.effects}
    assert set(found) == {"viscous_friction", "coulomb_friction"}
    for name, number, true in (("viscous_friction", "f_v", VISCOUS), ("coulomb_friction", "f_c", COULOMB)):
        p = found[name][number]
        assert p.low <= true <= p.high and p.value == pytest.approx(true, rel=0.1)
    for name, true in (("mass", INERTIA), ("weight", WEIGHT)):
        assert said.constants[name].value == pytest.approx(true, rel=0.01)
    assert said.error.extended["turning"].rmse < 1.1 * said.noise_floor["turning"].rmse


@pytest.mark.parametrize("count", [2 * np.pi / 16384, 2 * np.pi / 1024, 2 * np.pi / 128])
def test_the_window_is_the_one_whose_slope_errs_least(count: float) -> None:
    q, v, u = swung()
    made = with_slopes([recording(np.round(a / count) * count, b) for a, b in zip(q, u, strict=True)], Shaft(), None)
    slope = made.slopes[1]
    assert (slope.of, slope.smoothing.order, slope.smoothing.derived) == (0, 3, True)
    errors = {}
    for window in {slope.smoothing.window, *range(5, 150, 6)}:
        weights = impulse_response(replace(slope.smoothing, window=window), True)
        read = correlate1d(np.round(q / count) * count, weights, axis=1) * RATE
        errors[window] = float(np.sqrt(((read - v)[:, 80:-80] ** 2).mean()))
    assert errors[slope.smoothing.window] < 1.2 * min(errors.values()) < 0.1 * errors[5]
    for r, true in zip(made.recordings, v, strict=True):
        assert r.channels[-1].name == "turning.shaft" and r.valid.sum() == len(r) - slope.smoothing.window + 1
        left = (r.outputs[:, 1] - true)[r.valid]
        assert np.sqrt((left**2).mean()) < 1.3 * min(errors.values())


def test_the_floor_knows_the_noise_of_a_slope(swing) -> None:
    subject = load(*swing)
    noise = noise_of(subject)
    assert noise.smoothing.kind == "none" and noise.smoothing_of(1) == subject.slopes[1].smoothing
    assert 0.9 < noise.raw[0] / (COUNT / 12**0.5) < 1.4 and noise.raw[1] == 0
    still = torch.zeros(1, 4000, 2, dtype=torch.float64)
    drawn = measure(still, noise, subject.model.state_channels, 1 / RATE, np.random.default_rng(0))
    assert drawn.shape[1] == 4000 - 2 * noise.half_width
    assert drawn.std((0, 1)).tolist() == pytest.approx(noise.processed, rel=0.1)


def test_a_stated_filter_is_not_gone_through_twice() -> None:
    q, _, u = swung()
    filtered = Smoothing("mean", 7, derived=True)
    made = with_slopes([recording(q[0], u[0])], Shaft(), filtered)
    assert made.slopes[1].smoothing == replace(filtered, differenced=True, straight=True) and made.noise == {}
    assert made.recordings[0].outputs[2:-2, 1] == pytest.approx(np.gradient(q[0], 1 / RATE)[2:-2])


@pytest.mark.parametrize("hold, stride", [("previous", 1), ("linear", 1), ("previous", 3)])
def test_what_a_window_does_not_follow_is_taken_from_the_model(hold: str, stride: int) -> None:
    """A motor whose own voltage brakes it, without noise: what a window takes off its rate brakes it as well.

    Its motion is exact (matrix exponentials); the model that fills in is a tenth off, the one that is judged is not.
    """
    q, _, u = turned(hold)
    exact = replace(Brushed(), input_hold=hold)
    slope = {1: Slope(0, Smoothing("savgol", 25, 3, derived=True, straight=hold == "linear"))}
    v = correlate1d(q, impulse_response(slope[1].smoothing, True), mode="nearest") * RATE
    valid = np.zeros(len(q), dtype=bool)
    valid[12:-12] = True
    one = Recording("run", float(RATE), u[:, None], np.stack([q, v], 1), GIVEN, Shaft.state_channels, valid)
    log = log_of(one, exact, "torque")
    rows = []
    for seen in (log, with_missed(log, replace(exact, mass=1.1 * exact.mass, brake=0.9 * exact.brake), slope)):
        (seen,) = shortened([seen], len(seen), stride, [0] if hold == "previous" else [])
        stack, filters = LogBatch.of([seen]), [slope[1].smoothing.coarser(stride)]
        tests = TestFunctions.over([seen], 12 // stride, filters)
        modelled = tests.integral(0, 0, mean_rates(exact, stack)[0, :, 1].numpy(), stack.dt)
        rows.append((tests.increment(0, seen.states[:, 1:].numpy())[:, 0] - modelled)[4:-4])
    without, with_it = (float(np.sqrt((r**2).mean())) for r in rows)
    assert with_it < 0.15 * without


def test_what_noise_of_a_slope_shifts_is_no_fault_of_the_log(swing, monkeypatch) -> None:
    subject = load(*swing)
    window = subject.slopes[1].smoothing.window
    for times, stopped in ((0.9, False), (1.1, True)):
        lag = -times * SHIFTING.blurred * window
        assert lag < -SHIFTING.certain
        monkeypatch.setattr(check, "lag_of", lambda *_, lag=lag: check.Lag(lag, 0.9, lag, lag))
        found, suspected = check.shifts(subject, {})
        assert bool(found) is stopped and bool(suspected) is not stopped
        assert check.shifts(replace(subject, slopes={}), {})[0]


@pytest.mark.parametrize("model, seen", [(Tanks(), ("level.lower",)), (Quadrotor(), ("position", "body_rates"))])
def test_what_is_no_slope_or_does_not_run_free_stays_unmeasured(model: Any, seen: tuple[str, ...]) -> None:
    """The level of another tank is no rate; a velocity without an attitude would run free of nothing."""
    channels = tuple(c for c in model.state_channels if c.name in seen or c.group in seen)
    values = np.random.default_rng(0).normal(size=(300, len(channels)))
    one = Recording("run", 100.0, np.zeros((300, 0)), values, (), channels, np.ones(300, dtype=bool))
    made = with_slopes([one], model, None)
    assert made.slopes == {} and made.recordings == (one,)


@dataclass(frozen=True)
class Shaft(Mechanical):
    """The same in this process."""

    mass: Any = constant(INERTIA, "J", "kg m^2", low=1e-6)
    state_channels: ClassVar[tuple[Channel, ...]] = (Channel("tilt.shaft", "rad"), Channel("turning.shaft", "rad/s"))
    input_signals: ClassVar[tuple[str, ...]] = ("torque",)
    signals: ClassVar[dict[str, Signal]] = {"torque": Signal("N m", ("",))}
    equation: ClassVar[str] = "J d²q/dt² = u"

    def own_force(self, state: Tensor, inputs: Tensor) -> Tensor:
        return inputs[..., :1] * tensor(1.0, state)


@dataclass(frozen=True)
class Brushed(Shaft):
    """A shaft that its motor brakes in proportion to its rate."""

    brake: Any = constant(0.9, "K²/R", "N m s/rad", low=0)

    def own_force(self, state: Tensor, inputs: Tensor) -> Tensor:
        return inputs[..., :1] - tensor(self.brake, state) * state[..., 1:]


def turned(hold: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Angle, rate and torque (N,) of such a shaft, which tones drive that hold or are straight between samples."""
    t = np.arange(4000) / RATE
    u = np.sin(2 * np.pi * np.array([0.4, 1.1, 1.7, 2.6]) * t[:, None] + np.arange(4)).sum(1)
    model, path = Brushed(), np.zeros((len(u), 2))
    rates = np.zeros((4, 4))
    rates[0, 1], rates[1, 1], rates[1, 2], rates[2, 3] = 1.0, -model.brake / model.mass, 1 / model.mass, 1.0
    step, slopes = expm(rates / RATE), 0 * u if hold == "previous" else np.append(np.diff(u), 0) * RATE
    for k in range(len(u) - 1):
        path[k + 1] = step[:2] @ [*path[k], u[k], slopes[k]]
    return path[:, 0], path[:, 1], u


def recording(q: np.ndarray, u: np.ndarray) -> Recording:
    """Of the angle alone."""
    return Recording(
        "run", float(RATE), u[:, None], q[:, None], GIVEN, Shaft.state_channels[:1], np.ones(len(q), dtype=bool)
    )
