"""The load hybrid against the rigid body integrated elsewhere, its mirror images, and its own derivatives."""

import numpy as np
import pytest
import torch
from networks import check_pieces
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from bench.experiment.config import RunConfig, Training
from bench.experiment.notation import parse, write
from bench.training.data import prepare
from bench.training.train import train
from registry.contracts import Problem
from registry.datasets.signals import channels
from registry.datasets.twins import PelicanTwin
from registry.errors import BenchError
from registry.kernels.loaded_body import LoadedBody
from registry.physics.quadrotor import Quadrotor
from registry.predictors.load_hybrid import LoadHybrid

HOVER, ARM, MASS, LIFT, DRAG = 1700.0, 0.04, 0.05, 4.2e-8, 6e-10
INERTIA = (2e-5, 3e-5, 4e-5)
HUBS = ((ARM, -ARM, 0.0), (-ARM, -ARM, 0.0), (-ARM, ARM, 0.0), (ARM, ARM, 0.0))
SPINS = (-1.0, 1.0, -1.0, 1.0)
PHYSICS = {
    "mass": MASS,
    "inertia": INERTIA,
    "thrust_coefficient": LIFT,
    "torque_coefficient": DRAG,
    "rotor_positions": HUBS,
    "rotor_directions": SPINS,
}
LEFT_FOR_RIGHT = {"rotors": [3, 2, 1, 0], "polar": [1, -1, 1], "axial": [-1, 1, -1]}
FRONT_FOR_BACK = {"rotors": [1, 0, 3, 2], "polar": [-1, 1, 1], "axial": [1, -1, -1]}
HALF_TURN = {"rotors": [2, 3, 0, 1], "polar": [-1, -1, 1], "axial": [-1, -1, 1]}
IMAGES = (LEFT_FOR_RIGHT, FRONT_FOR_BACK, HALF_TURN)


def problem(horizon=8, history=6, rate=100.0, context=("attitude", "specific_force"), **physics):
    count = {"attitude": 4, "rotor_speed": 4}
    named = {s: channels(s, count.get(s, 3)) for s in ("rotor_speed", "velocity", "body_rates", *context)}
    return Problem(
        named["rotor_speed"],
        named["velocity"] + named["body_rates"],
        horizon,
        history,
        tuple(c for s in context for c in named[s]),
        rate,
        physics=PHYSICS | physics,
    )


def build(given, **options):
    """A predictor in float64, with scalers that are not symmetric, in the mode of tests."""
    torch.manual_seed(0)
    p = LoadHybrid(hidden=8, encoder=8, **options).build(given).double().eval()
    p.input_scaler.set(torch.tensor([HOVER - 5, HOVER, HOVER + 9, HOVER - 4]), torch.tensor([120.0, 130, 125, 135]))
    p.output_scaler.set(torch.linspace(-0.1, 0.2, 6), torch.linspace(0.4, 0.9, 6))
    p.context_scaler.set(torch.linspace(-0.2, 0.3, p.n_context), torch.linspace(0.3, 1.1, p.n_context))
    return p


def lively(p):
    """The same with every weight away from its start, so that nothing is silent."""
    torch.manual_seed(1)
    with torch.no_grad():
        for weight in p.parameters():
            weight += 0.05 * torch.randn_like(weight)
    return p


def windows(given, count=3):
    """Random SI windows: history inputs and outputs with context, horizon inputs, horizon outputs."""
    g = torch.Generator().manual_seed(2)
    draw = lambda *shape: torch.randn(*shape, generator=g, dtype=torch.float64)  # noqa: E731
    u = HOVER + 100 * draw(count, given.history + given.horizon, 4)
    q = draw(count, given.history, 4) * 0.2 + torch.tensor([0.0, 0, 0, 1])
    q = q / q.norm(dim=-1, keepdim=True)
    felt = draw(count, given.history, 3) + torch.tensor([0.0, 0, 9.81])
    past = torch.cat([draw(count, given.history, 6), q, felt], -1)
    return u[:, : given.history], past, u[:, given.history :], draw(count, given.horizon, 6)


def predict(p, u_history, history, u):
    return p(u, p.init_buffers(p.input_scaler(u_history), p.scale_history(history)))


def mirrored(image, u_history, history, u, y):
    polar, axial = (torch.tensor(image[k], dtype=torch.float64) for k in ("polar", "axial"))
    both = torch.cat([polar, axial])
    context = torch.cat([axial, torch.ones(1), polar])
    return u_history[..., image["rotors"]], history * torch.cat([both, context]), u[..., image["rotors"]], y * both


def integrated(state, u, rate, inertia, more=(0, 0, 0, 0, 0, 0)):
    """Velocity, attitude and body rates (T, 10) of a rigid body by SciPy, rotor speeds (T + 1, 4) linear in between.

    ``more`` is a further angular acceleration and specific force.
    """
    u, hubs = np.asarray(u), np.array(HUBS)

    def slope(t, x):
        squares = np.array([np.interp(t * rate, np.arange(len(u)), u[:, i]) for i in range(4)]) ** 2
        thrust = LIFT * squares
        torque = [(hubs[:, 1] * thrust).sum(), -(hubs[:, 0] * thrust).sum(), DRAG * (np.array(SPINS) * squares).sum()]
        rotation, w = Rotation.from_quat(x[3:7]), x[7:]
        v = rotation.apply(np.array([0, 0, thrust.sum() / MASS]) + more[3:]) - [0, 0, 9.81]
        a, b = x[3:6], x[6]
        q = np.concatenate([b * w + np.cross(a, w), [-a @ w]]) / 2
        return np.concatenate([v, q, (torque - np.cross(w, inertia * w)) / inertia + more[:3]])

    times = np.arange(1, len(u)) / rate
    solved = solve_ivp(slope, (0, times[-1]), state, t_eval=times, rtol=1e-8, atol=1e-10, max_step=1 / rate)
    return solved.y.T


OUTPUTS = [0, 1, 2, 7, 8, 9]


@pytest.mark.parametrize(("inertia", "ratio"), [((3e-5, 3e-5, 3e-5), 4), (INERTIA, 2)])
def test_without_anything_learned_it_is_the_rigid_body(inertia, ratio) -> None:
    """To second order in the time step; the gyroscopic torque, which a sphere does not have, to first."""
    errors = []
    t = np.linspace(0, 0.4, 161)
    speeds = HOVER + np.stack([60 * np.sin(9 * t + i) + 15 * np.cos(21 * t - i) for i in range(4)], 1)
    state = np.array([0.8, -1.1, 0.3, 0.1, -0.2, 0.05, 0.97, 0.9, -1.4, 0.7])
    state[3:7] /= np.linalg.norm(state[3:7])
    for rate, every in ((100.0, 4), (200.0, 2)):
        u = torch.from_numpy(speeds[::every])
        p = build(problem(len(u) - 1, 2, rate, inertia=inertia))
        with torch.no_grad():
            for name in ("past_load", "past_force", "latent", "latent_bias"):
                getattr(p.load, name).zero_()
        now = torch.from_numpy(np.concatenate([state[OUTPUTS], state[3:7], [0, 0, 9.81]]))
        found = predict(p, u[[0, 0]].unsqueeze(0), now.expand(1, 2, -1), u[1:].unsqueeze(0)).detach()[0].numpy()
        wanted = integrated(state, u, rate, np.array(inertia))[:, OUTPUTS]
        errors.append(np.abs(found - wanted).max())
        assert np.abs(wanted - wanted[0]).max() > 1  # it moves
    assert errors[0] < 0.03
    assert errors[0] / errors[1] == pytest.approx(ratio, rel=0.15)


@pytest.mark.parametrize("felt", [False, True])
def test_a_load_that_the_nominal_constants_lack_is_found_in_the_history(felt) -> None:
    """As the residual of the motion over two steps, the force from the accelerometer or from the velocity."""
    inertia, more, past = np.array([3e-5] * 3), np.array([3.0, -2, 1, 0.5, -0.4, 0.8]), 20
    t = np.arange(past + 21) / 100
    speeds = HOVER + np.stack([100 * np.sin(18 * t + 0.3 * i) + 300 * t * (i - 2) for i in range(4)], 1)
    start = np.array([0.8, -1.1, 0.3, 0.1, -0.2, 0.05, 0.97, 0.3, -0.4, 0.2])
    start[3:7] /= np.linalg.norm(start[3:7])
    flown = np.concatenate([start[None], integrated(start, speeds, 100.0, inertia, more)])
    thrust = (LIFT * speeds**2).sum(1, keepdims=True) / MASS * [0, 0, 1]
    # the accelerometer tells of the step that ends with its sample
    force = np.concatenate([thrust[:1], (thrust[1:] + thrust[:-1]) / 2]) + more[3:]
    p = build(problem(20, past + 1, inertia=tuple(inertia)))
    with torch.no_grad():
        for weight in (p.load.latent, p.load.latent_bias, p.load.past_load, p.load.past_force):
            weight.zero_()
        p.load.past_load[-2:, : 3 if felt else 6] = 1 / 2
        p.load.past_force[-2:] = felt / 2
        p.load.keep += 100
    seen = torch.from_numpy(np.concatenate([flown[:, OUTPUTS], flown[:, 3:7], force], 1)[: past + 1]).unsqueeze(0)
    u = torch.from_numpy(speeds).unsqueeze(0)
    found = predict(p, u[:, : past + 1], seen, u[:, past + 1 :]).detach()[0].numpy()
    nominal = integrated(flown[past], speeds[past:], 100.0, inertia)
    error, without = (np.abs(x - flown[past + 1 :, OUTPUTS]).max() for x in (found, nominal[:, OUTPUTS]))
    print(without, error)
    assert without > 0.3 and error < 0.01 * without


@pytest.mark.parametrize("image", IMAGES)
def test_the_prediction_of_a_mirror_image_is_the_mirror_image_of_the_prediction(image) -> None:
    given = problem()
    p, window = lively(build(given)), windows(given)
    u_history, history, u, _ = window
    own = predict(p, u_history, history, u)
    u_history, history, u, wanted = mirrored(image, *window[:3], own)
    torch.testing.assert_close(predict(p, u_history, history, u), wanted, rtol=1e-12, atol=1e-12)
    without = lively(build(given, mirrors=False))
    assert (predict(without, u_history, history, u) - wanted).abs().max() > 1e-3


def test_a_vehicle_without_the_symmetry_has_no_mirror_images() -> None:
    assert len(build(problem()).mirrors) == 4
    assert len(build(problem(rotor_positions=(*HUBS[:3], (ARM, 2 * ARM, 0.0)))).mirrors) == 1
    assert len(build(problem(rotor_directions=(1.0, 1.0, -1.0, -1.0))).mirrors) == 2  # only the reflection that fits
    plus = ((ARM, 0.0, 0.0), (0.0, ARM, 0.0), (-ARM, 0.0, 0.0), (0.0, -ARM, 0.0))
    assert len(build(problem(rotor_positions=plus)).mirrors) == 2  # the half turn


def test_inputs_act_when_they_come_and_not_before() -> None:
    given = problem()
    p, (u_history, history, u, _) = lively(build(given)), windows(given)
    before = predict(p, u_history, history, u)
    later = u.clone()
    later[:, 5] += 50
    after = predict(p, u_history, history, later)
    assert torch.equal(before[:, :5], after[:, :5])
    assert ((before - after)[:, 5].abs() > 1e-6).all()


def test_what_is_left_of_a_run_goes_on_as_if_it_had_not_stopped() -> None:
    given = problem()
    p, (u_history, history, u, _) = lively(build(given)), windows(given)
    start = p.init_buffers(p.input_scaler(u_history), p.scale_history(history))
    check_pieces(p, p.input_scaler(u), start, cut=3)


def test_varied_windows_are_flights_of_the_same_vehicle() -> None:
    given = problem(horizon=20)
    p = build(given, jitter=0.0)
    model = Quadrotor(**PHYSICS)
    total = given.history + given.horizon
    g = torch.Generator().manual_seed(4)
    u = HOVER + 60 * torch.randn(16, total, 4, generator=g, dtype=torch.float64)
    state = torch.zeros(16, 13, dtype=torch.float64)
    state[:, 3:] = torch.randn(16, 10, generator=g, dtype=torch.float64) * 0.3
    state[:, 9] = 1
    flown = torch.stack(list(flights(model, state, u)), 1)
    y, context = flown[..., [3, 4, 5, 10, 11, 12]], torch.cat([flown[..., 6:10], torch.zeros(16, total, 3)], -1)
    n = given.history
    past = p.scale_history(torch.cat([y, context], -1)[:, :n])
    torch.manual_seed(0)
    window = (p.input_scaler(u[:, :n]), past, p.input_scaler(u[:, n:]), p.output_scaler(y[:, n:]))
    u_history, history, u_after, y_after = p.augment(window)
    changed = (y_after - window[3]).abs().amax((1, 2)) > 1e-3
    assert 6 <= changed.sum() < 16  # some are mirrored, some are not
    measured = p.output_scaler.invert(history[..., :6])
    attitude = p.context_scaler.invert(history[..., 6:])[..., :4]
    start = torch.cat([torch.zeros(16, 3), measured[:, -1, :3], attitude[:, -1], measured[:, -1, 3:]], -1)
    driving = p.input_scaler.invert(torch.cat([u_history[:, -1:], u_after], 1))
    again = torch.stack(list(flights(model, start, driving)), 1)[:, 1:, [3, 4, 5, 10, 11, 12]]
    torch.testing.assert_close(p.output_scaler(again), y_after, rtol=1e-9, atol=1e-9)


def flights(model, state, u):
    yield state
    for k in range(1, u.shape[1]):
        state = model.step(state, u[:, k - 1], u[:, k], 0.01)
        yield state


def test_jitter_delays_rotor_speeds_by_a_fraction_of_a_sample() -> None:
    given = problem(horizon=30, history=10)
    p = build(given, mirrors=False, jitter=1.0)
    ramp = (HOVER + 10 * torch.arange(40.0, dtype=torch.float64)).view(1, 40, 1).expand(50, 40, 4)
    u = p.input_scaler(ramp)
    _, history, _, y = windows(given, 50)
    torch.manual_seed(0)
    u_history, kept, u_after, left = p.augment((u[:, :10], history, u[:, 10:], y))
    found = p.input_scaler.invert(torch.cat([u_history, u_after], 1))
    delay = (ramp - found)[:, 1:-1] / 10
    torch.testing.assert_close(delay, delay[:, :1, :1].expand_as(delay), rtol=1e-9, atol=1e-9)
    assert -1 <= delay.min() < -0.8 and 0.8 < delay.max() <= 1
    assert torch.allclose(kept, history) and torch.allclose(left, y)


def test_gradient_of_the_cost() -> None:
    given = problem(horizon=5, history=4)
    p, (u_history, history, u, y) = lively(build(given)), windows(given)
    weights = dict(p.named_parameters())

    def cost():
        state = p.init_buffers(p.input_scaler(u_history), p.scale_history(history))
        return p.cost(p.rollout(p.input_scaler(u), state)[0], p.output_scaler(y))

    gradients = dict(zip(weights, torch.autograd.grad(cost(), list(weights.values())), strict=True))
    torch.manual_seed(3)
    for name, weight in weights.items():
        direction, value, h = torch.randn_like(weight), weight.detach().clone(), 1e-6
        sides = []
        for sign in (1, -1):
            with torch.no_grad():
                weight.copy_(value + sign * h * direction)
                sides.append(float(cost()))
        with torch.no_grad():
            weight.copy_(value)
        slope = float((gradients[name] * direction).sum())
        assert (sides[0] - sides[1]) / (2 * h) == pytest.approx(slope, rel=1e-5, abs=1e-7), name


def test_gradient_of_a_step() -> None:
    torch.manual_seed(0)
    draw = lambda *shape: torch.randn(*shape, dtype=torch.float64)  # noqa: E731
    rotation = torch.linalg.qr(draw(3, 3, 3))[0].permute(1, 2, 0).contiguous()
    leaves = [x.requires_grad_() for x in (rotation, draw(6, 3), draw(5, 3), draw(6, 3), 0.3 * draw(6, 17 + 8 + 5))]
    rotors = draw(4, 3), draw(3), draw(3)

    def step(rotation, motion, hidden, given, weight):
        return LoadedBody(0.01, 0.7, 1.3, weight)(rotation, motion, hidden, given, rotors)

    assert torch.autograd.gradcheck(step, leaves, eps=1e-6, atol=1e-6)


def test_it_trains_where_there_is_no_accelerometer() -> None:
    predictor, initializer = parse("Load hybrid: 1x8")
    assert write(predictor, initializer) == "Load hybrid: 1x8"
    config = RunConfig(predictor, None, PelicanTwin(), horizon=10, history=10, training=Training(updates=15))
    assert config.resolved().context == ("attitude",)
    data = prepare(config)
    (trained,) = train([config], [data])
    assert trained.status == "finished" and len(trained.model.predictor.mirrors) == 2
    assert trained.model.predictor.load.past_force is None


def test_what_it_is_not_for_is_said() -> None:
    given = problem()
    for wrong, word in (
        ({"outputs": given.outputs[:3]}, "velocity and body_rates"),
        ({"inputs": channels("rotor_command", 4)}, "rotor speeds"),
        ({"system": "helicopter"}, "rotor speeds"),
        ({"history": 1}, "two samples"),
        ({"context": ()}, "attitude"),
    ):
        with pytest.raises(BenchError, match=word):
            LoadHybrid().build(Problem(**(vars(given) | wrong)))
