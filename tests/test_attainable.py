"""The line below which no error can be: the true simulator from a smoothed start."""

import numpy as np
import pytest
import torch

from bench.experiment.config import RunConfig
from bench.experiment.notation import parse
from bench.training.data import prepare
from bench.training.model import build_scaled
from registry.contracts import Problem
from registry.datasets.twin import quadrotor
from registry.datasets.twins import PelicanTwin, channels
from registry.errors import BenchError
from registry.predictors.baselines.attainable import rotation

OUTPUTS = ("velocity", "body_rates")


def errors(spec: str, horizon: int, count: int = 48) -> tuple[float, float]:
    """Root mean square of velocity and body rates over windows and steps, validation part, SI."""
    run = RunConfig(*parse(spec), PelicanTwin(), outputs=OUTPUTS, horizon=horizon).resolved()
    data = prepare(run)
    model = build_scaled(run, data).eval()
    u_history, y_history, u, y = data.gather(data.validation.every(count).starts)
    e = (model.predict(u_history, y_history, u) - y).double().square()
    return float(e[..., :3].mean().sqrt()), float(e[..., 3:].mean().sqrt())


def test_without_errors_of_measurement_it_is_exact() -> None:
    """Flown by the truth itself, from rotor speeds that are known: what is left is the step from float32."""
    model, dt, n = quadrotor.BY_ROTOR_SPEED, 0.01, 51
    t = torch.arange(n, dtype=torch.float64) * dt
    u = 496 + 25 * torch.sin(torch.outer(t, torch.tensor([9.0, 11.0, 13.0, 8.0], dtype=torch.float64)))
    start = torch.tensor([0.1, -0.2, 1.0, 0.5, -0.3, 0.2, 0.05, -0.02, 0.1, 0.99, 0.3, -0.2, 0.1], dtype=torch.float64)
    states = model.simulate(model.project(start), u, dt)
    velocity, poses = states[:, :3].diff(dim=0) / dt, states[:, 6:10]
    rates = rotation(poses[:-1], poses[1:]) / dt
    seen = channels("rotor_speed"), channels(*OUTPUTS)
    predictor = parse("attainable")[0].build(Problem(*seen, 40, 10, channels("attitude", "position"), truth=model))
    history = torch.cat([velocity, rates, poses[1:], states[1:, :3]], -1)[None, :10]
    state = predictor.init_buffers(u[None, 1:11], history)
    predicted, _ = predictor.rollout(u[None, 11:], state)
    want = torch.cat([velocity, rates], -1)[10:]
    assert float((predicted[0] - want).abs().max()) < 1e-6


def test_it_lies_below_the_motion_model() -> None:
    """By as much as hidden effects and noise let it; its first step knows only what measuring leaves."""
    attainable, physics = errors("attainable", 40), errors("physics", 40)
    assert attainable[0] < 0.6 * physics[0] and attainable[1] < 0.3 * physics[1]
    deviation = 0.0004 * 100 * np.sqrt(518) / 35  # of a measured velocity's white error; see test_twins
    assert 0.8 * deviation < errors("attainable", 1)[0] < 1.5 * deviation


def test_nobody_knows_how_measured_recordings_came_about() -> None:
    with pytest.raises(BenchError, match="for simulated quadrotors"):
        parse("attainable")[0].build(Problem.plain(4, 3, 5, 10))


def test_it_needs_the_whole_pose() -> None:
    run = RunConfig(*parse("attainable"), PelicanTwin(), outputs=OUTPUTS, context=("attitude",)).resolved()
    with pytest.raises(BenchError, match="attitude and position"):
        build_scaled(run, prepare(run))
