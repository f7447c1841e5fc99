"""model.toml: what is written is read back, and what does not fit is refused with file and key."""

import dataclasses
import math
import tomllib
from pathlib import Path
from typing import Any

import pytest
import samples
import torch

from bench.diagnose.report import model_file
from registry.core import EFFECTS, PHYSICS
from registry.dynamics import PhysicsModel
from registry.errors import BenchError

QUADROTOR = PHYSICS.get("quadrotor")


def extended() -> PhysicsModel:
    """Constants that need all digits, as tuples and as tensors."""
    model: PhysicsModel = QUADROTOR(
        mass=torch.tensor(0.50623418, dtype=torch.float64),
        inertia=(3.65e-3, 3.68e-3, 7.03e-3),
        thrust_coefficient=5.6123456e-6,
        input_hold="previous",
        extras=("battery", "time"),
        effects=(
            EFFECTS.get("rotor_drag")(k_d=1.1873456e-4),
            EFFECTS.get("linear_drag")(d_x=0.2, d_y=0.0, d_z=torch.tensor(0.25, dtype=torch.float64)),
        ),
    )
    return model


def values(entry: Any) -> dict[str, Any]:
    return {p.name: torch.as_tensor(p.value, dtype=torch.float64) for p in entry.parameters()}


def test_round_trip(tmp_path: Path) -> None:
    path, model = tmp_path / "model.toml", extended()
    model_file.write(path, model, samples.named().effects)
    read = model_file.read(path)
    assert type(read) is type(model) and read.input_hold == "previous" and read.extras == ("battery", "time")
    assert [type(e) for e in read.effects] == [type(e) for e in model.effects]
    for before, after in zip((model, *model.effects), (read, *read.effects), strict=True):
        for name, value in values(before).items():
            torch.testing.assert_close(values(after)[name], value, rtol=1e-8, atol=0)
    model_file.write(tmp_path / "again.toml", read, samples.named().effects)
    assert path.read_bytes() == (tmp_path / "again.toml").read_bytes()


def test_file_is_as_designed_and_says_units_and_intervals(tmp_path: Path) -> None:
    path = tmp_path / "model.toml"
    model_file.write(path, extended(), samples.named().effects)
    text = path.read_text(encoding="utf-8")
    table = tomllib.loads(text)
    assert table["system"] == "quadrotor" and table["physics"]["thrust_coefficient"] == 5.6123456e-6
    assert table["effects"] == [
        {"id": "rotor_drag", "k_d": 1.1873456e-4},
        {"id": "linear_drag", "d_x": 0.2, "d_y": 0.0, "d_z": 0.25},
    ]
    line = next(x for x in text.splitlines() if x.startswith("k_d"))
    assert "kg/rad" in line and "95 %: 0.0001152 to 0.0001224" in line


GOOD = 'system = "quadrotor"\n[physics]\nmass = 1\n[[effects]]\nid = "rotor_drag"\nk_d = 1e-4\n'


def test_a_file_written_by_hand_is_read(tmp_path: Path) -> None:
    path = tmp_path / "model.toml"
    path.write_text(GOOD.partition("\n")[2])
    read = model_file.read(path, "quadrotor")
    assert (read.mass, read.effects[0].k_d) == (1.0, 1e-4)  # type: ignore[attr-defined]
    assert read.input_hold == "linear"


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('"quadrotor"', '"quadcopter"', "quadrotor"),
        ('"quadrotor"', '"helicopter"', "is a model of helicopter, not of quadrotor"),
        ("system", "sistem", "unknown key 'sistem'"),
        ("mass = 1", "mas = 1", r"\[physics\]: unknown parameter 'mas': did you mean mass"),
        ("mass = 1", "mass = -1", r"\[physics\]: mass = -1 must be .*0.* kg"),
        ("mass = 1", "mass = nan", "mass must be a finite number"),
        ("mass = 1", "mass = true", "mass must be a finite number"),
        ("mass = 1", 'mass = "1"', "mass must be a finite number"),
        ("mass = 1", "inertia = 1.0", "inertia must be a list of finite numbers"),
        ("mass = 1", "rotor_positions = [1.0, 2.0]", "rotor_positions must be a list of lists"),
        ("mass = 1", "effects = 1", "unknown parameter 'effects'"),
        ("[physics]\nmass", "physics", "physics must be a table"),
        ('"rotor_drag"', '"rotor_drug"', r"\[\[effects\]\] number 1: .*did you mean rotor_drag"),
        ('id = "rotor_drag"', "", "number 1 has no id"),
        ("k_d = 1e-4", "kd = 1e-4", r"\(rotor_drag\): unknown parameter 'kd': did you mean k_d"),
        ("k_d = 1e-4", "k_d = -1e-4", "k_d = -0.0001 must be .*0.* kg/rad"),
        ('"rotor_drag"\nk_d = 1e-4', '"wind"\nw_x = 1.0', "needs another one in the model: rotor_drag"),
        ("system", 'input_hold = "never"\nsystem', "choose linear or previous"),
        ("system", "input_hold = 3\nsystem", "input_hold must be of the kind of"),
        ("mass = 1", "mass = 1 2", "cannot be read"),
    ],
)
def test_bad_files_are_refused_with_a_sentence(tmp_path: Path, old: str, new: str, said: str) -> None:
    path = tmp_path / "model.toml"
    assert old in GOOD
    path.write_text(GOOD.replace(old, new, 1))
    with pytest.raises(BenchError, match=said) as caught:
        model_file.read(path, "quadrotor")
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


def test_bytes_absence_and_namelessness_are_sentences(tmp_path: Path) -> None:
    with pytest.raises(BenchError, match="does not exist"):
        model_file.read(tmp_path / "model.toml")
    (tmp_path / "model.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(BenchError, match="not UTF-8"):
        model_file.read(tmp_path / "model.toml")
    (tmp_path / "model.toml").write_text("[physics]\n")
    with pytest.raises(BenchError, match="names no system"):
        model_file.read(tmp_path / "model.toml")


def test_a_constant_that_is_not_finite_is_not_written(tmp_path: Path) -> None:
    with pytest.raises(BenchError, match="mass = nan is not finite"):
        model_file.write(tmp_path / "model.toml", dataclasses.replace(extended(), mass=math.nan))  # type: ignore[call-arg]
    assert not list(tmp_path.iterdir())


def test_a_file_never_names_code_to_run(tmp_path: Path) -> None:
    (tmp_path / "own.py").write_text("raise SystemExit('was run')")
    (tmp_path / "model.toml").write_text(GOOD.replace("quadrotor", f"{tmp_path}/own.py:Own"))
    with pytest.raises(BenchError, match="no physics model"):
        model_file.read(tmp_path / "model.toml")
