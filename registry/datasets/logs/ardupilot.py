"""ArduPilot logs: messages of the flight controller, in NED and FRD, as series in ENU and FLU."""

from pathlib import Path

import numpy as np

from registry.datasets.folder.constants import Constant
from registry.datasets.logs.formats import dataflash
from registry.datasets.logs.px4 import enu, enu_flu, flu
from registry.datasets.logs.series import Log, Series, series, steps
from registry.datasets.reading.rotations import quaternion_from_euler

ESTIMATES = ("XKF1", "NKF1", "EKF1")
"""Of position and velocity, the newest filter first."""
ESCS = ("ESC", *(f"ESC{i}" for i in range(1, 9)))
WANTED = ("ATT", "IMU", "RCOU", "BAT", "CURR", "EV", *ESTIMATES, *ESCS)
_INSTANCES = ("I", "C", "Inst", "Instance")
"""Fields that number sensors, filters and batteries."""
_GROUND = {18: 1.0, 11: 1.0, 28: 0.0}
"""Events: landing complete, disarmed; not landed."""
_MOTOR_1 = 33
"""SERVOn_FUNCTION of the first motor; the eighth has 40."""
_FRAMES = {
    0: ([-1.0, -1.0, 1.0, 1.0], "right, left, front, rear (plus frame)"),
    1: ([-1.0, -1.0, 1.0, 1.0], "front right, rear left, front left, rear right (X frame)"),
    3: ([1.0, 1.0, -1.0, -1.0], "front right, rear left, front left, rear right (H frame)"),
}
"""Of quadrotors by FRAME_TYPE: the signs of the reaction torques about the axis up, and where motors 1 to 4 are."""
Columns = dict[str, np.ndarray]


def read_dataflash(file: Path) -> Log:
    """The signals of a DataFlash log, each with its own clock, and what its parameters and events say.

    Raises:
        BenchError: the file is damaged.
    """
    found = dataflash.read(file, WANTED)
    messages = {name: _first_instance(name, columns) for name, columns in found.messages.items()}
    log = Log()

    def add(signal: str, name: str, values: np.ndarray | None) -> None:
        t = _times(messages.get(name, {}))
        made = None if values is None or t is None else series(t, values, name, signal)
        if made is not None:
            log.signals.setdefault(signal, made)

    angles = _columns(messages.get("ATT", {}), ("Roll", "Pitch", "Yaw"))
    if angles is not None:
        x, y, z, w = quaternion_from_euler(np.deg2rad(angles)).T
        add("attitude", "ATT", enu_flu(np.stack([w, x, y, z], axis=1)))
    for signal, name, fields in (
        ("body_rates", "IMU", ("GyrX", "GyrY", "GyrZ")),
        ("specific_force", "IMU", ("AccX", "AccY", "AccZ")),
    ):
        values = _columns(messages.get(name, {}), fields)
        add(signal, name, None if values is None else flu(values))
    for name in ESTIMATES:
        for signal, letter in (("position", "P"), ("velocity", "V")):
            values = _columns(messages.get(name, {}), tuple(f"{letter}{axis}" for axis in "NED"))
            add(signal, name, None if values is None else enu(values))
    add("pwm", "RCOU", _motors(messages.get("RCOU", {}), found.parameters))
    for name in ("BAT", "CURR"):
        volt = _columns(messages.get(name, {}), ("Volt",))
        hundredths = name == "CURR" and "TimeMS" in messages.get(name, {})
        add("battery", name, volt if volt is None or not hundredths else 0.01 * volt)
    speeds = _rotor_speeds(found.messages)
    if speeds is not None:
        log.signals["rotor_speed"] = speeds
    log.landed = _landed(messages.get("EV", {}))
    _frame(found.parameters, log)
    if found.skipped:
        log.notes.append(f"{found.skipped} bytes belong to no message, as in a log that was cut short: left out.")
    return log


def _first_instance(name: str, columns: Columns) -> Columns:
    """The messages of the first sensor, filter or battery, where there are several."""
    number = next((columns[n] for n in _INSTANCES if n in columns), None)
    if number is None or name in ESCS or not len(number):
        return columns
    return {n: x[number == number.min()] for n, x in columns.items()}


def _times(columns: Columns) -> np.ndarray | None:
    """(N,) [s]."""
    for name, tick in (("TimeUS", 1e-6), ("TimeMS", 1e-3)):
        if name in columns:
            return tick * np.asarray(columns[name], dtype=float)
    return None


def _columns(columns: Columns, names: tuple[str, ...]) -> np.ndarray | None:
    if not all(n in columns and columns[n].dtype.kind in "fiu" for n in names):
        return None
    return np.stack([np.asarray(columns[n], dtype=float) for n in names], axis=1)


def _motors(outputs: Columns, parameters: dict[str, float]) -> np.ndarray | None:
    """What drives the motors (N, c), in their order, 0 to 1 between the least and the most that they are told.

    Without parameters that name their outputs (before ArduPilot 3.5), those that move and that no RCn_FUNCTION gives to
    a gimbal, a gripper or the like.
    """
    channels = [n for i in range(1, 15) for n in (f"C{i}", f"Ch{i}") if n in outputs]
    of = {int(parameters.get(f"SERVO{i}_FUNCTION", 0)): f"C{i}" for i in range(1, 15)}
    named = [of[m] for m in range(_MOTOR_1, _MOTOR_1 + 8) if of.get(m) in outputs]
    others = {n for n in channels if parameters.get(f"RC{n.lstrip('Ch')}_FUNCTION", 0.0)}
    moving = [n for n in channels if n not in others and len(outputs[n]) and np.ptp(outputs[n].astype(float)) > 0]
    pulses = _columns(outputs, tuple(named or moving)) if named or moving else None
    low, high = (parameters.get(f"MOT_PWM_{k}", 0.0) or usual for k, usual in (("MIN", 1000.0), ("MAX", 2000.0)))
    return None if pulses is None or not low < high else (pulses - low) / (high - low)


def _rotor_speeds(messages: dict[str, Columns]) -> Series | None:
    """Speeds [rad/s] of all motors at the times of the first one's; each controller has a clock of its own."""
    one = messages.get("ESC", {})
    if {"Instance", "RPM"} <= set(one):
        each = [{n: x[one["Instance"] == i] for n, x in one.items()} for i in np.unique(one["Instance"])]
    else:
        each = [messages[n] for n in ESCS[1:] if "RPM" in messages.get(n, {})]
    read = [(_times(columns), _columns(columns, ("RPM",))) for columns in each]
    made = [series(t, rpm, "ESC") for t, rpm in read if t is not None and rpm is not None]
    whole = [s for s in made if s is not None]
    if not whole or len(whole) < len(each):
        return None
    first = whole[0]
    values = np.stack([np.interp(first.t, s.t, s.values[:, 0]) for s in whole], axis=1)
    return Series(first.t, values * np.pi / 30, "ESC")


def _landed(events: Columns) -> Series | None:
    t, numbers = _times(events), events.get("Id")
    if t is None or numbers is None:
        return None
    known = np.isin(numbers, list(_GROUND))
    values = np.array([[_GROUND[int(n)]] for n in numbers[known]]).reshape(-1, 1)
    if not len(values):
        return None
    return steps(np.r_[-np.inf, t[known]], np.concatenate([1 - values[:1], values]), "EV")


def _frame(parameters: dict[str, float], log: Log) -> None:
    """Put what the thrust curve and the kind of frame say of a quadrotor's motors into ``log``."""
    expo, least, most = (parameters.get(f"MOT_{k}", 0.0) for k in ("THST_EXPO", "SPIN_MIN", "SPIN_MAX"))
    if 0 < expo <= 1 and 0 <= least < most <= 1:
        # A share r of what a motor is told beyond the least gives thrust (1 − e) r + e r² (AP_MotorsMulticopter).
        offset = (1 - expo) / (2 * expo) * (most - least) - least
        log.hints["pwm_offset"] = f"{offset:.3g} × pwm_gain, as MOT_THST_EXPO, MOT_SPIN_MIN and MOT_SPIN_MAX have it"
    kind = parameters.get("FRAME_TYPE", parameters.get("FRAME", -1.0))
    if parameters.get("FRAME_CLASS", 1.0) != 1 or kind not in _FRAMES:
        return
    directions, order = _FRAMES[int(kind)]
    log.constants["rotor_directions"] = Constant(directions, "of FRAME_TYPE")
    log.hints["rotor_positions"] = f"in the order {order}"
