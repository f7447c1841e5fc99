"""ULogs written here byte by byte, and bags by rosbags' own writers, read back as folders of CSV files."""

import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from scipy.spatial.transform import Rotation

from bench.cli.commands.data import data_command
from registry.core import PHYSICS
from registry.datasets.folder.dataset import Folder, check
from registry.datasets.logs.formats.ulog import read as read_topics
from registry.datasets.logs.importing import convert
from registry.errors import BenchError
from registry.stated import refuse_unstated

pytest.importorskip("rosbags")

FORMATS = {
    "vehicle_local_position": "uint64_t timestamp;float x;float y;float z;float vx;float vy;float vz;bool xy_valid;",
    "vehicle_attitude": "uint64_t timestamp;uint64_t timestamp_sample;float[4] q;",
    "vehicle_angular_velocity": "uint64_t timestamp;float[3] xyz;",
    "actuator_motors": "uint64_t timestamp;float[12] control;",
    "battery_status": "uint64_t timestamp;float voltage_v;",
    "esc_report": "int32_t esc_rpm;uint8_t[4] _padding0;",
    "esc_status": "uint64_t timestamp;esc_report[8] esc;uint8_t[3] _padding0;",
    "vehicle_land_detected": "uint64_t timestamp;bool landed;bool ground_contact;",
}
LAYOUTS = {
    "vehicle_local_position": "<Q6f?",
    "vehicle_attitude": "<QQ4f",
    "vehicle_angular_velocity": "<Q3f",
    "actuator_motors": "<Q12f",
    "battery_status": "<Qf",
    "esc_status": "<Q" + "i4x" * 8,  # the padding at its end is not written
    "vehicle_land_detected": "<Q??",
}
STILL = (1.0, 0.0, 0.0, 0.0)


def message(kind: bytes, content: bytes) -> bytes:
    return struct.pack("<H", len(content)) + kind + content


def ulog(path: Path, rows: dict[str, list[tuple[float, ...]]], parameters: dict[str, float] | None = None) -> None:
    """A ULog of these topics, as https://docs.px4.io/main/en/dev_log/ulog_file_format.html has it."""
    out = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0)
    for topic in (*rows, "esc_report"):
        out += message(b"F", f"{topic}:{FORMATS[topic]}".encode())
    for name, value in (parameters or {}).items():
        key = f"{'int32_t' if isinstance(value, int) else 'float'} {name}".encode()
        packed = struct.pack("<i" if isinstance(value, int) else "<f", value)
        out += message(b"P", bytes([len(key)]) + key + packed)
    for number, topic in enumerate(rows):
        out += message(b"A", struct.pack("<BH", 0, number) + topic.encode())
    for number, (topic, data) in enumerate(rows.items()):
        for row in data:
            out += message(b"D", struct.pack("<H", number) + struct.pack(LAYOUTS[topic], *row))
    path.write_bytes(out)


def px4(seconds: float = 4.0, q: tuple[float, ...] = STILL, gap: tuple[float, float] = (9, 9)) -> dict[str, list]:
    """Flying north at 2 m/s, sinking at 1 m/s, turning right at .3 rad/s about body z, at different rates."""

    def times(rate: float) -> list[float]:
        return [t for t in np.arange(0, seconds, 1 / rate) if not gap[0] < t < gap[1]]

    return {
        "vehicle_local_position": [(int(1e6 * t), 2 * t, 0.5, t, 2.0, 0.0, 1.0, True) for t in times(50)],
        "vehicle_attitude": [(int(1e6 * t) + 700, int(1e6 * t), *q) for t in times(125)],
        "vehicle_angular_velocity": [(int(1e6 * t), 0.1, 0.2, 0.3) for t in times(250)],
        "actuator_motors": [(int(1e6 * t), t / 10, 0.5, 0.5 - t / 20, t / 9, *[np.nan] * 8) for t in times(100)],
        "battery_status": [(int(1e6 * t), 16.0 - t / 10) for t in times(5)],
    }


def test_px4_axes_become_east_north_up_and_forward_left_up(tmp_path: Path) -> None:
    ulog(tmp_path / "flight.ulg", px4())
    convert([tmp_path / "flight.ulg"], tmp_path / "out")
    with pytest.raises(BenchError, match="does not state mass"):  # of the vehicle that flew, no other
        refuse_unstated(Folder(str(tmp_path / "out")), PHYSICS.get("quadrotor"))
    (recording,) = check(tmp_path / "out").recordings
    assert recording.rate == 100
    t = np.arange(len(recording)) / recording.rate
    expected = {
        "position": np.stack([0 * t + 0.5, 2 * t, -t], axis=1),  # north is y, down is −z
        "velocity": np.tile([0.0, 2.0, -1.0], (len(t), 1)),
        "body_rates": np.tile([0.1, -0.2, -0.3], (len(t), 1)),  # turning right is negative about the z that is up
        "battery": 16.0 - t[:, None] / 10,
    }
    for signal, values in expected.items():
        np.testing.assert_allclose(recording.pick([signal])[0], values, atol=1e-5, err_msg=signal)
    # Nose to the north, level: a quarter turn to the left from east.
    turned = Rotation.from_quat(recording.pick(["attitude"])[0])
    np.testing.assert_allclose(turned.apply([1, 0, 0]), np.tile([0, 1.0, 0], (len(t), 1)), atol=1e-6)
    np.testing.assert_allclose(turned.apply([0, 0, 1]), np.tile([0, 0, 1.0], (len(t), 1)), atol=1e-6)
    # Motor commands are as logged, unused outputs are left out.
    assert [c.name for c in recording.input_channels] == [f"pwm.{i}" for i in (1, 2, 3, 4)]
    np.testing.assert_allclose(recording.inputs[:, 0], t / 10, atol=1e-3)


def test_px4_attitude_is_turned_as_vectors_are(tmp_path: Path) -> None:
    """What the nose, the left wing and the roof point to, by hand: pitched up by 30° with the nose to the east."""
    c, s = np.cos(np.deg2rad(15)), np.sin(np.deg2rad(15))
    yaw, pitch = np.array([2**-0.5, 0, 0, 2**-0.5]), np.array([c, 0, s, 0])  # wxyz, NED: yaw 90°, then pitch 30°
    w = yaw[0] * pitch[0] - yaw[1:] @ pitch[1:]
    v = yaw[0] * pitch[1:] + pitch[0] * yaw[1:] + np.cross(yaw[1:], pitch[1:])
    ulog(tmp_path / "flight.ulg", px4(q=(w, *v)))
    convert([tmp_path / "flight.ulg"], tmp_path / "out")
    turned = Rotation.from_quat(check(tmp_path / "out").recordings[0].pick(["attitude"])[0][0])
    c, s = np.cos(np.deg2rad(30)), np.sin(np.deg2rad(30))
    np.testing.assert_allclose(turned.apply(np.eye(3)), [[c, 0, s], [0, 1, 0], [-s, 0, c]], atol=1e-6)


def test_a_gap_cuts_and_a_rate_is_kept(tmp_path: Path) -> None:
    ulog(tmp_path / "flight.ulg", px4(seconds=8.0, gap=(3.0, 4.0)))
    said = convert([tmp_path / "flight.ulg"], tmp_path / "out", rate=200)
    recordings = check(tmp_path / "out").recordings
    assert [(r.name, r.rate) for r in recordings] == [("flight_part1", 200), ("flight_part2", 200)]
    assert [round(r.seconds) for r in recordings] == [3, 4]
    assert "attitude, velocity, battery came slower than 200 Hz: interpolated" in " ".join(said)
    assert "pwm came slower than 200 Hz: held" in " ".join(said)
    with pytest.raises(BenchError, match=r"--rate 1e\+06 is beyond them all"):
        convert([tmp_path / "flight.ulg"], tmp_path / "out2", rate=1e6)


ROTORS = {"CA_ROTOR_COUNT": 4}
for i, (x, y, turn) in enumerate(((0.1, 0.2, 0.05), (-0.1, -0.2, 0.05), (0.1, -0.2, -0.05), (-0.1, 0.2, -0.05))):
    ROTORS |= {f"CA_ROTOR{i}_PX": x, f"CA_ROTOR{i}_PY": y, f"CA_ROTOR{i}_PZ": 0.0, f"CA_ROTOR{i}_KM": turn}


def telemetry(rate: float, seconds: float = 8.0) -> dict[str, list]:
    """Hovering with motors at ω = 800 u + 100 rad/s, speeds logged at ``rate``; on the ground until 3 s."""
    rows = px4(seconds=seconds)
    commands = [0.5 + 0.1 * np.sin(k / 40) for k in range(int(100 * seconds))]
    rows["actuator_motors"] = [(10_000 * k, u, u, u, u, *[np.nan] * 8) for k, u in enumerate(commands)]
    rows["esc_status"] = [
        (10_000 * k, *[round((800 * commands[k] + 100) * 30 / np.pi)] * 4, *[0] * 4)
        for k in range(0, len(commands), round(100 / rate))
    ]
    rows["vehicle_land_detected"] = [(int(1e6 * t), t < 2, t < 3) for t in np.arange(0, seconds, 0.5)]
    return rows


def test_rotors_landings_and_the_map_of_the_motors_are_in_the_log(tmp_path: Path) -> None:
    ulog(tmp_path / "flight.ulg", telemetry(rate=4), {"MC_AIRMODE": 1, **ROTORS})
    said = " ".join(convert([tmp_path / "flight.ulg"], tmp_path / "out"))
    assert "4.8 s in 1 recording(s) at 100 Hz" in said and "time on the ground, by landed, is left out" in said
    assert "another tells more: rotor_speed" in said  # of 4 Hz
    stated = Folder(str(tmp_path / "out")).physics
    np.testing.assert_allclose(
        stated["rotor_positions"], [[0.1, -0.2, 0], [-0.1, 0.2, 0], [0.1, 0.2, 0], [-0.1, -0.2, 0]]
    )
    assert stated["rotor_directions"] == (-1, -1, 1, 1)  # what turns counter-clockwise turns the body clockwise
    assert stated["pwm_gain"] == pytest.approx(800, rel=1e-3) and stated["pwm_offset"] == pytest.approx(100, rel=1e-2)
    with pytest.raises(BenchError, match=r"does not state mass .*, inertia .*, thrust_coefficient .*, torque_coeff"):
        refuse_unstated(Folder(str(tmp_path / "out")), PHYSICS.get("quadrotor"))


def test_measured_speeds_drive_where_they_are_fast_enough(tmp_path: Path) -> None:
    ulog(tmp_path / "flight.ulg", telemetry(rate=50))
    convert([tmp_path / "flight.ulg"], tmp_path / "out")
    description = Folder(str(tmp_path / "out")).description
    assert description.inputs == ("rotor_speed",) and description.rate == 50 and "pwm" in description.signals


def test_with_mass_and_inertia_no_question_is_left(tmp_path: Path) -> None:
    """k_f so that the median of thrust is mass × that of specific force, k_m by the moment ratio."""
    rows = telemetry(rate=4)
    rows["sensor_combined"] = [(4000 * k, 0, 0, 0, 0, 0, -9.5) for k in range(2000)]
    FORMATS["sensor_combined"] = "uint64_t timestamp;float[3] gyro_rad;float[3] accelerometer_m_s2;"
    LAYOUTS["sensor_combined"] = "<Q6f"
    ulog(tmp_path / "flight.ulg", rows, ROTORS)
    (tmp_path / "vehicle.toml").write_text("[physics]\nmass = 1.5\ninertia = [0.03, 0.03, 0.05]\n")
    convert([tmp_path / "flight.ulg"], tmp_path / "out", vehicle=str(tmp_path / "vehicle.toml"))
    assert "TODO" not in (tmp_path / "out" / "dataset.toml").read_text()
    folder = Folder(str(tmp_path / "out"))
    refuse_unstated(folder, PHYSICS.get("quadrotor"))
    omega = 800 * np.array([row[1] for row in rows["actuator_motors"]])[300:781] + 100
    assert folder.physics["thrust_coefficient"] == pytest.approx(1.5 * 9.5 / (4 * np.median(omega**2)), rel=2e-3)
    assert folder.physics["torque_coefficient"] == pytest.approx(0.05 * folder.physics["thrust_coefficient"], rel=1e-4)


def test_shares_of_thrust_become_motor_signals(tmp_path: Path) -> None:
    rows = px4()
    rows["actuator_motors"] = [(int(1e6 * t), *[0.36 + t / 100] * 4, *[np.nan] * 8) for t in np.arange(0, 4, 0.01)]
    ulog(tmp_path / "flight.ulg", rows, {"THR_MDL_FAC": 0.4})
    said = convert([tmp_path / "flight.ulg"], tmp_path / "out")
    signal = check(tmp_path / "out").recordings[0].inputs[:, 0]
    np.testing.assert_allclose(0.4 * signal**2 + 0.6 * signal, 0.36 + np.arange(len(signal)) / 1e4, atol=1e-4)
    assert "THR_MDL_FAC = 0.4" in " ".join(said)


def test_without_motors_setpoints_drive_networks(tmp_path: Path) -> None:
    rows = _no_motors(px4())
    FORMATS["vehicle_rates_setpoint"] = "uint64_t timestamp;float roll;float pitch;float yaw;float[3] thrust_body;"
    LAYOUTS["vehicle_rates_setpoint"] = "<Q6f"
    rows["vehicle_rates_setpoint"] = [(20_000 * k, 0.1, 0.2, 0.3, 0, 0, -0.6) for k in range(200)]
    rows["actuator_motors"] = [(10_000 * k, *[0.0] * 12) for k in range(400)]
    ulog(tmp_path / "flight.ulg", rows)
    said = convert([tmp_path / "flight.ulg"], tmp_path / "out")
    assert "flight: actuator_motors stood still, as of a vehicle that was not armed." in said
    (recording,) = check(tmp_path / "out").recordings
    np.testing.assert_allclose(recording.inputs, np.tile([0.6, 0.1, -0.2, -0.3], (len(recording), 1)), atol=1e-6)
    assert not Folder(str(tmp_path / "out")).system


def test_topics_are_what_px4s_own_reader_finds(tmp_path: Path) -> None:
    """Arrays, types within types, several instances, a lost stretch, and the tail that a crash appended."""
    pyulog = pytest.importorskip("pyulog")
    rows = telemetry(rate=20)
    ulog(tmp_path / "plain.ulg", rows, ROTORS)
    content = (tmp_path / "plain.ulg").read_bytes()
    flags = bytes(8) + b"\x01" + bytes(7)
    more = content[16:] + message(b"O", struct.pack("<H", 120))
    more += message(b"A", struct.pack("<BH", 1, 99) + b"battery_status")
    more += message(b"D", struct.pack("<H", 99) + struct.pack("<Qf", 5, 1.0))
    late = message(b"D", struct.pack("<H", 4) + struct.pack("<Qf", 9_000_000, 11.0))
    at = 16 + 43 + len(more) + 5
    more += b"\xff\x00Dxx"  # cut by the crash
    whole = content[:16] + message(b"B", flags + struct.pack("<3Q", at, 0, 0)) + more + late
    (tmp_path / "crash.ulg").write_bytes(whole)
    ours, theirs = read_topics(tmp_path / "plain.ulg", FORMATS), pyulog.ULog(str(tmp_path / "plain.ulg"))
    found = {d.name: d.data for d in theirs.data_list}
    assert set(ours.topics) == set(found) == set(rows)
    for topic, data in found.items():
        assert set(ours.topics[topic]) == set(data)
        for column, values in data.items():
            np.testing.assert_array_equal(ours.topics[topic][column], values, err_msg=f"{topic} {column}")
    assert ours.parameters == {k: float(v) for k, v in theirs.initial_parameters.items()} and ours.whole
    crash = read_topics(tmp_path / "crash.ulg", FORMATS)
    assert crash.dropped == 0.12 and crash.whole and set(crash.topics) == set(rows)
    np.testing.assert_array_equal(
        crash.topics["battery_status"]["voltage_v"][:-1], found["battery_status"]["voltage_v"]
    )
    assert crash.topics["battery_status"]["voltage_v"][-1] == 11.0


def bag(path: Path, version: int, actuators: str = "mav_msgs/msg/Actuators", wheels: bool = False) -> Path:
    """Circling at 1 rad/s on a circle of 2 m, nose along the path, as ROS odometry has it: twist in the body frame.

    On ``wheels`` in place of rotors, it is told its speed and turn, without a stamp.
    """
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if version == 1 else Stores.ROS2_HUMBLE)
    definition = "std_msgs/Header header\nfloat64[] angles\nfloat64[] angular_velocities\nfloat64[] normalized\n"
    store.register(get_types_from_msg(definition, actuators))
    kind = store.types

    def header(t: float) -> object:
        stamp = kind["builtin_interfaces/msg/Time"](sec=int(t), nanosec=round(1e9 * (t % 1)))
        sequence = {"seq": 0} if version == 1 else {}
        return kind["std_msgs/msg/Header"](stamp=stamp, frame_id="map", **sequence)

    def vector(*xyz: float, of: str = "Vector3") -> object:
        return kind[f"geometry_msgs/msg/{of}"](*map(float, xyz))

    def odometry(t: float) -> object:
        yaw = t + np.pi / 2
        turn = kind["geometry_msgs/msg/Quaternion"](0.0, 0.0, float(np.sin(yaw / 2)), float(np.cos(yaw / 2)))
        pose = kind["geometry_msgs/msg/Pose"](vector(2 * np.cos(t), 2 * np.sin(t), 1.0, of="Point"), turn)
        twist = kind["geometry_msgs/msg/Twist"](vector(2.0, 0, 0), vector(0, 0, 1.0))
        return kind["nav_msgs/msg/Odometry"](
            header(t),
            "base_link",
            kind["geometry_msgs/msg/PoseWithCovariance"](pose, np.zeros(36)),
            kind["geometry_msgs/msg/TwistWithCovariance"](twist, np.zeros(36)),
        )

    def motors(t: float) -> object:
        return kind[actuators](header(t), np.zeros(0), np.array([500.0, 510, 520, 530 + t]), np.zeros(0))

    def wanted(t: float) -> object:
        return kind["geometry_msgs/msg/Twist"](vector(2.0 + t, 0, 0), vector(0, 0, 1.0 - t))

    late = 0.3 * (not wheels)  # of the recorder, against the stamps
    driven = ("/cmd_vel", "geometry_msgs/msg/Twist", wanted) if wheels else ("/motor_speed", actuators, motors)
    writer = Writer1(path) if version == 1 else Writer2(path, version=9, storage_plugin=StoragePlugin.SQLITE3)
    with writer:
        topics = (("/odom", "nav_msgs/msg/Odometry", odometry), driven)
        for topic, type_name, build in topics:
            connection = writer.add_connection(topic, type_name, typestore=store)
            for t in np.arange(0.0, 5.0, 0.01):
                built = build(t)
                raw = store.serialize_ros1(built, type_name) if version == 1 else store.serialize_cdr(built, type_name)
                writer.write(connection, round(1e9 * (t + late)), raw)
    return path


@pytest.mark.parametrize("version", [1, 2])
def test_a_bag_is_read_with_velocities_turned_into_the_world(version: int, tmp_path: Path) -> None:
    file = bag(tmp_path / ("run.bag" if version == 1 else "run"), version)
    convert([file], tmp_path / "out")
    parts = check(tmp_path / "out").recordings  # of the only recording
    assert {r.rate for r in parts} == {100} and parts[0].input_channels[0].group == "rotor_speed"
    t = np.arange(sum(map(len, parts))) / 100
    velocity, rates = (np.concatenate([r.pick([s])[0] for r in parts]) for s in ("velocity", "body_rates"))
    expected = np.stack([-2 * np.sin(t), 2 * np.cos(t), 0 * t], axis=1)
    np.testing.assert_allclose(velocity, expected, atol=1e-6)
    np.testing.assert_allclose(rates, np.tile([0, 0, 1.0], (len(t), 1)), atol=1e-9)
    np.testing.assert_allclose(np.concatenate([r.inputs for r in parts])[:, 3], 530 + t, atol=1e-6)


@pytest.mark.parametrize("version", [1, 2])
def test_a_robot_on_wheels_is_driven_by_the_velocity_that_it_is_told(version: int, tmp_path: Path) -> None:
    file = bag(tmp_path / ("run.bag" if version == 1 else "run"), version, wheels=True)
    said = convert([file], tmp_path / "out")
    assert "velocity_command and rate_command can drive networks, no physics model" in " ".join(said)
    parts, told = check(tmp_path / "out").recordings, np.zeros((500, 6))
    told[:, 0], told[:, 5] = 2 + np.arange(500) / 100, 1 - np.arange(500) / 100
    np.testing.assert_allclose(np.concatenate([r.inputs for r in parts])[:499], told[:499], atol=1e-6)
    assert not Folder(str(tmp_path / "out")).system


def test_a_bag_without_motors_is_driven_by_setpoints(tmp_path: Path) -> None:
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    definition = (
        "std_msgs/Header header\nuint8 type_mask\ngeometry_msgs/Quaternion orientation\n"
        "geometry_msgs/Vector3 body_rate\nfloat32 thrust\n"
    )
    store.register(get_types_from_msg(definition, "mavros_msgs/msg/AttitudeTarget"))
    kind = store.types
    turn = kind["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    zero = kind["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)

    def header(t: float) -> object:
        stamp = kind["builtin_interfaces/msg/Time"](sec=int(t), nanosec=round(1e9 * (t % 1)))
        return kind["std_msgs/msg/Header"](seq=0, stamp=stamp, frame_id="map")

    def imu(t: float) -> object:
        rates = kind["geometry_msgs/msg/Vector3"](0.1, 0.2, float(np.sin(t)))
        covariance = np.zeros(9)
        return kind["sensor_msgs/msg/Imu"](header(t), turn, covariance, rates, covariance, zero, covariance)

    def pose(t: float) -> object:
        point = kind["geometry_msgs/msg/Point"](t, 0.0, 1.0)
        return kind["geometry_msgs/msg/PoseStamped"](header(t), kind["geometry_msgs/msg/Pose"](point, turn))

    def target(t: float) -> object:
        wanted = kind["geometry_msgs/msg/Vector3"](0.0, 0.0, float(np.cos(t)))
        return kind["mavros_msgs/msg/AttitudeTarget"](header(t), 0, turn, wanted, 0.5 + 0.1 * np.sin(t))

    with Writer(tmp_path / "run.bag") as writer:
        for topic, name, build in (
            ("/imu", "sensor_msgs/msg/Imu", imu),
            ("/pose", "geometry_msgs/msg/PoseStamped", pose),
            ("/target", "mavros_msgs/msg/AttitudeTarget", target),
        ):
            connection = writer.add_connection(topic, name, typestore=store)
            for t in np.arange(1.0, 7.0, 0.02):
                writer.write(connection, round(1e9 * t), store.serialize_ros1(build(t), name))
    said = convert([tmp_path / "run.bag"], tmp_path / "out")
    assert "thrust_command and rate_command can drive networks, no physics model" in " ".join(said)
    (r,) = check(tmp_path / "out").recordings
    t = 1 + np.arange(len(r)) / 50
    expected = np.stack([0.5 + 0.1 * np.sin(t), 0 * t, 0 * t, np.cos(t)], axis=1)
    np.testing.assert_allclose(r.inputs, expected, atol=1e-6)


def test_the_command_says_what_it_did_and_what_is_next(tmp_path: Path) -> None:
    ulog(tmp_path / "flight.ulg", px4())
    done = CliRunner().invoke(data_command, ["import", str(tmp_path / "flight.ulg"), "-o", str(tmp_path / "out")])
    assert done.exit_code == 0, done.output
    assert "body_rates from vehicle_angular_velocity (250 Hz)" in done.output and "bench data check" in done.output
    assert len(pd.read_csv(tmp_path / "out" / "flight.csv").columns) == 1 + 3 + 4 + 3 + 3 + 4 + 1


def _no_motors(rows: dict[str, list]) -> dict[str, list]:
    return {k: v for k, v in rows.items() if k != "actuator_motors"}


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("a.ulg", b"no log", "cannot be read as a PX4 ULog"),
        ("b.ulg", b"ULog\x01\x12\x35\x01" + bytes(8) + b"\x28\0B" + bytes(8) + b"\x02" + bytes(31), "a newer reader"),
        ("a.bag", b"no bag", "cannot be read as a ROS bag"),
        ("a.txt", b"", "neither a PX4 ULog"),
        ("absent.ulg", None, "does not exist"),
        ("no_motors.ulg", _no_motors(px4()), "no motor signal"),
        ("short.ulg", px4(seconds=1.0), "2 s in which all signals"),
    ],
)
def test_a_mistake_is_one_sentence_and_nothing_is_written(
    name: str, content: bytes | dict | None, says: str, tmp_path: Path
) -> None:
    if isinstance(content, dict):
        ulog(tmp_path / name, content)
    elif content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(BenchError, match=says):
        convert([tmp_path / name], tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_without_the_libraries_it_says_what_to_install(tmp_path: Path) -> None:
    (tmp_path / "run.bag").write_bytes(b"")
    code = "import sys; sys.modules['rosbags'] = None; from bench.cli import main; main()"
    arguments = ["data", "import", str(tmp_path / "run.bag"), "-o", str(tmp_path / "out")]
    done = subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True, timeout=60)
    assert done.returncode == 2 and "-m pip install 'rosbags>=0.11'" in done.stderr
