"""A slow mode in a log that is sampled far faster than it moves, and was filtered before it was kept."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import pytest
from scipy.signal import butter, filtfilt
from torch import Tensor

from bench.diagnose.fit import fit_parameters
from bench.diagnose.learn.axis_series import AxisSeries, Stretch, axis_series
from bench.diagnose.learn.modes.search import sought
from bench.diagnose.logs.subject import Subject, log_of
from bench.diagnose.select.timing.reading import prepared
from bench.diagnose.settings import HIDING
from registry.contracts import Channel, Recording
from registry.dynamics import constant, tensor
from registry.physics.state_space import StateSpace
from registry.terms.signals import available
from registry.units import Signal

RATE, FINE, PASSED, RELAXING = 20, 5, 1.0, 1.7
"""Samples a second, steps a sample, what the recorded rate's zero-phase filter passes [Hz], how late sway is [s]."""


@dataclass(frozen=True)
class Ship(StateSpace):
    """A ship that its rudder turns (Nomoto, first order)."""

    gain: Any = constant(0.016, "K", "1/s^2", uncertainty=0.3)
    damping: Any = constant(0.05, "D", "1/s", low=0, uncertainty=0.5)

    state_channels: ClassVar[tuple[Channel, ...]] = (Channel("angle_rate.yaw", "rad/s"),)
    input_signals: ClassVar[tuple[str, ...]] = ("rudder",)
    signals: ClassVar[dict[str, Signal]] = {"rudder": Signal("rad", ("",))}
    alike: ClassVar[tuple[str, ...]] = ()
    equation: ClassVar[str] = "dr/dt = K δ − D r"

    def own_rate(self, state: Tensor, inputs: Tensor) -> Tensor:
        """The turn's rate of change (…, 1)."""
        gain, damping = (tensor(v, state).unsqueeze(-1) for v in (self.gain, self.damping))
        return gain * inputs[..., :1] - damping * state


def zigzag(seed: int, seconds: float = 100.0) -> tuple[np.ndarray, np.ndarray]:
    """Rudder and rate (N, 1) of a ship whose turns also go with |r| r and with a sway that answers the rudder late."""
    rng, dt = np.random.default_rng(seed), 1 / RATE / FINE
    most, side = np.radians(rng.uniform(5, 35)), 1
    kicks, share = rng.normal(size=round(seconds / dt)), 2 * np.pi * dt
    heading = rate = rudder = sway = 0.0
    waves = np.zeros(3)
    out = []
    for k, kick in enumerate(kicks):
        if k % FINE == 0:
            out.append((rudder, rate))
        if side * heading > most / 3 + 0.05:
            side = -side
        turning = float(np.clip((side * most - rudder) / dt, -0.35, 0.35))
        waves += share * (np.array([kick, *waves[:2]]) - waves)
        change = (
            0.016 * rudder - 0.05 * rate - rate * abs(rate) - 0.02 * (sway - rudder) + 0.002 * waves[2] / share**0.5
        )
        sway += dt / RELAXING * (rudder - sway)
        heading, rate, rudder = heading + dt * rate, rate + dt * change, rudder + dt * turning
    found = np.array(out)
    filtered = filtfilt(*butter(4, PASSED, fs=RATE), found[:, 1:], axis=0)
    return found[:, :1], filtered + 1e-6 * rng.normal(size=filtered.shape)


@pytest.fixture(scope="module")
def ship() -> Subject:
    """Six recordings of 100 s, the last two of them held out."""
    model, logs = Ship(), []
    for i in range(6):
        rudder, rate = zigzag(100 + i)
        channels, good = (Channel("rudder", "rad"),), np.ones(len(rate), bool)
        made = Recording(f"run_{i}", float(RATE), rudder, rate, channels, model.state_channels, good)
        logs.append(log_of(made, model, "rudder"))
    names = [log.name for log in logs]
    return Subject(
        "ship", model, tuple(logs), tuple(names[:4]), tuple(names[4:]), None, {}, {}, ("angle_rate", "rudder")
    )


def test_it_shows_in_longer_windows(ship: Subject) -> None:
    of, noise = prepared(ship)
    calibrated, _ = fit_parameters(of, of.model, noise, through_simulator=False)
    (series,) = axis_series(of, calibrated, noise)
    drivers = {name: place for place, name in enumerate(available(of.model)) if name in ("angle_rate.yaw", "rudder")}
    relaxing = {}
    for count in (1, 4):
        seen = sought(series.coarser(count), drivers, of.training, len(HIDING.windows), ["rudder"])
        relaxing[count] = {m.driver: 1 / (2 * np.pi * m.pole.frequency) for m in seen if m.pole.order == 1}
    assert relaxing[4]["rudder"] == pytest.approx(RELAXING, rel=0.3)
    assert relaxing[1].get("rudder", np.inf) > 2 * RELAXING


def test_longer_windows_are_means_of_short_ones() -> None:
    dt, stride, count, frequency = 0.05, 2, 4, 0.7
    t = np.arange(400) * dt
    kernel = np.array([0.25, 0.5, 0.25])
    centres = np.arange(1, 399, stride)
    means = np.array([kernel @ np.cos(2 * np.pi * frequency * t[c - 1 : c + 2]) for c in centres])
    short = Stretch("a", t[centres], means, means[:, None], 2 * means, means[:, None])
    series = AxisSeries(
        "speed.q", "m/s²", (short, Stretch("b", *(x[:7] for x in (short.t, *[means] * 4)))), stride * dt, kernel, 0, dt
    )
    long = series.coarser(count)
    assert [s.recording for s in long.stretches] == ["a"] and long.step == pytest.approx(count * stride * dt)
    (stretch,) = long.stretches
    np.testing.assert_allclose(stretch.t, short.t[: len(short.t) // count * count].reshape(-1, count).mean(1))
    np.testing.assert_allclose(stretch.driven, 2 * stretch.left)
    # What is left of a sine's amplitude is what the weights say.
    basis = np.column_stack([np.cos(2 * np.pi * frequency * stretch.t), np.sin(2 * np.pi * frequency * stretch.t)])
    amplitude = np.linalg.norm(np.linalg.lstsq(basis, stretch.left, rcond=None)[0])
    assert amplitude == pytest.approx(long.gain(frequency), rel=1e-9)
