"""What is hidden in a machine is found whatever its size, the unit of its drive and the units it is counted in."""

import sys
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
import torch
from torch import Tensor

from bench.diagnose import diagnose, discover
from bench.diagnose.logs.noise import Noise, noise_of
from bench.diagnose.logs.subject import Subject
from bench.diagnose.report import model_file
from bench.diagnose.select.catalogue import admissible, drive_is_noisy
from bench.diagnose.select.timing.regression import read_at
from registry.contracts import Channel
from registry.core import EFFECTS, PHYSICS
from registry.dynamics import constant, tensor
from registry.physics.state_space import Mechanical
from registry.units import Signal
from tests.diagnose.machines_of_any_size import (
    LOOP,
    RATE,
    Array,
    backlash,
    cart,
    dead_zone,
    lag,
    recorded,
    saturation,
    square,
)


@pytest.mark.parametrize(
    ("id", "drive", "value", "length", "force"),
    [
        ("dead_zone", dead_zone, 4.0, 1.0, 1.0),
        ("backlash", backlash, 3.0, 1e-3, 1e-3),
        ("saturation", saturation, 12.5, 1.0, 1e3),
    ],
)
def test_what_is_wrong_with_a_drive_is_found_in_a_machine_of_any_size(
    id: str, drive: Any, value: float, length: float, force: float
) -> None:
    (found,) = discover(cart(drive, length=length, force=force)).found
    (number,) = found.estimates
    told = 1 / number.value if id == "saturation" else number.value
    assert (found.id, found.rivals) == (id, ()) and told == pytest.approx(value * force, rel=0.01)
    assert number.entry.unit == ("1/N" if id == "saturation" else "N")


@pytest.mark.parametrize("force", [1.0, 1e-3])
def test_a_drive_whose_force_grows_with_its_square_is_found(force: float) -> None:
    """A propeller: nothing of the straight line is left."""
    (found,) = discover(cart(square, force=force)).found
    number = found.estimates[0]
    assert (found.id, found.rivals) == ("curved_drive", ()) and number.value == pytest.approx(1, abs=0.03)


@pytest.mark.parametrize("length", [1.0, 1e-3])
def test_an_actuator_that_lags_is_found_and_is_no_delay_or_joint(length: float) -> None:
    told, _ = diagnose(cart(lag, length=length), brief=True)
    (effect,) = told.effects
    tau = effect.parameters["tau"]
    assert (effect.id, effect.indistinguishable_from) == ("actuator_lag", ())
    assert tau.low < 0.04 < tau.high and tau.high - tau.low < 0.004


def test_nothing_is_wrong_with_a_drive_that_acts_as_it_was_logged() -> None:
    assert discover(cart(lambda u: u)).found == ()


def test_a_hysteresis_on_any_scale_is_found() -> None:
    """It gives way at some centimetres here, that of the benchmark's machine at a millimetre."""
    rivals = ["bouc_wen", "cubic_stiffness", "coulomb_friction", "viscous_friction"]
    (found,) = discover(cart(lambda u: u, loop=True), rivals).found
    assert (found.id, found.rivals) == ("bouc_wen", ())
    assert {x.entry.label: x.value for x in found.estimates}["beta"] == pytest.approx(LOOP["beta"], rel=0.1)


def test_a_machine_counted_in_other_units_has_the_same_answer_in_these() -> None:
    """Every number that the search takes its way by goes along, not the name alone."""
    names = ["dead_zone", "backlash", "coulomb_friction", "stribeck_friction", "cubic_stiffness"]
    here, there = (discover(cart(dead_zone, length=m, force=n), names) for m, n in ((1.0, 1.0), (1e-3, 1e-4)))
    assert [f.id for f in here.found] == [f.id for f in there.found] == ["dead_zone"]
    ((one,), (other,)) = (d.found[0].estimates for d in (here, there))
    scaled = [1e4 * x for x in (other.value, other.low, other.high)]
    assert scaled == pytest.approx([one.value, one.low, one.high], rel=1e-3)
    assert {c.id for r in here.rounds for c in r} == {c.id for r in there.rounds for c in r}


@dataclass(frozen=True)
class Arm(Mechanical):
    """A pendulum that a motor turns: coordinates in rad, and paths of effects in metres along the arc."""

    mass: Any = constant(0.8, "m", "kg", low=1e-6)
    length: Any = constant(0.4, "l", "m", low=1e-6)
    damping: Any = constant(0.3, "d", "N s/m", low=0)

    state_channels: ClassVar[tuple[Channel, ...]] = (
        Channel("angle.theta", "rad"),
        Channel("angle_rate.theta", "rad/s"),
    )
    input_signals: ClassVar[tuple[str, ...]] = ("torque",)
    signals: ClassVar[dict[str, Signal]] = {"torque": Signal("N m")}
    equation: ClassVar[str] = "m l² θ'' = u − m g l sin θ − d l² θ'"

    def lever(self, like: Tensor) -> Tensor:
        return tensor(self.length, like)

    def own_force(self, state: Tensor, inputs: Tensor) -> Tensor:
        m, rod, d = (tensor(p, state).unsqueeze(-1) for p in (self.mass, self.length, self.damping))
        return inputs / rod - m * 9.81 * torch.sin(state[..., :1]) - d * rod * state[..., 1:]


def swing(seed: int) -> tuple[Array, Array]:
    """Torque (N,) [N m], and states (N, 2) of such an arm whose motor gives 1.2 N m at most, by Heun's method."""
    rng, fine = np.random.default_rng(seed), 20
    t = np.arange(900) / RATE
    u = np.sin(2 * np.pi * np.geomspace(0.2, 2.0, 8) * t[:, None] + rng.uniform(0, 2 * np.pi, 8)).sum(1)
    u *= 3.0 / np.abs(u).max()
    acting = np.clip(np.interp(np.arange((len(t) - 1) * fine + 1) / fine, np.arange(len(t)), u), -1.2, 1.2)
    x, h, path = rng.normal(size=2) * 0.3, 1 / RATE / fine, []

    def rate(x: Array, torque: float) -> Array:
        return np.array([x[1], (torque / 0.4 - 0.8 * 9.81 * np.sin(x[0]) - 0.3 * 0.4 * x[1]) / 0.8 / 0.4])

    for before, after in pairwise(acting):
        path.append(x)
        slope = rate(x, before)
        x = x + h / 2 * (slope + rate(x + h * slope, after))
    seen = np.array([*path, x])[::fine]
    return u, seen + rng.normal(size=seen.shape) * 2e-3 * seen.std(0)


def test_a_system_of_ones_own_has_the_effects_of_the_drive_in_the_unit_of_its_drive(tmp_path: Path) -> None:
    arm = recorded(Arm(), [swing(seed) for seed in range(4)], Channel("torque", "N m"))
    (found,) = discover(arm, ["saturation", "dead_zone", "backlash", "coulomb_friction", "cubic_stiffness"]).found
    assert (found.id, found.estimates[0].entry.unit) == ("saturation", "1/(N m)")
    assert 1 / found.estimates[0].value == pytest.approx(1.2, rel=0.01)
    model_file.write(tmp_path / "model.toml", replace(Arm(), effects=(found.effect,)))
    assert "1/(N m): 1/U" in (tmp_path / "model.toml").read_text()


def test_what_flies_or_has_no_drive_has_none_of_them() -> None:
    for name in PHYSICS.names():
        kind = PHYSICS.get(name)
        driven = name in ("mass_on_rail", "oscillator", "tanks")
        for effect in ("dead_zone", "saturation", "backlash"):
            assert EFFECTS.get(effect).suits(kind) is driven, (effect, name)


def test_a_drive_that_a_noisy_sensor_measured_is_what_acts() -> None:
    """Of a command, held over a step, noise is no sensor's; and steps are no noise."""
    clean = cart(lambda u: u)
    assert not drive_is_noisy(clean)
    rng = np.random.default_rng(0)
    noise = [torch.from_numpy(5.0 * rng.normal(size=log.inputs.shape)) for log in clean.logs]
    noisy = [replace(log, inputs=log.inputs + x) for log, x in zip(clean.logs, noise, strict=True)]
    measured = replace(clean, logs=tuple(noisy))
    assert drive_is_noisy(measured)
    assert not drive_is_noisy(replace(measured, model=replace(clean.model, input_hold="previous")))
    steps = [replace(log, inputs=(log.inputs / 8.0).round()) for log in clean.logs]
    assert not drive_is_noisy(replace(clean, logs=tuple(steps)))
    assert not {"dead_zone", "saturation", "backlash"} & {n for n, _ in admissible(measured, clean.model, None)}


def test_a_shift_that_only_play_made_is_taken_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """The shift is told before play is looked for, which looks late; of the two readings the better one is kept."""
    given = cart(backlash)

    def late(subject: Subject, *_: Any) -> tuple[Subject, Noise]:
        logs = tuple(replace(log, inputs=read_at(log.inputs, 1, -0.5)) for log in subject.logs)
        return replace(subject, logs=logs, timed=True, notes=("read late",)), noise_of(subject)

    names = ["backlash", "coulomb_friction"]
    monkeypatch.setattr(sys.modules["bench.diagnose.discover"], "prepared", late)
    said, _ = diagnose(given, catalogue=names, brief=True)
    (found,) = said.effects
    assert found.id == "backlash" and found.parameters["width"].value == pytest.approx(3.0, rel=0.005)
    assert "read late" not in said.evidence.notes
