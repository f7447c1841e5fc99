"""ROS 1 and ROS 2 bags: messages of the usual types as series; ROS has z up and x forward, y left, by REP 103."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from registry.datasets.logs.series import Log, series
from registry.datasets.reading.rotations import rotate, unit_quaternion
from registry.errors import BenchError, not_installed

Rows = dict[str, list[float]]


def _vector(v: Any) -> list[float]:
    return [v.x, v.y, v.z]


def _odometry(message: Any) -> Rows:
    pose, twist = message.pose.pose, message.twist.twist
    o = pose.orientation
    return {
        "position": _vector(pose.position),
        "attitude": [o.x, o.y, o.z, o.w],
        "velocity_body": _vector(twist.linear),  # of the child frame, the body
        "body_rates": _vector(twist.angular),
    }


def _pose(message: Any) -> Rows:
    o = message.pose.orientation
    return {"position": _vector(message.pose.position), "attitude": [o.x, o.y, o.z, o.w]}


def _imu(message: Any) -> Rows:
    return {
        "body_rates": _vector(message.angular_velocity),
        "specific_force": _vector(message.linear_acceleration),
    }


def _twist(message: Any) -> Rows:
    return {"rate_command": _vector(message.angular), "velocity_command": _vector(message.linear)}


def _actuators(message: Any) -> Rows:
    speeds = message.angular_velocities if hasattr(message, "angular_velocities") else message.velocity
    return {"rotor": [float(x) for x in speeds]}


READERS: dict[str, Callable[[Any], Rows]] = {
    "sensor_msgs/msg/Imu": _imu,
    "nav_msgs/msg/Odometry": _odometry,
    "geometry_msgs/msg/PoseStamped": _pose,
    "mav_msgs/msg/Actuators": _actuators,
    "actuator_msgs/msg/Actuators": _actuators,
    "mavros_msgs/msg/RCOut": lambda m: {"pwm": [float(x) for x in m.channels]},
    "mavros_msgs/msg/AttitudeTarget": lambda m: {"rate_command": _vector(m.body_rate), "thrust_command": [m.thrust]},
    "geometry_msgs/msg/TwistStamped": lambda m: _twist(m.twist),
    "geometry_msgs/msg/Twist": _twist,
    "sensor_msgs/msg/BatteryState": lambda m: {"battery": [m.voltage]},
}
"""By type of message, the best source of a signal first."""


def read_bag(file: Path) -> Log:
    """The signals of a bag, each with its own clock; of several topics of one type, the one with most messages.

    Raises:
        BenchError: rosbags is not installed, or the bag is damaged.
    """
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ModuleNotFoundError as error:
        raise not_installed("A ROS bag", "rosbags>=0.11") from error
    log = Log()
    path = file.parent if file.suffix == ".db3" else file
    if path.is_dir() and not (path / "metadata.yaml").is_file():
        raise BenchError(f"{path} holds no metadata.yaml beside {file.name}: `ros2 bag reindex {path}` makes it.")
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            for kind, read in READERS.items():
                alike = sorted((c for c in reader.connections if c.msgtype == kind), key=lambda c: -c.msgcount)
                for connection in alike:
                    _add(reader, connection, read, log)
    except BenchError:
        raise
    except Exception as error:  # a damaged bag makes its reader raise whatever comes
        raise BenchError(
            f"{file} cannot be read as a ROS bag: {str(error).rstrip('.') or type(error).__name__}."
        ) from error
    return log


def _add(reader: Any, connection: Any, read: Callable[[Any], Rows], log: Log) -> None:
    """Put the signals of one topic into ``log`` that are not there yet."""
    stamps: list[float] = []
    recorded: list[float] = []
    rows: dict[str, list[list[float]]] = {}
    for _, received, raw in reader.messages(connections=[connection]):
        message = reader.deserialize(raw, connection.msgtype)
        stamp = message.header.stamp if hasattr(message, "header") else None
        stamps.append(0.0 if stamp is None else stamp.sec + 1e-9 * stamp.nanosec)
        recorded.append(1e-9 * received)
        for signal, values in read(message).items():
            rows.setdefault(signal, []).append(values)
    times = np.array(stamps if any(stamps) else recorded)
    for signal, listed in rows.items():
        if len({len(row) for row in listed}) > 1 or not listed[0]:
            raise BenchError(f"{connection.topic}: messages have different numbers of values for {signal}.")
        x = np.array(listed, dtype=float)
        if signal == "rotor":
            signal = "rotor_command" if "com" in connection.topic.rpartition("/")[2] else "rotor_speed"
        if signal == "velocity_body":
            signal, x = "velocity", rotate(unit_quaternion(np.array(rows["attitude"])), x)
        if signal == "pwm":
            x = x[:, np.ptp(x, axis=0) > 0]
        made = series(times, x, connection.topic, signal) if x.shape[1] else None
        if made is not None and signal not in log.signals:
            log.signals[signal] = made
