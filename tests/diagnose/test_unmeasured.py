"""States that were not measured: what can be said without them, and what by simulation."""

import numpy as np
import pytest
import torch

from bench.diagnose import diagnose, discover_by_simulation, load
from bench.diagnose.discover import discover
from bench.diagnose.simulation_fit import Windows, fit
from bench.diagnose.subject import Subject, log_of, self_contained
from bench.diagnose.unmeasured import beginning, completed, hidden
from bench.diagnose.weak import Stack
from registry.contracts import Channel, Recording
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
    stack = Stack.of(subject.logs)
    assert hidden(subject.logs) == (0,)
    assert beginning(truth, stack)[:, 0].numpy() == pytest.approx(UPPER, rel=0.01)
    assert completed(truth, stack)[..., 0].numpy() == pytest.approx(upper, rel=0.01)


def test_constants_are_fitted_although_a_state_is_unmeasured(tanks):
    subject, truth, _ = tanks
    (found,) = fit(subject, Windows.of(subject.logs), [subject.model])
    assert np.sqrt(found.loss.sum() / found.errors.size) < 2e-3  # as much as the noise
    assert found.model.lower_outflow == pytest.approx(truth.lower_outflow, rel=0.05)


def test_without_a_state_effects_are_found_by_simulation(tanks, monkeypatch):
    said = object()
    monkeypatch.setattr(discover_by_simulation, "discover", lambda *_: said)
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
