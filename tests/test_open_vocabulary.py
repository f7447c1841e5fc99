"""Signals that nobody foresaw: any name, unit and axes, from the draft of their description to a prediction."""

from pathlib import Path

import matrix
import numpy as np
import pandas as pd
import pytest
from conftest import command as bench

from bench.records import record
from registry.contracts import Channel
from registry.datasets.folder.dataset import Folder
from registry.datasets.folder.draft import draft
from registry.datasets.signals import recording
from registry.errors import BenchError
from registry.units import Signal, conversion


@pytest.fixture(scope="module")
def batches(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four batches of a neutralisation, described by the draft and two edits.

    Acid flow [L/min] lowers the pH with a lag of 40 s; a sample every 2 s.
    """
    folder = tmp_path_factory.mktemp("ph") / "batches"
    folder.mkdir()
    for i in range(4):
        rng, n = np.random.default_rng(i), 300
        flow, ph = np.repeat(rng.uniform(1, 5, n // 20), 20), np.full(n, 7.0)
        for k in range(1, n):
            ph[k] = ph[k - 1] + 0.05 * (7 - 0.6 * (flow[k - 1] - 3) - ph[k - 1])
        table = np.column_stack([2.0 * np.arange(n), ph + rng.normal(0, 0.01, n), flow])
        np.savetxt(folder / f"batch_{i}.csv", table, "%.6g", ",", header="time,ph,flow_l_min", comments="")
    said = bench("data", "init", folder)
    assert "No physics model: networks only." in said
    text = (folder / "dataset.toml").read_text()
    assert "rate_hz = 0.5 " in text and 'flow_l_min = {columns = ["flow_l_min"], unit = "L/min"}' in text
    text = text.replace('unit = "1"', 'unit = "pH"').replace('# TODO: input = ["…"]', 'input = "flow_l_min" #')
    (folder / "dataset.toml").write_text(text)
    return folder


def test_two_invented_signals_go_all_the_way(batches: Path, tmp_path: Path) -> None:
    assert "flow_l_min → ph" in bench("data", "check", batches)
    assert "pH" in bench("data", "inspect", batches)
    dataset = Folder(path=str(batches))
    assert dataset.load().recordings[0].channels == (Channel("flow_l_min", "L/min"), Channel("ph", "pH"))
    spec, here = "LSTM: 1x4 - MLP: 4x10", ("--results", tmp_path)
    little = ("--dataset", batches, "-T", 8, "--set", "training.updates=20", "--no-track", *here)
    said = bench("run", spec, *little, "--workers", 1)
    assert "[pH]" in said and "linear" in said
    (page,) = (tmp_path / "studies").rglob("report.html")
    assert "[pH]" in page.read_text()
    assert "Report" in bench("sweep", spec, *little, "--trials", 2)
    (swept,) = (tmp_path / "sweeps").rglob("report.html")
    assert "ph [pH]" in swept.read_text()
    page.unlink()
    bench("report", page.parent.name, *here)
    assert "[pH]" in page.read_text()
    runs = (record.find(tmp_path / "runs", p.name) for p in (tmp_path / "runs").iterdir())
    key = next(r.key for r in runs if r.summary["spec"] == spec)
    bench("predict", key, "--input", batches / "batch_3.csv", "-o", tmp_path / "told.csv", *here)
    told = pd.read_csv(tmp_path / "told.csv")
    assert list(told) == ["time_s", "ph"] and len(told) == 290 and told["ph"].between(2, 12).all()
    with pytest.raises(BenchError, match="no physics model, so that only networks predict it"):
        bench("run", "physics", *little)


def test_every_predictor_runs_on_the_invented_signals_or_says_why_not(batches: Path, tmp_path: Path) -> None:
    rows = {predictor: said for predictor, _, said in matrix.single([str(batches)], tmp_path)}
    refused = {name for name, said in rows.items() if said != matrix.RAN}
    assert refused == {
        "physics",
        "Hybrid",
        "Hybrid residual",
        "Hybrid unsummed",
        "Load hybrid",
        "Cascade",
        "Cascade TDL",
        "Cascade attitude",
        "attainable",  # of a simulator only
    }
    assert rows["Cascade attitude"].startswith("Cascade attitude starts from the measured attitude, which batches")


@pytest.mark.slow
@pytest.mark.data
def test_every_predictor_and_study_runs_on_every_data_set_or_says_why_not(tmp_path: Path) -> None:
    here = [d for d in matrix.registered() if "download" not in matrix.attempt("constant", d, tmp_path)]
    assert {"emps", "cascaded_tanks", "silverbox", "pelican_twin", "helicopter_twin"} <= set(here)
    rows = {(name, d): said for make in (matrix.single, matrix.whole) for name, d, said in make(here, tmp_path)}
    networks = {"LSTM", "LSTM TDL", "GRU", "MLFC", "NARX", "TCN", "LRU", "SUBNET", "Neural ODE"}
    black_box = {*networks, "linear", "constant"}
    assert {rows[name, d] for name in black_box for d in here} == {matrix.RAN}


def test_units_convert_where_a_model_wants_another() -> None:
    assert conversion("mN m", "N m") == (pytest.approx(1e-3), 0.0)
    assert conversion("degC", "K") == (pytest.approx(1.0), pytest.approx(273.15))
    assert conversion("rpm", "rad/s") == (np.pi / 30, 0.0)
    for unit, wanted in (("Hz", "rad/s"), ("deg", "1"), ("NTU", "m"), ("9^9^9", "m")):
        with pytest.raises(BenchError):
            conversion(unit, wanted)


def test_a_plug_in_brings_its_own_signals() -> None:
    own = {"ph": Signal("pH", ("",)), "flow": Signal("L/min", ("acid", "base"))}
    x = np.zeros((5, 2))
    made = recording("a", 1.0, {"flow": x}, {"ph": x[:, :1]}, np.ones(5, bool), own)
    assert [c.name for c in made.channels] == ["flow.acid", "flow.base", "ph"]
    with pytest.raises(BenchError, match="'ph' comes without its unit"):
        recording("a", 1.0, {}, {"ph": x[:, :1]}, np.ones(5, bool))


@pytest.mark.parametrize(
    ("columns", "holds"),
    [
        (
            ["timestamp", "gyro.x", "gyro.y", "gyro.z", "acc.x", "acc.y", "acc.z", "motor.m1", "motor.m2"],
            ['body_rates = {columns = ["gyro.x", "gyro.y", "gyro.z"], unit = "deg/s"}', 'unit = "g"', 'input = "pwm"'],
        ),
        (
            ["timestamp", *(f"q[{i}]" for i in range(4)), "x", "y", "z", "vx", "vy", "vz"],
            [
                '"q[3]"], unit = "1", convention = "quaternion_wxyz", frame = "ned"',
                '"vz"], unit = "m/s", frame = "ned"',
            ],
        ),
        (
            ["t", *(f"pose.pose.position.{a}" for a in "xyz"), *(f"pose.pose.orientation.{a}" for a in "xyzw")],
            ['position = {columns = ["pose.pose.position.x"', 'convention = "quaternion_xyzw"'],
        ),
        (
            [
                "timestamp",
                *(f"q[{i}]" for i in range(4)),
                *(f"imu_{s}[{i}]" for s in ("gyro", "accel") for i in range(3)),
            ],
            ['"imu_gyro[2]"], unit = "rad/s", frame = "frd"', '"imu_accel[2]"], unit = "g", frame = "frd"'],
        ),
        (
            [
                "t",
                *("X_mm", "Y_mm", "Z [m]", "phi_deg", "theta_deg", "psi_deg", "vx_mps", "vy_mps", "vz_mps"),
                *("wx_dps", "wy_dps", "wz_dps", "ax_g", "ay_g", "az_g", "m1_rpm", "m2_rpm", "vbat_mV"),
            ],
            [
                'position = {columns = ["X_mm", "Y_mm", "Z [m]"], unit = "m"}',
                '["phi_deg", "theta_deg", "psi_deg"], unit = "deg", convention',
                '["vx_mps", "vy_mps", "vz_mps"], unit = "m/s"',
                '["wx_dps", "wy_dps", "wz_dps"], unit = "deg/s"',
                '["ax_g", "ay_g", "az_g"], unit = "g"',
                'rotor_speed = {columns = ["m1_rpm", "m2_rpm"], unit = "rpm"}',
                'battery = {columns = ["vbat_mV"], unit = "mV"}',
            ],
        ),
    ],
)
def test_names_of_autopilots_are_known(columns: list[str], holds: list[str], tmp_path: Path) -> None:
    data = pd.DataFrame(np.ones((50, len(columns))), columns=columns)
    stamped = columns[0] == "timestamp"
    data[columns[0]] = np.arange(50) * (4000 if stamped else 0.004)
    data.to_csv(tmp_path / "a.csv", index=False)
    text = draft(tmp_path)
    for part in (*holds, "rate_hz = 250 ", *(['time_unit = "us"'] if stamped else [])):
        assert part in text


def test_the_unit_of_an_accelerometer_is_told_by_gravity(tmp_path: Path) -> None:
    data = pd.DataFrame(
        {"t": 0.01 * np.arange(50), "p": 0.1, "q": 0.2, "r": 0.3, "acc.x": 0.3, "acc.y": 0.1, "acc.z": 9.8}
    )
    data.to_csv(tmp_path / "a.csv", index=False)
    assert '"acc.z"], unit = "m/s^2"' in draft(tmp_path)
    data.assign(**{"acc.z": 1.02}).to_csv(tmp_path / "a.csv", index=False)
    assert '"acc.z"], unit = "g"' in draft(tmp_path)
