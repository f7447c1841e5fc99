"""The physics predictor and the hybrid model, against a transcription of the paper's figure and the physics model."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import oracle
import pytest
import torch
from networks import Called, check_pieces, check_slopes, leaves, noise, vivid
from scipy.spatial.transform import Rotation
from torch import Tensor
from torch.func import functional_call

from registry import DATASETS, INITIALIZERS, PREDICTORS
from registry.contracts import Channel, Dataset, Predictor, Problem
from registry.core import PHYSICS
from registry.errors import BenchError
from registry.initializers.each import build as build_initializer
from registry.kernels.lstm import Layer, lstm
from registry.kernels.lstm_cell import LSTMCell
from registry.units import SIGNALS

F64 = torch.float64
TAU, HORIZON, WINDOWS = 10, 12, 3
PHYSICAL = {"mass": 0.9, "inertia": [0.01, 0.013, 0.02], "unheard_of": 3}


def channels(*signals: str) -> tuple[Channel, ...]:
    return tuple(Channel(f"{s}.{a}", SIGNALS[s].unit) for s in signals for a in SIGNALS[s].axes or "1234")


QUADROTOR = Problem(
    channels("rotor_speed"), channels("velocity", "body_rates"), HORIZON, TAU, channels("attitude", "position"),
    physics=PHYSICAL,
)  # fmt: skip


def built(name: str, problem: Problem = QUADROTOR, **options: object) -> Predictor:
    """With scalers that are not those of SI."""
    torch.manual_seed(1)
    predictor: Predictor = PREDICTORS.get(name)(**options).build(problem).double()
    for i, (scaler, at, spread) in enumerate(
        (
            (predictor.input_scaler, 480.0, 40.0),
            (predictor.output_scaler, 0.1, 1.5),
            (predictor.context_scaler, 0.0, 2.0),
        )
    ):
        if scaler is not None:
            size = len(scaler.scale)
            scaler.set(at + noise(size, seed=i), spread * (1 + 0.3 * noise(size, seed=i + 5).tanh()))
    return predictor


def windows(problem: Problem = QUADROTOR, seed: int = 0) -> tuple[Tensor, Tensor, Tensor]:
    """History inputs, history outputs and context, and horizon inputs, SI."""
    u = 480 + noise(WINDOWS, TAU + problem.horizon, 4, seed=seed, scale=25)
    y = noise(WINDOWS, TAU, problem.n_outputs + problem.n_context, seed=seed + 1)
    attitude = problem.n_outputs
    y[..., attitude : attitude + 4] /= y[..., attitude : attitude + 4].norm(dim=-1, keepdim=True)
    return u[:, :TAU], y, u[:, TAU:]


def scaled(p: Predictor, u_past: Tensor, y_past: Tensor, u: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    return p.input_scaler(u_past), p.scale_history(y_past), p.input_scaler(u)


def initialized(p: Predictor, u_past: Tensor, y_past: Tensor) -> Tensor:
    torch.manual_seed(2)
    initializer = build_initializer(INITIALIZERS.get("MLP")(hidden=5, history=TAU), p).double()
    return vivid(initializer, 0.4).initialize(p, u_past, y_past)


# --------------------------------------------------------------------------------------------------- physics


def test_physics_runs_the_model_from_the_measured_state() -> None:
    predictor, (u_past, y_past, u) = built("physics"), windows()
    u_scaled, y_scaled, _ = scaled(predictor, u_past, y_past, u)
    got = predictor(u, predictor.init_buffers(u_scaled, y_scaled))
    velocity, rates, attitude, position = y_past[:, -1].split([3, 3, 4, 3], -1)
    model = PHYSICS.get("quadrotor")(mass=0.9, inertia=(0.01, 0.013, 0.02))
    states = model.simulate(
        torch.cat([position, velocity, attitude, rates], -1), torch.cat([u_past[:, -1:], u], 1), 0.01
    )
    torch.testing.assert_close(got, states[:, 1:, [3, 4, 5, 10, 11, 12]], rtol=1e-10, atol=1e-10)


def test_a_model_file_brings_effects_whose_memory_is_that_of_the_history(tmp_path: Path) -> None:
    file = tmp_path / "model.toml"
    file.write_text('system = "quadrotor"\n[[effects]]\nid = "motor_lag"\ntau_up = 0.03\ntau_down = 0.05\n')
    predictor, (u_past, y_past, u) = built("physics", model=str(file)), windows()
    u_scaled, y_scaled, scaled_u = scaled(predictor, u_past, y_past, u)
    state = predictor.init_buffers(u_scaled, y_scaled)
    lagging = u_past[:, 0].numpy()
    for k in range(1, TAU):  # the exact lag behind a straight line, in two half steps as the effect says
        before, after = u_past[:, k - 1].numpy(), u_past[:, k].numpy()
        for one, two in ((before, (before + after) / 2), ((before + after) / 2, after)):
            tau = np.where((one + two) / 2 > lagging, 0.03, 0.05)
            behind = tau * (two - one) / 0.005
            lagging = two - behind + (lagging - one + behind) * np.exp(-0.005 / tau)
    np.testing.assert_allclose(state[:, -4:], lagging, rtol=1e-10)
    check_pieces(predictor, scaled_u, state, atol=1e-7)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"inputs": channels("pilot")}, "needs rotor_speed or rotor_command or pwm among the --inputs.*pilot"),
        ({"inputs": channels("rotor_speed")[:3]}, "3 channels and the model 4 rotors"),
        ({"context": channels("position")}, "starts from a measured attitude"),
        ({"outputs": channels("velocity", "euler_rates")}, "does not predict euler_rates"),
    ],
)
@pytest.mark.parametrize("name", ["physics", "Hybrid"])
def test_a_signal_that_is_missing_is_named(name: str, change: dict[str, object], said: str) -> None:
    with pytest.raises(BenchError, match=said):
        built(name, replace(QUADROTOR, **change), **({"input_model": "residual"} if name == "Hybrid" else {}))


@pytest.mark.parametrize("name", ["physics", "Hybrid"])
@pytest.mark.parametrize("dataset", ["pelican_twin", "helicopter_twin"])
def test_signals_that_run_without_being_named(dataset: str, name: str) -> None:
    data: Dataset = DATASETS.get(dataset)()
    entry = PREDICTORS.get(name)()
    inputs, outputs, context = (channels(*signals) for signals in entry.signals(data))
    assert entry.build(Problem(inputs, outputs, HORIZON, TAU, context, system=data.system)).layout.size > 13
    assert [c.group for c in outputs] == ["velocity"] * 3 + ["body_rates"] * 3


def test_any_system_is_predicted() -> None:
    """An oscillator whose speed nobody measures: the history tells it."""
    problem = Problem(
        channels("force")[:1], channels("displacement"), HORIZON, TAU, rate=100.0, system="oscillator",
        physics={"stiffness": 100.0, "damping": 20.0},
    )  # fmt: skip
    model = PHYSICS.get("oscillator")(stiffness=100.0, damping=20.0)
    force = noise(1, 40 + HORIZON, 1, seed=0)
    truth = model.simulate(torch.tensor([[0.1, 0.5]], dtype=F64), force, 0.01)
    predictor = PREDICTORS.get("physics")().build(problem).double()
    state = predictor.init_buffers(force[:, :40], truth[:, :40, :1])
    torch.testing.assert_close(state[0, -2:], truth[0, 39], rtol=0, atol=0.02)
    got, _ = predictor.rollout(force[:, 40:], state)
    torch.testing.assert_close(got, truth[:, 40:, :1], rtol=0, atol=2e-3)


# ---------------------------------------------------------------------------------------------------- hybrid


def figure(p: Predictor, entry: str, u_past: Tensor, y_past: Tensor, u: Tensor, state: Tensor) -> np.ndarray:
    """The paper's figure "Hybrid model of a quadrotor" for one layer: one sample, one step at a time.

    The motion model is that of Newton and Euler, with a rotation matrix, integrated in 50 small steps a sample.
    """
    w = {name: value.detach().numpy() for name, value in p.state_dict().items()}
    names = ("input_weight.0", "recurrent_weight.0", "bias.0", "peephole.0")
    m_in, m_out = ([w[f"{part}.{n}"] for n in names] for part in ("input_network", "output_network"))
    centre, size = w["output_scaler.offset"], w["output_scaler.scale"]
    width = m_in[1].shape[1]
    k_f, k_m, mass, inertia, g = 9.9865e-6, 1.5978e-7, 0.9, np.array([0.01, 0.013, 0.02]), 9.81
    arms, signs = np.array([[0.21, 0, 0], [0, 0.21, 0], [-0.21, 0, 0], [0, -0.21, 0]]), np.array([1, -1, 1, -1])
    unit = mass * g * np.array([1, 0.105, 0.105, k_m / k_f])  # weight, and the torques of rotors on one side only

    def rotors(speed: np.ndarray) -> np.ndarray:
        f = k_f * speed**2
        roll, pitch, _ = np.cross(arms, f[:, None] * [0, 0, 1]).sum(0)
        return np.array([f.sum(), roll, pitch, signs @ (k_m * speed**2)]) if entry == "residual" else np.zeros(4)

    predictions = []
    for b in range(len(u)):
        velocity, rates, attitude, position = np.split(y_past[b, -1].numpy(), [3, 6, 10])
        matrix = Rotation.from_quat(attitude).as_matrix()
        m1, m2, c1, c2 = np.split(state[b].detach().numpy()[-4 * width :], 4)
        y = (np.concatenate([velocity, rates]) - centre) / size
        read_in = lambda m: w["input_network.output_weight"] @ m + w["input_network.output_bias"]  # noqa: E731
        load, speed = unit * read_in(m1), u_past[b, -1].numpy()
        for k in range(u.shape[1]):
            u_k = ((u[b, k] - p.input_scaler.offset) / p.input_scaler.scale).numpy()
            m1, c1 = oracle.lstm_cell(*m_in, np.concatenate([u_k, y]), m1, c1)
            new_load, new_speed = unit * read_in(m1), u[b, k].numpy()
            velocity, rates = np.split(y * size + centre, 2)
            steps = 50
            for i in range(steps):  # midpoint rule
                h = 0.01 / steps
                part = (i + 0.5) / steps
                total = load + (new_load - load) * part + rotors(speed + (new_speed - speed) * part)
                slope = lambda w_b, n=total: (n[1:] - np.cross(w_b, inertia * w_b)) / inertia  # noqa: E731
                half = rates + h / 2 * slope(rates)
                upright = matrix @ Rotation.from_rotvec(h / 2 * half).as_matrix()
                change = upright[:, 2] * total[0] / mass - [0, 0, g]
                position, velocity = position + h * (velocity + h / 2 * change), velocity + h * change
                rates, matrix = rates + h * slope(half), matrix @ Rotation.from_rotvec(h * half).as_matrix()
            hat = (np.concatenate([velocity, rates]) - centre) / size
            m2, c2 = oracle.lstm_cell(*m_out, np.concatenate([hat, read_in(m1), u_k]), m2, c2)
            y = hat + w["output_network.output_weight"] @ m2 + w["output_network.output_bias"]
            predictions.append(y)
            load, speed = new_load, new_speed
    return np.array(predictions).reshape(len(u), u.shape[1], -1)


@pytest.mark.parametrize("entry", ["learned", "residual"])
def test_rollout_follows_the_figure(entry: str) -> None:
    predictor, (u_past, y_past, u) = vivid(built("Hybrid", hidden=3, input_model=entry), 0.3), windows()
    u_scaled, y_scaled, scaled_u = scaled(predictor, u_past, y_past, u)
    state = initialized(predictor, u_scaled, y_scaled)
    outputs, _ = predictor.rollout(scaled_u, state)
    want = figure(predictor, entry, u_past, y_past, u, state)
    assert np.ptp(want, axis=1).max() > 0.5, "the case must move"
    np.testing.assert_allclose(outputs.detach().numpy(), want, rtol=0, atol=2e-5)


def test_the_cell_is_the_lstm() -> None:
    for layers in (1, 3):
        shapes = [[(16, 5 if i == 0 else 4), (16, 4), (16,), (3, 4)] for i in range(layers)]
        weights = [Layer(*(noise(*s, seed=9 * i + j) for j, s in enumerate(row))) for i, row in enumerate(shapes)]
        u, states = noise(6, 5, 2, seed=50), tuple(noise(layers, 4, 2, seed=s) for s in (51, 52))
        cell, now = LSTMCell(weights), states
        for k in range(6):
            now = cell((u[k, :2], u[k, 2:]), *now)
        flat = [s.permute(2, 0, 1).flatten(1)[None] for s in states]
        stacked = [Layer(*(w[None] for w in (x.input, x.recurrent, x.bias, x.peephole))) for x in weights]
        _, end = lstm(u.permute(2, 0, 1)[None], torch.cat(flat, -1), stacked)
        for got, want in zip(now, end.chunk(2, -1), strict=True):
            torch.testing.assert_close(got.permute(2, 0, 1).flatten(1), want[0], rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("file", ["", 'system = "quadrotor"\n[[effects]]\nid = "rotor_drag"\nk_d = 1e-4\n'])
@pytest.mark.parametrize("hold", ["linear", "previous"])
def test_with_nothing_learned_it_is_the_physics_model(tmp_path: Path, file: str, hold: str) -> None:
    path = tmp_path / "model.toml"
    path.write_text(f'input_hold = "{hold}"\n{file}')
    options = {"model": str(path)} if file else {}
    problem = replace(QUADROTOR, input_hold=hold)
    physics = built("physics", problem, **options)
    hybrid = built("Hybrid", problem, hidden=4, input_model="residual", fit_constants=True, **options)
    u_past, y_past, u = scaled(physics, *windows())
    want, end = physics.rollout(u, physics.init_buffers(u_past, y_past))
    state = initialized(hybrid, u_past, y_past)
    outputs, last = hybrid.rollout(u, state)
    torch.testing.assert_close(outputs, want, rtol=1e-10, atol=1e-10)
    torch.testing.assert_close(last[:, : end.shape[1]], end, rtol=1e-10, atol=1e-8)
    torch.testing.assert_close(hybrid.view("uncompensated", u, outputs, state), want, rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("hold", ["linear", "previous"])
@pytest.mark.parametrize("entry", ["learned", "residual"])
@pytest.mark.parametrize("effect", ["", '[[effects]]\nid = "rotor_drag"\nk_d = 1e-4\n'])
def test_an_input_acts_from_its_sample_on_and_held_ones_after_it(
    tmp_path: Path, effect: str, entry: str, hold: str
) -> None:
    path = tmp_path / "model.toml"
    path.write_text(f'input_hold = "{hold}"\n{effect}')
    problem = replace(QUADROTOR, input_hold=hold)
    predictor = vivid(built("Hybrid", problem, hidden=3, input_model=entry, output_model="none", model=str(path)), 0.3)
    u_past, y_past, u = scaled(predictor, *windows())
    state = initialized(predictor, u_past, y_past)
    changed = u.clone()
    changed[:, 4:] += 0.5
    difference = (predictor.rollout(u, state)[0] - predictor.rollout(changed, state)[0]).abs().amax((0, 2))
    first = 4 if hold == "linear" else 5
    assert (difference[:first] == 0).all() and (difference[first:] > 1e-6).all()


@pytest.mark.parametrize("entry", ["learned", "residual"])
@pytest.mark.parametrize("effects", [False, True])
def test_a_horizon_in_two_pieces_is_the_horizon(tmp_path: Path, entry: str, effects: bool) -> None:
    path = tmp_path / "model.toml"
    path.write_text('[[effects]]\nid = "motor_lag"\ntau_up = 0.03\ntau_down = 0.05\n')
    options = {"model": str(path)} if effects else {}
    predictor = vivid(built("Hybrid", layers=2, hidden=3, input_model=entry, **options), 0.3)
    u_past, y_past, u = scaled(predictor, *windows())
    state, y = initialized(predictor, u_past, y_past), noise(WINDOWS, HORIZON, 6, seed=9)
    for feedback in (None, y):
        check_pieces(predictor, u, state, feedback, atol=1e-7)


def test_what_the_output_model_says_is_added_or_stands_alone_or_is_left_out() -> None:
    u_past, y_past, u = windows()
    for choice in ("added", "alone", "none"):
        predictor = vivid(built("Hybrid", hidden=3, output_model=choice), 0.2)
        past_u, past_y, now = scaled(predictor, u_past, y_past, u)
        state = initialized(predictor, past_u, past_y)
        outputs, _ = predictor.rollout(now[:, :1], state)
        read = predictor.readout(state, past_u[:, -1])
        if choice == "none":
            assert predictor.views == () and read is None and len(predictor.parts()) == 1
            continue
        before = predictor.view("uncompensated", now[:, :1], outputs, state)
        own = predictor.output_network
        hidden = predictor.layout.split(state)[1]
        _, _, end = predictor._run(now[:, :1], state, None)
        said = predictor.layout.split(end)[1][:, 3:] @ own.output_weight.T + own.output_bias
        torch.testing.assert_close(outputs[:, 0], said + before[:, 0] if choice == "added" else said)
        at_start = hidden[:, 3:] @ own.output_weight.T + own.output_bias
        torch.testing.assert_close(read, at_start + past_y[:, -1, :6] if choice == "added" else at_start)


def test_washout_is_refused_with_a_sentence() -> None:
    hybrid = built("Hybrid", hidden=3)
    washout = build_initializer(INITIALIZERS.get("Washout")(history=TAU), hybrid)
    with pytest.raises(BenchError, match="initialize it by MLP or RNN"):
        washout.initialize(hybrid, *scaled(hybrid, *windows())[:2])


def test_stays_valid_through_a_flip() -> None:
    """A pitch torque that turns the vehicle over more than once, in single precision."""
    problem = replace(QUADROTOR, horizon=190)
    predictor = built("Hybrid", problem, hidden=4, output_model="none").float()
    with torch.no_grad():
        predictor.input_network.output_bias[2] = 0.05
    start = torch.zeros(1, 1, 13)
    start[..., 9] = 1.0
    state = torch.cat(
        [predictor.init_buffers(torch.zeros(1, 1, 4), predictor.scale_history(start)), torch.zeros(1, 8)], -1
    )
    outputs = predictor(torch.full((1, 190, 4), 480.0), state)
    _, end = predictor.rollout(torch.zeros(1, 190, 4), state)
    attitude = end[0, 6:10].detach()
    turned = float(outputs[0, :, 4].detach().sum()) * 0.01
    assert turned > 2 * np.pi and outputs.isfinite().all()
    assert attitude.norm() == pytest.approx(1.0, abs=1e-6)
    pitch = Rotation.from_quat(attitude.numpy()).as_rotvec()[1] % (2 * np.pi)
    assert pitch == pytest.approx(turned % (2 * np.pi), abs=0.1)


@pytest.mark.parametrize("entry", ["learned", "residual"])
def test_gradient_is_the_finite_difference_with_and_without_a_model_dimension(entry: str) -> None:
    problem = replace(QUADROTOR, rate=30.0)  # long steps: every term counts
    predictor = vivid(built("Hybrid", problem, layers=2, hidden=2, input_model=entry, fit_constants=True), 0.2)
    u_past, y_past, u = scaled(predictor, *windows())
    state = initialized(predictor, u_past, y_past).detach()
    speeds = state[:, :4] if entry == "residual" else state[:, :0]  # of hundreds: not for one step of differences
    run = Called(
        predictor, lambda u, rest: predictor.rollout(u, torch.cat([speeds.expand(*rest.shape[:-1], -1), rest], -1))
    )
    u, rest = u[:, :3].clone().requires_grad_(), state[:, speeds.shape[1] :].clone().requires_grad_()
    check_slopes(run, u, rest, fast=True)
    stacked = functional_call(run, {n: v[None] for n, v in leaves(run).items()}, (u[None], rest[None]))
    for one, all_models in zip(run(u, rest), stacked, strict=True):
        assert torch.equal(all_models[0], one)


def test_fitted_constants_stay_within_their_uncertainty() -> None:
    hybrid = built("Hybrid", hidden=3, input_model="residual", fit_constants=True)
    u_past, y_past, u = scaled(hybrid, *windows())
    state, speed = initialized(hybrid, u_past, y_past), hybrid.input_scaler.invert(u)
    places = [p.name for p in hybrid.box.model.parameters() if p.uncertainty]
    assert places[:2] == ["mass", "inertia"] and len(hybrid.constants) > 8
    with torch.no_grad():
        hybrid.constants[0] = -1e9  # the mass: ten times 2 % below nominal
    middle = hybrid._motion(state[:, :4], speed)
    expected = 9.9865e-6 * (speed[:, 0] ** 2).sum(-1) / (0.9 * np.exp(-0.2))
    torch.testing.assert_close(middle.given[0, 2, 0], expected)
