"""PX4 ULog files: topics of the flight controller, in NED and FRD, as series in ENU and FLU.

Topics and parameters as docs.px4.io describes them: uORB message reference, parameter reference (CA_ROTOR*,
THR_MDL_FAC, PWM_MAIN_FUNC*).
"""

from pathlib import Path

import numpy as np

from registry.datasets.folder.constants import Constant
from registry.datasets.logs.formats import ulog
from registry.datasets.logs.series import Log, series, steps

TOPICS = (
    "vehicle_local_position",
    "vehicle_attitude",
    "vehicle_angular_velocity",
    "sensor_combined",
    "esc_status",
    "actuator_motors",
    "actuator_outputs",
    "battery_status",
    "vehicle_land_detected",
    "vehicle_rates_setpoint",
)
_ON_GROUND = ("landed", "maybe_landed", "ground_contact")
"""Of `vehicle_land_detected`, the surest first; any of them ends a flight."""
_MOTOR_1 = 101
"""The function of the first motor's output, of those named PWM_MAIN_FUNC1, …"""
_ROTORS = 12
_ENU_NED = np.array([0.5**0.5, 0.5**0.5, 0.0, 0.0])
"""Half a turn about the line between north and east, xyzw: x = east, y = north, z = up."""

Topic = dict[str, np.ndarray]
Parameters = dict[str, float]


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
    """The signals of a ULog, each with its own clock, the rotors that its parameters state, and when it had landed.

    Raises:
        BenchError: the file is damaged.
    """
    found = ulog.read(file, TOPICS)
    topics, parameters = found.topics, found.parameters
    log = Log()

    def add(signal: str, topic: str, values: np.ndarray | None, applied: bool = False, keep: object = True) -> None:
        if values is None or signal in log.signals:
            return
        of = topics[topic]
        sampled = np.asarray(of.get("timestamp_sample", of["timestamp"]), dtype=float)
        # A measurement is of when it was sampled, a command of when it was given.
        stamp = np.asarray(of["timestamp"], dtype=float) if applied or not sampled.any() else sampled
        mask = np.broadcast_to(np.asarray(keep, dtype=bool), stamp.shape)
        made = series(1e-6 * stamp[mask], values[mask], topic, signal)
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
    add("pwm", "actuator_motors", _commands(topics.get("actuator_motors", {}), parameters, log.notes), applied=True)
    add("pwm", "actuator_outputs", _outputs(topics.get("actuator_outputs", {}), parameters), applied=True)
    add("battery", "battery_status", _columns(topics.get("battery_status", {}), ("voltage_v",)))
    wanted = topics.get("vehicle_rates_setpoint", {})
    rates = _columns(wanted, ("roll", "pitch", "yaw"))
    add("rate_command", "vehicle_rates_setpoint", None if rates is None else flu(rates), applied=True)
    thrust = _columns(wanted, ("thrust_body[2]",))
    add("thrust_command", "vehicle_rates_setpoint", None if thrust is None else -thrust, applied=True)
    add("thrust_command", "vehicle_rates_setpoint", _columns(wanted, ("thrust",)), applied=True)
    _rotors(parameters, log)
    landed = topics.get("vehicle_land_detected", {})
    if "landed" in landed:
        down = np.any([np.asarray(landed[f], dtype=bool) for f in _ON_GROUND if f in landed], axis=0)
        log.landed = steps(1e-6 * np.asarray(landed["timestamp"], dtype=float), 1.0 * down[:, None], "landed")
    log.notes += _remarks(found, "pwm" in log.signals)
    return log


def _remarks(found: ulog.ULog, driven: bool) -> list[str]:
    """What a user should know of the file; ``driven``: its motors were told something."""
    notes = []
    outputs = [t for t in ("actuator_motors", "actuator_outputs") if t in found.topics]
    if outputs and not driven:
        notes.append(f"{' and '.join(outputs)} stood still, as of a vehicle that was not armed.")
    if found.dropped:
        notes.append(f"{found.dropped:.2g} s are missing here and there: the memory card was too slow.")
    if not found.whole:
        notes.append("the file is cut short: read up to its last message.")
    return notes


def _rotors(parameters: Parameters, log: Log) -> None:
    """Put what CA_ROTOR* say of the rotors into ``log``: x forward, y right, z down; positive KM counter-clockwise."""
    count = int(np.clip(np.nan_to_num(parameters.get("CA_ROTOR_COUNT", 0)), 0, _ROTORS))
    rotors = [
        [parameters.get(f"CA_ROTOR{i}_{k}", 0.0) for k in ("PX", "PY", "PZ", "KM", "AX", "AY")] for i in range(count)
    ]
    table = np.array(rotors).reshape(count, 6)
    ratio = table[:, 3]
    if not count or not np.isfinite(table).all() or not table[:, :3].any() or not ratio.all():
        return
    if np.abs(table[:, 4:]).max() > 0.01:
        log.notes.append("its rotors are tilted (CA_ROTOR*_AX, _AY), which the quadrotor model does not know.")
    places = [[float(f"{x:.6g}") for x in place] for place in (table[:, :3] * [1.0, -1.0, -1.0] + 0.0).tolist()]
    log.constants["rotor_positions"] = Constant(places, "of CA_ROTOR*_PX, _PY, _PZ")
    # A rotor that turns counter-clockwise, seen from above, turns the body clockwise.
    log.constants["rotor_directions"] = Constant((-np.sign(ratio)).tolist(), "of the signs of CA_ROTOR*_KM")
    log.torque_over_thrust = float(np.abs(ratio).mean())


def _commands(topic: Topic, parameters: Parameters, notes: list[str]) -> np.ndarray | None:
    """Of the normalised thrust that each motor is told, the signal that its controller gets, 0 to 1.

    PX4 makes the one from the other by thrust = f signal² + (1 − f) signal, f = THR_MDL_FAC.
    """
    thrust = _numbered(topic, "control[{}]")
    f = parameters.get("THR_MDL_FAC", 0.0)
    if thrust is None or not 0 < f <= 1:
        return thrust
    notes.append(f"its motor commands are shares of thrust: turned into motor signals by THR_MDL_FAC = {f:g}.")
    out: np.ndarray = (np.sqrt((1 - f) ** 2 + 4 * f * np.maximum(thrust, 0)) - (1 - f)) / (2 * f)
    return out


def _outputs(topic: Topic, parameters: Parameters) -> np.ndarray | None:
    """Those of the outputs that drive motors, in their order, as far as the parameters say so."""
    of = {int(parameters.get(f"PWM_MAIN_FUNC{i + 1}", 0)): i for i in range(16)}
    motors = [f"output[{of[m]}]" for m in range(_MOTOR_1, _MOTOR_1 + _ROTORS) if m in of]
    return _columns(topic, tuple(motors)) if motors else _numbered(topic, "output[{}]")


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
