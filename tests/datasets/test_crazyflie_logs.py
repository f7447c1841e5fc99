"""Crazyflie logs written here, byte by byte as the firmware does or row by row as cfclient does, and read back."""

import struct
import zlib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from scipy.spatial.transform import Rotation

from bench.cli.commands.data import data_command
from registry.datasets.folder.dataset import Folder, check
from registry.datasets.logs.importing import convert
from registry.errors import BenchError
from registry.physics.quadrotor import Quadrotor
from registry.stated import refuse_unstated

SECONDS, RATE = 6.0, 100
TIMES = np.arange(0, SECONDS, 1 / RATE)
STATE: dict[str, tuple[str, np.ndarray]] = {
    "stateEstimate.x": ("f", 0.5 * TIMES),
    "stateEstimate.y": ("f", 0 * TIMES),
    "stateEstimate.z": ("f", 1 + 0.1 * TIMES),
    "stateEstimate.vx": ("f", 0.5 + 0 * TIMES),
    "stateEstimate.vy": ("f", 0 * TIMES),
    "stateEstimate.vz": ("f", 0.1 + 0 * TIMES),
    "stateEstimate.roll": ("f", 0 * TIMES),
    "stateEstimate.pitch": ("f", 30 + 0 * TIMES),  # the nose is up
    "stateEstimate.yaw": ("f", 90 + 0 * TIMES),
}
SENSORS: dict[str, tuple[str, np.ndarray]] = {
    "gyro.x": ("f", 90 + 0 * TIMES),
    "gyro.y": ("f", -45 + 0 * TIMES),
    "gyro.z": ("f", 10 * TIMES),
    "acc.x": ("f", 0 * TIMES),
    "acc.y": ("f", 0 * TIMES),
    "acc.z": ("f", 1 + 0 * TIMES),
    **{f"motor.m{i}": ("H", 30_000 + 1000 * i + np.round(100 * TIMES)) for i in (1, 2, 3, 4)},
}
POWER: dict[str, tuple[str, np.ndarray]] = {"pm.vbat": ("f", 4.1 - 0.01 * TIMES[::10])}


def usd_log(events: dict[str, tuple[np.ndarray, dict[str, tuple[str, np.ndarray]]]], version: int = 2) -> bytes:
    """As bitcraze.io describes the log of the micro SD card deck."""
    out = struct.pack("<BHH", 0xBC, version, len(events))
    for code, (name, (_, variables)) in enumerate(events.items()):
        out += struct.pack("<H", code) + name.encode() + b"\0" + struct.pack("<H", len(variables))
        out += b"".join(f"{variable}({kind})".encode() + b"\0" for variable, (kind, _) in variables.items())
    rows = []
    for code, (times, variables) in enumerate(events.values()):
        for k, t in enumerate(times):
            stamp = struct.pack("<Q", round(1e6 * t)) if version == 2 else struct.pack("<I", round(1e3 * t))
            values = (struct.pack(f"<{kind}", int(x[k]) if kind == "H" else x[k]) for kind, x in variables.values())
            rows.append((t, struct.pack("<H", code) + stamp + b"".join(values)))
    out += b"".join(row for _, row in sorted(rows, key=lambda r: r[0]))
    return out + struct.pack("<I", zlib.crc32(out))


def whole(version: int = 2) -> bytes:
    return usd_log(
        {"fixedFrequency": (20 + TIMES, {**STATE, **SENSORS}), "power": (20.003 + TIMES[::10], POWER)}, version
    )


def read(folder: Path) -> dict[str, np.ndarray]:
    """All signals of the parts that the only recording is cut into, (N, c)."""
    parts = check(folder).recordings
    groups = {c.group for c in parts[0].channels}
    return {g: np.concatenate([r.pick([g])[0] for r in parts]) for g in groups}


@pytest.mark.parametrize("version", [1, 2])
def test_a_memory_card_log_is_read_in_si_with_the_signs_of_the_firmware(version: int, tmp_path: Path) -> None:
    (tmp_path / "log00.bin").write_bytes(whole(version))  # told by its content
    said = convert([tmp_path / "log00.bin"], tmp_path / "out")
    assert Folder(str(tmp_path / "out")).description.rate == RATE
    x, n = read(tmp_path / "out"), len(TIMES) - 10
    np.testing.assert_allclose(x["position"][:n, 0], 0.5 * TIMES[:n], atol=2e-3)
    nose = Rotation.from_quat(x["attitude"][:n]).apply([1.0, 0, 0])
    np.testing.assert_allclose(nose, np.tile([0, np.cos(np.pi / 6), np.sin(np.pi / 6)], (n, 1)), atol=1e-6)
    np.testing.assert_allclose(x["body_rates"][:n, :2], np.tile([np.pi / 2, -np.pi / 4], (n, 1)), atol=1e-6)
    np.testing.assert_allclose(x["specific_force"][:n], np.tile([0, 0, 9.80665], (n, 1)), atol=1e-6)
    assert x["pwm"][0].tolist() == [31_000, 32_000, 33_000, 34_000]
    np.testing.assert_allclose(x["battery"][:n, 0], 4.1 - 0.01 * TIMES[:n], atol=2e-4)
    assert "power: values between samples are interpolated" in " ".join(said)


def test_what_the_vehicle_is_must_be_said_or_is_asked_for(tmp_path: Path) -> None:
    (tmp_path / "log00").write_bytes(whole())
    for vehicle, done in (("", "Complete the lines marked TODO"), ("crazyflie", "Next: bench data check")):
        out = tmp_path / (vehicle or "unknown")
        arguments = ["import", str(tmp_path / "log00"), "-o", str(out), *["--vehicle", vehicle][: 2 * bool(vehicle)]]
        result = CliRunner().invoke(data_command, arguments)
        assert result.exit_code == 0 and done in result.output, result.output
    with pytest.raises(BenchError, match="does not state mass"):
        refuse_unstated(Folder(str(tmp_path / "unknown")), Quadrotor)
    known = Folder(str(tmp_path / "crazyflie"))
    refuse_unstated(known, Quadrotor)
    assert known.physics["mass"] == 0.027 and known.uncertainty["pwm_offset"] == 1.0
    assert known.input_hold == "previous" and "TODO" not in (tmp_path / "crazyflie/dataset.toml").read_text()
    convert([tmp_path / "log00"], tmp_path / "again", vehicle=str(tmp_path / "crazyflie/dataset.toml"))
    assert Folder(str(tmp_path / "again")).physics == known.physics


def test_a_log_that_ends_with_the_battery_is_read_to_its_last_event(tmp_path: Path) -> None:
    (tmp_path / "log00").write_bytes(whole()[:-4000])
    assert "cut short" in convert([tmp_path / "log00"], tmp_path / "out")[0]
    x = read(tmp_path / "out")
    assert 0.7 * len(TIMES) < len(x["pwm"]) < 0.95 * len(TIMES)
    np.testing.assert_allclose(x["position"][-20:, 2], 1 + 0.1 * TIMES[len(x["pwm"]) - 20 : len(x["pwm"])], atol=2e-3)


def test_compressed_estimates_are_millimetres_and_milliradians_and_whole_voltages_millivolts(tmp_path: Path) -> None:
    short = {f"stateEstimateZ.{a}": ("h", np.full(len(TIMES), 10.0 * i)) for i, a in enumerate(("x", "y", "z"))}
    rates = {f"stateEstimateZ.rate{a}": ("h", np.full(len(TIMES), 500.0)) for a in ("Roll", "Pitch", "Yaw")}
    values = {k: ("f", x) for k, (_, x) in (short | rates).items()}
    (tmp_path / "log00").write_bytes(usd_log({"fixedFrequency": (TIMES, values | SENSORS)}))
    convert([tmp_path / "log00"], tmp_path / "out")
    signals = Folder(str(tmp_path / "out")).description.signals
    assert signals["position"].unit == "mm"
    assert signals["body_rates"].unit == "deg/s"  # the gyroscope's, which are finer
    pure = {k: v for k, v in SENSORS.items() if not k.startswith("gyro")}
    pure["pm.vbatMV"] = "H", np.full(len(TIMES), 3950)
    (tmp_path / "log01").write_bytes(usd_log({"fixedFrequency": (TIMES, values | pure)}))
    convert([tmp_path / "log01"], tmp_path / "out1")
    np.testing.assert_allclose(read(tmp_path / "out1")["body_rates"], np.tile([0.5, -0.5, 0.5], (len(TIMES), 1)))
    np.testing.assert_allclose(read(tmp_path / "out1")["battery"], 3.95)


def test_the_files_that_cfclient_writes_for_each_block_are_one_recording(tmp_path: Path) -> None:
    stamps = 1000 * (20 + TIMES)
    for name, block, late in (("state", STATE, 0), ("sensors", SENSORS, 3), ("power", POWER, 5)):
        columns = {k: x for k, (_, x) in block.items()}
        every = len(TIMES) // len(next(iter(columns.values())))
        table = pd.DataFrame({"Timestamp": (stamps[::every] + late).astype(int), **columns})
        table.to_csv(tmp_path / f"{name}.csv", index=False)
    said = convert([tmp_path / f"{n}.csv" for n in ("state", "sensors", "power")], tmp_path / "out")
    assert len(said) == 1 and "power" in said[0]
    x, n = read(tmp_path / "out"), len(TIMES) - 20
    np.testing.assert_allclose(x["position"][:n, 0], 0.5 * TIMES[:n], atol=2e-3)
    np.testing.assert_allclose(x["body_rates"][:n, 2], np.deg2rad(10 * (TIMES[:n] - 0.003)), atol=2e-3)
    np.testing.assert_allclose(x["battery"][:n, 0], 4.1 - 0.01 * (TIMES[:n] - 0.005), atol=2e-4)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "neither a PX4 ULog"),
        (b"\xbc", "does not begin"),
        (b"\xbc" + bytes(40), "version 0"),
        (whole()[:80], "damaged"),
        (whole().replace(b"gyro.x(f)", b"gyro.x(P)"), "unknown type"),
        (usd_log({"fixedFrequency": (TIMES[:0], STATE)}), "no events"),
        (usd_log({"fixedFrequency": (TIMES[:2], {k: (c, x[:2]) for k, (c, x) in STATE.items()})}), "2 samples"),
    ],
)
def test_a_broken_log_is_one_sentence(content: bytes, says: str, tmp_path: Path) -> None:
    (tmp_path / "log00").write_bytes(content)
    with pytest.raises(BenchError, match=says):
        convert([tmp_path / "log00"], tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.data
def test_a_real_log_is_described_without_a_question(bench_data: Path, tmp_path: Path) -> None:
    """CrazyPAD: no motors' variables are in it, but the estimate and the rates that its controller was given."""
    file = bench_data / "crazypad_mass_prop/controller_data/normal_flight/E9_log00"
    said = convert([file], tmp_path / "out", vehicle="crazyflie")
    assert "at 100 Hz: 19 columns of fixedFrequency (100.9 Hz)" in said[0] and "No motor signal" in said[1]
    text = (tmp_path / "out/dataset.toml").read_text()
    assert 'columns = ["controller.r_roll", "-controller.r_pitch", "controller.r_yaw"], unit = "rad/s"' in text
    assert 'columns = ["stateEstimate.x", "stateEstimate.y", "stateEstimate.z"]' in text
    assert {r.rate for r in check(tmp_path / "out").recordings} == {100} and not Folder(str(tmp_path / "out")).system
