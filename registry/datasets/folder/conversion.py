"""From the columns of a file to signals in SI and in the frames of this project, as a dataset.toml says."""

from collections.abc import Mapping

import numpy as np

from registry.datasets.folder.signals import SignalColumns
from registry.datasets.reading.rotations import quaternion_from_euler, rotate, unit_quaternion
from registry.units import conversion, to_si

Array = np.ndarray

HALF_TURN = np.array([1.0, -1.0, -1.0])
"""Half a turn about x: from north-east-down to north-west-up, from forward-right-down to forward-left-up."""
GRAVITY = np.array([0.0, 0.0, 9.80665])
"""What an accelerometer at rest shows in the world frame [m/s²]."""


def own_units(columns: Mapping[str, Array], signal: SignalColumns) -> Array:
    """The columns (N, c) of a signal with their signs, in the unit in which it is kept."""
    picked = np.stack([-columns[c[1:]] if c.startswith("-") else columns[c] for c in signal.columns], axis=1)
    factor, offset = conversion(signal.unit, signal.kept) if signal.kept else (to_si(signal.unit)[1], 0.0)
    return picked * factor + offset if offset else picked * factor


def turns_counted(values: Array) -> tuple[Array, int, float]:
    """Angles (N, c) [rad] past the span that they were filed in, how often one went past its end, and the span [rad].

    A span is a turn, or all that a motor's protocol has room for.
    """
    out, times, last = values.copy(), 0, 2 * np.pi
    for c, x in enumerate(values.T):
        ends, span = _span(x)
        if ends:
            out[:, c], times, last = np.unwrap(x, period=span), times + ends, span
    return out, times, last


def _span(x: Array) -> tuple[int, float]:
    """How often an angle (N,) goes past the end of the span that it is filed in, and that span; 0: it never does.

    What stays within one turn and goes from one end of it to the other between two samples, where it mostly moves by
    far less, was filed so; an encoder that counts its turns leaves one. Of another span it also moves on beyond the
    end as it did before it, every time, and its size is the simplest number of what that leaves open.
    """
    steps, range_ = np.diff(x), float(np.ptp(x))
    usual = float(np.median(np.abs(steps))) if len(steps) else 0.0
    ends = int((np.abs(steps) > 1.5 * np.pi).sum())
    if ends and range_ <= 2 * np.pi * 1.001 and usual < np.pi / 2:
        return ends, 2 * np.pi
    at = np.flatnonzero(np.abs(steps) > 0.9 * range_)
    if range_ <= 2 * np.pi * 1.001 or not len(at) or at[0] == 0 or at[-1] > len(steps) - 2 or usual > 0.05 * range_:
        return 0, 0.0
    before, jump, after = (np.sign(steps[at]) * steps[at + k] for k in (-1, 0, 1))
    if max(before.max(), after.max()) >= 0:
        return 0, 0.0
    full, open_ = float(np.median(jump - (before + after) / 2)), float(np.abs(before - after).max()) / 2
    return len(at), _simplest(max(full - open_, range_), full + open_)


def _simplest(low: float, high: float) -> float:
    """The number with fewest digits from one to another, of those the one next to their middle."""
    middle = (low + high) / 2
    numbers = (float(f"{middle:.{digits}g}") for digits in range(1, 17))
    return next((n for n in numbers if low <= n <= high), middle)


def attitude(values: Array, signal: SignalColumns) -> Array:
    """Quaternions xyzw (N, 4), body to world, of unit length, from angles [rad] or quaternions as ``signal`` says.

    Raises:
        ValueError: a quaternion of length zero.
    """
    if signal.convention == "euler_zyx":
        q = quaternion_from_euler(values)
    elif signal.convention == "euler_xyz":
        q = _xyz(values)
    else:
        q = unit_quaternion(values if signal.convention == "quaternion_xyzw" else values[:, [1, 2, 3, 0]])
    q = q * [1.0, -1.0, -1.0, 1.0] if signal.frame == "ned" else q
    return _times(q, -np.radians(signal.turned)) if signal.turned else q


def in_frames(x: dict[str, Array], signals: Mapping[str, SignalColumns]) -> dict[str, Array]:
    """Vectors turned into the frames of this project; ``x`` holds the attitude as `attitude` gives it."""
    out = dict(x)
    for name in ("position", "velocity", "body_rates", "specific_force"):
        if name in x:
            out[name] = vector(name, x[name], signals[name], x.get("attitude"))
    return out


def vector(name: str, values: Array, signal: SignalColumns, q: Array | None) -> Array:
    """One vector signal (N, 3) in its frame: world of position and velocity, body of the others.

    Args:
        name: of the signal.
        values: (N, 3), SI.
        signal: what the description says of it.
        q: attitude (N, 4), where it was measured.
    """
    if signal.frame in ("ned", "frd"):
        values = values * HALF_TURN
    if signal.turned:
        values = rotate(_times(np.array([[0.0, 0.0, 0.0, 1.0]]), np.radians(signal.turned)), values)
    if name == "velocity" and signal.frame in ("body", "frd"):
        assert q is not None
        return rotate(q, values)
    if name == "specific_force" and (signal.frame in ("world", "ned") or signal.gravity == "removed"):
        assert q is not None
        inverse = q * [-1.0, -1.0, -1.0, 1.0]
        turned = rotate(inverse, values) if signal.frame in ("world", "ned") else values
        return turned + rotate(inverse, np.broadcast_to(GRAVITY, values.shape)) * (signal.gravity == "removed")
    return values


def _times(q: Array, turn: Array) -> Array:
    """Quaternions xyzw (N, 4) times that of a rotation vector (3,) [rad]."""
    x, y, z, w = q.T
    size = float(np.linalg.norm(turn))
    a, b, c = turn * (np.sin(size / 2) / size if size else 0.5)
    d = np.cos(size / 2)
    out = [w * a + x * d + y * c - z * b, w * b - x * c + y * d + z * a, w * c + x * b - y * a + z * d]
    return np.stack([*out, w * d - x * a - y * b - z * c], axis=1)


def _xyz(angles: Array) -> Array:
    """Quaternions xyzw (N, 4) of roll, then pitch, then yaw (N, 3) [rad], each about the axis turned so far."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(angles.T / 2), np.sin(angles.T / 2)
    x, y, z = sr * cp * cy + cr * sp * sy, cr * sp * cy - sr * cp * sy, cr * cp * sy + sr * sp * cy
    return unit_quaternion(np.stack([x, y, z, cr * cp * cy - sr * sp * sy], axis=1))
