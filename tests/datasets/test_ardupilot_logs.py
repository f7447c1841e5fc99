"""DataFlash logs written here message by message, as ArduPilot's logger does, and read back."""

import re
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from registry.core import PHYSICS
from registry.datasets.folder.dataset import Folder, check
from registry.datasets.logs.formats.dataflash import read as read_messages
from registry.datasets.logs.importing import convert
from registry.errors import BenchError
from registry.stated import refuse_unstated

SECONDS = 8.0
PACKED = {"Q": "Q", "f": "f", "B": "B", "c": "h", "C": "H", "H": "H", "N": "16s", "h": "h"}
KINDS: dict[str, tuple[str, str]] = {
    "PARM": ("QNff", "TimeUS,Name,Value,Default"),
    "ATT": ("QccC", "TimeUS,Roll,Pitch,Yaw"),
    "IMU": ("QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
    "XKF1": ("QBffffff", "TimeUS,C,VN,VE,VD,PN,PE,PD"),
    "RCOU": ("QHHHHHH", "TimeUS,C1,C2,C3,C4,C5,C6"),
    "BAT": ("QBf", "TimeUS,Inst,Volt"),
    "ESC": ("QBf", "TimeUS,Instance,RPM"),
    "EV": ("QB", "TimeUS,Id"),
    "JUNK": ("QZ", "TimeUS,Text"),
}
PARAMETERS = {"FRAME_CLASS": 1, "FRAME_TYPE": 1, "MOT_PWM_MIN": 1000, "MOT_PWM_MAX": 2000}
PARAMETERS |= {f"SERVO{output}_FUNCTION": 32 + motor for output, motor in ((1, 2), (2, 1), (5, 3), (6, 4))}


def dataflash(rows: dict[str, list[tuple[float, ...]]], parameters: dict[str, float] = PARAMETERS) -> bytes:
    """The messages in the order of their times."""
    rows = {"PARM": [(0, name.encode(), value, 0) for name, value in parameters.items()], **rows}
    packed = PACKED | {"Z": "64s"}
    layouts = {name: "<" + "".join(packed[c] for c in letters) for name, (letters, _) in KINDS.items()}

    def described(number: int, name: str, letters: str, labels: str, layout: str) -> bytes:
        size = 3 + struct.calcsize(layout)
        content = struct.pack("<BB4s16s64s", number, size, name.encode(), letters.encode(), labels.encode())
        return b"\xa3\x95\x80" + content

    out = described(128, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns", "<BB4s16s64s")
    for number, (name, (letters, labels)) in enumerate(KINDS.items(), start=1):
        out += described(number, name, letters, labels, layouts[name])
    numbers = {name: i for i, name in enumerate(KINDS, start=1)}
    ordered = sorted(((row[0], name, row) for name, data in rows.items() for row in data), key=lambda r: r[:2])
    return out + b"".join(b"\xa3\x95" + bytes([numbers[n]]) + struct.pack(layouts[n], *row) for _, n, row in ordered)


def times(rate: float) -> list[tuple[int, float]]:
    return [(round(1e6 * t), t) for t in np.arange(0, SECONDS, 1 / rate)]


def flight(landed_until: float = 3.0, esc: float = 10.0) -> dict[str, list[tuple[float, ...]]]:
    """North at 2 m/s, sinking at 1 m/s; nose up by 30° to the east; ω = 900 (pwm − 1000)/1000 + 150 rad/s."""

    def pulse(t: float) -> int:
        return round(1500 + 100 * np.sin(2 * t))

    return {
        "ATT": [(us, 0, 3000, 9000) for us, _ in times(100)],
        "IMU": [(us, i, 0.1 + i, 0.2, 0.3, 0.5, 0.0, -9.5) for us, _ in times(200) for i in (0, 1)],
        "XKF1": [(us, core, 2.0, 0.0, 1.0, 2 * t + 50 * core, 0.5, t) for us, t in times(50) for core in (0, 1)],
        "RCOU": [
            (us, pulse(t), pulse(t) + 10, 1500, 1500 + round(10 * t), pulse(t) + 20, pulse(t) + 30)
            for us, t in times(100)
        ],
        "BAT": [(us, i, 16.0 - t / 10 - i) for us, t in times(10) for i in (0, 1)],
        "ESC": [
            (us + i, i, (0.9 * (pulse(t) + d - 1000) + 150) * 30 / np.pi)
            for us, t in times(esc)
            for i, d in enumerate((10, 0, 20, 30))
        ],
        "EV": [(round(1e6 * landed_until), 28), (round(7.5e6), 18)],
        "JUNK": [(5, b"\xa3\x95\x80 looks like a message")],
    }


def test_messages_become_signals_in_the_frames_of_this_project(tmp_path: Path) -> None:
    (tmp_path / "12.BIN").write_bytes(dataflash(flight()))
    said = " ".join(convert([tmp_path / "12.BIN"], tmp_path / "out"))
    assert "4.5 s in 1 recording(s) at 100 Hz" in said and "time on the ground, by EV, is left out" in said
    (r,) = check(tmp_path / "out").recordings
    t, n = 3 + np.arange(len(r)) / 100, len(r)
    for signal, values in {
        "position": np.stack([0 * t + 0.5, 2 * t, -t], axis=1),
        "velocity": np.tile([0.0, 2.0, -1.0], (n, 1)),
        "body_rates": np.tile([0.1, -0.2, -0.3], (n, 1)),
        "specific_force": np.tile([0.5, 0.0, 9.5], (n, 1)),
        "battery": 16 - t[:, None] / 10,
    }.items():
        np.testing.assert_allclose(r.pick([signal])[0], values, atol=1e-5, err_msg=signal)
    turned = Rotation.from_quat(r.pick(["attitude"])[0][0])
    c, s = np.cos(np.pi / 6), np.sin(np.pi / 6)
    np.testing.assert_allclose(turned.apply(np.eye(3)), [[c, 0, s], [0, 1, 0], [-s, 0, c]], atol=1e-6)
    # In the order of the motors, by SERVOn_FUNCTION: outputs 2, 1, 5, 6; share of the pulses' range.
    np.testing.assert_allclose(np.diff(r.inputs[5]), [-0.01, 0.02, 0.01], atol=1e-6)


def test_messages_are_what_ardupilots_own_reader_finds(tmp_path: Path) -> None:
    """Every number of every message, and the parameters."""
    theirs = pytest.importorskip("pymavlink.DFReader")
    (tmp_path / "flight.bin").write_bytes(dataflash(flight()))
    found: dict[str, dict[str, list[Any]]] = {}
    log = theirs.DFReader_binary(str(tmp_path / "flight.bin"))
    while (message := log.recv_msg()) is not None:
        columns = found.setdefault(message.get_type(), {name: [] for name in message.get_fieldnames()})
        for name, values in columns.items():
            values.append(getattr(message, name))
    ours = read_messages(tmp_path / "flight.bin", KINDS.keys())
    assert ours.skipped == 0 and found.keys() - {"FMT"} == {*ours.messages, "PARM"}
    assert ours.parameters == dict(zip(found["PARM"]["Name"], found["PARM"]["Value"], strict=True))
    for kind, columns in ours.messages.items():
        assert list(columns) == list(found[kind])
        for name, values in columns.items():
            if values.dtype.kind != "S":
                np.testing.assert_allclose(values, found[kind][name], rtol=1e-12, err_msg=f"{kind}.{name}")


def test_frame_and_motor_controllers_say_what_they_know(tmp_path: Path) -> None:
    (tmp_path / "12.bin").write_bytes(dataflash(flight()))
    convert([tmp_path / "12.bin"], tmp_path / "out")
    stated = Folder(str(tmp_path / "out")).physics
    assert stated["rotor_directions"] == (-1, -1, 1, 1)
    assert stated["pwm_gain"] == pytest.approx(900, rel=0.02) and stated["pwm_offset"] == pytest.approx(150, abs=10)
    text = (tmp_path / "out" / "dataset.toml").read_text()
    assert "in the order front right, rear left, front left, rear right" in text
    with pytest.raises(BenchError, match=r"does not state mass .* inertia .* thrust_coeff.* torque_coeff.* rotor_pos"):
        refuse_unstated(Folder(str(tmp_path / "out")), PHYSICS.get("quadrotor"))


def test_without_speeds_the_thrust_curve_tells_what_a_command_does(tmp_path: Path) -> None:
    """Thrust (1 − e) r + e r² of a share r is that of a speed in proportion to the command and an offset."""
    curve = {"MOT_THST_EXPO": 0.65, "MOT_SPIN_MIN": 0.15, "MOT_SPIN_MAX": 0.95}
    (tmp_path / "12.bin").write_bytes(dataflash({k: v for k, v in flight().items() if k != "ESC"}, PARAMETERS | curve))
    convert([tmp_path / "12.bin"], tmp_path / "out")
    text = (tmp_path / "out" / "dataset.toml").read_text()
    assert "a guess, such as 1000: thrust_coefficient takes up" in text
    share = float(re.search(r"(\S+) × pwm_gain, as MOT_THST_EXPO", text)[1])  # type: ignore[index]
    r = np.linspace(0, 1, 9)
    thrust, speed = 0.35 * r + 0.65 * r**2, 0.15 + 0.8 * r + share
    assert np.polyfit(speed**2, thrust, 1, full=True)[1] < 1e-5


def test_before_outputs_had_names_those_of_a_gimbal_are_no_motors(tmp_path: Path) -> None:
    """ArduPilot until 3.4 names no motors; RC5_FUNCTION and RC6_FUNCTION 7 and 8 are pan and tilt of a camera."""
    rows, old = {k: v for k, v in flight().items() if k != "ESC"}, {"FRAME": 1}
    rows["RCOU"] = [(us, *row[:2], row[0] + 1, *row[3:]) for us, *row in rows["RCOU"]]
    for name, functions, motors in (("gimbal", {"RC5_FUNCTION": 7, "RC6_FUNCTION": 8}, 4), ("six", {}, 6)):
        (tmp_path / f"{name}.bin").write_bytes(dataflash(rows, old | functions))
        said = " ".join(convert([tmp_path / f"{name}.bin"], tmp_path / name))
        (r,) = check(tmp_path / name).recordings
        assert len(r.input_channels) == motors
        # Signs of a quadrotor's four rotors are none of six.
        assert ("rotor_directions" in Folder(str(tmp_path / name)).physics) == (motors == 4)
        assert ("another number of rotors than the 6" in said) == (motors == 6)


def test_a_file_without_motors_is_named_among_the_others(tmp_path: Path) -> None:
    (tmp_path / "flown.bin").write_bytes(dataflash(flight()))
    (tmp_path / "glider.bin").write_bytes(dataflash({k: v for k, v in flight().items() if k not in ("RCOU", "ESC")}))
    with pytest.raises(BenchError, match=r"^glider: no motor signal"):
        convert([tmp_path / "flown.bin", tmp_path / "glider.bin"], tmp_path / "out")


def test_fast_speeds_of_the_motor_controllers_drive(tmp_path: Path) -> None:
    (tmp_path / "12.bin").write_bytes(dataflash(flight(esc=100)))
    convert([tmp_path / "12.bin"], tmp_path / "out")
    (r,) = check(tmp_path / "out").recordings
    assert {c.group for c in r.input_channels} == {"rotor_speed"}
    np.testing.assert_allclose(r.inputs[10, 0] - r.inputs[10, 1], 9.0, atol=0.05)


def test_damaged_stretches_are_skipped_and_said(tmp_path: Path) -> None:
    whole = dataflash(flight())
    at = len(whole) * 2 // 3
    (tmp_path / "12.bin").write_bytes(whole[:at] + bytes(5) + whole[at + 40 : -7])
    assert "bytes belong to no message" in " ".join(convert([tmp_path / "12.bin"], tmp_path / "out"))
    (r,) = check(tmp_path / "out").recordings
    assert r.seconds == pytest.approx(4.5, abs=0.2)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "does not begin with 0xA3"),
        (b"\xa3\x95\x80" + bytes(86), "no message that is known"),
        (dataflash({"ATT": flight()["ATT"]}), "no motor signal"),
        (dataflash({k: v for k, v in flight().items() if k != "ATT"}), "no attitude"),
        (dataflash(flight(landed_until=7.0)), "no 2 s in the air"),
    ],
)
def test_a_log_that_does_not_do_is_one_sentence(content: bytes, says: str, tmp_path: Path) -> None:
    (tmp_path / "12.bin").write_bytes(content)
    with pytest.raises(BenchError, match=says):
        convert([tmp_path / "12.bin"], tmp_path / "out")
    assert not (tmp_path / "out").exists()
