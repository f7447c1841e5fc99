"""Every single change of a reading that mends a mistake people make: units, signs, axes, frames, orders."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import permutations, product

from bench.diagnose.checks.description.recorded import Reading
from bench.diagnose.settings import MENDING
from registry.datasets.folder.signals import SignalColumns

UNITS = {
    "position": ("m", "cm", "mm"),
    "velocity": ("m/s", "cm/s", "mm/s", "km/h"),
    "body_rates": ("rad/s", "deg/s"),
    "specific_force": ("m/s^2", "g"),
}
"""In which each signal is logged by one vehicle or another."""
WORLD, BODY = ("position", "velocity"), ("body_rates", "specific_force")


@dataclass(frozen=True)
class Edit:
    """One change of a reading."""

    kind: str
    signals: tuple[str, ...]
    """Those it changes; the drive where it changes rotors."""
    what: str
    """What the log looks like if it is right, to follow "looks like" or to stand by itself."""
    reading: Reading
    cost: float = 0.0


def edits(reading: Reading, signals: Sequence[str]) -> Iterator[Edit]:
    """Changes of ``signals`` that could be what is wrong."""
    known = [s for s in signals if s in reading.signals]
    yield from _everything(reading)
    if "attitude" in known:
        yield from _attitude(reading)
    for name in (*WORLD, *BODY):
        if name in known:
            yield from _units(reading, (name,))
            yield from _frames(reading, name)
            yield from _axes(reading, (name,))
    if all(n in known for n in WORLD):
        yield from _units(reading, WORLD)
        yield from _axes(reading, WORLD)
        yield Edit("frame", WORLD, "north-east-down", _framed(reading, WORLD, "ned"), MENDING.less_common)
    if reading.drive in known and reading.positions:
        yield from _rotors(reading)


# --------------------------------------------------------------------------------------------- frames and units


def _framed(reading: Reading, names: Sequence[str], frame: str) -> Reading:
    for name in names:
        if name in reading.signals:
            reading = reading.with_signal(name, frame=frame)
    return reading


def _everything(reading: Reading) -> Iterator[Edit]:
    """North-east-down and forward-right-down instead of z up, for the world and the body together or for one."""
    s = reading.signals
    plain = all(s[n].frame in ("", "world", "flu", "body") for n in (*WORLD, *BODY, "attitude") if n in s)
    if not plain or (s.get("velocity") and s["velocity"].frame == "body"):
        return
    both = _framed(_framed(reading, (*WORLD, "attitude"), "ned"), BODY, "frd")
    names = tuple(n for n in (*WORLD, "attitude", *BODY) if n in s)
    yield Edit("frame", names, "north-east-down, forward-right-down", both)
    if "attitude" in s:
        body = _framed(_framed(reading, ("attitude",), "ned"), BODY, "frd")
        told = tuple(n for n in ("attitude", *BODY) if n in s)
        yield Edit("frame", told, "forward-right-down to north-east-down", body, MENDING.less_common)
        rates = _framed(_framed(reading, (*WORLD, "attitude"), "ned"), ("body_rates",), "frd")
        if "specific_force" in s:
            yield Edit("frame", names[:-1], "north-east-down, forward-right-down", rates, MENDING.less_common)
    if all(n in s for n in BODY):
        yield Edit("frame", BODY, "forward-right-down", _framed(reading, BODY, "frd"), MENDING.less_common)


def _units(reading: Reading, names: Sequence[str]) -> Iterator[Edit]:
    """Another unit of the same quantity; of position and velocity together the same thousandth."""
    for i, unit in enumerate(UNITS[names[0]][: min(len(UNITS[n]) for n in names)]):
        changed, differs = reading, False
        for name in names:
            other = UNITS[name][i]
            differs |= other != reading.signals[name].unit
            changed = changed.with_signal(name, unit=other)
        if differs:
            yield Edit("unit", tuple(names), unit, changed, MENDING.less_common * (len(names) - 1))


def _frames(reading: Reading, name: str) -> Iterator[Edit]:
    now = reading.signals[name].frame
    turned = "attitude" in reading.signals
    if name == "position":
        frames = {"world": "z up", "ned": "north-east-down"}
    elif name == "velocity":
        frames = {"world": "the world frame", "ned": "north-east-down"}
        if turned:
            frames |= {"body": "the body frame", "frd": "the body frame, forward-right-down"}
    else:
        frames = {"body": "forward-left-up", "frd": "forward-right-down"}
    for frame, said in frames.items():
        if frame != (now or next(iter(frames))):
            yield Edit("frame", (name,), said, _framed(reading, (name,), frame))
    if name == "specific_force":
        yield from _gravity(reading, turned)


def _gravity(reading: Reading, turned: bool) -> Iterator[Edit]:
    """Acceleration without the weight, in the world, of the other sign, in g: one of these or several."""
    now = reading.signals["specific_force"]
    against = _signed(now.columns, (-1, -1, -1))
    for unit, columns, frame, gravity in product(
        UNITS["specific_force"],
        (now.columns, against),
        ("body", "frd", "world", "ned") if turned else ("body", "frd"),
        ("included", "removed") if turned else ("included",),
    ):
        changed = replace(
            now,
            unit=unit,
            columns=columns,
            frame="" if frame == "body" else frame,
            gravity=gravity.replace("included", ""),
        )
        if changed == now:
            continue
        said = []
        if gravity != (now.gravity or "included"):
            said.append("free of gravity" if gravity == "removed" else "with gravity")
        if unit != now.unit:
            said.append(f"in {unit}")
        if columns != now.columns:
            said.append("of the opposite sign")
        if frame != (now.frame or "body"):
            said.append({"body": "forward-left-up", "frd": "forward-right-down"}.get(frame, "in the world frame"))
        changes = (gravity != (now.gravity or "included"), unit != now.unit, columns != now.columns)
        kind = next((k for k, c in zip(("gravity", "unit", "swapped sign"), changes, strict=True) if c), "frame")
        cost = MENDING.less_common * (len(said) - 1) + MENDING.uncommon * (frame == "ned")
        yield Edit(
            kind, ("specific_force",), ", ".join(said), reading.with_signal("specific_force", **vars(changed)), cost
        )


# ------------------------------------------------------------------------------------------------ axes and signs


def _axes(reading: Reading, names: Sequence[str]) -> Iterator[Edit]:
    """Columns in another order, with other signs; the same of several signals."""
    for order in permutations(range(3)):
        for signs in product((1, -1), repeat=3):
            if order == (0, 1, 2) and signs == (1, 1, 1):
                continue
            if len(names) > 1 and (order[2] != 2 or signs[2] < 0):
                continue  # of several signals at once, only another heading of the world
            changed = reading
            for name in names:
                columns = reading.signals[name].columns
                changed = changed.with_signal(name, columns=_signed([columns[i] for i in order], signs))
            moved, turned = sum(o != i for i, o in enumerate(order)), signs.count(-1)
            kind = "swapped axes" if moved else "swapped sign"
            cost = MENDING.less_common * (turned > 1 or (moved and turned) or moved > 2) + MENDING.uncommon * (
                len(names) - 1
            )
            yield Edit(kind, tuple(names), ", ".join(changed.signals[names[0]].columns), changed, cost)


def _signed(columns: Sequence[str], signs: Sequence[int]) -> tuple[str, ...]:
    """Columns with the sign turned where ``signs`` is −1."""

    def turned(name: str) -> str:
        return name[1:] if name.startswith("-") else f"-{name}"

    return tuple(c if s > 0 else turned(c) for c, s in zip(columns, signs, strict=True))


def _attitude(reading: Reading) -> Iterator[Edit]:
    now = reading.signals["attitude"]
    if now.convention.startswith("euler"):
        yield from _angles(reading, now)
        return
    other = {"quaternion_xyzw": "quaternion_wxyz", "quaternion_wxyz": "quaternion_xyzw"}[now.convention]
    frame = "" if now.frame == "ned" else "ned"
    for convention, inverse, framed in product((now.convention, other), (False, True), (now.frame, frame)):
        if convention == now.convention and not inverse and framed == now.frame:
            continue
        kind = "quaternion order" if convention != now.convention else "inverse attitude" if inverse else "frame"
        columns = now.columns
        if inverse:
            columns = _signed(columns, (-1, -1, -1, 1) if convention == "quaternion_xyzw" else (1, -1, -1, -1))
        said = [convention.removeprefix("quaternion_")] if convention != now.convention else []
        said += ["world to body"] if inverse else []
        said += ["north-east-down"] if framed != now.frame else []
        changed = reading.with_signal("attitude", convention=convention, columns=columns, frame=framed)
        yield Edit(kind, ("attitude",), ", ".join(said), changed, MENDING.less_common * (len(said) - 1))


def _angles(reading: Reading, now: SignalColumns) -> Iterator[Edit]:
    for unit, convention, frame in product(("rad", "deg"), ("euler_zyx", "euler_xyz"), ("", "ned")):
        changes = [unit != now.unit, convention != now.convention, frame != now.frame]
        if any(changes):
            kind = "unit" if changes[0] else "euler convention" if changes[1] else "frame"
            said = [x for x, c in zip((unit, convention, "north-east-down"), changes, strict=True) if c]
            changed = reading.with_signal("attitude", unit=unit, convention=convention, frame=frame)
            yield Edit(kind, ("attitude",), ", ".join(said), changed, MENDING.less_common * (len(said) - 1))
    for order in permutations(range(3)):
        for signs in product((1, -1), repeat=3):
            moved, turned = order != (0, 1, 2), signs.count(-1)
            if moved or turned:
                columns = _signed([now.columns[i] for i in order], signs)
                kind = "swapped axes" if moved else "swapped sign"
                changed = reading.with_signal("attitude", columns=columns)
                cost = MENDING.less_common * (turned > 1 or bool(moved and turned)) + MENDING.less_common
                yield Edit(kind, ("attitude",), ", ".join(columns), changed, cost)


# -------------------------------------------------------------------------------------------------------- rotors


def _rotors(reading: Reading) -> Iterator[Edit]:
    """Another order of the rotors' columns, hubs on the other side, reaction torques of the other sign."""
    columns = reading.signals[reading.drive].columns
    count = len(columns)
    if not 1 < count <= 4:
        return
    against = tuple(-s for s in reading.directions)
    for order in permutations(range(count)):
        moved = order != tuple(range(count))
        said = "-".join(str(i + 1) for i in order)
        changed = reading.with_signal(reading.drive, columns=tuple(columns[i] for i in order))
        if moved:
            yield Edit("rotor order", (reading.drive,), said, changed)
        if against:
            kind = "rotor order" if moved else "rotor directions"
            told = f"{said}, with directions of the opposite sign" if moved else "of the opposite sign"
            turned = replace(changed, directions=against)
            yield Edit(kind, (reading.drive,), told, turned, MENDING.uncommon * moved)
    for swapped, sx, sy in product((False, True), (1, -1), (1, -1)):
        if (swapped, sx, sy) != (False, 1, 1):
            hubs = tuple((sx * (y if swapped else x), sy * (x if swapped else y), z) for x, y, z in _whole(reading))
            what = ", ".join(
                (["x and y swapped"] if swapped else []) + [f"{a} negative" for a, s in (("x", sx), ("y", sy)) if s < 0]
            )
            yield Edit("rotor positions", (reading.drive,), what, replace(reading, positions=hubs), MENDING.less_common)


def _whole(reading: Reading) -> list[tuple[float, float, float]]:
    """Hubs with a height, which may be left out."""
    return [(p[0], p[1], p[2] if len(p) > 2 else 0.0) for p in reading.positions]
