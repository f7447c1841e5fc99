"""What goes wrong in logs, put in on purpose; every function returns the spoilt columns and where."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

Array = np.ndarray
Columns = dict[str, Array]

SIGNALS = ("position", "attitude", "velocity", "body_rates", "rotor_speed")


@dataclass(frozen=True)
class Fault:
    """What is wrong and where."""

    recording: int
    signal: str
    """"t" where the clock is meant."""
    rows: tuple[int, int]
    """First row, and the one after the last."""
    kind: str


def _copy(columns: Columns) -> Columns:
    return {name: values.copy() for name, values in columns.items()}


def _somewhere(rng: np.random.Generator, columns: Columns, length: int) -> tuple[int, int]:
    start = int(rng.integers(100, len(columns["t"]) - 100 - length))
    return start, start + length


def spike(rng: np.random.Generator, columns: Columns, recording: int) -> tuple[Columns, Fault]:
    """One or two samples of one axis that lie far off."""
    out, signal = _copy(columns), str(rng.choice(SIGNALS))
    rows = _somewhere(rng, columns, int(rng.integers(1, 3)))
    size = {"position": 0.3, "attitude": 0.4, "velocity": 3.0, "body_rates": 6.0}.get(signal)
    size = (0.4 * float(columns[signal].mean()) if size is None else size) * rng.uniform(0.7, 1.5) * rng.choice([-1, 1])
    at = slice(*rows)
    if signal == "attitude":
        turn = Rotation.from_rotvec(size * np.eye(3)[rng.integers(3)])
        out[signal][at] = (Rotation.from_quat(out[signal][at]) * turn).as_quat()
    else:
        out[signal][at, rng.integers(out[signal].shape[1])] += size
    return out, Fault(recording, signal, rows, "spike")


def frozen(rng: np.random.Generator, columns: Columns, recording: int) -> tuple[Columns, Fault]:
    """A sensor that repeats its last value for .5 to 1.5 s."""
    out, signal = _copy(columns), str(rng.choice(SIGNALS))
    first, last = _somewhere(rng, columns, int(rng.integers(50, 150)))
    out[signal][first:last] = out[signal][first - 1]
    return out, Fault(recording, signal, (first, last), "frozen")


def swapped_sign(rng: np.random.Generator, columns: Columns, recording: int) -> tuple[Columns, Fault]:
    """An axis that counts the wrong way."""
    out, signal = _copy(columns), str(rng.choice(("position", "velocity", "body_rates")))
    out[signal][:, rng.integers(3)] *= -1
    return out, Fault(recording, signal, (0, len(out["t"])), "swapped_sign")


def clock_jump(rng: np.random.Generator, columns: Columns, recording: int) -> tuple[Columns, Fault]:
    """.1 to .4 s of samples lost, while the clock runs on as if nothing were missing."""
    first, last = _somewhere(rng, columns, int(rng.integers(10, 40)))
    out = {name: np.delete(values, slice(first, last), axis=0) for name, values in columns.items()}
    out["t"] = columns["t"][: len(out["t"])].copy()
    return out, Fault(recording, "t", (first, first + 1), "clock_jump")


def clock_rate(rng: np.random.Generator, columns: Columns, recording: int) -> tuple[Columns, Fault]:
    """A clock that runs 5 to 15 % too fast or too slow."""
    pace = 1 + rng.uniform(0.05, 0.15) * rng.choice([-1, 1])
    t, dt = columns["t"], columns["t"][1] - columns["t"][0]
    when = np.arange(int((t[-1] - t[0]) / (dt * pace)) + 1) * dt * pace
    out = resampled(columns, when)
    out["t"] = np.arange(len(when)) * dt
    return out, Fault(recording, "t", (0, len(when)), "clock_rate")


def resampled(columns: Columns, when: Array) -> Columns:
    """The columns at other times."""
    t = columns["t"]
    out = {"t": when}
    for name, values in columns.items():
        if name == "attitude":
            out[name] = Slerp(t, Rotation.from_quat(values))(np.clip(when, t[0], t[-1])).as_quat()
        elif name != "t":
            flat = values.reshape(len(t), -1)
            moved = np.stack([np.interp(when, t, c) for c in flat.T], axis=1)
            out[name] = moved.reshape(len(when), *values.shape[1:])
    return out


def time_shift(columns: Columns, recording: int, shift: float = 0.01) -> tuple[Columns, Fault]:
    """Inputs filed ``shift`` seconds too late against the states."""
    out = _copy(columns)
    late = resampled({name: columns[name] for name in ("t", "rotor_speed", "rotor_command")}, columns["t"] - shift)
    out["rotor_speed"], out["rotor_command"] = late["rotor_speed"], late["rotor_command"]
    return out, Fault(recording, "rotor_speed", (0, len(out["t"])), "time_shift")


KINDS = {
    "spike": spike,
    "frozen": frozen,
    "swapped_sign": swapped_sign,
    "clock_jump": clock_jump,
    "clock_rate": clock_rate,
}
"""Faults of one recording; `time_shift` is of all."""
