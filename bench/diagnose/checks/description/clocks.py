"""Signals that were logged late against others, all of a kind by the same: their clocks are compared in pairs."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from bench.diagnose.checks.description.mistake import Mistake, lines
from bench.diagnose.checks.description.recorded import Flight, Reading, Recorded
from bench.diagnose.checks.description.relations import Signals, acceleration, boxed, felt
from bench.diagnose.logs.consistency import slope
from bench.diagnose.settings import OFFSETTING
from registry.datasets.folder.conversion import GRAVITY
from registry.datasets.reading.cleaning import delay
from registry.datasets.reading.rotations import rotate

Array = np.ndarray

SAMPLES, TIME = 1.2, 0.012
"""Least offset that is one: in samples, and in seconds."""
GROUPS: tuple[tuple[str, ...], ...] = (
    ("specific_force",),
    ("attitude",),
    ("position",),
    ("body_rates",),
    ("velocity",),
    ("position", "velocity"),
    ("body_rates", "specific_force"),
    ("position", "velocity", "attitude"),
)
"""What one device or another logs, in the order in which it is taken to be late where nothing tells more."""


@dataclass(frozen=True)
class _Pair:
    """Two groups of signals that show the same motion."""

    first: tuple[str, ...]
    second: tuple[str, ...]
    show: Callable[[Flight, Signals], tuple[Array, Array, Array]]
    """Motion by either (N, c), and where it can be trusted (N,)."""
    braked: bool = False
    """Whether drag makes one lead the other: what goes with the velocity is left out."""


@dataclass(frozen=True)
class _Lag:
    """By how much one group comes after the other."""

    pair: _Pair
    lags: dict[str, float]
    """By recording [samples]: how much later the second is."""

    @property
    def middle(self) -> float:
        return float(np.median(list(self.lags.values())))

    @property
    def spread(self) -> float:
        values = np.array(list(self.lags.values()))
        return float(1.4826 * np.median(np.abs(values - self.middle)))


def clocks(recorded: Recorded, carried: bool = True) -> list[Mistake]:
    """Groups of signals that come late, by an offset that all recordings share, or by one of each its own.

    Args:
        recorded: what is read.
        carried: whether rotors carry the vehicle, so that it tilts where it accelerates.
    """
    reading, rate = recorded.reading, recorded.rate
    least = max(SAMPLES, TIME * rate)
    found = [
        lag
        for pair in (_PAIRS if carried else _PAIRS[:2])
        if (lag := _lag(recorded.flights, reading, pair)) is not None
    ]
    for flight in recorded.flights:
        flight.forget()
    wrong = [f for f in found if abs(f.middle) > least or f.spread > least]
    # Wind shifts tilt against acceleration as well: that pair only says which side of another is late.
    if all(f.pair.braked for f in wrong):
        return []
    free = [f for f in wrong if f.spread > max(1.0, OFFSETTING.steady * abs(f.middle))]
    told = [_varying(f, rate) for f in free if not f.pair.braked]
    found, wrong = ([f for f in fs if f not in free] for fs in (found, wrong))
    best: tuple[int, int, tuple[str, ...], float] | None = None
    for number, group in enumerate(GROUPS):
        if not all(g in reading.signals for g in group):
            continue
        shifts = [s for f in wrong if (s := _late(f, group)) is not None]
        if not shifts:
            continue
        shift = float(np.median(shifts))
        left = sum(abs(f.middle - _effect(f, group) * shift) > least for f in found)
        if best is None or (left, number) < best[:2]:
            best = (left, number, group, shift)
    if best is None or best[0] >= len(wrong):
        return told
    return [_offset(recorded, best[2], best[3], wrong), *told]


def _effect(lag: _Lag, group: Sequence[str]) -> int:
    """What a sample by which ``group`` is late does to this lag."""

    def late(side: Sequence[str]) -> bool:
        return any(s in group for s in side)

    first, second = late(lag.pair.first), late(lag.pair.second)
    return int(second) - int(first)


def _late(lag: _Lag, group: Sequence[str]) -> float | None:
    effect = _effect(lag, group)
    return lag.middle * effect if effect else None


def _lag(flights: Sequence[Flight], reading: Reading, pair: _Pair) -> _Lag | None:
    names = (*pair.first, *pair.second)
    if not all(n in reading.signals for n in names):
        return None
    lags = {}
    for flight in flights:
        x = flight.signals(reading, ("attitude", "velocity", *names))
        widest = round(OFFSETTING.widest * flight.rate)
        if len(flight) < 8 * widest:
            continue
        a, b, inside = pair.show(flight, x)
        a, b = (np.where(inside[:, None], v - v[inside].mean(axis=0), 0.0) if inside.any() else v for v in (a, b))
        beside = np.where(inside[:, None], x["velocity"][:, :2], 0.0) if pair.braked else None
        shift, how = delay(a, b, widest, beside)
        if how > OFFSETTING.least_correlation and abs(shift) < 0.9 * widest:
            # Slow motion agrees with itself at many offsets, and noise picks one.
            agrees = 1 - _together(a, b) < OFFSETTING.least_disagreement * (1 - how) and not pair.braked
            lags[flight.name] = 0.0 if agrees else shift
    return _Lag(pair, lags) if len(lags) >= max(1, OFFSETTING.recordings * len(flights)) else None


def _together(a: Array, b: Array) -> float:
    """Correlation of two motions (N, c) as they are, mean over the channels."""
    size = np.sqrt((a * a).sum(axis=0) * (b * b).sum(axis=0))
    return float(np.mean((a * b).sum(axis=0) / np.where(size > 0, size, 1.0)))


def _offset(recorded: Recorded, group: tuple[str, ...], shift: float, wrong: Sequence[_Lag]) -> Mistake:
    ms, rate = 1e3 * shift / recorded.rate, recorded.rate
    changed = recorded.reading
    for name in group:
        changed = changed.with_signal(name, delay=round(recorded.reading.signals[name].delay + shift / rate, 4))
    others = sorted({s for w in wrong for s in (*w.pair.first, *w.pair.second)} - set(group))
    side = "after" if shift > 0 else "before"
    detail = (
        f"{' and '.join(group)} {'come' if len(group) > 1 else 'comes'} {abs(shift):.1f} samples ({abs(ms):.3g} ms) "
        f"{side} {' and '.join(others)}, in {min(len(w.lags) for w in wrong)} of {len(recorded.flights)} recordings."
    )
    names = tuple(wrong[0].lags)
    return Mistake("clock offset", group[0], names, detail, lines(recorded.reading, changed), reading=changed)


def _varying(lag: _Lag, rate: float) -> Mistake:
    first, second, values = " and ".join(lag.pair.first), " and ".join(lag.pair.second), list(lag.lags.values())
    low, high = min(values), max(values)
    detail = (
        f"{second} and {first} have no common clock: the former comes between {low:+.1f} and {high:+.1f} samples "
        f"({1e3 * low / rate:+.3g} to {1e3 * high / rate:+.3g} ms) after the latter, by recording."
    )
    return Mistake("clock offset", lag.pair.second[0], tuple(lag.lags), detail, (), False)


# ------------------------------------------------------------------------------------- the same motion, seen twice


def _turns(flight: Flight, x: Signals) -> tuple[Array, Array, Array]:
    told = slope(x["attitude"], True, 1 / flight.rate)
    return boxed(flight, told), boxed(flight, x["body_rates"]), flight.valid


def _moves(flight: Flight, x: Signals) -> tuple[Array, Array, Array]:
    told = slope(x["position"], False, 1 / flight.rate)
    return boxed(flight, told), boxed(flight, x["velocity"]), flight.valid


def _tilts(flight: Flight, x: Signals) -> tuple[Array, Array, Array]:
    a, inside = acceleration(flight, x)
    up = boxed(flight, rotate(x["attitude"], np.broadcast_to([0.0, 0.0, 1.0], a.shape)))
    said = (a[:, 2:] + GRAVITY[2]) * up[:, :2] / np.maximum(np.abs(up[:, 2:]), 0.3)
    return said, a[:, :2], inside


def _feels(flight: Flight, x: Signals) -> tuple[Array, Array, Array]:
    told, inside = felt(flight, x)
    return told[:, 2:], boxed(flight, x["specific_force"])[:, 2:], inside


_PAIRS = (
    _Pair(("attitude",), ("body_rates",), _turns),
    _Pair(("position",), ("velocity",), _moves),
    _Pair(("attitude",), ("velocity",), _tilts, True),
    _Pair(("velocity",), ("specific_force",), _feels),
)
