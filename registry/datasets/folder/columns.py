"""What the columns of a log are by the names that people, autopilots and robots give them."""

import json
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

from registry.errors import BenchError
from registry.units import SIGNALS, Signal, checked, measures, to_si

TIME = r"%?time(?:_?(?:s|ms|us|ns))?|t(?:out)?|t_?(?:s|ms|us|ns)|timestamp(?:_?(?:s|ms|us|ns))?|tick|(?:.*\.)?stamp"
"""Of the column that holds the time."""
_ROS = r"(?:.*\.)?"
_EULER = ("roll", "pitch", "yaw")
_COMPASS = ("north", "east", "down")
_NED = 'frame = "ned"'
_TURNED = {"attitude": _NED, "body_rates": 'frame = "frd"', "specific_force": 'frame = "frd"'}
"""Of logs whose places are north, east and down: the frames of what else they hold."""
_GUESSES: tuple[tuple[str, str, tuple[str, ...]], ...] = (
    ("attitude", 'unit = "1", convention = "quaternion_wxyz", frame = "ned"', tuple(rf"q\[{i}\]" for i in range(4))),
    ("body_rates", 'unit = "rad/s", frame = "frd"', tuple(rf"(?:.*\.)?xyz\[{i}\]|.*gyro\w*\[{i}\]" for i in range(3))),
    (
        "specific_force",
        'unit = "m/s^2", frame = "frd"',
        tuple(rf".*acc\w*\[{i}\]" for i in range(3)),
    ),
    ("position", f'unit = "m", {_NED}', tuple(rf"p(?:os)?_?{a[0]}|(?:pos_?)?{a}" for a in _COMPASS)),
    ("velocity", f'unit = "m/s", {_NED}', tuple(rf"v(?:el)?_?{a[0]}|v(?:el)?_?{a}" for a in _COMPASS)),
    ("position", 'unit = "m"', tuple(rf"{a}|p{a}|pos[_.]?{a}|stateEstimate\.{a}|{_ROS}position\.{a}" for a in "xyz")),
    (
        "attitude",
        'unit = "1", convention = "quaternion_xyzw"',
        tuple(rf"q[_.]?{a}|stateEstimate\.q{a}|{_ROS}orientation\.{a}" for a in "xyzw"),
    ),
    ("attitude", 'unit = "1", convention = "quaternion_wxyz"', tuple(rf"kalman\.q{i}|q_?{i}" for i in range(4))),
    ("attitude", 'unit = "rad", convention = "euler_zyx"', ("roll|phi", "pitch|theta", "yaw|psi")),
    (
        "attitude",  # the Crazyflie's pitch is positive with the nose up
        'unit = "deg", convention = "euler_zyx"',
        tuple(rf"{'-' * (a == 'pitch')}(?:stateEstimate|stabilizer)\.{a}" for a in _EULER),
    ),
    ("position", 'unit = "mm"', tuple(rf"stateEstimateZ\.{a}" for a in "xyz")),
    ("velocity", 'unit = "mm/s", frame = "world"', tuple(rf"stateEstimateZ\.v{a}" for a in "xyz")),
    (
        "velocity",
        'unit = "m/s", frame = "world"',
        tuple(rf"v[_.]?{a}|vel[_.]?{a}|stateEstimate\.v{a}|{_ROS}(?:lin(?:ear)?|velocity)\.{a}" for a in "xyz"),
    ),
    ("body_rates", 'unit = "deg/s"', ("gyro\\.x", "gyro\\.y", "gyro\\.z")),
    (
        "body_rates",
        'unit = "mrad/s"',
        tuple(rf"{'-' * (a == 'pitch')}stateEstimateZ\.rate{a.title()}" for a in _EULER),
    ),
    ("body_rates", 'unit = "rad/s"', tuple(rf"{'-' * (a == 'pitch')}controller\.r_{a}" for a in _EULER)),
    (
        "body_rates",
        'unit = "rad/s"',
        tuple(
            rf"{a}|w_?{b}|gyro?_?{b}|omega_?{b}|ang_?vel_?{b}|{_ROS}ang(?:ular)?(?:_velocity)?\.{b}"
            for a, b in zip("pqr", "xyz", strict=True)
        ),
    ),
    ("specific_force", 'unit = "g", frame = "body"', ("acc\\.x", "acc\\.y", "acc\\.z")),
    (
        "specific_force",
        'unit = "m/s^2", frame = "body"',
        tuple(rf"a_?{a}|acc?(?:el)?_?(?:b_?)?{a}|{_ROS}linear_acceleration\.{a}" for a in "xyz"),
    ),
    ("battery", 'unit = "mV"', (r"pm\.vbatMV",)),
    ("battery", 'unit = "V"', (r"v_?batt?|battery|battery_voltage|pm\.vbat|voltage_v|voltage_filtered_v",)),
    ("pilot", 'unit = "1"', ("aileron", "elevator", "rudder", "collective")),
)
_MOVING = {"position", "velocity", "specific_force", "rotor_speed", "pwm", "pilot"}
"""Beside attitude and body rates, signals of a vehicle, which has a battery."""
_NUMBERED = (
    ("rotor_speed", "rpm", r"(?:rpm_?|rpm\.m)|(?:esc|m|motor|rotor|w)_?(?=\d+_rpm)"),
    ("rotor_speed", "rad/s", "(?:rotor|omega|motor_speed)_?"),
    ("rotor_command", "rad/s", "(?:cmd|command|rotor_cmd|rotor_command)_?"),
    ("pwm", "pwm", r"(?:pwm|motor|m|motor\.m|out)_?|pwm\.m(?=\d_pwm)|(?:output|channels)\["),
)
_NAMED: dict[str, str] = {
    "displacement": "q|x|y|pos|position|disp|displacement",
    "speed": "v|speed|vel|velocity|d[qx]|[qx]_?dot",
    "angle": "theta|phi|th|q|angle",
    "angle_rate": "omega|w|gyro|(?:theta|phi|th|q|angle)_?(?:dot|rate)|d(?:theta|phi|th|q)|qd",
    "force": "f|u|force|input",
    "voltage": "u|v|volt|voltage|input",
    "level": "h|y|[hy]_?2|level|level_?2|lower|lower_?level",
    "upper_level": "[hy]_?1|level_?1|upper|upper_?level",
}
"""Of systems with one axis, whose names are too short to be guessed where the system is not named."""
_DRIVES = (
    r"u_?\d*|in(?:put)?_?\d*|(?:.*[_.])?(?:cmd|command|set_?point|reference|ref|drive|duty|throttle|pwm|pump|valve|heater"
    r"|torque|force|voltage|volts|current)(?:_.*|\d+)?"
)
"""What drives a system of which nothing else is known."""
_SUFFIXES = ("l_min", "lpm", "m_s", "rad_s", "deg_s", "degc", "bar", "kpa", "pa", "rpm", "hz", "kg", "mm", "deg", "rad")
_WORDS = {"volts": "V", "amps": "A", "newtons": "N", "pct": "%", "percent": "%", "rpm": "rpm", "celsius": "degC"}
"""Units that are written out at the end of a name, or are all of it."""
_SIGNS = ("V", "mV", "A", "mA", "N", "Nm", "C")
"""Units of one or two letters, which are none in small letters: "force_n" is north."""
_OF_MOTION = {
    **{u: u for u in ("m", "cm", "mm", "deg", "rad", "g", "rpm")},
    **{u: "deg/s" for u in ("dps", "degs", "deg_s", "degps", "deg_per_s")},
    **{u: "rad/s" for u in ("rads", "rad_s", "radps", "rad_per_s")},
    **{u: "m/s" for u in ("ms", "mps", "m_s", "m_per_s")},
    **{u: "m/s^2" for u in ("ms2", "mps2", "mss", "m_s2", "m_per_s2", "m_s_2")},
    "v": "V",
    "mv": "mV",
}
"""Endings of names of a vehicle's signals, where the signal can be measured so: "ax_g", "roll_deg"."""
_UNITS = {
    "Nm": "N m",
    "C": "degC",
    "lpm": "L/min",
    "degc": "degC",
    "kpa": "kPa",
    "pa": "Pa",
    "hz": "Hz",
    "l_min": "L/min",
}


@dataclass
class Found:
    """Signals that the columns of a file seem to hold, and the columns that are left."""

    signals: dict[str, str] = field(default_factory=dict)
    """Name → its entry as a dataset.toml has it."""
    columns: dict[str, list[str]] = field(default_factory=dict)
    """Name → the columns that it is made of."""
    left: list[str] = field(default_factory=list)

    def take(self, signal: str, column: str, unit: str) -> None:
        """A column is one of the signals, in a unit."""
        self.signals[signal], self.columns[signal] = _entry([column], f'unit = "{unit}"'), [column]
        self.left.remove(column)


def time_column(names: Sequence[str]) -> str | None:
    """The column that holds the time, by its name."""
    return next((n for n in names if re.fullmatch(TIME, bare(n), re.IGNORECASE)), None)


def recognised(names: Sequence[str], wanted: Collection[str] = (), units: Mapping[str, str] | None = None) -> Found:
    """The signals whose columns have a known name.

    Args:
        names: of the columns, without that of the time.
        wanted: the only signals that are looked for; none: those of a vehicle.
        units: of columns whose unit the file states.
    """
    found = Found(left=list(names))
    told = {n: (units or {}).get(n, "") or _of_motion(n)[1] for n in names}

    def take(pattern: str, about: str) -> str | None:
        (usual,) = re.findall(r'unit = "([^"]*)"', about)
        called = next((n for n in found.left if re.fullmatch(pattern, bare(n), re.IGNORECASE)), None)
        return called or next(
            (n for n in found.left if re.fullmatch(pattern, _of_motion(n)[0], re.IGNORECASE) and _fits(told[n], usual)),
            None,
        )

    px4 = any(n.startswith(("q[", "xyz[", "timestamp_sample")) for n in names)
    down = False
    for signal, about, patterns in _guesses(wanted):
        columns = [take(p.removeprefix("-"), about) for p in patterns]
        if signal not in found.signals and all(columns) and len(set(columns)) == len(columns):
            signs = ["-" * p.startswith("-") for p in patterns]
            said = (
                about.replace(', frame = "world"', "") + ', frame = "ned"'
                if px4 and signal in ("position", "velocity")
                else about
            )
            down = down or (signal in ("position", "velocity") and _NED in about)
            if down and signal in _TURNED and "frd" not in about and _NED not in about:
                said = ", ".join([about.replace(', frame = "body"', ""), _TURNED[signal]])
            found.columns[signal] = [c for c in columns if c]
            said = _in_units(said, found.columns[signal], told)
            found.signals[signal] = _entry([f"{sign}{c}" for sign, c in zip(signs, columns, strict=True)], said)
            found.left = [n for n in found.left if n not in columns]
    driven = set(found.signals) & {"attitude", "body_rates"}  # of a vehicle; elsewhere u is a name for anything
    along = [next((n for n in found.left if bare(n).lower() == a), "") for a in "uvw"]
    if driven and all(along) and "velocity" not in found.signals and (not wanted or "velocity" in wanted):
        about = _in_units(f'unit = "m/s", frame = "{"frd" if down else "body"}"', along, told)
        found.signals["velocity"], found.columns["velocity"] = _entry(along, about), along
        found.left = [n for n in found.left if n not in along]
    for signal, unit, prefix in (*_NUMBERED, *([("pwm", "pwm", "u_?")] * bool(driven))):
        pattern = re.compile(rf"(?:{prefix})\d+(?:\]|_pwm|_rpm)?", re.IGNORECASE)
        numbered = sorted((n for n in found.left if pattern.fullmatch(n)), key=_number)
        if numbered and signal not in found.signals and (not wanted or signal in wanted):
            about = _in_units(f'unit = "{unit}"', numbered, told)
            found.signals[signal], found.columns[signal] = _entry(numbered, about), numbered
            found.left = [n for n in found.left if n not in numbered]
    moves = driven or set(found.signals) & _MOVING
    (supply,) = found.columns.get("battery", [""])
    if supply and not wanted and not moves and "bat" not in supply.lower():
        found.left += found.columns.pop("battery")  # "voltage_V" of a motor
        del found.signals["battery"]
    return found


def of_own(
    names: Sequence[str], wanted: Mapping[str, Signal], units: Mapping[str, str], inputs: Sequence[str] = ()
) -> Found:
    """The signals of a class of one's own: columns called as they are, "torque", as their axes, "torque_elbow", or "u".

    Args:
        names: of the columns, without that of the time.
        wanted: the signals that are looked for.
        units: of columns whose unit the file states.
        inputs: those of ``wanted`` that drive the system.
    """
    found = Found(left=list(names))
    for signal, about in wanted.items():
        axes = [a for a in about.axes if a]
        short = [[signal], [_NAMED.get(signal, signal)]] if len(about.axes) == 1 else []
        ways = [[rf"{signal}[._ ]?{a}" for a in axes], list(map(re.escape, axes)), *short]
        for patterns in ways:
            columns = [next((n for n in found.left if re.fullmatch(p, bare(n), re.IGNORECASE)), "") for p in patterns]
            if not columns or not all(columns) or len(set(columns)) < len(columns):
                continue
            written = [units.get(c, "") or _unit(c) for c in columns]
            unit = written[0] if len(set(written)) == 1 and written[0] else about.unit
            found.signals[signal], found.columns[signal] = _entry(columns, f'unit = "{unit}"'), columns
            found.left = [n for n in found.left if n not in columns]
            break
    _by_unit(found, wanted, units)
    driving = [n for n in found.left if drives(n)]
    if len(inputs) == len(driving) == 1 and inputs[0] not in found.signals and len(wanted[inputs[0]].axes) <= 1:
        column = driving[0]
        found.take(inputs[0], column, units.get(column, "") or _unit(column) or wanted[inputs[0]].unit)
    return found


def _by_unit(found: Found, wanted: Mapping[str, Signal], units: Mapping[str, str]) -> None:
    """Take columns for signals of one axis by a name that ends in a unit, or by a unit that no other has."""

    def fitting(signal: str) -> dict[str, str]:
        told = {n: units.get(n, "") or _unit(n) for n in found.left}
        return {n: unit for n, unit in told.items() if unit and measures(unit, wanted[signal].unit)}

    single = [s for s in wanted if s not in found.signals and len(wanted[s].axes) <= 1]
    for signal in single:
        named = rf"(?:{_NAMED.get(signal, signal)}|{signal})_\w+"
        for column, unit in [(n, u) for n, u in fitting(signal).items() if re.fullmatch(named, bare(n), re.IGNORECASE)][
            :1
        ]:
            found.take(signal, column, unit)
    for signal in (s for s in single if s not in found.signals):
        alike = [s for s in single if s not in found.signals and measures(wanted[s].unit, wanted[signal].unit)]
        if len(alike) == 1 and len(columns := fitting(signal)) == 1:
            found.take(signal, *columns.popitem())


def _in_units(about: str, columns: Sequence[str], units: Mapping[str, str]) -> str:
    """The rest of an entry with the one unit that the file states of its columns, if that measures the same."""
    (usual,) = re.findall(r'unit = "([^"]*)"', about)
    stated = {units.get(c, "") for c in columns}
    unit = stated.pop() if len(stated) == 1 else ""
    return about.replace(f'"{usual}"', f'"{unit}"', 1) if _fits(unit, usual) else about


def _fits(unit: str, usual: str) -> bool:
    """Whether what is usually in one unit can be in the other."""
    return bool(unit) and measures(unit, to_si(usual)[0])


def _of_motion(column: str) -> tuple[str, str]:
    """Name without unit, and unit, of a column of a vehicle's: "ax_g", "x [mm]"."""
    name = bare(column)
    stem, _, ending = name.partition("_")
    while ending and ending.lower() not in _OF_MOTION:
        more, _, ending = ending.partition("_")
        stem = f"{stem}_{more}"
    return (stem, _OF_MOTION[ending.lower()]) if ending else (name, _unit(column))


def own_signal(column: str, taken: Collection[str], unit: str = "") -> tuple[str, str]:
    """Name and entry of a signal that holds one column of which nothing is known but its name, and perhaps unit."""
    unit = unit or _unit(column)
    name = re.sub(r"\W+", "_", bare(column)).strip("_")[:36] or "signal"
    name = name if not name[0].isdigit() else f"s{name}"
    if name in taken:
        name = next(f"{name}_{i}" for i in range(2, len(taken) + 3) if f"{name}_{i}" not in taken)
    return name, _entry([column], f'unit = "{unit or 1}"') + ("" if unit else '  # TODO: its unit, such as "L/min"')


def drives(column: str) -> bool:
    """Whether a column seems to hold what drives a system, by its name."""
    return re.fullmatch(_DRIVES, bare(column), re.IGNORECASE) is not None


def bare(name: str) -> str:
    """A column's name without a unit in brackets, and without what makes its header a comment."""
    return re.sub(r"\s*[\[(](?!\d+[\])]$)[^\[(]*[\])]$", "", name.strip().lstrip("# "))


def _unit(column: str) -> str:
    """What the name says of the unit: "flow [L/min]", "flow_l_min"; empty: nothing."""
    in_brackets = re.fullmatch(r".*[\[(](?!\d+[\])]$)([^\[(]+)[\])]", column.strip())
    if in_brackets:
        try:
            return checked(in_brackets[1])
        except BenchError:
            return ""
    word = re.split(r"[_.\s]", column.strip().lower())[-1]
    if word in _WORDS:
        return _WORDS[word]
    endings = (column.lower(), _SUFFIXES), (column, _SIGNS)
    suffix = next((s for name, known in endings for s in known if name.endswith(f"_{s}")), "")
    return _UNITS.get(suffix, suffix.replace("_", "/"))


def _entry(columns: Sequence[str], about: str) -> str:
    return f"{{columns = {json.dumps(list(columns), ensure_ascii=False)}, {about}}}"


def _guesses(wanted: Collection[str]) -> list[tuple[str, str, tuple[str, ...]]]:
    """Signal, the rest of its entry, and a pattern for each of its columns."""
    if not wanted:
        return list(_GUESSES)
    found = [g for g in _GUESSES if g[0] in wanted]
    for signal in (s for s in wanted if s not in {g[0] for g in _GUESSES}):
        known = SIGNALS[signal]
        patterns = (_NAMED[signal] + rf"|{signal}(?:\.\w+)?",) if signal in _NAMED else known.axes
        if patterns:
            found.append((signal, f'unit = "{known.unit}"', patterns))
    return found


def _number(name: str) -> int:
    return int(re.findall(r"\d+", name)[-1])
