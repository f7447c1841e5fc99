"""A forecast from the start alone, against motion that the start alone decides."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from bench.diagnose.ceiling.autoregression import autoregression
from bench.diagnose.logs.subject import Log, log_of
from bench.diagnose.simulate.free_run import Group, measured_windows
from registry.contracts import Channel, Recording
from registry.physics.oscillator import Oscillator

RATE, MODEL = 100.0, Oscillator(mass=1.0, damping=0.5, stiffness=100.0)


def test_an_autoregression_knows_the_start_alone() -> None:
    rng, groups_ = np.random.default_rng(2), [Group("displacement", "m", (0,)), Group("speed", "m/s", (1,))]
    step = np.array([[0.95, 0.1], [-0.3, 0.9]])

    def logs(count: int, seed: int) -> list[Log]:
        x, out = np.random.default_rng(seed).normal(size=(count, 2)), []
        for _ in range(40):
            out.append(x)
            x = x @ step.T + 0.5
        states = np.stack(out, axis=1)
        inputs = rng.normal(size=(count, 40, 1))
        return [
            log_of(
                Recording(f"r{i}", RATE, u, s, (Channel("force", "N"),), MODEL.state_channels, np.ones(40, bool)),
                MODEL,
                "force",
            )
            for i, (u, s) in enumerate(zip(inputs, states, strict=True))
        ]

    learned, other, at = logs(6, 0), logs(2, 1), np.arange(0, 20, 3)
    run = autoregression((learned, [at] * 6), (other, [at] * 2), 15, groups_)
    truth = measured_windows(other, [at] * 2, 15)
    assert run.numpy() == pytest.approx(truth.numpy(), abs=1e-9)  # of a linear system without inputs it knows all
    late = [replace(log, states=torch.cat([log.states[:20], 9 + log.states[20:]])) for log in other]
    again = autoregression((learned, [at] * 6), (late, [at] * 2), 15, groups_)
    assert torch.equal(again, run)


def test_an_autoregression_turns_an_attitude() -> None:
    """At one rate about one axis, the attitude alone says where it ends, whichever sign its quaternion has."""
    turns = Rotation.from_rotvec(np.outer(np.linspace(0, 2, 60), [0.0, 0.0, 1.0]))
    logs = [SimpleNamespace(states=torch.from_numpy(sign * turns.as_quat())) for sign in (1, -1)]
    at = np.arange(0, 50)
    run = autoregression((logs, [at] * 2), (logs, [at] * 2), 8, [Group("attitude", "rad", (0, 1, 2, 3))])  # type: ignore[arg-type]
    left = Rotation.from_quat(run[:, 8].numpy()) * turns[np.tile(at, 2) + 8].inv()
    assert left.magnitude() == pytest.approx(np.zeros(100), abs=1e-6)
