"""Systems with several moving parts whose physics no catalogue has: every part's equation is told by itself."""

from collections.abc import Callable
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
from registry.physics.state_space import StateSpace
from registry.units import Signal

Rate = Callable[[np.ndarray, np.ndarray], list[float]]
RATE, SECONDS = 100.0, 15.0
DRIVE = np.array([0.6, 0.15])
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


def diagnosed(of: Rate, held: float) -> tuple[Diagnosis, PhysicsModel]:
    """Six recordings with white noise of `NOISE`, driven by multisines, and pulled to rest by ``held`` [N m s]."""
    logs = []
    for k in range(6):
        rng = np.random.default_rng(100 + k)
        phase, frequency = rng.uniform(0, 6.28, (2, 5)), rng.uniform(0.1, 1.2, (2, 5))

        def drive(t: np.ndarray, phase: np.ndarray = phase, frequency: np.ndarray = frequency) -> np.ndarray:
            angles = 2 * np.pi * frequency[..., None] * t + phase[..., None]
            out: np.ndarray = DRIVE[:, None] * np.sin(angles).sum(1)
            return out

        def rate(t: float, x: np.ndarray, drive: Callable[..., np.ndarray] = drive) -> list[float]:
            return [x[2], x[3], *of(x, drive(np.array([t]))[:, 0] - held * x[2:])]

        t = np.arange(0, SECONDS, 1 / RATE)
        x = solve_ivp(rate, (0, SECONDS), [0, 0, 0, 0], t_eval=t, rtol=1e-9, atol=1e-10).y.T
        u = (drive(t) - held * x[:, 2:].T).T
        x = x + rng.normal(size=x.shape) * NOISE
        inputs = (Channel("torque.a", "N m"), Channel("torque.b", "N m"))
        made = Recording(f"run_{k}", RATE, u, x, inputs, TwoParts.state_channels, np.ones(len(x), bool))
        logs.append(log_of(made, TwoParts(), "torque"))
    names = [log.name for log in logs]
    subject = Subject(
        "hidden",
        TwoParts(),
        tuple(logs),
        tuple(names[:4]),
        tuple(names[4:]),
        None,
        {},
        {},
        ("angle", "angle_rate", "torque"),
    )
    return diagnose(subject)


def functions(found: PhysicsModel) -> dict[tuple[str, ...], LearnedTerm]:
    """Every learned term by its axis and what it follows."""
    return {(e.axis, *e.signals): e for e in found.effects if isinstance(e, LearnedTerm)}


def agrees(term: LearnedTerm, true: Callable[[np.ndarray], np.ndarray]) -> bool:
    """Whether it is the true function within 1 % of its largest value, wherever the signal went."""
    x = np.linspace(*term.span, 101)
    return bool(np.abs(term.function(torch.from_numpy(x)).numpy() - true(x)).max() < 0.01 * np.abs(true(x)).max())


def test_both_links_of_an_arm_are_described_each_by_its_own_equation() -> None:
    found, model = diagnosed(arm, 0.0)
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
    _, model = diagnosed(shaft, 0.05)
    terms = functions(model)
    assert set(terms) == {("angle_rate.a", "angle.a-angle.b"), ("angle_rate.b", "angle.a-angle.b")}
    assert {t.shape for t in terms.values()} == {"linear_cubic"}
    np.testing.assert_allclose(terms["angle_rate.a", "angle.a-angle.b"].values, (-3.75, -10), rtol=0.02)
    np.testing.assert_allclose(terms["angle_rate.b", "angle.a-angle.b"].values, (15, 40), rtol=0.02)


def test_where_nothing_is_missing_nothing_is_learned() -> None:
    found, model = diagnosed(free, 0.05)
    assert (found.verdict, model.effects) == ("nothing", ())
