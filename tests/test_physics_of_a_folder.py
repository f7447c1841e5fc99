"""A folder of flights and the physics that predicts them: what it must hold, and what is told apart."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from conftest import Typed
from conftest import command as bench

from bench.diagnose import load
from registry.core import DATASETS, PHYSICS
from registry.dynamics import constant
from registry.errors import BenchError
from registry.stated import needed

SIGNALS = {
    "attitude": ('["qx", "qy", "qz", "qw"], unit = "1", convention = "quaternion_xyzw"', (0, 0, 0, 1)),
    "velocity": ('["vx", "vy", "vz"], unit = "m/s", frame = "world"', (0, 0, 0)),
    "body_rates": ('["p", "q", "r"], unit = "rad/s"', (0, 0, 0)),
    "rotor_speed": ('["rotor1", "rotor2", "rotor3", "rotor4"], unit = "rad/s"', (495.5, 495.5, 495.5, 495.5)),
}
CONSTANTS = {
    "mass": "1.0",
    "inertia": "[0.01, 0.01, 0.02]",
    "thrust_coefficient": "9.9865e-6",
    "torque_coefficient": "1.5978e-7",
    "rotor_positions": "[[0.2, 0], [0, 0.2], [-0.2, 0], [0, -0.2]]",
    "rotor_directions": "[1, -1, 1, -1]",
}


def hover(folder: Path, without: tuple[str, ...] = ()) -> Path:
    """Three flights of a quadrotor that all but hovers, without some signals and constants."""
    folder.mkdir()
    signals = {name: s for name, s in SIGNALS.items() if name not in without}
    columns = [c for about, _ in signals.values() for c in about[2 : about.index('"]')].split('", "')]
    at = np.concatenate([values for _, values in signals.values()])
    for i in range(3):
        noise = np.random.default_rng(i).normal(size=(200, len(at))) * 1e-3
        table = np.column_stack([np.arange(200) / 100, at + noise])
        np.savetxt(folder / f"flight_{i}.csv", table, "%.9g", ",", header=",".join(["t", *columns]), comments="")
    lines = ['name = "hover"', 'system = "quadrotor"', "rate_hz = 100", 'files = "*.csv"', 'time = "t"']
    lines += ['input = "rotor_speed"', "[signals]", *(f"{n} = {{columns = {s}}}" for n, (s, _) in signals.items())]
    lines += ["[physics]", *(f"{n} = {v}" for n, v in CONSTANTS.items() if n not in without)]
    (folder / "dataset.toml").write_text("\n".join(lines))
    return folder


def test_a_position_that_nothing_looks_at_need_not_be_measured(tmp_path: Path) -> None:
    folder, models = hover(tmp_path / "flights"), [tmp_path / n / "model.toml" for n in "ab"]
    for mass, model in zip((1.0, 1.2), models, strict=True):
        model.parent.mkdir()
        constants = "\n".join(f"{n} = {v}" for n, v in (CONSTANTS | {"mass": str(mass)}).items())
        model.write_text(f'system = "quadrotor"\n[physics]\n{constants}\n')
        said = bench(
            "run", "physics", "--dataset", folder, "--physics", model, "-T", 10, "--no-track", "--workers", 1,
            "--results", tmp_path,
        )  # fmt: skip
        assert "Figure and tables" in said
    studies = sorted(p.name for p in (tmp_path / "studies").iterdir())
    assert len(studies) == 2  # of two models of one name, each its own
    assert len({(tmp_path / "studies" / s / "study.json").read_text() for s in studies}) == 2


@pytest.mark.parametrize(("effect", "lacking"), [("", "body_rates"), ("ground_effect", "position")])
def test_what_is_not_measured_is_told_before_anything_is_read(tmp_path: Path, effect: str, lacking: str) -> None:
    folder, model = hover(tmp_path / "flights", without=(lacking,)), tmp_path / "model.toml"
    for file in folder.glob("*.csv"):
        file.unlink()
    physics = "\n".join(['system = "quadrotor"', "[physics]", *(f"{n} = {v}" for n, v in CONSTANTS.items())])
    model.write_text(f'{physics}\n[[effects]]\nid = "{effect}"' if effect else physics)
    with pytest.raises(BenchError, match=f"hover has no {lacking}, from which quadrotor starts"):
        bench("run", "physics", "--dataset", folder, "--physics", model, "--no-track", "--results", tmp_path)


@pytest.mark.parametrize(
    "command",
    ["data check {}", "compare {}", "diagnose {}", "run physics --dataset {}", "run Hybrid:1x8-MLP:8x10 --dataset {}"],
)
def test_constants_that_nobody_stated_are_asked_for(tmp_path: Path, command: str) -> None:
    folder = hover(tmp_path / "flights", without=("mass", "rotor_directions"))
    with pytest.raises(
        BenchError, match=r"\[physics\] does not state mass \[kg\], rotor_directions: add.*show quadrotor"
    ):
        bench(*command.format(folder).split())
    left = sorted(p.name for p in tmp_path.rglob("*"))
    assert left == ["dataset.toml", "flight_0.csv", "flight_1.csv", "flight_2.csv", "flights"]


def test_a_model_file_must_state_them_too(tmp_path: Path) -> None:
    folder, model = hover(tmp_path / "flights"), tmp_path / "model.toml"
    model.write_text('system = "quadrotor"\n[physics]\nmass = 1.0\n')
    for command in ("run physics --physics {} --dataset {}", "compare --model {} {}"):
        with pytest.raises(
            BenchError, match=r"model\.toml \[physics\] does not state inertia \[kg m\^2\], thrust_coeff"
        ):
            bench(*command.format(model, folder).split())


def test_what_is_left_to_the_default_is_said(tmp_path: Path) -> None:
    folder = hover(tmp_path / "flights")
    assert "read without an error" in bench("data", "check", folder)
    (note,) = [n for n in load(str(folder)).notes if n.startswith("Not stated")]
    assert note == "Not stated, and assumed where an effect looks at it: rotor radius = 0.127 m."


def test_a_draft_is_not_diagnosed(tmp_path: Path, typed: Typed) -> None:
    folder = hover(tmp_path / "flights")
    (folder / "dataset.toml").unlink()
    bench("data", "init", folder)
    with pytest.raises(BenchError, match="does not state mass"):
        bench("diagnose", folder)
    code, said, refused = typed("data", "check", folder)
    assert code == 2 and "dataset.toml still says TODO" in said and "does not state mass" in refused


def test_constants_of_a_registered_data_set_are_its_own() -> None:
    """The rotors of another vehicle are none of its business: the Pelican's are in the model itself."""
    assert not DATASETS.get("pelican_twin")().described
    assert [p.name for p in needed(PHYSICS.get("quadrotor"), "pwm")][-2:] == ["pwm_gain", "pwm_offset"]

    class Mine(PHYSICS.get("oscillator")):
        """With a stiffness of its own."""

        stiffness: float = constant(3.0, "stiffness", "N/m", source="measured")

    assert [p.name for p in needed(dataclass(frozen=True)(Mine))] == ["mass", "damping"]


def test_what_many_recordings_have_is_told_of_the_first(tmp_path: Path) -> None:
    folder = tmp_path / "lab bench"
    folder.mkdir()
    (folder / "dataset.toml").write_text(
        'name = "lab bench"\nrate_hz = 100\nfiles = "*.csv"\ntime = "t"\ninput = "voltage"\n[signals]\n'
        'voltage = {columns = ["u"], unit = "V"}\nspeed = {columns = ["v"], unit = "m/s"}\n'
    )
    t = np.arange(400) * 0.01
    for i in range(7):
        lost = (t > 1) & (t < (1.3 if i < 6 else 1.0))  # the last has no gap
        rows = np.column_stack([t, np.sin(t + i), np.cos(t)])[~lost]
        np.savetxt(folder / f"run_{i}.csv", rows, delimiter=",", header="t,u,v", comments="", fmt="%.4f")
    said = bench("data", "check", folder)
    gaps = [line.strip() for line in said.splitlines() if line.startswith("  run_") or "more like this" in line]
    assert [line.partition(":")[0] for line in gaps[:-1]] == ["run_0", "run_1", "run_2"]
    assert gaps[-1].startswith("… and 3 more like this (gap)")
    assert gaps[-1].endswith(f"bench data inspect '{folder}'")
    every = bench("data", "inspect", folder)
    assert all(f"run_{i}: gap" in every for i in range(6)) and "run_6: gap" not in every
