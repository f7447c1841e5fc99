import gzip

import h5py
import numpy as np
import pytest
import scipy.io

from registry.datasets.nanobench import Nanobench
from registry.datasets.nanodrone import Nanodrone
from registry.datasets.pelican import Pelican
from registry.datasets.reading.inspect import inspect
from registry.datasets.tailsitter import Tailsitter
from registry.errors import BenchError

FIELDS = ("len", "Pos", "Euler", "Motors", "Motors_CMD", "Vel", "pqr")


def flight(samples, seed, printed=False):
    """A flight as the documentation of the published file has it: mm, degrees, differences of the smoothed signals."""
    rng, t = np.random.default_rng(seed), np.arange(samples) / 100
    position, euler = (
        scale * np.sin(2 * np.pi * np.outer(rng.uniform(0.2, 1, 3), t) + rng.uniform(0, 6, (3, 1)))
        for scale in (900.0, np.array([[25.0], [30.0], [170.0]]))
    )
    roll, pitch, _ = np.deg2rad(euler[:, 1:])
    droll, dpitch, dyaw = np.diff(euler) * 100
    if printed:
        turn = np.sin(roll) * dpitch + np.cos(roll) * dyaw
        pqr = [droll + np.tan(pitch) * turn, np.cos(roll) * dpitch - np.sin(roll) * dyaw, turn / np.cos(pitch)]
    else:
        q = np.cos(roll) * dpitch + np.sin(roll) * np.cos(pitch) * dyaw
        pqr = [droll - np.sin(pitch) * dyaw, q, np.cos(roll) * np.cos(pitch) * dyaw - np.sin(roll) * dpitch]
    wrapped = (euler + 180) % 360 - 180
    motors = rng.integers(0, 219, (2, 4, samples)).astype(float)
    return dict(zip(FIELDS, (samples, position, wrapped, *motors, np.diff(position) * 100, np.stack(pqr)), strict=True))


def write_v5(file, flights):
    cells = np.empty((1, len(flights)), dtype=object)
    for i, f in enumerate(flights):
        cells[0, i] = f
    scipy.io.savemat(file, {"flights": cells}, do_compression=True)


def write_v73(file, flights):
    """As MATLAB does: 512 bytes of text before the HDF5 signature, matrices transposed, cells as references."""
    with h5py.File(file, "w", userblock_size=512) as content:
        references = []
        for i, f in enumerate(flights):
            group = content.create_group(f"#refs#/{i}")
            for name, value in f.items():
                group[name] = np.atleast_2d(value).T
            references.append(group.ref)
        content.create_dataset("flights", data=np.array(references, dtype=h5py.ref_dtype)[:, None])
    with file.open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file")


@pytest.fixture
def place(tmp_path, monkeypatch):
    monkeypatch.setenv("BENCH_DATA", str(tmp_path))
    (tmp_path / "pelican").mkdir()
    return tmp_path / "pelican" / "AscTec_Pelican_Flight_Dataset.mat"


@pytest.mark.parametrize("write", [write_v5, write_v73])
@pytest.mark.parametrize("metres", [False, True])
def test_both_formats_give_the_flights_in_si(place, write, metres):
    flights = [flight(300, 1), flight(200, 2)]
    stored = [f | {"Vel": f["Vel"] / 1000, "pqr": np.deg2rad(f["pqr"])} if metres else f for f in flights]
    write(place, stored)
    first, second = Pelican().load().recordings
    assert (len(first), len(second), second.name) == (299, 199, "flight_02")
    f = flights[0]
    assert first.inputs == pytest.approx(f["Motors"].T[1:])
    assert first.pick(["pwm"])[0] == pytest.approx(f["Motors_CMD"].T[1:])
    assert first.pick(["position"])[0] == pytest.approx(f["Pos"].T[1:] / 1000)
    assert first.pick(["velocity"])[0] == pytest.approx(f["Vel"].T / 1000)
    assert first.pick(["body_rates"])[0] == pytest.approx(np.deg2rad(f["pqr"].T))
    recomputed = Pelican(body_rates="recomputed").load().recordings[0]
    assert recomputed.pick(["body_rates"])[0] == pytest.approx(np.deg2rad(f["pqr"].T))


def test_the_misprinted_matrix_the_size_and_the_maxima_are_noticed(place):
    write_v5(place, [flight(300, 1, printed=True), flight(200, 2)])
    rows, findings = inspect(Pelican())
    assert [r["name"] for r in rows] == ["flight_01", "flight_02"]
    about = {f.kind: f for f in findings}
    assert about["convention"].count == 1
    assert "500 samples where 54 of 1388410" in about["size"].detail
    assert "differ from the paper's table" in about["maxima"].detail
    good = flight(300, 1)["pqr"]
    recomputed = Pelican(body_rates="recomputed").load().recordings[0]
    assert recomputed.pick(["body_rates"])[0] == pytest.approx(np.deg2rad(good.T))


@pytest.mark.parametrize("write", [write_v5, write_v73])
def test_a_torn_file_is_one_sentence(place, write):
    write(place, [flight(300, 1), flight(200, 2)])
    whole = place.read_bytes()
    for size in (0, 100, 600, len(whole) // 2, len(whole) - 50):
        place.write_bytes(whole[:size])
        with pytest.raises(BenchError, match="download it again"):
            Pelican().load()


@pytest.mark.parametrize("name", ["Vel", "Motors"])
def test_a_flight_of_the_wrong_shape_is_named(place, name):
    broken = flight(200, 2)
    broken[name] = broken[name][:, :-1]
    write_v5(place, [flight(300, 1), broken])
    with pytest.raises(BenchError, match=f"{name} of flight 2"):
        Pelican().load()


def test_absent_data_say_where_to_get_them(tmp_path, monkeypatch):
    monkeypatch.delenv("BENCH_DATA", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    with pytest.raises(BenchError) as caught:
        Pelican().load()
    for part in (
        str(tmp_path / "multistep-bench/pelican"),
        "wavelab.uwaterloo.ca",
        "SHA-256 is not known",
        "BENCH_DATA",
    ):
        assert part in str(caught.value)


def test_a_file_in_the_cache_folder_is_found(tmp_path, monkeypatch):
    monkeypatch.setenv("BENCH_DATA", str(tmp_path / "empty"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    place = tmp_path / "multistep-bench" / "pelican" / "AscTec_Pelican_Flight_Dataset.mat"
    place.parent.mkdir(parents=True)
    write_v5(place, [flight(50, 1)])
    assert len(Pelican().load().recordings) == 1


@pytest.mark.parametrize(
    ("entry", "name", "content"),
    [
        (Tailsitter, "tailsitter_polyu/a.mat", b"MATLAB 5.0 MAT-file" + bytes(200)),
        (Nanodrone, "nanodrone_idsia/raw_parquet/a.parquet", b"PAR1" + bytes(200)),
        (Nanobench, "nanobench/a.csv.gz", gzip.compress(b"t,px\n" + bytes(range(256)) * 9)[:-30]),
        (Nanobench, "nanobench/a.csv", b"t,px\n1,2\n"),
    ],
)
def test_other_damaged_files_are_named(tmp_path, monkeypatch, entry, name, content):
    monkeypatch.setenv("BENCH_DATA", str(tmp_path))
    (tmp_path / name).parent.mkdir(parents=True)
    (tmp_path / name).write_bytes(content)
    with pytest.raises(BenchError, match="download it again") as caught:
        entry().load()
    assert name in str(caught.value)
