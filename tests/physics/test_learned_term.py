"""A learned term against plain formulas, in every kind of model, and as data of a file."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.integrate import quad
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from bench.diagnose.regression.parameters import entries, with_values
from bench.diagnose.report import model_file
from registry.effects.learned_term import LearnedTerm
from registry.errors import BenchError
from registry.physics.oscillator import Oscillator
from registry.physics.quadrotor import Quadrotor
from registry.terms.shapes import SHAPES, value
from registry.terms.spline import basis, roughness, through
from registry.terms.unit_algebra import product

F64 = torch.float64
KNOTS = (-2.0, -0.7, 0.4, 1.0, 2.5)


def test_the_basis_is_that_of_natural_cubic_splines_and_goes_on_straight() -> None:
    heights = np.array([1.0, -1.0, 2.0, 0.0, 1.5])
    known = CubicSpline(KNOTS, heights, bc_type="natural")
    x = np.linspace(-2, 2.5, 91)
    found = basis(KNOTS, torch.from_numpy(x)).numpy() @ heights
    np.testing.assert_allclose(found, known(x), atol=1e-12)
    ends = torch.tensor([-3.0, 4.0], dtype=F64)
    wanted = [known(-2) - known(-2, 1), known(2.5) + 1.5 * known(2.5, 1)]
    np.testing.assert_allclose(basis(KNOTS, ends).numpy() @ heights, wanted, atol=1e-12)
    several = torch.from_numpy(np.stack([heights, 2 * heights]))[:, None]  # two splines at once
    one, two = through(KNOTS, several, torch.from_numpy(x)).numpy()
    np.testing.assert_allclose([one, two / 2], [known(x), known(x)], atol=1e-12)
    np.testing.assert_allclose(through(KNOTS, several[0, 0], ends).numpy(), wanted, atol=1e-12)
    bend = quad(lambda t: float(known(t, 2)) ** 2, -2, 2.5, points=KNOTS[1:-1])[0]
    assert heights @ roughness(KNOTS) @ heights == pytest.approx(bend)


FORMULAS = {
    "constant": lambda x, c: c + 0 * x,
    "linear": lambda x, k: k * x,
    "square": lambda x, k: k * x**2,
    "signed_square": lambda x, k: k * x * abs(x),
    "root": lambda x, k: k * x / (x**2 + 0.02**2) ** 0.25,
    "cubic": lambda x, k: k * x**3,
    "sign": lambda x, c: c * np.tanh(x / 0.02),
    "affine": lambda x, k, c: k * x + c,
    "linear_square": lambda x, k, q: k * x + q * x**2,
    "linear_signed_square": lambda x, k, q: k * x + q * x * abs(x),
    "sides": lambda x, k, q: np.where(x > 0, k, q) * x,
    "square_sides": lambda x, k, q: np.where(x > 0, k, q) * x**2,
    "linear_cubic": lambda x, k, q: k * x + q * x**3,
    "sign_linear": lambda x, k, c: k * x + c * np.tanh(x / 0.02),
    "saturation": lambda x, k, w: k * np.clip(x, -w, w),
    "dead_zone": lambda x, k, w: np.where(x > w, k * (x - w), np.where(x < -w, k * (x + w), 0)),
    "above": lambda x, k, w: k * np.maximum(x - w, 0),
    "below": lambda x, k, w: k * np.maximum(w - x, 0),
    "exponential": lambda x, k, n: k * np.exp(-n * x),
    "parabola": lambda x, c, k, q: c + k * x + q * x**2,
    "sine": lambda x, a, n: a * np.sin(n * x),
    "wave": lambda x, a, b, n: a * np.sin(n * x) + b * np.cos(n * x),
    "inverse": lambda x, k: k / x,
    "inverse_square": lambda x, k: k / x**2,
}


@pytest.mark.parametrize("name", SHAPES)
def test_every_formula_is_what_it_says_and_linear_where_it_says(name: str) -> None:
    shape, positive = SHAPES[name], SHAPES[name].positive
    x, span = np.linspace(0.3 if positive else -2, 2, 37), (0.3 if positive else -2.0, 2.0)
    numbers = [0.7, -0.4, 1.3][-len(shape.parameters) :]
    numbers[-1] = abs(numbers[-1])
    found = value(name, (), span, torch.tensor(numbers, dtype=F64), torch.from_numpy(x)).numpy()
    np.testing.assert_allclose(found, FORMULAS[name](x, *numbers), atol=1e-12)
    twice = [2 * p if i < shape.linear else p for i, p in enumerate(numbers)]
    doubled = value(name, (), span, torch.tensor(twice, dtype=F64), torch.from_numpy(x)).numpy()
    np.testing.assert_allclose(doubled, 2 * found, atol=1e-12)


def test_units_follow_from_the_formula() -> None:
    assert product(("N", 1), ("m/s", -2)) == "N s^2/m^2"
    assert product(("m/s", 1), ("s", -1), ("m/s", -1)) == "1/s"
    assert product(("K/s", 1), ("K", -1)) == "1/s" and product(("K/s", 1), ("K", -3)) == "1/(K^2 s)"
    assert product(("L/min", 1), ("pH (25°)", -1)) == "L/(min pH (25°))"
    model = Quadrotor(effects=(LearnedTerm("torque_y", ("body_velocity.x",), "signed_square", (0.1,)),))
    assert model.effects[0].named_parameters(model) == [("k", "N s^2/m")]  # a metre is gone
    bent = LearnedTerm("speed.q", ("displacement.q",), "dead_zone", (-3.0, 0.2))
    assert bent.named_parameters(Oscillator()) == [("k", "1/s^2"), ("w", "m")]


def test_forces_and_torques_act_where_they_say() -> None:
    turn = Rotation.from_rotvec([0.3, -0.5, 0.8])
    state = torch.tensor([0.4, -1.2, 2.0, 1.0, -2.0, 0.5, *turn.as_quat(), 0.3, -0.2, 0.1], dtype=F64)
    speeds = torch.full((4,), 500.0, dtype=F64)
    body = turn.inv().apply([1.0, -2.0, 0.5])

    def added(*effects: LearnedTerm) -> np.ndarray:
        with_it, bare = Quadrotor(mass=2.0, effects=effects), Quadrotor(mass=2.0)
        return np.asarray((with_it.derivative(state, speeds) - bare.derivative(state, speeds)).numpy())

    spring = added(LearnedTerm("world_force_y", ("position.y",), "linear", (-0.5,)))
    np.testing.assert_allclose(spring, [0, 0, 0, 0, 0.6 / 2, *[0] * 8], atol=1e-12)
    drag = added(LearnedTerm("force_x", ("airspeed", "body_velocity.x"), "linear", (-0.1,)))
    expected = turn.apply([-0.1 * np.linalg.norm(body) * body[0] / 2, 0, 0])
    np.testing.assert_allclose(drag[3:6], expected, atol=1e-12)
    assert np.abs(drag[10:]).max() == 0
    twist = added(LearnedTerm("torque_z", ("pitch",), "linear", (0.2,)))
    pitch = turn.as_euler("ZYX")[1]
    np.testing.assert_allclose(twist, [*[0] * 12, 0.2 * pitch / 0.02], atol=1e-12)


def test_its_parameters_are_fitted_one_by_one_and_many_at_once() -> None:
    term = LearnedTerm("speed.q", ("displacement.q",), "spline", (0.5, -0.1, 0.0, 0.3, 2.0), KNOTS, (-2.0, 2.5))
    model = Oscillator(effects=(term,))
    where = [e for e in entries(model, {}) if e.owner == 0]
    assert [e.label for e in where] == [f"values[{i}]" for i in range(5)]
    assert {e.scale for e in where} == {2.0}  # that of the largest: a value of zero has no size of its own
    some = torch.tensor([[1.0, 2.0, 3.0, 4.0, 5.0], [0.5, -0.1, 0.0, 0.3, 2.0]], dtype=F64)
    state, u = torch.tensor([[0.7, 0.1], [-1.4, 0.2], [3.0, 0.0]], dtype=F64), torch.zeros(3, 1, dtype=F64)
    both = with_values(model, where, some).derivative(state.expand(2, 1, 3, 2), u.expand(2, 1, 3, 1))
    for row, values in zip(both, some, strict=True):
        alone = with_values(model, where, values.numpy())
        torch.testing.assert_close(row[0], alone.derivative(state, u), rtol=1e-13, atol=1e-13)
    values = torch.tensor([0.5, -0.1, 0.0, 0.3, 2.0], dtype=F64, requires_grad=True)

    def rates(x: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
        return Oscillator(effects=(replace(term, values=v),)).derivative(x, u)

    assert torch.autograd.gradcheck(rates, (state.requires_grad_(), values))


def test_a_model_that_lacks_axis_or_signal_says_so() -> None:
    with pytest.raises(BenchError, match=r"oscillator has no axis 'force_z'.*speed\.q"):
        Oscillator(effects=(LearnedTerm("force_z", ("displacement.q",)),))
    with pytest.raises(BenchError, match="no signal 'heigth' to follow: did you mean height"):
        Quadrotor(effects=(LearnedTerm("force_z", ("heigth",)),))
    with pytest.raises(BenchError, match="no signal 'battery'"):
        Quadrotor(effects=(LearnedTerm("force_z", ("battery",)),))
    Quadrotor(extras=("battery",), effects=(LearnedTerm("force_z", ("battery",)),))


def test_a_file_gives_the_same_free_run(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    terms = (
        LearnedTerm("world_force_x", ("position.x",), "spline", tuple(rng.normal(size=5)), KNOTS, (-2.0, 2.5)),
        LearnedTerm("force_x", ("airspeed", "body_velocity.x"), "linear", (-0.0123456789012,), (), (0.0, 4.0)),
        LearnedTerm("torque_z", (), "constant", (1.23456789e-5,)),
    )
    model = Quadrotor(effects=terms)
    model_file.write(tmp_path / "model.toml", model)
    read = model_file.read(tmp_path / "model.toml")
    assert [e.options() for e in read.effects] == [e.options() for e in terms]
    state = torch.tensor([0.1, 0.2, 1.0, 0.5, 0.3, 0.1, 0, 0, 0, 1, 0.1, 0.2, 0.3], dtype=F64)
    inputs = torch.from_numpy(rng.normal(495, 10, (101, 4)))
    a, b = (m.simulate(state, inputs, 0.01) for m in (model, read))
    assert (a - Quadrotor().simulate(state, inputs, 0.01)).abs().max() > 0.05
    torch.testing.assert_close(b, a, rtol=0, atol=1e-9)


GOOD = {"axis": "force_z", "signals": ["height"], "shape": "linear", "values": [0.1], "span": [0.0, 2.0]}


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"axis": "__import__('os')"}, "has no axis"),
        ({"axis": 3}, "axis and shape must be texts"),
        ({"signals": "height"}, "signals must be one or two names"),
        ({"signals": ["height"] * 3}, "signals must be one or two names"),
        ({"signals": []}, "signals must be one or two names"),
        ({"shape": "lambda x: x"}, "unknown shape"),
        ({"values": [0.1, 0.2]}, "linear takes 1 values here, not 2"),
        ({"values": 0.1}, "values must be a list of finite numbers"),
        ({"values": [float("nan")]}, "values must be a list of finite numbers"),
        ({"values": [True]}, "values must be a list of finite numbers"),
        ({"values": [10**400]}, "values must be a list of finite numbers"),
        ({"knots": [0.0, 1.0, 2.0]}, "only a spline has knots"),
        ({"shape": "spline", "knots": [0.0, 1.0]}, "from 3 to 40 knots, not 2"),
        ({"shape": "spline", "knots": [float(i) for i in range(99)]}, "from 3 to 40 knots, not 99"),
        ({"shape": "spline", "knots": [0.0, 2.0, 1.0], "values": [1.0, 2.0, 3.0]}, "knots must ascend"),
        ({"span": [2.0, 0.0]}, "span must be the lowest and the highest"),
        ({"code": "print(1)"}, "unknown key 'code'"),
    ],
)
def test_a_hostile_file_is_refused_with_a_sentence(changed: dict[str, object], says: str, tmp_path: Path) -> None:
    table = {**GOOD, **changed}
    text = "\n".join(
        f"{k} = {json.dumps(v).replace('NaN', 'nan').replace('Infinity', 'inf')}" for k, v in table.items()
    )
    (tmp_path / "model.toml").write_text(f'system = "quadrotor"\n[[effects]]\nid = "learned_term"\n{text}\n')
    with pytest.raises(BenchError, match=says) as refused:
        model_file.read(tmp_path / "model.toml")
    assert "model.toml" in str(refused.value)
