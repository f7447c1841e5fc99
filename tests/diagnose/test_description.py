"""What a system says of itself: the general answer, that of a rigid body, and that of a toy which says it itself."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

import bench.diagnose
from bench.diagnose.locate import _judged
from bench.diagnose.logs.consistency import pairs
from bench.diagnose.logs.smoothing import Smoothing
from bench.diagnose.logs.subject import LogBatch, Subject, log_of
from bench.diagnose.manoeuvre.limits import shown
from bench.diagnose.regression import test_functions
from bench.diagnose.regression.conditions import conditions
from bench.diagnose.regression.generic import dictionary
from bench.diagnose.regression.residuals import residuals
from registry.contracts import Channel
from registry.core import EFFECTS
from registry.datasets.signals import recording
from registry.dynamics import Axis, Description, Pilot, Quantity, SetPoint, Signals, constant, tensor
from registry.effects.learned_term import LearnedTerm
from registry.effects.waves.periodic_term import PeriodicTerm
from registry.errors import BenchError
from registry.physics.helicopter import Helicopter
from registry.physics.quadrotor import Quadrotor
from registry.physics.state_space import StateSpace

DT, N, F64 = 0.002, 2000, torch.float64


@dataclass(frozen=True)
class Winch(StateSpace):
    """dx/dt = v, dv/dt = (u_1 + u_2) / m."""

    mass: Any = constant(2.0, "m", "kg")

    state_channels: ClassVar[tuple[Channel, ...]] = (Channel("displacement.q", "m"), Channel("speed.q", "m/s"))
    input_signals: ClassVar[tuple[str, ...]] = ("force",)
    equation: ClassVar[str] = "m d²x/dt² = u_1 + u_2"

    def own_rate(self, state: Tensor, inputs: Tensor) -> Tensor:
        """dx/dt (…, 2)."""
        pull = inputs[..., :2].sum(-1) / tensor(self.mass, state)
        return torch.stack([state[..., 1], pull], dim=-1)


class Told(Description):
    """A winch in its own words: its energy, the power of its ropes together, air that brakes it."""

    @property
    def located(self) -> tuple[str, ...]:
        return ("speed",)

    def curved(self, signals: Signals) -> tuple[str, ...]:
        return ("displacement",)

    def laws(self, signals: Signals) -> Signals:
        return {"speed": {"v |v| v": signals["speed"]["speed.q"] ** 3}}

    def mixing(self, drives: int) -> np.ndarray | None:
        return np.array([[0.5, 0.5], [0.5, -0.5]])

    def axes(self, state: Tensor, channels: Any) -> list[Axis]:
        full = np.zeros((*state.shape[:-1], 2))
        full[..., 1] = 1 / self.model.mass
        return [Axis("pull", full[..., list(channels)], ("displacement", "constant"))]

    def conditions(self, states: Tensor, inputs: Tensor, dt: float, measured: Any, drives: Any) -> list[Quantity]:
        return [Quantity("energy", "N m", self.model.mass * states[..., 1].square().numpy() / 2)]

    def residuals(self, state: Tensor, inputs: Tensor, rates: Any) -> list[Quantity]:
        return [Quantity("pull", "N", self.model.mass * rates[1])]


class Winder(Pilot):
    """Asks for a height; the ropes jump to what brings it there."""

    set_points = (SetPoint("displacement", "m", rate=1, state=0), SetPoint("trim", "1", rate=1, ends=(-0.2, 0.3)))
    band = (0.1, 3.0)
    path_columns = (("displacement", "m"),)

    def path(self, asked: np.ndarray, dt: float) -> np.ndarray:
        return asked[..., :1]

    def flown(self, asked: np.ndarray, extras: Tensor, dt: float) -> tuple[Tensor, Tensor]:
        raise NotImplementedError


@dataclass(frozen=True)
class ToldWinch(Winch):
    """A winch that says it itself, and that would fall."""

    needs_pilot: ClassVar[bool] = True

    def description(self) -> Told:
        """Its own words."""
        return Told(self)


@dataclass(frozen=True)
class Wound(ToldWinch):
    """And that somebody steers."""

    def pilot(self) -> Winder:
        """The winder."""
        return Winder()


def hoisted(model: Winch, missing: float = 0.0) -> Subject:
    """Two recordings of a winch: x = a sin ωt exactly, by ropes whose force leaves ``missing`` newtons out."""
    t, logs = np.arange(N) * DT, []
    for name, omega in (("one", 3.0), ("two", 4.0)):
        x, v, a = np.sin(omega * t), omega * np.cos(omega * t), -(omega**2) * np.sin(omega * t)
        rope = np.stack([model.mass * a - missing - 1.0, np.ones(N)], axis=1)
        made = recording(
            name, 1 / DT, {"force": rope}, {"displacement": x[:, None], "speed": v[:, None]}, np.ones(N, bool)
        )
        logs.append(log_of(made, model, "force"))
    return Subject("winch", model, tuple(logs), ("one",), ("two",), Smoothing(), {})


def residual_means(model: Winch, missing: float) -> dict[tuple[str, str], np.ndarray]:
    logs = hoisted(model, missing).logs
    return residuals(model, LogBatch.of(logs), test_functions.TestFunctions.over(logs, 10, [Smoothing()] * 2), [0, 1])


def test_a_system_that_says_nothing_is_described_by_its_states_and_inputs() -> None:
    model = Winch()
    logs = hoisted(model).logs
    stack = LogBatch.of(logs)
    met = {c.name: c for c in conditions(model, stack)}
    assert list(met) == [
        "displacement",
        "|displacement|",
        "speed",
        "|speed|",
        "force 1",
        "|force 1|",
        "change of force 1",
    ]
    assert met["|speed|"].unit == "m/s" and met["|speed|"].values == pytest.approx(np.abs(stack.states[..., 1].numpy()))
    words = dictionary(model, stack, (0, 1))
    assert words.names == ("d displacement.q/dt", "d speed.q/dt")
    assert words.axes[:, 0, 0].tolist() == [[1.0, 0.0], [0.0, 1.0]]
    assert {len(m) for m in words.members} == {len(words.values)}  # each may follow everything
    texts = {t.text for t in words.terms}
    assert {
        "sin 1 speed.q",
        "sign displacement.q",
        "u1³",
        "displacement.q speed.q",
        "displacement.q u0",
        "du0/dt",
    } <= texts
    found = residual_means(model, 3.0)
    assert list(found) == [("rate of change of displacement.q", "m/s"), ("rate of change of speed.q", "m/s^2")]
    assert found["rate of change of speed.q", "m/s^2"] == pytest.approx(3.0 / 2.0, rel=1e-3)
    assert [g.name for g in _judged(model, logs)[0]] == ["displacement", "speed"]
    assert [(p.signal, p.rate) for p in pairs(model, (True, True))] == [("displacement", "speed")]
    assert [d.name for d in shown(hoisted(model)).drives] == ["force.1", "force.2"]


def test_a_system_is_described_as_it_says_itself() -> None:
    model = ToldWinch()
    logs = hoisted(model).logs
    stack = LogBatch.of(logs)
    assert [(c.name, c.unit) for c in conditions(model, stack)] == [("energy", "N m")]
    assert residual_means(model, 3.0)["pull", "N"] == pytest.approx(3.0, rel=1e-3)
    assert [g.name for g in _judged(model, logs)[0]] == ["speed"]
    words = dictionary(model, stack, (1,))
    assert words.names == ("pull",) and words.axes == pytest.approx(0.5)
    assert {t.signal for t in words.terms} == {"displacement", "constant"}
    other = dictionary(replace(model, mass=4.0), stack, (1,))
    assert other.axes == pytest.approx(0.25)


def test_the_ropes_act_together_and_the_air_brakes(monkeypatch: pytest.MonkeyPatch) -> None:
    model = ToldWinch()
    logs = hoisted(model).logs
    monkeypatch.setattr(Told, "axes", Description.axes)
    words = dictionary(model, LogBatch.of(logs), (1,))
    at = {t.text: values for t, values in zip(words.terms, words.values, strict=True)}
    assert "v |v| v" in at and "sin 1 displacement.q" in at and not {"sin 1 speed.q", "sin 1 u0"} & set(at)
    ropes = torch.stack([log.inputs for log in logs]).numpy()
    middle = (ropes[:, 1:] + ropes[:, :-1]) / 2
    for text, both in (("u0", middle.sum(-1)), ("u1", middle[..., 0] - middle[..., 1])):
        scale = np.sign(ropes.mean()) / both.std()
        assert at[text] == pytest.approx(both * scale)


def test_a_vehicle_without_a_pilot_is_refused_and_one_with_a_pilot_is_asked_for_set_points() -> None:
    with pytest.raises(BenchError, match="No pilot is known for ToldWinch"):
        shown(hoisted(ToldWinch()))
    limits = shown(hoisted(Wound()))
    height, trim = limits.drives
    assert limits.band == (0.1, 3.0)
    assert (height.low, height.high) == pytest.approx((-1.1, 1.1), abs=0.01)  # 5 % of 2 m beyond what was recorded
    assert 3.5 < height.rate <= 4.0
    assert (trim.low, trim.high, trim.start) == (-0.2, 0.3, 0.0) and trim.rate == height.rate


# ----------------------------------------------------------------------------------------------- a rigid body


def poses(rows: int) -> Tensor:
    """States (rows, 13) of a rigid body in any attitude."""
    rng = np.random.default_rng(3)
    quaternion = Rotation.random(rows, random_state=4).as_quat()
    return torch.from_numpy(np.hstack([rng.normal(size=(rows, 6)), quaternion, rng.normal(size=(rows, 3))]))


def test_an_axis_of_a_rigid_body_moves_it_as_a_force_along_it_does() -> None:
    simple, state = Quadrotor(mass=1.7, inertia=(0.02, 0.03, 0.05)), poses(6)
    inputs = torch.full((6, 4), 500.0, dtype=F64)
    plain = simple.derivative(state, inputs)
    per = {"force": 1.7, "torque": torch.tensor(simple.inertia, dtype=F64)}
    for axis in simple.description().axes(state, range(13)):
        term = LearnedTerm(axis.name.replace(" ", "_"), (), "constant", (1.0,))
        moved = replace(simple, effects=(term,)).derivative(state, inputs) - plain
        kind = "torque" if axis.name.startswith("torque") else "force"
        at = slice(10, 13) if kind == "torque" else slice(3, 6)
        assert (moved[:, at] * per[kind]).numpy() == pytest.approx(axis.rates[:, at], abs=1e-9), axis.name
        assert axis.follows == (("position", "time", "constant") if axis.name.startswith("world") else ())


def test_an_accelerometer_feels_an_axis_along_the_bodys_own() -> None:
    simple, state = Quadrotor(), poses(5)
    turned = Rotation.from_quat(state[:, 6:10].numpy())
    axes = {a.name: a.rates for a in simple.description().axes(state, (3, 4, 5, 13, 14, 15))}
    assert len(axes) == 9
    for rates in (axes["force y"], axes["world force y"]):
        assert turned.inv().apply(rates[:, :3]) == pytest.approx(rates[:, 3:], abs=1e-12)
    assert axes["force y"][:, 3:] == pytest.approx(np.tile([0.0, 1.0, 0.0], (5, 1)))


def test_what_a_rigid_body_leaves_out_is_a_force_and_a_torque_in_its_own_axes() -> None:
    model, state = Quadrotor(mass=1.7, inertia=(0.02, 0.03, 0.05)), poses(7)
    rates = np.random.default_rng(5).normal(size=(7, 13))
    found = model.description().residuals(state, torch.full((7, 4), 500.0, dtype=F64), dict(enumerate(rates.T)))
    said = {q.name: (q.unit, q.values) for q in found}
    force = 1.7 * Rotation.from_quat(state[:, 6:10].numpy()).inv().apply(rates[:, 3:6])
    for i, a in enumerate("xyz"):
        assert said[f"force {a}"][0] == "N" and said[f"force {a}"][1] == pytest.approx(force[:, i])
        assert said[f"torque {a}"][0] == "N m"
        assert said[f"torque {a}"][1] == pytest.approx(model.inertia[i] * rates[:, 10 + i])
    few = model.description().residuals(state, torch.zeros(7, 4, dtype=F64), {c: rates[:, c] for c in range(10)})
    assert [q.name for q in few] == ["force x", "force y", "force z"]


def test_the_signals_of_a_rigid_body_are_about_its_own_axes() -> None:
    state = poses(4)
    signals = Helicopter().description().signals(state)
    turned = Rotation.from_quat(state[:, 6:10].numpy())
    v = turned.inv().apply(state[:, 3:6].numpy())
    for i, a in enumerate("xyz"):
        assert signals["velocity"][f"v_{a}"] == pytest.approx(v[:, i])
    laws = Helicopter().description().laws(signals)
    assert laws["velocity"]["|v| v_y"] == pytest.approx(np.linalg.norm(state[:, 3:6], axis=1) * v[:, 1])
    assert signals["attitude"]["R_zx"] == pytest.approx(turned.as_matrix()[:, 2, 0])


def test_the_own_states_of_a_rigid_bodys_effects_move_as_the_whole_does() -> None:
    load = EFFECTS.get("suspended_load").typical()
    model, state = Quadrotor(effects=(PeriodicTerm("world_force_z", 2.0), load)), poses(6)
    inputs, slopes = torch.full((6, 4), 500.0, dtype=F64), torch.zeros(6, 4, dtype=F64)
    own = 0.1 * torch.randn(6, model.internal_size, generator=torch.Generator().manual_seed(1), dtype=F64)
    whole = model.derivative(torch.cat([state, own], dim=-1), inputs, slopes)[:, 13:]
    assert model.internal_rates(state, inputs, slopes)(own).numpy() == pytest.approx(whole.numpy())
    assert Winch().internal_rates(torch.zeros(2), torch.zeros(2), torch.zeros(2)) is None


def test_the_diagnosis_knows_no_vehicle() -> None:
    room = Path(bench.diagnose.__file__).parent
    texts = {p.relative_to(room).as_posix(): p.read_text(encoding="utf-8") for p in room.rglob("*.py")}
    assert len(texts) > 80
    assert [p for p, text in texts.items() if "RigidBody" in text or "Quadrotor" in text] == []
    assert [p for p, text in texts.items() if "registry.physics" in text] == []
