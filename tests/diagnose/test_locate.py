"""Step 2: where the error is."""

import re
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import pytest
import torch
from torch import Tensor

from bench.diagnose.locate import locate
from bench.diagnose.logs.noise import noise_of
from bench.diagnose.logs.smoothing import Smoothing
from bench.diagnose.logs.subject import Subject, log_of
from bench.diagnose.simulate.flights import flights
from registry.contracts import Channel
from registry.core import EFFECTS
from registry.datasets.signals import recording
from registry.dynamics import constant, tensor
from registry.physics.quadrotor import Quadrotor
from registry.physics.state_space import StateSpace

DT = 0.01
LOSS = 2.0


@dataclass(frozen=True)
class Tub(StateSpace):
    """dx/dt = u − c where x > 1: one level, one inflow, one overflow."""

    overflow: Any = constant(0.0, "c", "m/s")

    state_channels: ClassVar[tuple[Channel, ...]] = (Channel("displacement.q", "m"),)
    input_signals: ClassVar[tuple[str, ...]] = ("force",)
    equation: ClassVar[str] = "dx/dt = u − c [x > 1]"

    def own_rate(self, state: Tensor, inputs: Tensor) -> Tensor:
        """dx/dt (…, 1)."""
        return inputs - tensor(self.overflow, state) * (state > 1)


def tub(overflow: float, recordings: int = 3, sigma: float = 0.002) -> Subject:
    """What a tub does in numpy: the level follows a slow wave that passes 1 for a quarter of the time."""
    rng, logs, t = np.random.default_rng(0), [], np.arange(2500) * DT
    for i in range(recordings):
        x = 0.3 + sum(
            a * np.sin(w * t + p) for a, w, p in zip((0.6, 0.4), (1.1, 2.3), rng.uniform(0, 6, 2), strict=True)
        )
        middle = (x[1:] + x[:-1]) / 2
        rate = np.diff(x) / DT + overflow * (middle > 1)  # the inflow that brings the level there
        u = np.concatenate([[rate[0]], (rate[1:] + rate[:-1]) / 2, [rate[-1]]])
        noisy = (x + rng.normal(0, sigma, len(x)))[:, None]
        made = recording(
            f"run_{i}", 1 / DT, {"force": u[:, None]}, {"displacement": noisy}, np.ones(len(x), dtype=bool)
        )
        logs.append(log_of(made, Tub(), "force"))
    names = tuple(log.name for log in logs)
    return Subject("tub", Tub(), tuple(logs), names[:2], names[2:], Smoothing(), {"displacement": sigma, "force": 0.0})


def test_the_region_of_a_missing_term_is_found_with_its_threshold_and_its_size() -> None:
    subject = tub(LOSS)
    found = locate(subject, subject.model, after=Tub(overflow=LOSS))
    best = found.regions[0]
    threshold = re.fullmatch(r"displacement > (\d\.\d+) m", best.region)
    assert threshold is not None and float(threshold[1]) == pytest.approx(1.0, abs=0.1)
    assert best.share_of_error > 0.9 and best.share_of_time < 0.3
    assert best.recordings == ("run_0", "run_1", "run_2")
    told = next(m for m in found.residuals if m.x_signal == "displacement")
    assert (told.y_quantity, told.y_unit, told.region) == ("rate of change of displacement.q", "m/s", best.region)
    x, y = np.array(told.x), np.array(told.y)
    assert y[x > 1.2].mean() == pytest.approx(-LOSS, rel=0.05)
    assert np.abs(y[x < 0.8].mean()) < 0.02
    assert told.before[-1] < -0.7 * LOSS and np.abs(told.after).max() < 0.1


def test_the_worst_windows_are_of_different_recordings_and_show_what_was_measured() -> None:
    subject = tub(LOSS)
    windows = locate(subject, subject.model, after=Tub(overflow=LOSS)).windows
    assert sorted(w.recording for w in windows) == ["run_0", "run_1", "run_2"]
    for w in windows:
        first = round(w.start_s / DT)
        measured = subject.of([w.recording])[0].states[first : first + len(w.t), 0].numpy()
        assert w.measured[0] == pytest.approx(measured)
        missed, left = (np.abs(np.array(x[0]) - measured)[-1] for x in (w.nominal, w.extended))
        assert missed > 0.5 * LOSS * w.t[-1] and left < 0.2 * missed


def test_the_worst_windows_and_whole_recordings_run_as_long_as_was_asked_for() -> None:
    subject, better = tub(LOSS), Tub(overflow=LOSS)
    for w in locate(subject, subject.model, after=better, horizon_s=3.0).windows:
        assert w.t[-1] == pytest.approx(3.0) and len(w.nominal[0]) == 301
    for shown in flights(subject, subject.model, better, noise_of(subject), horizon_s=3.0):
        assert shown.restart_s == pytest.approx(3.0)


def test_an_exact_model_errs_nowhere_in_particular() -> None:
    subject = tub(0.0)
    found = locate(subject, subject.model)
    assert found.regions == () and "no larger than noise" in found.notes[0]


def test_a_spike_in_one_recording_is_no_region() -> None:
    subject = tub(0.0)
    log = subject.logs[0]
    log.states[1200:1230] += 0.3
    found = locate(subject, subject.model)
    assert max(found.above_floor.values()) > 1 and found.regions == ()


def test_the_residual_of_a_body_is_a_force_in_its_own_axes() -> None:
    drag = EFFECTS.get("linear_drag")(d_x=0.3, d_y=0.1, d_z=0.0)
    simple = Quadrotor(mass=1.2, extras=("time",))
    hover = (1.2 * 9.81 / 4 / simple.thrust_coefficient) ** 0.5
    logs = []
    for i, (v, yaw) in enumerate([((4.0, 1.0, 0.0), 1.2), ((-3.0, 2.0, 0.0), -2.0)]):
        state = torch.zeros(13, dtype=torch.float64)
        state[3:6] = torch.tensor(v)
        state[8:10] = torch.tensor([np.sin(yaw / 2), np.cos(yaw / 2)])
        state[12] = 0.8  # turns, so that the velocity sweeps through all directions of the body
        inputs = torch.full((600, 5), hover, dtype=torch.float64)
        inputs[:, 4] = torch.arange(600) * DT
        x = replace(simple, effects=(drag,)).simulate(state, inputs, DT).numpy()
        signals = {"position": x[:, :3], "velocity": x[:, 3:6], "attitude": x[:, 6:10], "body_rates": x[:, 10:]}
        made = recording(
            f"flight_{i}", 100.0, {"rotor_speed": inputs[:, :4].numpy()}, signals, np.ones(600, dtype=bool)
        )
        logs.append(log_of(made, simple, "rotor_speed"))
    names = ("flight_0", "flight_1")
    subject = Subject("drag", simple, tuple(logs), names[:1], names[1:], Smoothing(), {})
    maps = {(m.y_quantity, m.x_signal): m for m in locate(subject, simple).residuals}
    for axis, signal, d in (("x", "forward airspeed", 0.3), ("y", "leftward airspeed", 0.1)):
        m = maps[f"force {axis}", signal]
        assert m.y_unit == "N"
        assert np.polyfit(m.x, m.y, 1)[0] == pytest.approx(-d, rel=0.02)
