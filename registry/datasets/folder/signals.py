"""One signal of a `dataset.toml`: where it is in the files, what it is measured in, and what it is kept in."""

import re
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from registry.core import finite
from registry.dynamics import PhysicsModel
from registry.errors import BenchError, meant, near
from registry.units import SIGNALS, Signal, checked, conversion, measures, to_si

CONVENTIONS = {"euler_zyx": 3, "euler_xyz": 3, "quaternion_xyzw": 4, "quaternion_wxyz": 4}
FRAMES = {
    "position": ("world", "ned"),
    "velocity": ("world", "body", "ned", "frd"),
    "attitude": ("flu", "ned"),
    "body_rates": ("body", "frd"),
    "specific_force": ("body", "frd", "world", "ned"),
}
"""Of each signal: world with z up or north-east-down; body with y left and z up or forward-right-down. An attitude is
from the body (flu) to the world with z up, or from forward-right-down to north-east-down (ned)."""
GRAVITY = ("included", "removed")
TURNED = {"attitude": ("flu", "ned"), "body_rates": ("body", "frd"), "specific_force": ("body", "frd")}
"""Signals about axes that can be turned against the body's, and the frames in which they are about such."""
LARGEST_TURN = 45.0
"""Of them [deg]: more is another order or sign of the columns."""
LONGEST_DELAY = 1.0
"""Of a signal that was logged late [s]."""
_NAME = re.compile(r"[^\W\d]\w{0,39}")
_AXIS = re.compile(r"\w{1,20}")
_KEYS = ("columns", "unit", "axes", "convention", "frame", "gravity", "delay_s", "turned_deg")


@dataclass(frozen=True)
class SignalColumns:
    """Where a signal is in the files and what it is measured in."""

    columns: tuple[str, ...]
    unit: str
    """That of the files."""
    convention: str = ""
    """Of the attitude: one of `CONVENTIONS`."""
    frame: str = ""
    """One of `FRAMES`; empty: the first of them."""
    gravity: str = ""
    """Of the specific force: "removed" where it is the acceleration alone."""
    delay: float = 0.0
    """By how much it was logged late [s]."""
    turned: tuple[float, ...] = ()
    """By what rotation vector about the body's axes (forward, left, up) its own are turned [deg]; empty: not at all."""
    kept: str = ""
    """The unit in which it is kept; empty: that of SI."""
    axes: tuple[str, ...] = ()
    """Their names, where those of `registry.units.SIGNALS` do not hold."""

    @property
    def signal(self) -> Signal | None:
        """Unit and axes in which it is kept; None: as in `registry.units.SIGNALS`."""
        return Signal(self.kept, self.axes) if self.axes else None

    @property
    def names(self) -> tuple[str, ...]:
        """The columns as the files call them, without the sign that may stand before."""
        return tuple(c.removeprefix("-") for c in self.columns)


def signal_columns(path: Path, name: str, entry: Any, model: type[PhysicsModel] | None) -> SignalColumns:
    """The checked entry of a signal.

    A signal that the model names, or every vehicle has, is converted to its unit; any other is kept in its own.

    Args:
        path: of the dataset.toml.
        name: of the signal.
        entry: what is written there.
        model: the physics model of the recorded system; None: there is none.

    Raises:
        BenchError: what is missing, unknown or of the wrong kind.
    """
    if not isinstance(entry, dict) or "columns" not in entry:
        raise BenchError(f'{path}: {name} must be written {{columns = ["…"], unit = "…"}}.')
    known(entry, _KEYS, f"{path}: {name}")
    columns, convention, frame = (
        _texts(path, name, entry, "columns"),
        entry.get("convention", ""),
        entry.get("frame", ""),
    )
    if not isinstance(convention, str) or not isinstance(frame, str):
        raise BenchError(f"{path}: {name}: convention and frame must be texts.")
    wanted, unit = _wanted(path, name, entry, model), entry.get("unit")
    if name == "attitude":
        if convention not in CONVENTIONS:
            raise BenchError(f"{path}: attitude: convention = {convention!r}: {near(str(convention), CONVENTIONS)}")
        euler = convention.startswith("euler")
        wanted = Signal("rad" if euler else "1", tuple(str(i) for i in range(CONVENTIONS[convention])))
        unit = entry.get("unit", None if euler else "1")
    elif convention:
        raise BenchError(f"{path}: {name} has no convention: only the attitude has.")
    if unit is None:
        raise BenchError(f"{path}: {name} has no unit: add one, such as {wanted.unit if wanted else 'L/min'!r}.")
    if not isinstance(unit, str):
        raise BenchError(f"{path}: {name}: unit must be a text, not {unit!r}.")
    frames = FRAMES.get(name, ()) if wanted else ()
    if frame and frame not in frames:
        raise BenchError(f"{path}: {name}: frame = {frame!r}: {near(str(frame), frames)}")
    gravity, delay = entry.get("gravity", ""), entry.get("delay_s", 0.0)
    if gravity and (name != "specific_force" or gravity not in GRAVITY):
        raise BenchError(f"{path}: {name}: gravity = {gravity!r}: only specific_force has it, {near('', GRAVITY)}")
    if not finite(delay) or abs(delay) > LONGEST_DELAY:
        raise BenchError(f"{path}: {name}: delay_s must be a number of at most {LONGEST_DELAY:g} s, not {delay!r}.")
    kept, axes = _kept(path, name, entry, columns, unit, wanted)
    return SignalColumns(
        columns=columns,
        unit=unit,
        convention=convention,
        frame=frame,
        gravity=gravity,
        delay=float(delay),
        turned=_turned(path, name, entry, frame),
        kept=kept,
        axes=axes,
    )


def _turned(path: Path, name: str, entry: dict[str, Any], frame: str) -> tuple[float, ...]:
    """The turn that is written of a signal's axes; empty: none."""
    if "turned_deg" not in entry:
        return ()
    if name not in TURNED or (frame or TURNED[name][0]) not in TURNED[name]:
        raise BenchError(f"{path}: {name} has no turned_deg: only {', '.join(TURNED)} have, about axes of the body.")
    turn = entry["turned_deg"]
    sound = isinstance(turn, list) and len(turn) == 3 and all(finite(x) and abs(x) <= LARGEST_TURN for x in turn)
    if not sound:
        raise BenchError(f"{path}: {name}: turned_deg must be three angles of at most {LARGEST_TURN:g}, not {turn!r}.")
    return tuple(map(float, turn))


def _wanted(path: Path, name: str, entry: dict[str, Any], model: type[PhysicsModel] | None) -> Signal | None:
    """What the signal is to be; None: whatever the data say.

    Without a model that names it, a name that the suite knows holds where unit and number of columns fit it.
    """
    own = model.signal(name) if model else None
    if own is not None:
        return own
    if not _NAME.fullmatch(name):
        raise BenchError(f"{path}: {name!r} is no name of a signal: up to 40 letters, digits and _, no digit first.")
    listed = SIGNALS.get(name)
    if listed is None:
        if model and (other := meant(name, SIGNALS)):
            raise BenchError(f"{path}: unknown signal {name!r}: did you mean {other}?")
        return None
    fits = len(listed.axes) in (0, len(entry["columns"])) and measures(str(entry.get("unit", listed.unit)), listed.unit)
    strict = model or name == "attitude" or {"frame", "gravity"} & set(entry)
    return listed if (fits or strict) and not (fits and "axes" in entry and not model) else None


def _kept(
    path: Path, name: str, entry: dict[str, Any], columns: tuple[str, ...], unit: str, wanted: Signal | None
) -> tuple[str, tuple[str, ...]]:
    """The unit in which a signal is kept, and its axes if they are its own."""
    axes = _texts(path, name, entry, "axes") if "axes" in entry else ()
    if axes and (len(set(axes)) != len(columns) or not all(_AXIS.fullmatch(a) for a in axes)):
        raise BenchError(f"{path}: {name}: axes must be {len(columns)} different names, not {list(axes)!r}.")
    if wanted is None:
        try:
            checked(unit)
        except BenchError as error:
            raise BenchError(f"{path}: {name}: {error}") from error
        return unit, axes or (("",) if len(columns) == 1 else tuple(str(i + 1) for i in range(len(columns))))
    try:
        conversion(unit, wanted.unit)
    except BenchError as error:
        reason = f"{name} is measured in {wanted.unit}, which {unit!r} is not."
        try:
            to_si(unit)
        except BenchError as unknown:
            reason = f"{name}: {unknown}" if "did you mean" in str(unknown) else f"{name}: {error}"
        raise BenchError(f"{path}: {reason}") from error
    if wanted.axes and len(columns) != len(wanted.axes):
        raise BenchError(f"{path}: {name} needs {len(wanted.axes)} columns, not {len(columns)}.")
    if axes and wanted.axes and axes != wanted.axes:
        raise BenchError(f"{path}: {name}: its axes are {', '.join(wanted.axes)}: leave axes out.")
    listed = SIGNALS.get(name)
    same = listed is not None and listed.unit == wanted.unit and listed.axes == wanted.axes and not axes
    if name == "attitude" or same:
        return wanted.unit, ()
    return wanted.unit, axes or wanted.axes or tuple(str(i + 1) for i in range(len(columns)))


def _texts(path: Path, name: str, entry: dict[str, Any], key: str) -> tuple[str, ...]:
    values = entry[key]
    if not isinstance(values, list) or not values or not all(isinstance(v, str) for v in values):
        what = "column names" if key == "columns" else "names"
        raise BenchError(f"{path}: {name}: {key} must be a list of {what}, not {values!r}.")
    return tuple(values)


def refuse_unturned(path: Path, signals: dict[str, SignalColumns]) -> None:
    """Raise `BenchError` where a vector must be turned and the attitude was not measured."""
    if "attitude" in signals:
        return
    if signals.get("velocity", SignalColumns((), "")).frame in ("body", "frd"):
        raise BenchError(f"{path}: velocity in the body frame needs the attitude to be turned into the world.")
    force = signals.get("specific_force", SignalColumns((), ""))
    if force.frame in ("world", "ned") or force.gravity == "removed":
        raise BenchError(f"{path}: specific_force in the world frame, or without gravity, needs the attitude.")


def known(table: Any, keys: Collection[str], where: str) -> None:
    """Raise `BenchError` where something is no table or has other keys."""
    if not isinstance(table, dict):
        raise BenchError(f"{where} must be a table, not {table!r}.")
    for key in table:
        if key not in keys:
            raise BenchError(f"{where}: unknown key {key!r}: {near(key, keys)}")
