"""Faults of a machine's data: nothing moves, a drive is filed inverted or stands still, a class gives NaN."""

import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
import torch
from click.testing import CliRunner
from torch import Tensor

from bench.cli import cli
from bench.diagnose import diagnose
from bench.diagnose.checks.machines import machine_problems
from bench.diagnose.checks.problems import problems
from bench.diagnose.logs.load import load
from bench.diagnose.logs.smoothing import Slope
from bench.diagnose.logs.subject import Subject, log_of
from registry.contracts import Channel, Recording
from registry.dynamics import constant, tensor
from registry.errors import BenchError
from registry.physics.state_space import Mechanical
from registry.units import Signal
from tests.diagnose.machines_of_any_size import cart, delay, recording

TOML = """
name = "cart"
system = "oscillator"
rate_hz = 100
files = "*.csv"
time = "t"
input = "force"
[signals]
displacement = {columns = ["x"], unit = "m"}
speed = {columns = ["v"], unit = "m/s"}
force = {columns = ["f"], unit = "N"}
[physics]
mass = 2.1
damping = 5.0
stiffness = 310.0
"""


def folder(where: Path, sign: float = 1.0, still: bool = False) -> Path:
    """Three recordings of a cart on a spring, the force with a sign, or 0."""
    (where / "dataset.toml").write_text(TOML)
    for i in range(3):
        u, x = recording(i, lambda u: 0 * u if still else u, False, 2e-3)
        table = np.column_stack([np.arange(len(u)) / 100, x, 0 * u if still else sign * u])
        np.savetxt(where / f"run_{i}.csv", table, delimiter=",", header="t,x,v,f", comments="")
    return where


def test_an_inverted_drive_is_found_with_the_line_that_mends_it(tmp_path: Path) -> None:
    """A dead zone as wide as the force was named, which switches the drive off."""
    found = problems(load(folder(tmp_path, sign=-1.0))).problems
    assert {(p.recording, p.signal, p.kind) for p in found} == {(f"run_{i}", "force", "swapped sign") for i in range(3)}
    (line,) = {m[1] for p in found if (m := re.search(r"dataset.toml should have: (force = .*)", p.detail))}
    mended = re.sub(r"^force = .*$", line, TOML, count=1, flags=re.MULTILINE)
    (tmp_path / "dataset.toml").write_text(mended)
    assert not problems(load(tmp_path)).problems


@dataclass(frozen=True)
class Pendulum(Mechanical):
    """A pendulum with a motor in its joint."""

    mass: Any = constant(0.012, "J", "kg m^2", low=1e-6)
    friction: Any = constant(0.02, "B", "N m s/rad", low=0)
    weight: Any = constant(0.7, "m g l", "N m", low=0)
    state_channels: ClassVar[tuple[Channel, ...]] = (Channel("angle.q", "rad"), Channel("angle_rate.q", "rad/s"))
    input_signals: ClassVar[tuple[str, ...]] = ("torque",)
    signals: ClassVar[dict[str, Signal]] = {"torque": Signal("N m", ("",))}
    equation: ClassVar[str] = "J dω/dt = u − B ω − m g l sin q"

    def own_force(self, state: Tensor, inputs: Tensor) -> Tensor:
        """Torque less that of the joint and of the weight (…, 1) [N m]."""
        bent = tensor(self.weight, state).unsqueeze(-1) * torch.sin(state[..., :1])
        return inputs[..., :1] - tensor(self.friction, state).unsqueeze(-1) * state[..., 1:] - bent


def swung_up(sign: float) -> Subject:
    """Two recordings of a pendulum that is swung up, the torque filed with a sign, and one with another torque."""
    logs = []
    for seed in range(3):
        rng, dt, fine = np.random.default_rng(seed), 0.005, 10
        x, out, drive = np.array([0.1, 0.0]), [], []
        for k in range(2000):
            if k % 20 == 0:
                u = 0.12 * np.sign(x[1] * np.cos(x[0])) * rng.uniform(0.2, 1.0) + 0.03 * rng.normal()
            out.append(x.copy())
            drive.append(u)
            for _ in range(fine):
                x[1] += dt / fine * (u - 0.004 * x[1] - 0.49 * np.sin(x[0])) / 0.01
                x[0] += dt / fine * x[1]
        torque = np.array(drive)[:, None] if seed < 2 else rng.normal(size=(2000, 1))
        states = np.array(out) + rng.normal(size=(2000, 2)) * [1e-3, 1e-2]
        whole, valid = Pendulum(input_hold="previous"), np.ones(2000, dtype=bool)
        made = Recording(
            f"run_{seed}", 1 / dt, sign * torque, states, (Channel("torque", "N m"),), whole.state_channels, valid
        )
        logs.append(log_of(made, whole, "torque"))
    names = tuple(log.name for log in logs)
    return Subject("swing", whole, tuple(logs), names[:2], names[2:], None, {}, {}, ("angle", "angle_rate", "torque"))


def test_a_drive_is_found_inverted_beside_a_weight_that_is_stated_far_off() -> None:
    """No straight line is what a swing of a whole turn feels; and one recording may tell nothing."""
    assert {(p.recording, p.kind) for p in machine_problems(swung_up(-1.0))} == {
        ("run_0", "swapped sign"),
        ("run_1", "swapped sign"),
    }
    assert machine_problems(swung_up(1.0)) == []


@pytest.mark.parametrize("drive", [lambda u: u, delay, lambda u: np.clip(u, -5, 5), lambda u: np.sign(u) * u * u / 25])
def test_what_a_model_lacks_inverts_no_drive(drive: object) -> None:
    assert machine_problems(cart(drive)) == []  # type: ignore[arg-type]


def test_all_signals_that_stand_still_while_the_drive_moves_are_frozen_and_a_machine_at_rest_is_not() -> None:
    """From first to last, or at a speed that is not 0. Friction holds a machine at speed 0 for a while."""

    def stopped(first: int, end: int, speed: float, given: Subject | None = None) -> Subject:
        given = cart(lambda u: u) if given is None else given
        log = given.logs[0]
        states = log.states.clone()
        states[first:end] = states[first]
        states[first:end, 1] = speed
        return replace(given, logs=(replace(log, states=states), *given.logs[1:]))

    (whole,) = machine_problems(stopped(0, 900, 0.0))
    assert (whole.recording, whole.kind, whole.rows) == ("run_0", "frozen", (1, 899))
    (stretch,) = machine_problems(stopped(300, 600, 0.1))
    assert (stretch.kind, stretch.rows) == ("frozen", (301, 599))
    assert machine_problems(stopped(300, 600, 0.0)) == []
    # A sensor without a zero reads half a count whenever the machine stands; a speed is lost twice at two speeds.
    assert machine_problems(stopped(300, 450, 0.01, stopped(500, 650, 0.01))) == []
    assert len(machine_problems(stopped(300, 450, 0.1, stopped(500, 650, -0.2)))) == 2
    # The slope of a position that repeats its value is 0 but for rounding, and all of it stands still no less.
    slope = {1: Slope(0, np.ones(3))}
    assert machine_problems(replace(stopped(300, 600, 1e-16), slopes=slope)) == []
    assert [p.rows for p in machine_problems(replace(stopped(0, 900, 1e-16), slopes=slope))] == [(1, 899)]


def test_a_drive_that_never_moves_is_told_and_nothing_is_named_that_forecasts_worse(tmp_path: Path) -> None:
    folder(tmp_path, still=True)
    said = CliRunner().invoke(cli, ["data", "check", str(tmp_path)])
    assert said.exit_code == 0 and "note: force is 0 N in every sample: what it does" in said.output
    told, _ = diagnose(tmp_path, brief=True, catalogue=["cubic_stiffness", "coulomb_friction"])
    assert any("force is 0 N in every sample" in note for note in told.evidence.notes)
    assert all(e.share_explained > 0 for e in told.effects)


ROOT = """
from dataclasses import dataclass
from typing import Any
import torch
from registry.contracts import Channel
from registry.dynamics import constant, tensor
from registry.physics.state_space import StateSpace

@dataclass(frozen=True)
class Root(StateSpace):
    \"\"\"A root of what may be negative.\"\"\"
    gain: Any = constant(1.0, "g", "1", low=0)
    state_channels = (Channel("displacement.q", "m"), Channel("speed.q", "m/s"))
    input_signals = ("force",)
    equation = "dv/dt = g u − 100 sqrt(q + OFF)"

    def own_rate(self, state, inputs):
        pull = 100 * torch.sqrt(state[..., :1] + OFF)
        return torch.cat([state[..., 1:], tensor(self.gain, state).unsqueeze(-1) * inputs - pull], -1)
"""


@pytest.mark.parametrize("command", [["data", "check"], ["diagnose"]])
def test_a_class_that_gives_no_finite_rate_ends_in_one_sentence(command: list[str], tmp_path: Path) -> None:
    """It was a traceback from the regression."""
    folder(tmp_path)
    (tmp_path / "dataset.toml").write_text(TOML.replace('system = "oscillator"\n', "").split("[physics]")[0])
    (tmp_path / "mine.py").write_text(ROOT.replace("OFF", "0.01"))
    said = CliRunner().invoke(cli, [*command, str(tmp_path), "--system", f"{tmp_path}/mine.py:Root"])
    wanted = r"Root gives no finite rate at \d+ of 2700 samples \(\d+ %\), first in run_0 after [\d.]+ s"
    assert isinstance(said.exception, BenchError) and re.search(wanted, str(said.exception))


def test_few_samples_without_a_rate_are_left_out(tmp_path: Path) -> None:
    folder(tmp_path)
    (tmp_path / "dataset.toml").write_text(TOML.replace('system = "oscillator"\n', "").split("[physics]")[0])
    lowest = np.sort(np.concatenate([np.loadtxt(f, delimiter=",", skiprows=1)[:, 1] for f in tmp_path.glob("*.csv")]))
    (tmp_path / "mine.py").write_text(ROOT.replace("OFF", repr(-float(lowest[9] + lowest[10]) / 2)))
    subject = load(tmp_path, f"{tmp_path}/mine.py:Root")
    assert sum(int((~log.valid).sum()) for log in subject.logs) == 10
    assert any("no finite rate at 10 of 2700 samples" in w for w in subject.warned) and set(subject.warned) <= set(
        subject.notes
    )


def test_every_command_tells_the_same_of_the_data(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """An absorber that the model lacks looks like a clock that is late: `compare` said so, `data check` did not."""
    from bench.diagnose.checks import problems as module
    from bench.diagnose.result import DataProblem

    late = DataProblem("run_1", "force", "time shift", None, "the motion comes late.")
    monkeypatch.setattr(module, "shifts", lambda *_: ([late], []))
    folder(tmp_path)
    for command in (["data", "check"], ["compare"]):
        said = CliRunner().invoke(cli, [*command, str(tmp_path)])
        assert said.exit_code == 0 and "the motion comes late" not in said.output, command
