"""PX4 ULog files: topics of the flight controller, in NED and FRD, as series in ENU and FLU."""

from pathlib import Path

import numpy as np

from registry.datasets.logs.series import Log, series
from registry.errors import BenchError, not_installed

TOPICS = (
    "vehicle_local_position",
    "vehicle_attitude",
    "vehicle_angular_velocity",
    "sensor_combined",
    "esc_status",
    "actuator_motors",
    "actuator_outputs",
    "battery_status",
)
_ENU_NED = np.array([0.5**0.5, 0.5**0.5, 0.0, 0.0])
"""Half a turn about the line between north and east, xyzw: x = east, y = north, z = up."""

Topic = dict[str, np.ndarray]


def enu(ned: np.ndarray) -> np.ndarray:
    """North, east, down (N, 3) as east, north, up."""
    out: np.ndarray = ned[:, [1, 0, 2]] * [1.0, 1.0, -1.0]
    return out


def flu(frd: np.ndarray) -> np.ndarray:
    """Forward, right, down (N, 3) as forward, left, up."""
    return frd * [1.0, -1.0, -1.0]


def enu_flu(quaternion: np.ndarray) -> np.ndarray:
    """Quaternions wxyz (N, 4) from FRD to NED as quaternions xyzw (N, 4) from FLU to ENU."""
    w, x, y, z = quaternion.T
    # Of q_NED = (x, y, z, w): first turned by half a turn about body x, then by `_ENU_NED`.
    ax, ay, az, aw = w, z, -y, -x
    bx, by, _, _ = _ENU_NED
    out = [bx * aw + by * az, by * aw - bx * az, bx * ay - by * ax, -bx * ax - by * ay]
    return np.stack(out, axis=1)


def read_ulog(file: Path) -> Log:
    """The signals of a ULog, each with its own clock.

    Raises:
        BenchError: pyulog is not installed, or the file is damaged.
    """
    try:
        from pyulog import ULog
    except ModuleNotFoundError as error:
        raise not_installed("A PX4 log", "pyulog>=1.3") from error
    try:
        found = ULog(str(file), list(TOPICS)).data_list
    except Exception as error:  # a damaged file makes pyulog raise whatever comes
        raise BenchError(f"{file} cannot be read as a PX4 ULog: {str(error) or type(error).__name__}.") from error
    topics: dict[str, Topic] = {d.name: d.data for d in sorted(found, key=lambda d: -d.multi_id)}
    log = Log()

    def add(signal: str, topic: str, values: np.ndarray | None, applied: bool = False, keep: object = True) -> None:
        if values is None or signal in log.signals:
            return
        of = topics[topic]
        sampled = np.asarray(of.get("timestamp_sample", of["timestamp"]), dtype=float)
        # A measurement is of when it was sampled, a command of when it was given.
        stamp = np.asarray(of["timestamp"], dtype=float) if applied or not sampled.any() else sampled
        mask = np.broadcast_to(np.asarray(keep, dtype=bool), stamp.shape)
        made = series(1e-6 * stamp[mask], values[mask], topic)
        if made is not None:
            log.signals[signal] = made

    place = topics.get("vehicle_local_position", {})
    flags = [np.asarray(place[f], dtype=bool) for f in ("xy_valid", "z_valid", "v_xy_valid", "v_z_valid") if f in place]
    sure: object = np.all(flags, axis=0) if flags else True
    position, velocity = _columns(place, ("x", "y", "z")), _columns(place, ("vx", "vy", "vz"))
    add("position", "vehicle_local_position", None if position is None else enu(position), keep=sure)
    add("velocity", "vehicle_local_position", None if velocity is None else enu(velocity), keep=sure)
    attitude = _columns(topics.get("vehicle_attitude", {}), tuple(f"q[{i}]" for i in range(4)))
    add("attitude", "vehicle_attitude", None if attitude is None else enu_flu(attitude))
    for signal, topic, name in (
        ("body_rates", "vehicle_angular_velocity", "xyz"),
        ("body_rates", "sensor_combined", "gyro_rad"),
        ("specific_force", "sensor_combined", "accelerometer_m_s2"),
    ):
        values = _columns(topics.get(topic, {}), tuple(f"{name}[{i}]" for i in range(3)))
        add(signal, topic, None if values is None else flu(values))
    rpm = _numbered(topics.get("esc_status", {}), "esc[{}].esc_rpm")
    add("rotor_speed", "esc_status", None if rpm is None else rpm * np.pi / 30)
    add("pwm", "actuator_motors", _numbered(topics.get("actuator_motors", {}), "control[{}]"), applied=True)
    add("pwm", "actuator_outputs", _numbered(topics.get("actuator_outputs", {}), "output[{}]"), applied=True)
    add("battery", "battery_status", _columns(topics.get("battery_status", {}), ("voltage_v",)))
    return log


def _columns(topic: Topic, names: tuple[str, ...]) -> np.ndarray | None:
    if not all(n in topic for n in names):
        return None
    return np.stack([np.asarray(topic[n], dtype=float) for n in names], axis=1)


def _numbered(topic: Topic, pattern: str) -> np.ndarray | None:
    """The numbered columns that are used: an unused one is NaN, or stands still at zero or at its disarmed value."""
    found = [np.asarray(topic[n], dtype=float) for i in range(16) if (n := pattern.format(i)) in topic]
    columns = [x for x in found if np.isfinite(x).any()]
    if len(columns) == len(found):
        columns = [x for x in columns if np.nanmax(x) > np.nanmin(x)]
    return np.stack(columns, axis=1) if columns else None
