"""States that were not measured: what can be said without them, and what by simulation."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from bench.diagnose import diagnose, load
from bench.diagnose.discover import discover
from bench.diagnose.logs.subject import LogBatch, Subject, log_of, self_contained
from bench.diagnose.select.simulated import by_simulation
from bench.diagnose.settings import SIMULATING
from bench.diagnose.simulate.simulation_fit import Windows, fit, starts
from bench.diagnose.simulate.unmeasured import beginning, completed, hidden
from registry.contracts import Channel, Recording
from registry.effects.mechanics.stiffness import CubicStiffness, JointElasticity
from registry.physics.oscillator import Oscillator
from registry.physics.quadrotor import Quadrotor
from registry.physics.tanks import Tanks

UPPER, VOLTAGE = (14.0, 22.0), Channel("voltage", "V")


@pytest.fixture(scope="module")
def tanks():
    """Two recordings of two tanks, of which the level of the upper one is hidden, and that level."""
    rng = np.random.default_rng(3)
    truth = Tanks(upper_outflow=0.06, pump_gain=0.11, input_hold="previous")
    logs, upper = [], []
    for i, first in enumerate(UPPER):
        drive = np.repeat(rng.uniform(1.5, 3.5, 13), 20)[:257, None]
        state = torch.tensor([[first, 6.0]], dtype=torch.float64)
        run = truth.simulate(state, torch.from_numpy(drive)[None], 4.0)[0].numpy()
        level = run[:, 1:] + rng.normal(size=(257, 1)) * 1e-3
        made = Recording(f"run_{i}", 0.25, drive, level, (VOLTAGE,), Tanks.state_channels[1:], np.ones(257, dtype=bool))
        logs.append(log_of(made, Tanks(input_hold="previous"), "voltage"))
        upper.append(run[:, 0])
    names = tuple(log.name for log in logs)
    return Subject("tanks", Tanks(input_hold="previous"), tuple(logs), names, names), truth, np.array(upper)


def test_the_beginning_of_an_unmeasured_state_is_found(tanks):
    subject, truth, upper = tanks
    stack = LogBatch.of(subject.logs)
    assert hidden(subject.logs) == (0,)
    assert beginning(truth, stack)[:, 0].numpy() == pytest.approx(UPPER, rel=0.01)
    assert completed(truth, stack)[..., 0].numpy() == pytest.approx(upper, rel=0.01)


def test_constants_are_fitted_although_a_state_is_unmeasured(tanks):
    subject, truth, _ = tanks
    windows = Windows.of(subject.logs)
    (found,) = fit(subject, windows, starts(windows, [subject.model]))
    assert np.sqrt(found.loss.sum() / found.errors.size) < 2e-3  # as much as the noise
    assert found.model.lower_outflow == pytest.approx(truth.lower_outflow, rel=0.05)


@pytest.mark.parametrize("times", [(0.5, 2, 1), (2, 0.5, 1), (0.5, 0.5, 2), (2, 1, 1)], ids=str)
def test_steps_that_go_too_far_do_not_end_a_fit(tanks, times):
    """By itself a fit from afar ends at the noise, without others beside it whose steps still gain."""
    subject, _, _ = tanks
    names = ("lower_outflow", "pump_gain", "upper_outflow")
    far = replace(subject.model, **{n: f * getattr(subject.model, n) for n, f in zip(names, times, strict=True)})
    windows = Windows.of(subject.logs)
    (found,) = fit(subject, windows, starts(windows, [far]), steps=30)
    assert np.sqrt(found.loss.sum() / found.errors.size) < 2e-3


def test_there_are_windows_enough_to_leave_some_out_at_any_sampling_rate(tanks):
    one, two = (Windows.of(tanks[0].logs[:count]) for count in (1, 2))
    assert len(one.log) >= 7 and len(two.log) >= 7  # the first sample of all is no step
    many = Windows.of(tanks[0].logs * 8)
    assert many.inputs.shape[1] - 1 == SIMULATING.window


@pytest.fixture(scope="module")
def spring():
    """A hardening spring far into its cubic part, of which the speed is hidden."""
    rng, rate, samples = np.random.default_rng(0), 100.0, 800
    truth = Oscillator(damping=0.51, stiffness=102.0, input_hold="previous", effects=(CubicStiffness(k_3=3000.0),))
    time, tones, logs = np.arange(samples) / rate, np.linspace(0.1, 4, 30), []
    for i in range(2):
        drive = 2.5 * np.cos(2 * np.pi * tones * time[:, None] + rng.uniform(0, 2 * np.pi, 30)).sum(1, keepdims=True)
        run = truth.simulate(torch.zeros(1, 2, dtype=torch.float64), torch.from_numpy(drive)[None], 1 / rate)[0].numpy()
        moved, channels = run[:, :1] + rng.normal(size=(samples, 1)) * 1e-3, Oscillator.state_channels[:1]
        valid = np.ones(samples, dtype=bool)
        made = Recording(f"run_{i}", rate, drive, moved, (Channel("force", "N"),), channels, valid)
        logs.append(log_of(made, Oscillator(input_hold="previous"), "force"))
    names = tuple(log.name for log in logs)
    return Subject("spring", Oscillator(input_hold="previous"), tuple(logs), names, names)


def test_a_fit_is_led_past_valleys_of_missed_periods(spring):
    model = replace(spring.model, effects=(CubicStiffness(),))
    found, _ = by_simulation.fit_by_simulation(spring, model)
    assert found.effects[0].k_3 == pytest.approx(3000.0, rel=0.02)
    windows = Windows.of(spring.logs)
    (at_once,) = fit(spring, windows, starts(windows, [replace(model, effects=(CubicStiffness.typical(),))]))
    assert abs(at_once.model.effects[0].k_3 - 3000.0) > 300.0  # what the leading is for


def test_starting_points_are_simulated_together_as_one_by_one(spring):
    kinds = [JointElasticity(resonance_period=p, damping=d) for p, d in ((0.0126, 0.05), (0.063, 0.3), (0.19, 0.1))]
    models = [replace(spring.model, effects=(k,)) for k in kinds]
    windows = Windows.of(spring.logs)
    together = starts(windows, models)
    assert np.ptp([t.begun for t in together], axis=0).max() > 1e-3  # a beginning depends on the model
    for model, start in zip(models, together, strict=True):
        (alone,) = starts(windows, [model])
        assert start.model is model
        np.testing.assert_allclose(start.begun, alone.begun, rtol=1e-6, atol=1e-9)
    for both, one in zip(fit(spring, windows, together, steps=1), together, strict=True):
        (alone,) = fit(spring, windows, [one], steps=1)
        np.testing.assert_allclose(both.loss, alone.loss, rtol=1e-6)


def test_without_a_state_effects_are_found_by_simulation(tanks, monkeypatch):
    said = object()
    monkeypatch.setattr(by_simulation, "discover", lambda *_: said)
    assert discover(tanks[0]) is said


def test_only_what_depends_on_measured_states_is_run_free():
    model, groups = Quadrotor(), [c.group for c in Quadrotor.state_channels]
    seen = self_contained(model, [g in ("position", "body_rates") for g in groups])
    assert seen == tuple(g == "body_rates" for g in groups)
    assert self_contained(Tanks(), (False, True)) == (False, False)
    assert all(self_contained(model, [True] * len(groups)))


@pytest.mark.data
@pytest.mark.slow
def test_both_tanks_overflow(bench_data):
    said, model = diagnose(load("cascaded_tanks"), catalogue=["overflow", "saturation", "dead_zone"], brief=True)
    assert (said.verdict, [e.id for e in said.effects]) == ("named", ["overflow"])
    assert said.error.nominal["level"].rmse > 0.6 > 0.3 > said.error.extended["level"].rmse
    lower = said.effects[0].parameters["lower_rim"]
    assert lower.low < 10.0 < lower.high  # the sensor's ceiling is the rim
    assert len(model.effects) == 1
