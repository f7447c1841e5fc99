"""Systems with several moving parts whose physics no catalogue has: every part's equation is told by itself."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import torch
from scipy.integrate import solve_ivp
from torch import Tensor

from bench.diagnose import diagnose
from bench.diagnose.logs.subject import Subject, log_of
from bench.diagnose.result import Diagnosis
from registry.contracts import Channel, Recording
from registry.dynamics import PhysicsModel, constant, tensor
from registry.effects.learned_term import LearnedTerm
from registry.effects.mechanics.joints import JointDamping, JointFriction
from registry.physics.state_space import StateSpace
from registry.units import Signal

Rate = Callable[[np.ndarray, np.ndarray], list[float]]
RATE, SECONDS = 100.0, 15.0
DRIVE = (0.6, 0.15)
DAMPED = 0.05 * np.eye(4)[2:]
NOISE = np.array([0.002, 0.002, 0.01, 0.01])


@dataclass(frozen=True)
class TwoParts(StateSpace):
    """Two parts with inertias of their own, each driven by a motor, and nothing else."""

    first: Any = constant(0.4, "J_1", "kg m^2", low=1e-6)
    second: Any = constant(0.1, "J_2", "kg m^2", low=1e-6)

    state_channels: ClassVar[tuple[Channel, ...]] = (
        Channel("angle.a", "rad"),
        Channel("angle.b", "rad"),
        Channel("angle_rate.a", "rad/s"),
        Channel("angle_rate.b", "rad/s"),
    )
    input_signals: ClassVar[tuple[str, ...]] = ("torque",)
    signals: ClassVar[dict[str, Signal]] = {"torque": Signal("N m", ("a", "b"))}
    alike: ClassVar[tuple[str, ...]] = ()
    equation: ClassVar[str] = "J d²q/dt² = u"

    def own_rate(self, state: Tensor, inputs: Tensor) -> Tensor:
        """The state's rate (…, 4)."""
        inertia = torch.stack([tensor(self.first, state), tensor(self.second, state)], -1)
        return torch.cat([state[..., 2:], inputs[..., :2] / inertia], -1)


@dataclass(frozen=True)
class CartPole(StateSpace):
    """A pendulum that hangs from a cart, without friction."""

    cart: Any = constant(1.0, "M", "kg", low=1e-3)
    bob: Any = constant(0.3, "m", "kg", low=1e-3)
    length: Any = constant(0.5, "l", "m", low=1e-3)

    state_channels: ClassVar[tuple[Channel, ...]] = (
        Channel("place.x", "m"),
        Channel("swing.theta", "rad"),
        Channel("pace.x", "m/s"),
        Channel("swing_rate.theta", "rad/s"),
    )
    input_signals: ClassVar[tuple[str, ...]] = ("push",)
    signals: ClassVar[dict[str, Signal]] = {"push": Signal("N", ("x",))}
    alike: ClassVar[tuple[str, ...]] = ()
    equation: ClassVar[str] = "M(q) d²q/dt² + c(q, dq/dt) = u"

    def own_rate(self, state: Tensor, inputs: Tensor) -> Tensor:
        """The state's rate (…, 4)."""
        cart, bob, length = (tensor(v, state) for v in (self.cart, self.bob, self.length))
        _, theta, v, w = state.unbind(-1)
        s, c = torch.sin(theta), torch.cos(theta)
        a = (inputs[..., 0] + bob * s * (length * w * w + 9.81 * c)) / (cart + bob * s * s)
        return torch.stack([v, w, a, -(a * c + 9.81 * s) / length], -1)


@dataclass(frozen=True)
class Tanks(StateSpace):
    """Two tanks side by side; water flows into the first and does not leave it."""

    area: Any = constant(0.02, "A", "m^2", low=1e-5)

    state_channels: ClassVar[tuple[Channel, ...]] = (Channel("filling.left", "m"), Channel("filling.right", "m"))
    input_signals: ClassVar[tuple[str, ...]] = ("inflow",)
    signals: ClassVar[dict[str, Signal]] = {"inflow": Signal("m^3/s", ("pump",))}
    alike: ClassVar[tuple[str, ...]] = ()
    equation: ClassVar[str] = "A dh/dt = q"

    def own_rate(self, state: Tensor, inputs: Tensor) -> Tensor:
        """The state's rate (…, 2)."""
        flow = inputs[..., 0] / tensor(self.area, state)
        return torch.stack([flow, torch.zeros_like(flow)], -1)


def cart(x: np.ndarray, u: np.ndarray) -> list[float]:
    """Dry and viscous friction under the cart, by the mass matrix of both coordinates."""
    _, theta, v, w = x
    pushed = u[0] - 0.5 * v - 0.8 * np.tanh(v / 0.01)
    mass = np.array([[1.3, 0.15 * np.cos(theta)], [0.15 * np.cos(theta), 0.075]])
    force = np.array([pushed + 0.15 * w * w * np.sin(theta), -0.3 * 9.81 * 0.5 * np.sin(theta)])
    return [float(r) for r in np.linalg.solve(mass, force)]


def arm(x: np.ndarray, u: np.ndarray) -> list[float]:
    """Weight and friction of an arm: the second link hangs from the first, and its bearing sticks."""
    q1, q2, w1, w2 = x
    return [
        (u[0] - 0.25 * w1 - 2.0 * np.sin(q1)) / 0.4,
        (u[1] - 0.06 * w2 - 0.5 * np.sin(q1 + q2) - 0.03 * np.tanh(w2 / 0.02)) / 0.1,
    ]


def shaft(x: np.ndarray, u: np.ndarray) -> list[float]:
    """A shaft that hardens as it twists between two discs."""
    twist = x[0] - x[1]
    moment = 1.5 * twist + 4.0 * twist**3
    return [(u[0] - moment) / 0.4, (u[1] + moment) / 0.1]


def free(x: np.ndarray, u: np.ndarray) -> list[float]:
    """What the model says."""
    return [u[0] / 0.4, u[1] / 0.1]


def subject_of(model: StateSpace, runs: Sequence[tuple[np.ndarray, np.ndarray]], rate: float) -> Subject:
    """Recordings of inputs (N, m) and states (N, s), the last two held out."""
    drive = model.input_signals[0]
    inputs = tuple(Channel(f"{drive}.{axis}", model.signals[drive].unit) for axis in model.signals[drive].axes)
    made = [
        Recording(f"run_{k}", rate, u, x, inputs, model.state_channels, np.ones(len(x), bool))
        for k, (u, x) in enumerate(runs)
    ]
    logs, names = tuple(log_of(r, model, drive) for r in made), [r.name for r in made]
    signals = (*dict.fromkeys(c.group for c in model.state_channels), drive)
    return Subject("hidden", model, logs, tuple(names[:-2]), tuple(names[-2:]), None, {}, {}, signals)


def diagnosed(
    of: Rate, model: StateSpace, sizes: Sequence[float], back: np.ndarray | float = 0.0
) -> tuple[Diagnosis, PhysicsModel]:
    """Six recordings with white noise of `NOISE`, driven by multisines.

    Args:
        of: what moves, from states and inputs to accelerations.
        model: that lacks some of it.
        sizes: amplitudes of the sines in every input.
        back: (inputs, states) feedback that keeps the system in its place.
    """
    gain, runs = np.broadcast_to(back, (len(sizes), 4)), []
    for k in range(6):
        rng = np.random.default_rng(100 + k)
        phase, frequency = rng.uniform(0, 6.28, (len(sizes), 5)), rng.uniform(0.1, 1.2, (len(sizes), 5))

        def driven(t: Any, x: np.ndarray, phase: np.ndarray = phase, frequency: np.ndarray = frequency) -> np.ndarray:
            angles = 2 * np.pi * frequency[..., None] * np.atleast_1d(t) + phase[..., None]
            out: np.ndarray = np.array(sizes)[:, None] * np.sin(angles).sum(1) - gain @ x.reshape(4, -1)
            return out

        def rate(t: float, x: np.ndarray, driven: Callable[..., np.ndarray] = driven) -> list[float]:
            return [x[2], x[3], *of(x, driven(t, x)[:, 0])]

        t = np.arange(0, SECONDS, 1 / RATE)
        x = solve_ivp(rate, (0, SECONDS), [0, 0, 0, 0], t_eval=t, rtol=1e-8, atol=1e-9, max_step=0.02).y.T
        u = driven(t, x.T).T
        runs.append((u, x + rng.normal(size=x.shape) * NOISE))
    return diagnose(subject_of(model, runs, RATE))


def functions(found: PhysicsModel) -> dict[tuple[str, ...], LearnedTerm]:
    """Every learned term by its axis and what it follows."""
    return {(e.axis, *e.signals): e for e in found.effects if isinstance(e, LearnedTerm)}


def agrees(term: LearnedTerm, true: Callable[[np.ndarray], np.ndarray]) -> bool:
    """Whether it is the true function within 1 % of its largest value, wherever the signal went."""
    x = np.linspace(*term.span, 101)
    return bool(np.abs(term.function(torch.from_numpy(x)).numpy() - true(x)).max() < 0.01 * np.abs(true(x)).max())


def test_both_links_of_an_arm_are_described_each_by_its_own_equation() -> None:
    found, model = diagnosed(arm, TwoParts(), DRIVE)
    terms = functions(model)
    assert set(terms) == {
        ("angle_rate.a", "angle.a"),
        ("angle_rate.a", "angle_rate.a"),
        ("angle_rate.b", "angle.a+angle.b"),
        ("angle_rate.b", "angle_rate.b"),
    }
    assert agrees(terms["angle_rate.a", "angle.a"], lambda x: -5 * np.sin(x))
    assert agrees(terms["angle_rate.b", "angle.a+angle.b"], lambda x: -5 * np.sin(x))
    assert terms["angle_rate.b", "angle.a+angle.b"].shape == "sine"
    friction = terms["angle_rate.b", "angle_rate.b"]
    assert friction.shape == "sign_linear"
    np.testing.assert_allclose(friction.values, (-0.6, -0.3), rtol=0.05)
    for group, floor in found.noise_floor.items():
        before, after = (e[group].rmse ** 2 - floor.rmse**2 for e in (found.error.nominal, found.error.extended))
        assert after < 0.001 * before


def test_a_shaft_that_hardens_follows_its_twist() -> None:
    _, model = diagnosed(shaft, TwoParts(), DRIVE, DAMPED)
    terms = functions(model)
    assert set(terms) == {("angle_rate.a", "angle.a-angle.b"), ("angle_rate.b", "angle.a-angle.b")}
    assert {t.shape for t in terms.values()} == {"linear_cubic"}
    np.testing.assert_allclose(terms["angle_rate.a", "angle.a-angle.b"].values, (-3.75, -10), rtol=0.02)
    np.testing.assert_allclose(terms["angle_rate.b", "angle.a-angle.b"].values, (15, 40), rtol=0.02)


def test_friction_is_told_where_the_drive_acts() -> None:
    answer, model = diagnosed(cart, CartPole(), (2.0,), np.array([[3.0, 0.0, 1.0, 0.0]]))
    assert {e.id for e in answer.effects} == {"joint_friction", "joint_damping"}
    friction, damping = (next(e for e in model.effects if isinstance(e, k)) for k in (JointFriction, JointDamping))
    np.testing.assert_allclose((friction.f_1, damping.f_1), (0.8, 0.5), rtol=0.05)


def test_a_joint_without_a_motor_is_no_other_joints() -> None:
    free = type("Free", (CartPole,), {"signals": {"push": Signal("N", ("belt",))}})
    assert [CartPole.state_channels[j].name for j in CartPole.joints()] == ["pace.x"]
    assert free.joints() == ()


def test_two_outlets_are_told_by_torricelli() -> None:
    runs = []
    for k in range(6):
        rng, t = np.random.default_rng(300 + k), np.arange(0, 400, 0.5)
        pump = rng.uniform(0, 2.5e-4, 21)

        def rate(t: float, h: np.ndarray, pump: np.ndarray = pump) -> list[float]:
            over = 1e-4 * np.sign(h[0] - h[1]) * np.sqrt(2 * 9.81 * abs(h[0] - h[1]))
            out = 5e-5 * np.sqrt(2 * 9.81 * max(h[1], 0.0))
            return [float((np.interp(t, np.arange(0, 420, 20), pump) - over) / 0.02), float((over - out) / 0.02)]

        h = solve_ivp(rate, (0, 400), [0.3, 0.2], t_eval=t, rtol=1e-8, atol=1e-10, max_step=1.0).y.T
        runs.append((np.interp(t, np.arange(0, 420, 20), pump)[:, None], h + rng.normal(size=h.shape) * 5e-4))
    _, model = diagnose(subject_of(Tanks(), runs, 2.0))
    terms, tell = functions(model), (2 * 9.81) ** 0.5 / 0.02
    between = "filling.left-filling.right"
    assert set(terms) == {("filling.left", between), ("filling.right", between), ("filling.right", "filling.right")}
    assert {t.shape for t in terms.values()} == {"root"}
    for axis, follows, true in (
        ("filling.left", between, -1e-4),
        ("filling.right", between, 1e-4),
        ("filling.right", "filling.right", -5e-5),
    ):
        np.testing.assert_allclose(terms[axis, follows].values, true * tell, rtol=0.02)


def test_where_nothing_is_missing_nothing_is_learned() -> None:
    found, model = diagnosed(free, TwoParts(), DRIVE, DAMPED)
    assert (found.verdict, model.effects) == ("nothing", ())
