"""A carriage with friction that its model lacks: what is named, and what is taken for a fault of the log."""

from dataclasses import replace
from functools import cache
from importlib import import_module
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from bench.diagnose import diagnose, discover
from bench.diagnose.checks.problems import problems
from bench.diagnose.logs.subject import LogBatch, Subject, log_of
from bench.diagnose.regression.weak import mean_rates, midpoint_rates
from registry.contracts import Channel, Recording
from registry.effects.mechanics.friction import CoulombFriction, StribeckFriction, ViscousFriction
from registry.physics.mass_on_rail import MassOnRail
from registry.physics.pendulum import Pendulum

RATE, NOISE = 100.0, (1e-4, 1e-3)
TRUE = (ViscousFriction(f_v=200.0), CoulombFriction(f_c=20.0))
NAMES = ["viscous_friction", "coulomb_friction"]


def subject(samples: int = 2000, late: int = 0, measured: int = 2, count: int = 3, spiked: int = 0) -> Subject:
    """Recordings; inputs filed ``late`` samples too late, the first states measured, spikes in the last ``spiked``."""
    rng, logs = np.random.default_rng(5), []
    truth, model = MassOnRail(effects=TRUE), MassOnRail()
    t, drives, noise = np.arange(samples + late) / RATE, [], []
    for i in range(count):
        tones, phases = rng.uniform(0.05, 1.0, 12), rng.uniform(0, 2 * np.pi, 12)
        drive = np.sin(2 * np.pi * tones * t[:, None] + phases).sum(1, keepdims=True)
        drives.append(drive * (3 + i % 3) / np.abs(drive).max())
        noise.append(rng.normal(size=(samples, measured)) * NOISE[:measured])
    still = torch.zeros(count, 2, dtype=torch.float64)
    runs = truth.simulate(still, torch.from_numpy(np.stack(drives)), 1 / RATE).numpy()
    for i, drive in enumerate(drives):
        seen = runs[i, late:, :measured] + noise[i]
        if i >= count - spiked:
            seen[700, 1] += 3.0
        channels, valid = MassOnRail.state_channels[:measured], np.ones(samples, dtype=bool)
        made = Recording(f"run_{i}", RATE, drive[:samples], seen, (Channel("voltage", "V"),), channels, valid)
        logs.append(log_of(made, model, "voltage"))
    names = tuple(log.name for log in logs)
    signals = ("voltage", *(c.group for c in MassOnRail.state_channels[:measured]))
    return Subject("rail", model, tuple(logs), names[: 2 * count // 3], names[2 * count // 3 :], signals=signals)


@pytest.mark.slow
def test_motion_that_leads_for_want_of_friction_is_no_time_shift() -> None:
    """Two frictions at once: the motion seems to come before the input, until both are in the model."""
    short = problems(subject())
    assert not short.problems and {p.kind for p in short.suspicions} == {"time shift"}  # known to 5 samples or worse
    rail = subject(6000)
    assert {p.kind for p in problems(rail).problems} == {"time shift"}
    said, model = diagnose(rail, catalogue=NAMES, brief=True)
    assert (said.verdict, sorted(e.id for e in said.effects)) == ("named", sorted(NAMES))
    for effect, value in zip(NAMES, (200.0, 20.0), strict=True):
        (found,) = next(e for e in said.effects if e.id == effect).parameters.values()
        assert found.value == pytest.approx(value, rel=0.05)
    again, kept = diagnose(replace(rail, model=model), catalogue=NAMES, brief=True)
    for group, error in again.error.extended.items():  # what was found is not spoilt by calibrating it once more
        assert error.rmse <= 1.1 * said.error.extended[group].rmse
    assert [type(e) for e in kept.effects] == [type(e) for e in model.effects]


@pytest.mark.slow
def test_a_log_that_was_shifted_is_one_whatever_friction_is_missing() -> None:
    said, _ = diagnose(subject(late=8), catalogue=NAMES, brief=True)
    assert said.verdict == "data_problem" and {p.kind for p in said.data_problems} == {"time shift"}


def test_one_damaged_recording_of_many_is_left_out_and_two_stop_the_analysis() -> None:
    """As many as one in ten are left out, and told in the answer; what is diagnosed is as if they were not there."""
    said, _ = diagnose(subject(720, count=12, spiked=1), catalogue=NAMES, brief=True)
    assert (said.verdict, sorted(e.id for e in said.effects)) == ("named", sorted(NAMES))
    assert [(p.recording, p.signal, p.kind) for p in said.data_problems] == [("run_11", "speed", "spike")]
    assert said.evidence.recordings == 11 and "run_11" not in said.evidence.held_out
    assert any("left out" in note and "run_11" in note for note in said.evidence.notes)
    assert said.headline.startswith("rail (mass_on_rail): named: ")
    said, _ = diagnose(subject(720, count=12, spiked=2), catalogue=NAMES, brief=True)
    assert said.verdict == "data_problem" and {p.recording for p in said.data_problems} == {"run_10", "run_11"}
    said, _ = diagnose(subject(720, spiked=1), catalogue=["viscous_friction"], brief=True, ignore=["spike"])
    assert said.verdict == "named" and said.data_problems == ()


def test_friction_is_found_by_the_position_alone() -> None:
    said, _ = diagnose(subject(samples=600, measured=1), catalogue=["viscous_friction"], brief=True)
    assert (said.verdict, [e.id for e in said.effects]) == ("named", ["viscous_friction"])


def test_what_leaves_many_times_the_noise_is_no_rival() -> None:
    """Swings of three sizes: nearly all that dry friction leaves is in the largest, which is few blocks."""
    rng, logs, model = np.random.default_rng(5), [], Pendulum(mass=0.8, length=0.5)
    truth = replace(model, effects=(ViscousFriction(f_v=0.15),))
    for i, first in enumerate((0.6, 1.2, 2.8)):
        state = torch.tensor([[first, 0.3 * i]], dtype=torch.float64)
        run = truth.simulate(state, torch.zeros(1, 2000, 0, dtype=torch.float64), 1 / RATE)[0].numpy()
        seen = run + rng.normal(size=run.shape) * (2e-3, 1e-2)
        valid = np.ones(len(run), dtype=bool)
        made = Recording(f"run_{i}", RATE, seen[:, :0], seen, (), Pendulum.state_channels, valid)
        logs.append(log_of(made, model, ""))
    names = tuple(log.name for log in logs)
    pendulum = Subject("pendulum", model, tuple(logs), names, names, signals=("angle", "angle_rate"))
    (found,) = discover(pendulum, ["viscous_friction", "coulomb_friction", "stribeck_friction"]).found
    assert (found.id, found.rivals) == ("viscous_friction", ())


@pytest.mark.slow
def test_friction_that_is_least_at_the_lowest_speeds_is_no_stribeck_friction(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every second sample of EMPS wanted F_s = 15.7 N below F_c = 21.8 N: no peak, but Coulomb friction in noise."""
    frictions = StribeckFriction(f_c=20.0, f_s=30.0), StribeckFriction(f_c=21.8, f_s=15.7)
    assert [f.possible_in(subject().model) for f in frictions] == [True, False]
    assert {f.id for f in discover(subject(), NAMES).found} == set(NAMES)
    monkeypatch.setattr(CoulombFriction, "possible_in", lambda self, model: False)
    found = discover(subject(), NAMES).found
    assert [f.id for f in found] == ["viscous_friction"]
    assert 200.0 < found[0].estimates[0].value < 600.0  # and it takes up what the other one did


@cache
def pulled_from_rest(model: MassOnRail, drive: tuple[float, ...]) -> torch.Tensor:
    """States (N, 2)."""
    still = torch.zeros(1, 2, dtype=torch.float64)
    return model.simulate(still, torch.tensor(drive, dtype=torch.float64)[None, :, None], 1 / RATE)[0]


@pytest.mark.parametrize("rates", [midpoint_rates, mean_rates])
@pytest.mark.parametrize("friction", [CoulombFriction(f_c=20.0), StribeckFriction(f_c=15.0, f_s=20.0, v_s=0.05)])
def test_friction_holds_what_rests_in_the_weak_form(rates, friction) -> None:
    """Pulled with up to 25 N it rests, slips and rests again; the sign of the noise in its speed holds nothing."""
    t, noise = np.arange(3000) / RATE, np.array(NOISE)
    drive = 25.0 / MassOnRail().force_gain * np.sin(2 * np.pi * t / 15)
    model = MassOnRail(effects=(replace(friction, v_0=0.01),))
    run = pulled_from_rest(model, tuple(drive)).numpy()
    seen = run + np.random.default_rng(0).normal(size=run.shape) * noise
    valid = np.ones(len(t), dtype=bool)
    made = Recording("run", RATE, drive[:, None], seen, (Channel("voltage", "V"),), MassOnRail.state_channels, valid)
    stack = LogBatch.of([log_of(made, model, "voltage")])
    ahead = np.cumsum(rates(model, stack)[0, :, 1].numpy()) / RATE
    rests = np.abs(run[:, 1]) < 1e-9
    assert 0.2 < rests.mean() < 0.9
    second, at_rest = round(RATE), np.convolve(rests, np.ones(101), "valid") == 101
    moved = np.abs(ahead[second:] - ahead[:-second])[at_rest[: len(ahead) - second]]  # m/s over a second
    pulled = np.abs(drive).max() * MassOnRail().force_gain / MassOnRail().mass
    assert len(moved) > 300 and np.quantile(moved, 0.9) < 3 * NOISE[1] < 0.02 * pulled


def test_what_has_numbers_that_nothing_has_is_no_rival(monkeypatch: pytest.MonkeyPatch) -> None:
    """Friction that is least at the lowest speeds grows with the speed, as viscous friction does."""
    frictions = {"peak": StribeckFriction(f_c=20.0, f_s=30.0), "dip": StribeckFriction(f_c=20.0, f_s=0.0)}
    step = import_module("bench.diagnose.discover")
    monkeypatch.setattr(step, "rivals", lambda view, place: frictions)
    chosen = SimpleNamespace(model=None, exchanged=lambda place, start: MassOnRail(effects=(start,)))
    weighing = SimpleNamespace(refutes=lambda *models: False)
    assert step._rivals(None, weighing, chosen, 0, None) == ("peak",)  # type: ignore[arg-type]
