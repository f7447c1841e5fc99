"""Systems of a user's own file with signals that nobody registered: a driven pendulum and an arm with two joints."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.integrate import solve_ivp

from bench.cli import cli
from bench.diagnose import compare, discover, load
from registry.errors import BenchError

SYSTEMS = '''
from dataclasses import dataclass
from typing import Any

import torch

from registry.contracts import Channel
from registry.dynamics import constant, tensor
from registry.physics.state_space import Mechanical, StateSpace
from registry.units import Signal

JOINTS = ("shoulder", "elbow")
STATES = (("angle", "rad"), ("angle_rate", "rad/s"))


@dataclass(frozen=True)
class Driven(Mechanical):
    """A pendulum with a motor at its pivot."""

    mass: Any = constant(1.0, "m", "kg", low=1e-6)
    length: Any = constant(1.0, "l", "m", low=1e-6)
    state_channels = (Channel("angle.theta", "rad"), Channel("angle_rate.theta", "rad/s"))
    input_signals = ("torque",)
    signals = {"torque": Signal("N m", ("motor",))}
    alike = ("pendulum",)
    equation = "m l² d²θ/dt² = u − m g l sin θ"

    def lever(self, like):
        return tensor(self.length, like)

    def own_force(self, state, inputs):
        weight = -9.81 * tensor(self.mass, state).unsqueeze(-1) * torch.sin(state[..., :1])
        return weight + inputs / tensor(self.length, state).unsqueeze(-1)


@dataclass(frozen=True)
class Arm(StateSpace):
    """Two joints in a horizontal plane, the masses at the ends of links of 0.4 m and 0.3 m."""

    m1: Any = constant(1.0, "m_1", "kg", low=1e-6)
    m2: Any = constant(0.8, "m_2", "kg", low=1e-6)
    state_channels = tuple(Channel(f"{s}.{j}", u) for s, u in STATES for j in JOINTS)
    input_signals = ("torque",)
    signals = {"torque": Signal("N m", JOINTS)}
    alike = ()
    equation = "M(q) d²q/dt² + c(q, dq/dt) = u"

    def own_rate(self, state, inputs):
        _, q2, w1, w2 = state.unbind(-1)
        m1, m2 = tensor(self.m1, state), tensor(self.m2, state)
        c, h = 0.12 * m2 * torch.cos(q2), 0.12 * m2 * torch.sin(q2)
        m11, m12, m22 = (m1 + m2) * 0.16 + m2 * 0.09 + 2 * c, m2 * 0.09 + c, m2 * 0.09
        f1, f2 = inputs[..., 0] + h * (2 * w1 * w2 + w2 * w2), inputs[..., 1] - h * w1 * w1
        det = m11 * m22 - m12 * m12
        return torch.stack([w1, w2, (m22 * f1 - m12 * f2) / det, (m11 * f2 - m12 * f1) / det], -1)
'''
HEAD = 'name = "{name}"\nrate_hz = 100\nfiles = "*.csv"\ntime = "t"\ninput = "torque"\n[signals]\n'
DAMPING = 0.05
"""Of the joints, which no model here knows [N m s]."""


def pendulum(_: float, x: np.ndarray, u: np.ndarray) -> list[float]:
    """l = 0.5 m, m = 1 kg, and a viscous friction of 0.6 N s/m along the path."""
    return [x[1], u[0] / 0.25 - 9.81 / 0.5 * np.sin(x[0]) - 0.6 * x[1]]


def arm(_: float, x: np.ndarray, u: np.ndarray) -> list[float]:
    """Lagrange's equations by a linear solve."""
    c, h = 0.096 * np.cos(x[1]), 0.096 * np.sin(x[1])
    inertia = np.array([[1.8 * 0.16 + 0.072 + 2 * c, 0.072 + c], [0.072 + c, 0.072]])
    coriolis = np.array([h * (2 * x[2] * x[3] + x[3] ** 2), -h * x[2] ** 2])
    return [x[2], x[3], *np.linalg.solve(inertia, u - DAMPING * x[2:] + coriolis)]


def logged(folder: Path, rate: Callable[..., list[float]], width: int, size: float, description: str) -> Path:
    """Four recordings of 8 s; torques in mN m, which are linear between samples."""
    folder.mkdir()
    t = np.arange(800) / 100
    for i in range(4):
        rng = np.random.default_rng(i)
        waves = [(size * rng.normal(size=width), f, rng.uniform(0, 6, width)) for f in (0.2, 0.5, 0.9, 1.7)]
        torque = sum(a * np.sin(2 * np.pi * f * t[:, None] + phase) for a, f, phase in waves)

        def motion(at: float, x: np.ndarray, torque: np.ndarray = torque) -> list[float]:
            return rate(at, x, np.array([np.interp(at, t, column) for column in torque.T]))

        x = solve_ivp(motion, (0, t[-1]), np.zeros(2 * width), t_eval=t, rtol=1e-9, atol=1e-11).y.T
        table = np.column_stack([t, x + rng.normal(0, 1e-4, x.shape), 1e3 * torque])
        names = ["t", *(f"{s}{j}" for s in "qwu" for j in range(width))]
        np.savetxt(folder / f"run_{i}.csv", table, "%.9g", ",", header=",".join(names), comments="")
    (folder / "dataset.toml").write_text(HEAD.format(name=folder.name) + description)
    return folder


@pytest.fixture(scope="module")
def mine(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("own") / "mine.py"
    file.write_text(SYSTEMS)
    return file


def test_a_driven_pendulum_is_diagnosed_from_torques_in_millinewton_metres(mine: Path, tmp_path: Path) -> None:
    described = (
        'angle = {columns = ["q0"], unit = "rad"}\nangle_rate = {columns = ["w0"], unit = "rad/s"}\n'
        'torque = {columns = ["u0"], unit = "mN m"}\n[physics]\nlength = 0.5\n'
    )
    subject = load(logged(tmp_path / "driven", pendulum, 1, 0.8, described), f"{mine}:Driven")
    (found,) = discover(subject).found
    assert found.id == "viscous_friction"
    (friction,) = found.estimates
    assert friction.value == pytest.approx(0.6, rel=0.01)
    toml = tmp_path / "driven" / "dataset.toml"
    toml.write_text(toml.read_text() + "[physics.uncertainty]\nmass = 0.3\n")  # the class alone states the mass
    assert load(tmp_path / "driven", f"{mine}:Driven").uncertainty == {"mass": 0.3}
    toml.write_text(toml.read_text().replace("mass = 0.3", "mas = 0.3"))
    with pytest.raises(BenchError, match=r"\[physics.uncertainty\]: unknown key 'mas': did you mean mass"):
        load(tmp_path / "driven", f"{mine}:Driven")
    toml.write_text(HEAD.format(name="x") + described + "lenght = 0.4\n")
    with pytest.raises(BenchError, match="'lenght': did you mean length"):
        load(tmp_path / "driven", f"{mine}:Driven")
    with pytest.raises(BenchError, match="name one with --system"):
        load(tmp_path / "driven")


def test_an_arm_of_two_joints_is_compared_joint_by_joint(mine: Path, tmp_path: Path) -> None:
    described = (
        'angle = {columns = ["q0", "q1"], unit = "rad"}\nangle_rate = {columns = ["w0", "w1"], unit = "rad/s"}\n'
        'torque = {columns = ["u0", "u1"], unit = "mN m"}\n'
    )
    subject = load(logged(tmp_path / "arm", arm, 2, 0.1, described), f"{mine}:Arm")
    assert [c.name for c in subject.logs[0].recording.input_channels] == ["torque.shoulder", "torque.elbow"]
    measured = compare(subject, {}).error("nominal")
    assert measured["angle"].rmse > np.deg2rad(1)
    (damping,) = discover(subject).found  # of both joints, in the order of the motors
    assert damping.id == "joint_damping"
    for estimate in damping.estimates:
        assert estimate.value == pytest.approx(DAMPING, abs=0.01) and estimate.low < DAMPING < estimate.high
    assert len(damping.estimates) == 2
    (tmp_path / "arm" / "dataset.toml").write_text(
        HEAD.format(name="arm") + described.replace('["u0", "u1"]', '["u0"]')
    )
    with pytest.raises(BenchError, match=r"torque has 1 column\(s\), and Arm means 2: shoulder, elbow"):
        load(tmp_path / "arm", f"{mine}:Arm")


def test_a_class_of_ones_own_names_the_columns_of_the_draft(mine: Path, tmp_path: Path) -> None:
    names = ["t", *(f"{s}_{j}" for s in ("angle", "torque", "angle_rate") for j in ("shoulder", "elbow")), "note"]
    table = np.column_stack([np.arange(500) / 100, np.random.default_rng(0).normal(size=(500, 7))])
    np.savetxt(tmp_path / "a.csv", table, "%.9g", ",", header=",".join(names), comments="")
    done = CliRunner().invoke(cli, ["data", "init", str(tmp_path), "--system", f"{mine}:Arm"])
    assert done.exception is None, done.exception
    text = (tmp_path / "dataset.toml").read_text()
    for line in (
        'input = "torque"',
        'torque = {columns = ["torque_shoulder", "torque_elbow"], unit = "N m"}',
        'angle_rate = {columns = ["angle_rate_shoulder", "angle_rate_elbow"], unit = "rad/s"}',
        '# TODO: what is column "note"?',
        "m1 = 1.0  # kg; m_1",
        "m1 = 0.02",
    ):
        assert line in text
    assert load(tmp_path, f"{mine}:Arm").logs[0].name.startswith("a")
