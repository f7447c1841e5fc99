"""A folder of flights and the physics that predicts them: what it must hold, and what is told apart."""

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from bench.cli import cli
from registry.errors import BenchError

SIGNALS = {
    "attitude": ('["qx", "qy", "qz", "qw"], unit = "1", convention = "quaternion_xyzw"', (0, 0, 0, 1)),
    "velocity": ('["vx", "vy", "vz"], unit = "m/s", frame = "world"', (0, 0, 0)),
    "body_rates": ('["p", "q", "r"], unit = "rad/s"', (0, 0, 0)),
    "rotor_speed": ('["w1", "w2", "w3", "w4"], unit = "rad/s"', (495.5, 495.5, 495.5, 495.5)),
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


def bench(*arguments: object) -> str:
    """What a command prints.

    Raises:
        BenchError: what it refuses.
    """
    done = CliRunner().invoke(cli, [str(a) for a in arguments])
    if done.exception is not None:
        raise done.exception
    return done.output


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
    model.write_text(f'system = "quadrotor"\n[[effects]]\nid = "{effect}"' if effect else 'system = "quadrotor"')
    with pytest.raises(BenchError, match=f"hover has no {lacking}, from which quadrotor starts"):
        bench("run", "physics", "--dataset", folder, "--physics", model, "--no-track", "--results", tmp_path)
