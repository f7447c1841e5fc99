"""Signals with clocks of their own, on one."""

from collections.abc import Mapping

import numpy as np

from registry.datasets.logs.series import Series
from registry.datasets.reading.cleaning import resample, runs
from registry.datasets.reading.rotations import unit_quaternion

MAX_GAP = 5.0
"""Periods of a signal without a sample that are bridged; a longer gap cuts the recording in two."""
SHORTEST = 2.0
"""Recordings shorter than this are left out [s]."""
Span = tuple[float, float]
"""First and last time [s]."""


def spans(signals: Mapping[str, Series], rate: float, landed: Series | None = None) -> list[Span]:
    """Stretches of `SHORTEST` or longer, in the air, in which all signals have samples near enough.

    Args:
        signals: by name.
        rate: that is wanted [Hz].
        landed: see `registry.datasets.logs.series.Log.landed`.
    """
    found = [(-np.inf, np.inf)] if landed is None else _in_the_air(landed)
    for s in signals.values():
        cuts = np.flatnonzero(np.diff(s.t) > MAX_GAP / min(s.rate, rate))
        own = list(zip(s.t[np.r_[0, cuts + 1]].tolist(), s.t[np.r_[cuts, len(s.t) - 1]].tolist(), strict=True))
        found = _both(found, own)
    return [(a, b) for a, b in found if b - a >= SHORTEST]


def on_grid(signals: Mapping[str, Series], span: Span, rate: float, held: tuple[str, ...]) -> dict[str, np.ndarray]:
    """Values (M, c) of every signal at the times first + k / rate of a stretch.

    Args:
        signals: by name.
        span: the stretch.
        rate: [Hz].
        held: signals whose samples stay until the next one; straight lines lie between those of the others.
    """
    grid = times(span, rate)
    out = {}
    for name, s in signals.items():
        if name in held:
            out[name] = s.values[np.clip(np.searchsorted(s.t, grid + 1e-9, side="right") - 1, 0, len(s.t) - 1)]
            continue
        near = slice(max(0, int(np.searchsorted(s.t, span[0])) - 1), int(np.searchsorted(s.t, span[1])) + 1)
        x = s.values[near]
        if name == "attitude":
            x = unit_quaternion(x)
        moved, _ = resample(s.t[near], x, grid, np.inf)
        out[name] = unit_quaternion(moved) if name == "attitude" else moved
    return out


def times(span: Span, rate: float) -> np.ndarray:
    """(M,) [s]."""
    first, last = span
    return first + np.arange(int((last - first) * rate + 1e-6) + 1) / rate


def _in_the_air(landed: Series) -> list[Span]:
    """From the first word of the air to that of the ground; what was said first holds before, what last, after."""
    air = landed.values[:, 0] < 0.5
    t = np.r_[-np.inf, landed.t[1:], np.inf]
    return [(float(t[a]), float(t[b])) for a, b in runs(air)]


def _both(a: list[Span], b: list[Span]) -> list[Span]:
    """Where two lists of stretches, each in order and apart, overlap."""
    out, i, j = [], 0, 0
    while i < len(a) and j < len(b):
        first, last = max(a[i][0], b[j][0]), min(a[i][1], b[j][1])
        if first < last:
            out.append((first, last))
        if a[i][1] < b[j][1]:
            i += 1
        else:
            j += 1
    return out
