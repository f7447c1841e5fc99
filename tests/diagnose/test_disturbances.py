"""What acts beside the drive and was measured: a room that is heated, and loses heat to outside air of known warmth."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
import torch
from torch import Tensor

from bench.diagnose import diagnose
from bench.diagnose.logs.load import load
from bench.diagnose.logs.noise import noise_of
from bench.diagnose.logs.own_system import own_class
from bench.diagnose.logs.subject import LogBatch
from bench.diagnose.regression.driving import mean_driving
from bench.diagnose.select.timing.disturbances import disturbances_read
from bench.diagnose.select.timing.reading import retimed
from bench.diagnose.simulate.roll import roll
from registry.contracts import Channel
from registry.datasets.folder.dataset import draft
from registry.dynamics import constant, tensor
from registry.effects.learned_term import LearnedTerm
from registry.effects.mechanics.joints import JointFriction
from registry.errors import BenchError
from registry.physics.state_space import StateSpace
from registry.units import Signal

SOURCE = '''
from dataclasses import dataclass
from typing import Any, ClassVar

from torch import Tensor

from registry.contracts import Channel
from registry.dynamics import constant, tensor
from registry.physics.state_space import StateSpace
from registry.units import Signal


@dataclass(frozen=True)
class Room(StateSpace):
    """A heated room."""

    capacity: Any = constant(6e5, "C", "J/K", low=1, uncertainty=0.1)
    loss: Any = constant(100.0, "H", "W/K", low=0, uncertainty=0.2)

    state_channels: ClassVar[tuple[Channel, ...]] = (Channel("temperature.room", "degC"),)
    input_signals: ClassVar[tuple[str, ...]] = ("power",)
    disturbances: ClassVar[tuple[str, ...]] = ("outside",)
    signals: ClassVar[dict[str, Signal]] = {
        "temperature": Signal("degC", ("room",)),
        "power": Signal("W", ("",)),
        "outside": Signal("degC", ("",)),
    }
    alike: ClassVar[tuple[str, ...]] = ()
    equation: ClassVar[str] = "C dT/dt = P − H (T − T_out)"

    def own_rate(self, state: Tensor, inputs: Tensor) -> Tensor:
        """The state's rate (…, 1)."""
        c, h = (tensor(v, state).unsqueeze(-1) for v in (self.capacity, self.loss))
        return (inputs[..., 0].unsqueeze(-1) - h * (state - inputs[..., 1].unsqueeze(-1))) / c
'''
CAPACITY, LOSS, STEP, OPEN, LOST = 5.8e5, 112.0, 300.0, 22.0, 45.0
"""Of the room [J/K], [W/K]; between samples [s]; warmer than [degC] somebody opens a window, which costs [W/K]."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four weeks of it, by Euler's method with a hundred steps a sample; drives are straight lines between samples."""
    home, fine, count = tmp_path_factory.mktemp("room"), 100, 1500
    for week in range(4):
        rng = np.random.default_rng(week)
        t = np.arange(count) * STEP
        power = np.interp(t, t[::8], rng.uniform(0, 3500, len(t[::8])))
        outside = 5 + 8 * np.sin(2 * np.pi * t / 86400 + week) + np.cumsum(rng.normal(size=count)) * 0.1
        at = np.arange((count - 1) * fine + 1) / fine * STEP
        heats, cools = np.interp(at, t, power), np.interp(at, t, outside)
        warm = np.empty(len(at))
        warm[0] = 18.0
        for k in range(len(at) - 1):
            lost = LOSS * (warm[k] - cools[k]) + LOST * max(warm[k] - OPEN, 0.0)
            warm[k + 1] = warm[k] + STEP / fine * (heats[k] - lost) / CAPACITY
        seen = warm[::fine] + 0.01 * rng.normal(size=count)
        rows = np.column_stack([t, seen, power, outside])
        np.savetxt(
            home / f"week{week}.csv", rows, "%.6f", ",", header="time,temperature_room,power,outside", comments=""
        )
    (home / "rooms.py").write_text(SOURCE)
    (home / "dataset.toml").write_text(draft(home, own=own_class(f"{home / 'rooms.py'}:Room")))
    return home


def test_a_window_is_found_in_a_room_whose_loss_follows_the_warmth_outside(folder: Path) -> None:
    assert 'outside = {columns = ["outside"], unit = "degC"}' in (folder / "dataset.toml").read_text()
    told, model = diagnose(load(folder, system=f"{folder / 'rooms.py'}:Room"), brief=True)
    assert told.verdict == "unknown_effect"
    (term,) = model.effects
    assert isinstance(term, LearnedTerm) and (term.axis, term.signals, term.shape) == (
        "temperature.room", ("temperature.room",), "above",
    )  # fmt: skip
    slope, width = term.values
    assert slope == pytest.approx(-LOST / CAPACITY, rel=0.1)
    assert width == pytest.approx(OPEN, abs=0.3)
    room: Any = model
    assert (room.capacity, room.loss) == (pytest.approx(CAPACITY, rel=0.01), pytest.approx(LOSS, rel=0.01))
    error, floor = (e["temperature"].rmse for e in (told.error.extended, told.noise_floor))
    assert error < 1.5 * floor


def warmth(power: np.ndarray, outside: np.ndarray, dt: float, held: bool) -> list[float]:
    """The exact solution under a power that holds; the warmth outside holds too or moves along straight lines."""
    out, rate = [18.0], LOSS / CAPACITY
    for p, now, then in zip(power, outside, outside[1:], strict=False):
        slope = 0.0 if held else (then - now) / dt
        begin = p / LOSS + now - slope / rate
        out.append(begin + slope * dt + (out[-1] - begin) * np.exp(-rate * dt))
    return out


@pytest.mark.parametrize("held", [False, True])
def test_recordings_tell_whether_a_disturbance_holds(folder: Path, tmp_path: Path, held: bool) -> None:
    """A load that is switched was read as a line, and a converter in which nothing is hidden erred fourfold."""
    for i in range(3):
        rng, count = np.random.default_rng(i), 400
        power, outside = rng.uniform(0, 3500, count), np.repeat(rng.uniform(-15, 25, count // 4), 4)
        seen = np.array(warmth(power, outside, 600.0, held)) + 0.02 * rng.normal(size=count)
        rows = np.column_stack([600.0 * np.arange(count), seen, power, outside])
        names = "time,temperature_room,power,outside"
        np.savetxt(tmp_path / f"week{i}.csv", rows, "%.6f", ",", header=names, comments="")
    text = draft(tmp_path, own=own_class(f"{folder / 'rooms.py'}:Room")).replace('"linear"', '"previous"')
    (tmp_path / "dataset.toml").write_text(text)
    subject = load(tmp_path, system=f"{folder / 'rooms.py'}:Room")
    assert subject.model.input_hold == "previous"
    noise = noise_of(subject)
    read = disturbances_read(subject, noise)
    assert retimed(subject, subject.model, noise).model.held_extras == read.model.held_extras
    assert read.model.held_extras == (("outside",) if held else ())
    assert any("outside is best read as what holds" in note for note in read.notes) is held


def test_a_disturbance_changes_between_samples_in_which_a_command_holds(folder: Path) -> None:
    rng, dt, count = np.random.default_rng(3), 300.0, 40
    power, outside = rng.uniform(0, 3500, count), rng.uniform(-5, 15, count)
    exact = warmth(power, outside, dt, held=False)
    kind = own_class(f"{folder / 'rooms.py'}:Room")
    room: Any = kind(capacity=CAPACITY, loss=LOSS, input_hold="previous", extras=("outside",))
    inputs, start = torch.from_numpy(np.column_stack([power, outside])), torch.tensor([18.0], dtype=torch.float64)
    assert room.simulate(start, inputs, dt)[:, 0].numpy() == pytest.approx(exact, abs=1e-4)
    assert roll(room, start[None], inputs[None], dt)[0, :, 0].numpy() == pytest.approx(exact, abs=1e-4)
    states = torch.tensor(exact, dtype=torch.float64)[None, :, None]
    mean, _ = mean_driving(room, LogBatch((), states, inputs[None], dt))
    assert mean[0].numpy() == pytest.approx(np.column_stack([power[:-1], (outside[:-1] + outside[1:]) / 2]))


def test_a_disturbance_that_was_not_measured_is_asked_for(folder: Path, tmp_path: Path) -> None:
    for file in folder.glob("*.csv"):
        (tmp_path / file.name).write_text(file.read_text())
    lines = (folder / "dataset.toml").read_text().splitlines()
    (tmp_path / "dataset.toml").write_text("\n".join(line for line in lines if not line.startswith("outside")))
    with pytest.raises(BenchError, match="has no outside, which acts on Room beside what drives it"):
        load(tmp_path, system=f"{folder / 'rooms.py'}:Room")
    misspelt = [line.replace("temperature =", "temperatur =") for line in lines]
    (tmp_path / "dataset.toml").write_text("\n".join(misspelt))
    with pytest.raises(BenchError, match="has a signal 'temperatur', which Room has not: temperature is meant"):
        load(tmp_path, system=f"{folder / 'rooms.py'}:Room")
    (tmp_path / "rooms.py").write_text(SOURCE.replace('        "outside": Signal("degC", ("",)),\n', ""))
    with pytest.raises(BenchError, match=r"disturbances has 'outside', which must stand in Room\.signals"):
        own_class(f"{tmp_path / 'rooms.py'}:Room")


@dataclass(frozen=True)
class Arm(StateSpace):
    """Two coupled joints, and a wind that was measured."""

    inertia: Any = constant(0.4, "J", "kg m^2", low=1e-6)

    state_channels: ClassVar[tuple[Channel, ...]] = tuple(
        Channel(f"{group}.{axis}", unit) for group, unit in (("angle", "rad"), ("angle_rate", "rad/s")) for axis in "ab"
    )
    input_signals: ClassVar[tuple[str, ...]] = ("torque",)
    disturbances: ClassVar[tuple[str, ...]] = ("wind",)
    signals: ClassVar[dict[str, Signal]] = {"torque": Signal("N m", ("a", "b")), "wind": Signal("m/s", ("",))}
    alike: ClassVar[tuple[str, ...]] = ()
    equation: ClassVar[str] = "J d²q/dt² = M u + w"

    def own_rate(self, state: Tensor, inputs: Tensor) -> Tensor:
        """The state's rate (…, 4)."""
        both = torch.stack([inputs[..., 0] + 0.3 * inputs[..., 1], inputs[..., 1] - 0.2 * inputs[..., 0]], -1)
        return torch.cat([state[..., 2:], (both + inputs[..., 2:]) / tensor(self.inertia, state).unsqueeze(-1)], -1)


def test_friction_of_joints_acts_where_their_motors_do_beside_a_disturbance() -> None:
    bare = Arm(extras=("time",))
    assert bare.extras == ("wind", "time")
    rubbing = replace(bare, effects=(JointFriction(0.5, 0.2),))
    state = torch.tensor([0.1, 0.2, 1.5, -2.0], dtype=torch.float64)
    inputs = torch.tensor([1.0, 0.7, 0.25, 9.0], dtype=torch.float64)
    lost = torch.tensor([0.5, -0.2, 0.0, 0.0], dtype=torch.float64)
    torch.testing.assert_close(rubbing.derivative(state, inputs), bare.derivative(state, inputs - lost))
    still = bare.derivative(state, torch.tensor([1.0, 0.7, 0.0, 9.0], dtype=torch.float64))
    torch.testing.assert_close(
        (bare.derivative(state, inputs) - still)[2:], torch.full((2,), 0.625, dtype=torch.float64)
    )
