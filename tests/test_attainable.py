"""The line below which no error can be: the true simulator from a smoothed start."""

import numpy as np
import pytest
import torch

from bench.experiment.config import RunConfig
from bench.experiment.notation import parse
from bench.training.data import prepare
from bench.training.model import build_scaled
from registry.contracts import Dataset, Problem
from registry.datasets.twin import helicopter, quadrotor
from registry.datasets.twins import HelicopterTwin, PelicanTwin, channels
from registry.errors import BenchError
from registry.predictors.baselines.known_flight import KnownHelicopter, euler_rates, rotation

OUTPUTS = ("velocity", "body_rates")


HELICOPTER = ("velocity", "euler_rates")


def errors(
    spec: str, horizon: int, data: Dataset | None = None, outputs: tuple[str, ...] = OUTPUTS, count: int = 48
) -> tuple[float, float]:
    """Root mean square of velocity and rates over windows and steps, validation part, SI."""
    run = RunConfig(*parse(spec), data or PelicanTwin(), outputs=outputs, horizon=horizon).resolved()
    data = prepare(run)
    model = build_scaled(run, data).eval()
    u_history, y_history, u, y = data.gather(data.validation.every(count).starts)
    e = (model.predict(u_history, y_history, u) - y).double().square()
    return float(e[..., :3].mean().sqrt()), float(e[..., 3:].mean().sqrt())


def test_on_the_helicopter_it_is_exact_without_wind_and_errors() -> None:
    """Flown by the truth itself in still air, from states that are known."""
    model, dt, n = helicopter.TRUTH, 0.01, 51
    t = (torch.arange(n, dtype=torch.float64) - 6).clamp(min=0) * dt  # what the delay still holds is as at the start
    u = 0.2 * torch.sin(torch.outer(t, torch.tensor([9.0, 7.0, 5.0, 3.0], dtype=torch.float64)))
    start = torch.zeros(19, dtype=torch.float64)
    start[3:13] = torch.tensor([2.0, -1.0, 0.5, 0.05, -0.02, 0.1, 0.99, 0.3, -0.2, 0.1])
    states = [model.initial(model.project(start), u[0], dt)]
    for k in range(1, n):
        states.append(model.step(states[-1], u[k - 1], u[k], dt))
    run = torch.stack(states)[:, :13]
    velocity, attitude, rates = run[:, 3:6], run[:, 6:10], run[:, 10:]
    outputs = channels("velocity", "euler_rates")
    problem = Problem(channels("pilot"), outputs, 40, 10, channels("attitude", "body_rates"), truth=model)
    predictor = parse("attainable")[0].build(problem)
    told = torch.cat([velocity, euler_rates(attitude, rates), attitude, rates], -1)
    state = predictor.init_buffers(u[None, 1:11], told[None, 1:11])
    predicted, _ = predictor.rollout(u[None, 11:], state)
    off = float((predicted[0] - told[11:, :6]).abs().max())
    assert off < 1e-4  # what was expected of servos and disc before pulls a little


def test_euler_rates_are_those_of_the_simulated_recordings() -> None:
    euler, rates = np.random.default_rng(0).uniform(-1.2, 1.2, (2, 50, 3))
    attitude = quadrotor.quaternion_zyx(euler)
    found = euler_rates(torch.from_numpy(attitude), torch.from_numpy(rates)).numpy()
    np.testing.assert_allclose(found, helicopter.euler_rates(euler, rates), atol=1e-12)


def test_what_it_knows_of_the_helicopters_errors_is_so() -> None:
    assert pytest.approx(list(helicopter.NOISE.values()), rel=0.01) == KnownHelicopter.noise
    steady, gust = helicopter.MEAN_WIND / np.sqrt(3), helicopter.GUST
    assert KnownHelicopter.scatter[2] == pytest.approx(np.hypot(steady, gust), rel=0.05)


def test_it_lies_far_below_constant_rates_on_the_helicopter() -> None:
    """Its first step is off by what is measured wrongly, there as everywhere."""
    line = errors("attainable", 40, HelicopterTwin(), HELICOPTER)
    constant = errors("constant", 40, HelicopterTwin(), HELICOPTER)
    assert line[0] < 0.2 * constant[0] and line[1] < 0.1 * constant[1]
    first = errors("attainable", 1, HelicopterTwin(), HELICOPTER)
    assert 0.03 < first[0] < 0.045 and 0.006 < first[1] < 0.012


def test_it_predicts_a_channel_alone_from_what_the_rest_of_the_history_says() -> None:
    alone = RunConfig(*parse("attainable"), HelicopterTwin(), outputs=("euler_rates.roll",)).resolved()
    assert alone.context == ("velocity", "attitude", "body_rates")
    rate = RunConfig(*parse("attainable"), PelicanTwin(), outputs=("body_rates.p",)).resolved()
    assert rate.context == ("attitude", "position", "velocity", "body_rates.q", "body_rates.r")
    whole = RunConfig(*parse("attainable"), PelicanTwin(), outputs=OUTPUTS).resolved()
    predicted = []
    for run in (rate, whole):
        data = prepare(run)
        u_history, y_history, u, _ = data.gather(data.validation.every(8).starts)
        predicted.append(build_scaled(run, data).eval().predict(u_history, y_history, u))
    torch.testing.assert_close(predicted[0], predicted[1][..., 3:4], rtol=1e-4, atol=1e-5)


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
    with pytest.raises(BenchError, match="for simulated flights"):
        parse("attainable")[0].build(Problem.plain(4, 3, 5, 10))


def test_it_needs_the_whole_pose() -> None:
    run = RunConfig(*parse("attainable"), PelicanTwin(), outputs=OUTPUTS, context=("attitude",)).resolved()
    with pytest.raises(BenchError, match="measured attitude, position"):
        build_scaled(run, prepare(run))
