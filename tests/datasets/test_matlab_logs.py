"""MATLAB files written by scipy and h5py in the forms that MATLAB and Simulink give logs, and read back."""

from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io

from registry.datasets.folder.dataset import Folder, check
from registry.datasets.logs import matlab
from registry.datasets.logs.importing import convert
from registry.errors import BenchError

T = np.arange(0, 6, 0.01)
TANK = {"time": T[:, None], "u_pump": np.sin(T)[:, None], "level": (0.1 * T)[:, None]}


def read(folder: Path) -> dict[str, np.ndarray]:
    parts = check(folder).recordings
    groups = {c.group for c in parts[0].channels}
    return {g: np.concatenate([r.pick([g])[0] for r in parts]) for g in groups}


def write_v73(path: Path, content: dict[str, object]) -> None:
    """As MATLAB's -v7.3: matrices transposed, structs as groups, texts as numbers, cells as references."""
    with h5py.File(path, "w", userblock_size=512) as file:

        def put(parent: h5py.Group, name: str, value: object) -> None:
            if isinstance(value, dict):
                group = parent.create_group(name)
                group.attrs["MATLAB_class"] = np.bytes_("struct")
                for key, inner in value.items():
                    put(group, key, inner)
            elif isinstance(value, str):
                data = parent.create_dataset(name, data=np.array([[ord(c)] for c in value], dtype=np.uint16))
                data.attrs["MATLAB_class"] = np.bytes_("char")
            elif isinstance(value, list):
                for i, inner in enumerate(value):
                    put(file.require_group("#refs#"), f"{name}{i}", inner)
                cell = parent.create_dataset(name, (len(value), 1), dtype=h5py.ref_dtype)
                cell.attrs["MATLAB_class"] = np.bytes_("cell")
                for i in range(len(value)):
                    cell[i, 0] = file[f"#refs#/{name}{i}"].ref
            else:
                parent.create_dataset(name, data=np.asarray(value).T)

        for name, value in content.items():
            put(file, name, value)


def save(path: Path, version: str, content: dict[str, object]) -> Path:
    if version == "7.3":
        write_v73(path, content)
        return path
    cells = {k: np.array(v, dtype=object) if isinstance(v, list) else v for k, v in content.items()}
    scipy.io.savemat(path, cells, do_compression=version == "7")
    return path


@pytest.mark.parametrize("version", ["5", "7", "7.3"])
def test_plain_variables_are_signals(version: str, tmp_path: Path) -> None:
    convert([save(tmp_path / "tank.mat", version, TANK)], tmp_path / "out")
    folder = Folder(str(tmp_path / "out"))
    assert folder.inputs == ("u_pump",) and folder.description.rate == 100
    x = read(tmp_path / "out")
    np.testing.assert_allclose(x["u_pump"][:, 0], np.sin(T), atol=1e-8)
    np.testing.assert_allclose(x["level"][:, 0], 0.1 * T, atol=1e-8)


@pytest.mark.parametrize("version", ["5", "7.3"])
def test_arrays_without_a_time_were_sampled_at_the_rate_that_is_said(version: str, tmp_path: Path) -> None:
    own = {name: x for name, x in TANK.items() if name != "time"} | {"fs": np.array([[100.0]])}
    for content in (own, {"log": own}):
        file = save(tmp_path / "tank.mat", version, content)
        with pytest.raises(BenchError, match="say with --rate at how many Hz"):
            convert([file], tmp_path / "none")
        out = tmp_path / f"out_{len(content)}"
        convert([file], out, rate=50.0)
        x = read(out)
        assert Folder(str(out)).description.rate == 50
        np.testing.assert_allclose(x["u_pump"][:, 0], np.sin(T), atol=1e-8)
        np.testing.assert_allclose(x["level"][:, 0], 0.1 * T, atol=1e-8)


@pytest.mark.parametrize("version", ["5", "7.3"])
def test_a_flight_in_nested_structs_at_two_rates_is_joined(version: str, tmp_path: Path) -> None:
    slow = T[::5]
    log = {
        "state": {
            "time": T[None, :],
            "pos": np.stack([T, 0 * T, 1 + 0 * T], axis=1),
            "gyro": np.stack([0.1 + 0 * T, 0 * T, 0 * T]),
            "attitude": {"roll": 0 * T[:, None], "pitch": 0 * T[:, None], "yaw": 0.1 * T[:, None]},
            "rotor": np.stack([500 + T * i for i in range(4)], axis=1),
        },
        "power": {"time": slow[:, None], "vbat": (4 - 0.1 * slow)[:, None], "units": {"vbat": "V", "time": "s"}},
    }
    said = convert([save(tmp_path / "flight.mat", version, {"log": log})], tmp_path / "out")
    assert "power: values between samples are interpolated" in said[0]
    text = (tmp_path / "out" / "dataset.toml").read_text()
    assert "rate_hz = 100" in text and 'input = "rotor_speed"' in text and 'system = "quadrotor"' in text
    x = read(tmp_path / "out")
    np.testing.assert_allclose(x["position"][:, 0], T, atol=1e-6)
    np.testing.assert_allclose(x["rotor_speed"][7], 500 + 0.07 * np.arange(4), atol=1e-6)
    np.testing.assert_allclose(x["battery"][:590, 0], 4 - 0.1 * T[:590], atol=1e-6)


def test_units_that_nobody_states_are_asked_for(tmp_path: Path) -> None:
    """acc.x would be in g if a Crazyflie had logged it; and the second of two clocks is no signal."""
    log = {
        "time": T[:, None],
        "t": T[:, None],
        "acc": {a: T[:, None] for a in ("x", "y", "z")},
        "m": T[:, None] @ np.ones((1, 4)),
    }
    convert([save(tmp_path / "a.mat", "5", {"log": log})], tmp_path / "out")
    assert "TODO: check every unit" in (tmp_path / "out" / "dataset.toml").read_text()
    assert set(read(tmp_path / "out")) == {"specific_force", "pwm"}


def test_units_of_a_cell_are_those_of_the_variables_in_order(tmp_path: Path) -> None:
    log = {**TANK, "units": np.array(["L/min", "mm"], dtype=object)}
    convert([save(tmp_path / "tank.mat", "5", {"log": log})], tmp_path / "out")
    signals = Folder(str(tmp_path / "out")).description.signals
    assert (signals["u_pump"].unit, signals["level"].unit) == ("L/min", "mm")


def test_simulinks_structure_with_time(tmp_path: Path) -> None:
    signals = np.array([(np.sin(T)[:, None], "u_cmd"), (T[:, None], "angle")], dtype=[("values", "O"), ("label", "O")])
    convert([save(tmp_path / "out.mat", "5", {"yout": {"time": T[:, None], "signals": signals}})], tmp_path / "out")
    x = read(tmp_path / "out")
    assert set(x) == {"u_cmd", "angle"}
    np.testing.assert_allclose(x["angle"][:, 0], T, atol=1e-8)


def test_an_array_of_structs_is_as_many_recordings(tmp_path: Path) -> None:
    runs = np.array([(T[:, None], np.sin(T + i)[:, None]) for i in range(3)], dtype=[("t", "O"), ("y", "O")])
    convert([save(tmp_path / "bench.mat", "5", {"runs": runs})], tmp_path / "out")
    recordings = check(tmp_path / "out").recordings
    assert [r.name for r in recordings] == [f"bench_runs_{i}" for i in (1, 2, 3)]
    np.testing.assert_allclose(recordings[2].outputs[:, 0], np.sin(T + 2), atol=1e-8)


def test_a_timetable_is_told_how_to_be_saved(tmp_path: Path) -> None:
    """A timetable is an object: in version 7.3 its variable says so; scipy cannot write one."""
    with h5py.File(tmp_path / "tt.mat", "w", userblock_size=512) as file:
        data = file.create_dataset("TT", data=np.zeros((1, 6), dtype=np.uint32))
        data.attrs["MATLAB_class"] = np.bytes_("timetable")
        data.attrs["MATLAB_object_decode"] = 3
    with pytest.raises(BenchError, match="timetable2table"):
        convert([tmp_path / "tt.mat"], tmp_path / "out")


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "damaged"),
        (b"MATLAB 5.0 MAT-file" + bytes(200), "damaged|no struct"),
        (None, "no struct or variable named"),
    ],
)
def test_what_holds_no_log_is_one_sentence(content: bytes | None, says: str, tmp_path: Path) -> None:
    if content is None:
        scipy.io.savemat(tmp_path / "a.mat", {"y": T})
    else:
        (tmp_path / "a.mat").write_bytes(content)
    with pytest.raises(BenchError, match=says):
        convert([tmp_path / "a.mat"], tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_what_would_fill_the_memory_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(matlab, "LARGEST", 2**21)
    scipy.io.savemat(tmp_path / "a.mat", {"t": np.zeros((2**19, 1))}, do_compression=True)
    assert (tmp_path / "a.mat").stat().st_size < 2**16
    with h5py.File(tmp_path / "b.mat", "w") as file:
        file.create_dataset("t", (1, 2**19), dtype="f8")
    for name in ("a.mat", "b.mat"):
        with pytest.raises(BenchError, match="more than 2 MiB"):
            convert([tmp_path / name], tmp_path / "out")
