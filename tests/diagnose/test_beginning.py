"""Logs that begin in the middle of a command: a lag remembers what was given before, and nobody recorded that."""

import numpy as np
import pytest

from bench.diagnose.discover import read_and_discovered
from bench.diagnose.logs.subject import Subject, log_of
from bench.diagnose.simulate.beginning import remembered
from registry.contracts import Channel, Recording
from registry.effects.actuation import ActuatorLag, InputDelay
from registry.physics.mass_on_rail import MassOnRail

STEP, SAMPLES, LAG = 0.01, 800, 0.15


def recording(seed: int) -> Recording:
    """A mass of 2 kg that held steps push through a lag; it begins with another force than is asked for."""
    rng = np.random.default_rng(seed)
    asked = np.repeat(rng.normal(size=SAMPLES // 25) * 10, 25)
    q, v, force, out = 0.0, 0.0, 60.0 * rng.choice([-1, 1]), np.empty((SAMPLES, 2))
    for i, u in enumerate(asked):
        out[i] = q, v
        for _ in range(20):
            force = u + (force - u) * np.exp(-STEP / 20 / LAG)
            v += STEP / 20 * force / 2
            q += STEP / 20 * v
    out += rng.normal(size=out.shape) * np.array([1e-4, 1e-3])
    states, inputs = MassOnRail.state_channels, (Channel("voltage", "V"),)
    return Recording(f"run_{seed}", 1 / STEP, asked[:, None], out, inputs, states, np.ones(SAMPLES, bool))


def test_what_a_lag_remembers_of_the_time_before_a_log_bends_nothing() -> None:
    made = [recording(seed) for seed in range(6)]
    model = MassOnRail(mass=2.0, force_gain=1.0, input_hold="previous")
    logs, names = tuple(log_of(r, model, "voltage") for r in made), tuple(r.name for r in made)
    subject = Subject("rail", model, logs, names[:4], names[4:], None, {}, {}, ("displacement", "speed", "voltage"))
    read, _, answer = read_and_discovered(subject)
    found = {f.id: [x.value for x in f.estimates] for f in answer.found}
    assert found == {"actuator_lag": pytest.approx([LAG], rel=0.01)}
    assert answer.equations[-1].models["extended"] < 0.01  # [m/s] after half a second; .6 with all samples
    left_out = [int((~log.valid).sum()) for log in read.logs]
    assert min(left_out) >= 4.6 * LAG / STEP - 1  # to a hundredth of what differed
    assert remembered(answer.model, read.logs[0]) <= max(left_out)


@pytest.mark.parametrize(("effect", "samples"), [(ActuatorLag(tau=0.1), 46), (InputDelay(delay=0.05), 5)])
def test_how_long_is_remembered(effect: ActuatorLag | InputDelay, samples: int) -> None:
    made = recording(1)
    model = MassOnRail(mass=2.0, force_gain=1.0, input_hold="previous", effects=(effect,))
    assert remembered(model, log_of(made, model, "voltage")) == pytest.approx(samples, abs=1)
