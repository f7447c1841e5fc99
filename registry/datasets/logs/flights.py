"""Flights as autopilots and robots log them, every signal with a clock of its own, as a folder with one clock.

In SI units, world z up, body x forward, y left, z up.
"""

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from registry.atomic_io import writing
from registry.datasets.folder.clock import THINNEST
from registry.datasets.folder.constants import Constant, physics_lines
from registry.datasets.folder.description import COMMANDS, FILE
from registry.datasets.logs.estimates import lift, motor_map, rotor_coefficients
from registry.datasets.logs.joining import SHORTEST, Span, on_grid, spans, times
from registry.datasets.logs.series import Log, round_rate
from registry.datasets.reading.ground import IDLE
from registry.errors import BenchError

FASTEST = 100.0
"""Sample rate that is chosen where the signals have it [Hz]."""
FINER = 5.0
"""How much finer than that of attitude, position or velocity the common rate may be: they change slowly."""
NEARLY = 0.45
"""Share of the rate of the motors' fastest signal from which one that tells more is preferred: half, and jitter."""
DRIVERS = ("rotor_speed", "rotor_command", "pwm")
"""What can drive a quadrotor, best first."""
SETPOINTS = ("thrust_command", "velocity_command", "rate_command")
"""What drives the networks where no motor was logged; of a robot on wheels its velocity and turn."""
_SLOW = ("attitude", "position", "velocity")
_COLUMNS: dict[str, tuple[tuple[str, ...], str]] = {
    "position": (("x", "y", "z"), 'unit = "m"'),
    "attitude": (("qx", "qy", "qz", "qw"), 'unit = "1", convention = "quaternion_xyzw"'),
    "velocity": (("vx", "vy", "vz"), 'unit = "m/s", frame = "world"'),
    "body_rates": (("p", "q", "r"), 'unit = "rad/s"'),
    "specific_force": (("ax", "ay", "az"), 'unit = "m/s^2", frame = "body"'),
    "rotor_speed": (("rotor",), 'unit = "rad/s"'),
    "rotor_command": (("cmd",), 'unit = "rad/s"'),
    "pwm": (("pwm",), 'unit = "pwm"'),
    "rate_command": (("p_cmd", "q_cmd", "r_cmd"), 'unit = "rad/s", axes = ["p", "q", "r"]'),
    "thrust_command": (("thrust_cmd",), 'unit = "1"'),
    "velocity_command": (("vx_cmd", "vy_cmd", "vz_cmd"), 'unit = "m/s", axes = ["x", "y", "z"]'),
    "battery": (("vbat",), 'unit = "V"'),
}
"""Columns of each signal (a prefix where the count is open), and how the description has it."""
_OPEN = ("rotor_speed", "rotor_command", "pwm")


_FREE = "where no speed was ever measured a guess, such as 1000: thrust_coefficient takes up what is wrong in it"
"""Of a command's gain."""


@dataclass(frozen=True)
class _Choice:
    """What is taken from the logs."""

    signals: list[str]
    counts: dict[str, int]
    """Columns of each signal."""
    inputs: list[str]
    rate: float
    """[Hz]."""


def write(logs: Mapping[str, Log], folder: Path, rate: float | None, known: Mapping[str, Constant]) -> list[str]:
    """The logs as CSV files with a drafted dataset.toml; what was done, in sentences.

    Args:
        logs: by the name that a recording gets.
        folder: made where it does not exist.
        rate: common sample rate [Hz]; None: that of the slower of body rates and motors, at most `FASTEST` and
            `FINER` times that of the slowest other state.
        known: constants of the vehicle that the logs do not state.

    Raises:
        BenchError: a log lacks the motion or its cause, or the folder cannot be written.
    """
    choice = _choose(logs, rate)
    notes: list[str] = []
    tables: dict[str, dict[str, np.ndarray]] = {}
    for name, log in logs.items():
        wanted = {s: log.signals[s] for s in choice.signals}
        parts = [p for p in spans(wanted, choice.rate, log.landed) if _driven(log, choice.inputs[0], p)]
        for i, span in enumerate(parts, start=1):
            x = on_grid(wanted, span, choice.rate, (*COMMANDS, *SETPOINTS))
            x = {s: values[:, : choice.counts[s]] for s, values in x.items()}
            label = name if len(parts) == 1 else f"{name}_part{i}"
            tables[label] = {"t": (times(span, choice.rate) - span[0])[:, None], **x}
        notes += _notes(name, log, choice, parts)
    if not tables:
        raise BenchError(_none(logs, choice))
    left = sorted({s for log in logs.values() for s in log.signals} - {*choice.signals, *SETPOINTS})
    if left:
        notes.append(f"Left out, because not every file has it or another tells more: {', '.join(left)}.")
    driver = choice.inputs[0] if choice.inputs[0] in DRIVERS else ""
    constants, hints = _constants(list(logs.values()), list(tables.values()), driver, known)
    places = {n: len(c.value) for n, c in constants.items() if n.startswith(("rotor_p", "rotor_d"))}
    if driver and set(places.values()) - {choice.counts[driver]}:
        notes.append(f"The vehicle's parameters name another number of rotors than the {choice.counts[driver]} logged.")
        constants = {n: c for n, c in constants.items() if n not in places}
    _write(folder, tables, choice, _lines(folder, choice, driver, constants, hints))
    return notes


def _none(logs: Mapping[str, Log], choice: _Choice) -> str:
    """Why nothing is left of the logs."""
    at_once = [n for n, log in logs.items() if spans({s: log.signals[s] for s in choice.signals}, choice.rate)]
    if at_once:
        names = ", ".join(at_once)
        return f"{names}: no {SHORTEST:g} s in the air, by what it says of landings and motors: take logs of flights."
    return f"No file holds {SHORTEST:g} s in which all signals ({', '.join(choice.signals)}) were logged at once."


def _driven(log: Log, driver: str, span: Span) -> bool:
    """Whether the motors did in a stretch what they usually do in flight, for a moment at least."""
    s = log.signals[driver]
    level = np.sqrt(np.mean(s.values**2, axis=1))
    inside = level[(s.t >= span[0]) & (s.t <= span[1])]
    return bool((inside >= IDLE * np.quantile(level, 0.8)).any()) or not len(inside)


def _choose(logs: Mapping[str, Log], rate: float | None) -> _Choice:
    """The signals that all logs have, what drives them, and the common rate.

    Raises:
        BenchError: there is no attitude or nothing that drives the vehicle, or the rate is beyond all signals.
    """
    common = set.intersection(*(set(log.signals) for log in logs.values()))
    for name, log in logs.items():
        if "attitude" not in log.signals:
            raise BenchError(
                f"{name} holds no attitude: log vehicle_attitude (PX4), nav_msgs/Odometry (ROS) or ATT (ArduPilot)."
            )
    rates = {s: min(log.signals[s].rate for log in logs.values()) for s in common}
    pace = min(FASTEST, rates.get("body_rates", rates["attitude"]))
    motors = [d for d in DRIVERS if d in common]
    best = max((min(pace, rates[d]) for d in motors), default=0.0)
    driver = next((d for d in motors if rates[d] >= NEARLY * best), "")
    outer = {"velocity_command"} if "thrust_command" in common else set()  # the loop that made the thrust
    inputs = [driver] if driver else [s for s in SETPOINTS if s in common - outer]
    if not inputs:
        without = [name for name, log in logs.items() if not {*DRIVERS, *SETPOINTS} & set(log.signals)]
        which = f"{', '.join(without)}: no motor signal" if without else "No motor signal is in all of the files"
        raise BenchError(
            f"{which}: log esc_status, actuator_motors or actuator_outputs (PX4), an Actuators or RCOut message or "
            "cmd_vel (ROS), or RCOU (ArduPilot), or import the others without."
        )
    slow = set(motors) - {driver}
    unused = {d for d in slow if rates[d] < NEARLY * best} | (set(SETPOINTS) - set(inputs))
    chosen = rate or round_rate(
        min(pace, *(rates[s] for s in inputs), *(FINER * rates[s] for s in _SLOW if s in common))
    )
    fastest = max(rates.values())
    if chosen > THINNEST * fastest:
        raise BenchError(f"No signal was logged faster than {fastest:.4g} Hz: --rate {chosen:g} is beyond them all.")
    signals = [s for s in _COLUMNS if s in common - unused]
    counts = {s: min(log.signals[s].values.shape[1] for log in logs.values()) for s in signals}
    return _Choice(signals, counts, inputs, chosen)


def _notes(name: str, log: Log, choice: _Choice, parts: Sequence[Span]) -> list[str]:
    sources = ", ".join(f"{s} from {log.signals[s].source} ({log.signals[s].rate:.3g} Hz)" for s in choice.signals)
    seconds = sum(b - a for a, b in parts)
    notes = [f"{name}: {seconds:.1f} s in {len(parts)} recording(s) at {choice.rate:g} Hz: {sources}."]
    slow = [s for s in choice.signals if log.signals[s].rate < 0.9 * choice.rate]
    lines = [s for s in slow if s not in (*COMMANDS, *SETPOINTS)]
    if lines:
        notes.append(f"{name}: {', '.join(lines)} came slower than {choice.rate:g} Hz: interpolated by straight lines.")
    if held := [s for s in slow if s not in lines]:
        notes.append(f"{name}: {', '.join(held)} came slower than {choice.rate:g} Hz: held until the next sample.")
    if log.landed is not None and log.landed.values.any():
        notes.append(f"{name}: time on the ground, by {log.landed.source}, is left out.")
    if choice.inputs[0] not in DRIVERS:
        notes.append(
            f"{name}: no motor was logged: {' and '.join(choice.inputs)} can drive networks, no physics model."
        )
    elif choice.rate < 0.5 * FASTEST:
        notes.append(f"{name}: {choice.rate:g} Hz shows little of rotations: log body rates and motors faster.")
    return [*notes, *(f"{name}: {sentence}" for sentence in log.notes)]


def _constants(
    logs: Sequence[Log], parts: Sequence[Mapping[str, np.ndarray]], driver: str, known: Mapping[str, Constant]
) -> tuple[dict[str, Constant], dict[str, str]]:
    """What is known of the vehicle, by its user or else by its logs; and hints of what is not."""
    if not driver:
        return {}, {}
    stated = logs[0].constants if all(log.constants == logs[0].constants for log in logs) else {}
    found = {**(motor_map(logs) if driver == "pwm" else {}), **stated, **known}
    ratio = logs[0].torque_over_thrust if stated else 0.0
    more, hints = rotor_coefficients(lift(parts, driver, found), ratio, found)
    free = {"pwm_gain": _FREE} if driver == "pwm" else {}
    return {**found, **more}, {**free, **logs[0].hints, **hints}


def _lines(
    folder: Path, choice: _Choice, driver: str, constants: Mapping[str, Constant], hints: Mapping[str, str]
) -> list[str]:
    """The dataset.toml."""
    held = set(choice.inputs) & {*COMMANDS, *SETPOINTS}
    names = {s: _names(s, choice.counts[s]) for s in choice.signals}
    return [
        f"name = {json.dumps(Path(os.path.realpath(folder)).name, ensure_ascii=False)}",
        *(['system = "quadrotor"'] if driver else []),
        f"rate_hz = {choice.rate:g}",
        'files = "*.csv"',
        'time = "t"',
        f"input = {json.dumps(driver or choice.inputs)}",
        f'input_hold = "{"previous" if held else "linear"}"',
        "",
        "[signals]  # SI; world z up, body x forward, y left, z up",
        *(f"{s} = {{columns = {json.dumps(names[s])}, {_COLUMNS[s][1]}}}" for s in choice.signals),
        *(
            [
                "",
                "# rotor_positions and rotor_directions go in the order of the motor columns; x forward, y left",
                *physics_lines("quadrotor", driver, constants, hints),
            ]
            * bool(driver)
        ),
    ]


def _write(folder: Path, tables: Mapping[str, Mapping[str, np.ndarray]], choice: _Choice, lines: list[str]) -> None:
    header = ",".join(["t", *(c for s in choice.signals for c in _names(s, choice.counts[s]))])
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        for name, x in tables.items():
            table = np.column_stack([x["t"], *(x[s] for s in choice.signals)])
            np.savetxt(folder / f"{name}.csv", table, fmt="%.9g", delimiter=",", header=header, comments="")
        (folder / FILE).write_text("\n".join(lines) + "\n", encoding="utf-8")


def _names(signal: str, count: int) -> list[str]:
    columns = _COLUMNS[signal][0]
    return [f"{columns[0]}{i + 1}" for i in range(count)] if signal in _OPEN else list(columns)
