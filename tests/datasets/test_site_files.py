"""Benchmarks whose files are not here, read from files made in their public formats."""

from pathlib import Path

import numpy as np
import pytest
import scipy.io

from registry.core import DATASETS
from registry.errors import BenchError


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("BENCH_DATA", str(tmp_path))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path


def save(file: Path, **variables: np.ndarray) -> None:
    file.parent.mkdir(exist_ok=True)
    scipy.io.savemat(file, variables)


def read(name: str):
    data = DATASETS.get(name)()
    loaded = {r.name: r for r in data.load().recordings}
    return loaded, data.split(list(loaded)), data


def drawn(*shape: int) -> np.ndarray:
    return np.random.default_rng(len(shape)).normal(size=shape)


def test_wiener_hammerstein(files: Path) -> None:
    u, y = drawn(188_000, 1), 2 * drawn(188_000, 1)
    save(files / "wiener_hammerstein/WienerHammerBenchMark.mat", uBenchMark=u, yBenchMark=y, fs=np.array([[51_200.0]]))
    loaded, split, data = read("wiener_hammerstein")
    assert (split.train, split.test, data.initial_window) == (("estimation",), ("test",), 50)
    assert {n: len(r) for n, r in loaded.items()} == {"estimation": 100_000, "test": 78_800}
    test = loaded["test"]
    assert test.rate == 51_200 and [c.name for c in test.channels] == ["voltage.1", "output"]
    np.testing.assert_array_equal(test.inputs, u[105_200:184_000])
    np.testing.assert_array_equal(test.outputs, y[105_200:184_000])


def test_coupled_drives(files: Path) -> None:
    table = {name: drawn(500, 1) + i for i, name in enumerate(("u11", "z11", "u12", "z12"))}
    save(files / "coupled_drives/DATAUNIF.MAT", **table)
    loaded, split, data = read("coupled_drives")
    assert (split.train, split.test) == (("low_train", "high_train"), ("low_test", "high_test"))
    assert data.initial_window == 4 and loaded["high_test"].rate == 50
    np.testing.assert_array_equal(loaded["high_test"].inputs, table["u12"][400:])
    np.testing.assert_array_equal(loaded["low_train"].outputs, table["z11"][:400])


def test_f16(files: Path) -> None:
    names = ("FullMSine_Level1", "SineSw_Level3", "SineSw_Level4_Validation", "SpecialOddMSine_Level2")
    made = {n: (drawn(1, 800 + i), drawn(3, 800 + i)) for i, n in enumerate(names)}
    for name, (force, acceleration) in made.items():
        values = {"Force": force, "Voltage": force, "Acceleration": acceleration, "Fs": np.array([[400.0]])}
        save(files / f"f16/F16Data_{name}.mat", **values)
    loaded, split, _ = read("f16")
    assert split.train == names[:2] and split.test == names[2:3] and set(loaded) == set(names[:3])
    np.testing.assert_array_equal(loaded[names[1]].outputs, made[names[1]][1].T)
    np.testing.assert_array_equal(loaded[names[1]].inputs, made[names[1]][0].T)


def test_industrial_robot(files: Path) -> None:
    """Trajectories stand behind each other; angles are in degrees."""
    u, y = drawn(6, 3 * 606), 90 * drawn(6, 3 * 606)
    file = files / "industrial_robot/forward_identification_without_raw_data.mat"
    save(file, u_train=u, y_train=y, u_test=u[:, :606], y_test=2 * y[:, :606])
    loaded, split, _ = read("industrial_robot")
    assert split.train == ("train_01", "train_02", "train_03") and split.test == ("test_01",)
    second = loaded["train_02"]
    assert second.outputs.shape == (606, 6) and second.output_channels[4].name == "joint_angle.5"
    np.testing.assert_allclose(second.outputs, y[:, 606:1212].T * np.pi / 180)
    np.testing.assert_array_equal(second.inputs, u[:, 606:1212].T)


def test_bouc_wen(files: Path) -> None:
    for name in ("uval_multisine", "yval_multisine", "uval_sinesweep", "yval_sinesweep"):
        save(files / f"bouc_wen/{name}.mat", **{name: drawn(1, 900) * sum(map(ord, name))})
    with pytest.raises(BenchError, match=r"make some with its simulator .* u_NAME\.mat and y_NAME\.mat"):
        read("bouc_wen")
    u, y = drawn(1, 500), 2 * drawn(1, 500)
    save(files / "bouc_wen/u_first.mat", u_first=u)
    with pytest.raises(BenchError, match=r"has no y_first\.mat beside it"):
        read("bouc_wen")
    save(files / "bouc_wen/y_first.mat", y_first=y)
    loaded, split, _ = read("bouc_wen")
    assert split.train == ("first",) and split.test == ("val_multisine", "val_sinesweep")
    np.testing.assert_array_equal(loaded["first"].outputs, y.T)


@pytest.mark.parametrize(
    ("name", "file", "wrong"),
    [
        (
            "wiener_hammerstein",
            "WienerHammerBenchMark.mat",
            {"uBenchMark": [[1.0]], "yBenchMark": [[1.0]], "fs": [[1.0]]},
        ),
        ("coupled_drives", "DATAUNIF.MAT", {k: np.full((500, 1), np.nan) for k in ("u11", "z11", "u12", "z12")}),
        ("f16", "F16Data_A.mat", {"Force": np.ones((1, 9)), "Acceleration": np.ones((2, 9)), "Fs": [[400.0]]}),
        (
            "industrial_robot",
            "forward_identification_without_raw_data.mat",
            {f"{k}_{p}": np.ones((6, 605)) for k in "uy" for p in ("train", "test")},
        ),
    ],
)
def test_files_of_another_shape_are_refused(files: Path, name: str, file: str, wrong: dict) -> None:
    with pytest.raises(BenchError, match="download them from https://"):
        read(name)
    save(files / name / file, **{k: np.asarray(v) for k, v in wrong.items()})
    with pytest.raises(BenchError, match="download"):
        read(name)
