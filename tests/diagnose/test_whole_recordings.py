"""Whole recordings beside the models: where free runs begin anew, what they err, and how true thinned lines are."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid
from scipy.spatial.transform import Rotation
from torch import Tensor

from bench.diagnose.evidence import AFTER, Flight
from bench.diagnose.logs.noise import noise_of
from bench.diagnose.logs.smoothing import Smoothing
from bench.diagnose.logs.subject import Subject, log_of
from bench.diagnose.settings import PLAYING
from bench.diagnose.simulate.flights import euler, flights
from registry.contracts import Channel
from registry.datasets.signals import recording
from registry.dynamics import constant, tensor
from registry.physics.state_space import StateSpace

DT = 0.01
STEPS = 50
"""Samples of the default horizon at 100 Hz."""
LOSSES = {"first": 0.2, "second": 0.3, "third": 0.6, "fourth": 0.4}


@dataclass(frozen=True)
class Basin(StateSpace):
    """dx/dt = u − c: what flows in, less a constant loss."""

    loss: Any = constant(0.0, "c", "m/s")

    state_channels: ClassVar[tuple[Channel, ...]] = (Channel("displacement.q", "m"),)
    input_signals: ClassVar[tuple[str, ...]] = ("force",)
    equation: ClassVar[str] = "dx/dt = u − c"

    def own_rate(self, state: Tensor, inputs: Tensor) -> Tensor:
        """dx/dt (…, 1)."""
        return inputs - tensor(self.loss, state)


def basins(gap: bool = False) -> Subject:
    """Levels that lose what `LOSSES` says, exactly, without noise."""
    t, logs = np.arange(1000) * DT, []
    for i, (name, loss) in enumerate(LOSSES.items()):
        u = np.sin(3 * t + i) + 0.4 * np.sin(17 * t)
        x = 5 + cumulative_trapezoid(u, t, initial=0.0) - loss * t
        valid = np.ones(len(t), dtype=bool)
        if gap:
            valid[420:430] = False
        made = recording(name, 1 / DT, {"force": u[:, None]}, {"displacement": x[:, None]}, valid)
        logs.append(log_of(made, Basin(), "force"))
    names = tuple(LOSSES)
    noise = {"displacement": 0.0, "force": 0.0}
    return Subject("basins", Basin(), tuple(logs), names[:1], names[1:], Smoothing(), noise)


def shown(subject: Subject, **limits: int) -> tuple[Flight, ...]:
    return flights(subject, Basin(), Basin(loss=0.3), noise_of(subject), **limits)


def test_errors_are_those_of_runs_that_begin_anew_at_the_measured_state() -> None:
    found = {f.recording: f for f in shown(basins())}
    lag = DT * np.arange(STEPS + 1)
    for name, loss in LOSSES.items():
        (signal,) = found[name].signals
        (trace,) = signal.traces
        assert trace.rms["nominal"] == pytest.approx(loss * np.sqrt(np.mean(lag**2)), rel=1e-9)
        assert trace.rms[AFTER] == pytest.approx(abs(loss - 0.3) * np.sqrt(np.mean(lag**2)), rel=1e-9, abs=1e-12)
        assert found[name].restart_s == STEPS * DT


def test_held_out_recordings_come_first_and_the_worst_of_them_before_the_others() -> None:
    found = shown(basins())
    assert [f.recording for f in found] == ["third", "fourth", "second", "first"]
    assert [f.held_out for f in found] == [True, True, True, False]
    assert [f.recording for f in shown(basins(), most=2)] == ["third", "fourth"]


def test_no_line_crosses_a_gap() -> None:
    for trace in (f.signals[0].traces[0] for f in shown(basins(gap=True))):
        for pieces in trace.lines.values():
            assert all(at[-1] < 420 or at[0] >= 430 for at, _ in pieces)
        assert len(trace.lines["measured"]) == 2


def test_a_thinned_line_misses_no_sample_by_more_than_it_says() -> None:
    subject = basins()
    for flight in shown(subject):
        log, (trace,) = subject.of([flight.recording])[0], flight.signals[0].traces
        x = log.states[:, 0].numpy()
        ((at, y),) = trace.lines["measured"]
        assert len(at) < len(x) / 2
        # each of the levels of halving may add its own
        assert np.abs(np.interp(np.arange(len(x)), at, y) - x).max() < 3 * PLAYING.finest * np.ptp(x)
        for at, y in trace.lines["nominal"]:
            assert y[0] == x[at[0]] and at[-1] - at[0] == STEPS


def test_a_page_is_kept_small_by_leaving_recordings_out_and_cutting_the_first() -> None:
    whole = shown(basins())
    assert [f.recording for f in shown(basins(), points=whole[0].points + whole[1].points)] == ["third", "fourth"]
    (cut,) = shown(basins(), points=whole[0].points // 2)
    assert cut.recording == "third" and cut.samples < 600 < cut.whole == 1000
    assert cut.points <= whole[0].points // 2
    assert all(at[-1] < cut.samples for t in cut.signals[0].traces for p in t.lines.values() for at, _ in p)


def test_angles_are_those_of_scipy_and_turn_on() -> None:
    t = np.linspace(0, 4, 401)
    turned = np.stack([0.4 * np.sin(t), 0.3 * np.cos(2 * t), 3.0 * t], axis=-1)  # roll, pitch, yaw: two turns
    quaternions = Rotation.from_euler("ZYX", turned[:, ::-1]).as_quat()
    assert euler(quaternions) == pytest.approx(turned, abs=1e-9)
    late = euler(quaternions[300:], begin=turned[300])
    assert late == pytest.approx(turned[300:], abs=1e-9)
