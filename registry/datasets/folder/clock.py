"""From the samples of a file, as its clock has them, to signals on a uniform grid."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from registry.contracts import Finding
from registry.datasets.reading.cleaning import resample, runs
from registry.datasets.reading.tables import first_row
from registry.errors import BenchError

Array = np.ndarray

UNIFORM = 1e-3
"""How far steps may differ, in sampling periods, for the samples to be taken as they are."""
JITTER = 0.4
"""How much of a sampling period the clock may be off between two samples before one is missing."""
MAX_GAP = 4.0
"""Steps of a signal, in its own sampling periods, over which values are interpolated; a longer one is a gap."""
THINNEST, THICKEST = 20, 100
"""Samples of the grid for one of the file, and of the file for one of the grid, beyond which its clock is wrong."""
BURSTS = 0.3
"""Share of the steps from which on long ones are no gaps: samples come in bursts."""
DRIFT, STRETCH = 0.05, 50
"""How far the rate may vary within a file, measured over so many samples."""
ODD = 0.1
"""Share of a file that may run at another rate than the rest, as a computer does that has just started: left out."""
TWICE = 0.01
"""Share of the rows that may hold other values at the time of the row before, as where a stamp came late."""


@dataclass(frozen=True, eq=False)
class Clock:
    """The times of a file and the grid that its signals are put on."""

    t: Array
    """(N,) [s], strictly increasing."""
    rate: float
    """Of the grid [Hz]."""
    grid: Array
    """(M,) [s]; ``t`` itself where the samples are taken as they are."""
    odd: tuple[tuple[float, float], ...] = ()
    """From when to when [s] its rate is another one: the times are not those of the samples."""
    twice: int = 0
    """Rows that held other values at the time of the row before, and were left out."""

    @property
    def as_it_is(self) -> bool:
        """Whether the samples lie on the grid already."""
        return self.grid is self.t

    @property
    def steady(self) -> Array:
        """(M,) whether the grid lies outside of what is ``odd``."""
        lies = np.ones(len(self.grid), dtype=bool)
        for start, end in self.odd:
            lies &= (self.grid < start) | (self.grid > end)
        return lies


@dataclass(frozen=True, eq=False)
class Pace:
    """How fast a clock runs, and how steadily."""

    period: float
    """Mean step without gaps [s]."""
    gaps: Array
    """(N - 1,) steps beyond which samples are missing."""
    spread: float
    """The largest deviation of another step, in periods."""
    stretch: int
    """Steps over which the following are measured; 0: there are too few."""
    low: float = 0.0
    """The least rate of a stretch [Hz]."""
    high: float = 0.0
    worst: int = 0
    """Sample at which the stretch begins whose rate is farthest from the others'."""
    odd: Array = field(default_factory=lambda: np.zeros(0, dtype=bool))
    """(N - 1,) steps in stretches whose rate is not that of most; as many as there are, or few enough to leave out."""

    @property
    def varies(self) -> float:
        """By which share of the least rate the greatest one is above it."""
        return self.high / self.low - 1 if self.stretch else 0.0


def clock(file: Path, column: str, t: Array, rate: float) -> Clock:
    """The clock of a file.

    Args:
        file: named in errors.
        column: that of the time.
        t: (N,) its values [s].
        rate: wanted [Hz].

    Raises:
        BenchError: it does not run forward, or its rate cannot become the one that is wanted.
    """
    period, step = 1 / rate, np.diff(t)
    if (step <= 0).any():
        i = int((step <= 0).argmax())
        raise BenchError(
            f"{file}, column {column!r}, row {first_row(file) + i + 1}: the clock goes on by {step[i]:.6g} s: "
            "times must increase from row to row; split the file there."
        )
    if not 1 / THICKEST <= np.median(step) * rate <= THINNEST:
        raise BenchError(
            f"{file}, column {column!r}: its samples come at {1 / np.median(step):.5g} Hz, which rate_hz = {rate:g} "
            "cannot be made of: mend rate_hz or time_unit."
        )
    if (t[-1] - t[0]) * rate > THINNEST * len(t) + 1000:
        i = int(step.argmax())
        raise BenchError(
            f"{file}, column {column!r}, row {first_row(file) + i + 1}: the clock jumps by {step[i]:.6g} s where "
            f"rate_hz = {rate:g} means {period:.6g} s; split the file there, or mend rate_hz or time_unit."
        )
    if np.ptp(step) <= UNIFORM * period and abs(np.median(step) - period) <= UNIFORM * period:
        return Clock(t, rate, t)
    return Clock(t, rate, t[0] + np.arange(int((t[-1] - t[0]) * rate + 1e-6) + 1) * period)


def joined(table: Array) -> tuple[Array, int]:
    """Rows (N, 1 + c) of times and values, those of one time made one; and how many had other values for it.

    A row may hold some signals and the next one others. Of two values of one signal the later one stays; a file in
    which that is more than seldom is left as it is: its clock is wrong.
    """
    same = np.flatnonzero(np.diff(table[:, 0]) == 0)
    if not len(same):
        return table, 0
    first, later = table[same, 1:], table[same + 1, 1:]
    twice = int((np.isfinite(first) & np.isfinite(later) & (first != later)).any(axis=1).sum())
    if twice > TWICE * len(table):
        return table, 0
    out = table.copy()
    for i in same:
        out[i + 1] = np.where(np.isfinite(out[i + 1]), out[i + 1], out[i])
    return np.delete(out, same, axis=0), twice


def pace(t: Array) -> Pace:
    """The pace of times (N,) [s], N ≥ 2, in the steadiest of its readings.

    A step that is too long is a missing sample, or a sample that was stamped late: then those after it come sooner.
    """
    step = np.diff(t)
    own = float(np.median(step))
    readings = [step > (1 + JITTER) * own, step > MAX_GAP * own, np.zeros(len(step), dtype=bool)]
    rare = [gaps for gaps in readings if _rare(gaps)]
    whole = min((_paced(step, gaps, whole=True) for gaps in rare), key=lambda p: p.varies)
    if not whole.stretch or whole.varies <= _allowed(whole.stretch):
        return whole
    return min((_paced(step, gaps) for gaps in rare), key=lambda p: p.varies)


def _rare(gaps: Array) -> bool:
    """Whether few steps are gaps; half of those of a stretch are another rate, a third of all are bursts."""
    n = min(STRETCH, len(gaps) // 4)
    return bool(gaps.mean() < BURSTS and not (n and (np.convolve(gaps, np.ones(n), "valid") > n / 2).any()))


def _paced(step: Array, gaps: Array, whole: bool = False) -> Pace:
    """The pace of steps (N - 1,) [s] of which some are gaps; ``whole``: with what runs at another rate."""
    at = np.flatnonzero(~gaps)
    own = step[at]
    period = float(own.mean())
    spread = float(np.abs(own / period - 1).max())
    n = min(STRETCH, len(own) // 4)
    if not n:
        return Pace(period, gaps, spread, 0)
    rates = _rates(own, n)
    usual = np.median(rates)
    off = np.convolve(np.abs(rates / usual - 1) > _allowed(n), np.ones(n)) > 0  # (len(own),) in such a stretch
    odd = np.zeros(len(step), dtype=bool)
    if not whole and off.mean() <= ODD and len(kept := _rates(own[~off], n)):
        odd[at[off]], period = True, float(own[~off].mean())
        for a, b in runs(odd | gaps):  # those that are long among them are no samples that are missing
            odd[a:b] = odd[a:b].any()
    else:
        kept = rates
    return Pace(
        period=period,
        gaps=gaps,
        spread=spread,
        stretch=n,
        low=float(kept.min()),
        high=float(kept.max()),
        worst=int(at[int(np.abs(rates - usual).argmax())]),
        odd=odd,
    )


def _rates(steps: Array, n: int) -> Array:
    """Of every stretch of ``n`` steps (N,) [s] [Hz]."""
    total = np.concatenate([[0.0], np.cumsum(steps)])
    return np.asarray(n / (total[n:] - total[:-n]))


def _allowed(stretch: int) -> float:
    """How far the rates of stretches of so many steps may be apart, as a share."""
    return DRIFT + 4 * JITTER / stretch


def without_drift(file: Path, column: str, of: Clock, logged: Sequence[Array]) -> Clock:
    """The clock with the little left out where the rate of a signal is another one: its times are not the samples'.

    Args:
        file: named in errors.
        column: that of the time.
        of: the clock of the file.
        logged: (N,) rows that hold each signal.

    Raises:
        BenchError: the rate varies elsewhere too, with the lowest and highest rate, and where.
    """
    odd: set[tuple[float, float]] = set()
    for rows in {r.tobytes(): r for r in logged}.values():
        if of.as_it_is or rows.sum() < 2:
            continue
        t = of.t[rows]
        found = pace(t)
        if not found.stretch or found.varies <= _allowed(found.stretch):
            odd |= {(float(t[a]), float(t[b])) for a, b in runs(found.odd)}
            continue
        row = first_row(file) + int(np.flatnonzero(rows)[found.worst])
        raise BenchError(
            f"{file}, column {column!r}: the clock runs from {found.low:.4g} to {found.high:.4g} Hz, worst from row "
            f"{row} on, where rate_hz = {of.rate:g}: mend the clock, split the file where its rate changes, or say "
            'clock = "exact" if the samples were taken at just these times.'
        )
    apart: list[tuple[float, float]] = []
    for start, end in sorted(odd):
        if apart and start <= apart[-1][1]:
            start, end = apart[-1][0], max(end, apart.pop()[1])
        apart.append((start, end))
    return replace(of, odd=tuple(apart))


def gridded(of: Clock, x: Array, logged: Array, late: float = 0.0, held: bool = False) -> tuple[Array, Array]:
    """A signal on the grid.

    Args:
        of: the clock of its file.
        x: (n, c) the samples that were logged.
        logged: (N,) which of the file's rows they are.
        late: by how much they were logged late [s].
        held: whether a value stays until the next one; else straight lines lie between them.

    Returns:
        (M, c), and (M,) whether there were samples near enough.
    """
    if of.as_it_is and logged.all() and not late:
        return x, np.ones(len(x), dtype=bool)
    t = of.t[logged]
    if len(t) < 2:
        return np.repeat(x, len(of.grid), axis=0), np.zeros(len(of.grid), dtype=bool)
    own = float(np.median(np.diff(t)))
    whole = logged.all() and bool((np.diff(t) <= MAX_GAP * own).all())
    moved, inside = resample(t - late, x, of.grid, np.inf if whole else MAX_GAP * own)
    if held and own > (1 + JITTER) / of.rate:
        moved = x[np.clip(np.searchsorted(t - late, of.grid + 1e-9, side="right") - 1, 0, len(x) - 1)]
    return moved, inside if late or not whole else np.ones(len(of.grid), dtype=bool)


def clock_findings(name: str, of: Clock, logged: Mapping[str, Array], near: Mapping[str, Array]) -> list[Finding]:
    """What was done to the samples of a recording.

    Args:
        name: of the recording.
        of: its clock.
        logged: (N,) rows that hold each signal.
        near: (M,) by signal, samples of the grid that it had samples near to; the others are left out.
    """
    found: list[Finding] = []
    if of.twice:
        have, stay = ("row has", "one stays") if of.twice == 1 else ("rows have", "ones stay")
        detail = f"{of.twice} {have} the time of the row before and other values: the later {stay}"
        found.append(Finding(name, "twice", of.twice, detail))
    if len(of.t) < 3:
        return found
    own, wanted = pace(of.t), of.rate
    for start, end in of.odd:
        n = int(((of.t >= start) & (of.t < end)).sum())
        detail = f"{n} samples from {start - of.t[0]:.3g} s on run at {n / (end - start):.4g} Hz: left out"
        found.append(Finding(name, "odd rate", n, detail))
    if own.stretch and own.varies > _allowed(own.stretch):
        detail = (
            f"samples come at {own.low:.4g} to {own.high:.4g} Hz, put on {wanted:g} Hz by the times they were taken"
        )
        found.append(Finding(name, "irregular", len(of.t), detail))
    off = abs(own.period * wanted - 1) > UNIFORM + 2 * own.spread / len(of.t)
    if not of.as_it_is and off and any(rows.all() for rows in logged.values()):
        detail = f"logged at {1 / own.period:.5g} Hz, put on {wanted:g} Hz by straight lines between samples"
        found.append(Finding(name, "resampled", abs(len(of.grid) - len(of.t)), detail))
    elif own.spread > UNIFORM and all(f.kind != "irregular" for f in found):
        detail = f"steps of the clock differ from {own.period:.4g} s by up to {100 * own.spread:.2g} %"
        detail += f": put on {wanted:g} Hz by straight lines between samples"
        found.append(Finding(name, "jitter", len(of.t), detail))
    for signal, rows in logged.items():
        if rows.sum() < 2 or rows.all():
            continue
        rate, missing = 1 / pace(of.t[rows]).period, int((~rows).sum())
        detail = f"{signal} has samples at {rate:.5g} Hz, and none in {missing} of {len(rows)} rows"
        if left := int((~near[signal]).sum()):
            how = f"{left} samples ({left / wanted:.3g} s) far from any are left out"
            how += ", the others interpolated" if left < missing else ""
        else:
            how = f"interpolated at {wanted:g} Hz"
        found.append(Finding(name, "missing", missing, f"{detail}: {how}"))
    gaps = np.diff(of.t)[own.gaps]
    if len(gaps):
        lost, longest = int(np.rint(gaps / own.period - 1).sum()), float(gaps.max())
        bridge = MAX_GAP * own.period
        how = (
            "bridged by straight lines"
            if all(n.all() for n in near.values())
            else f"bridged up to {bridge:.3g} s, left out beyond"
        )
        detail = f"{lost} samples missing in {len(gaps)} place(s), at most {longest:.3g} s apart: {how}"
        found.append(Finding(name, "gap", lost, detail))
    return found


def nearest(of: Clock, x: Array) -> tuple[Array, Array]:
    """A column (N,) that may lack values on the grid: the nearest value that was logged, and where one was near."""
    logged = np.isfinite(x)
    if of.as_it_is and logged.all():
        return x, logged
    t = of.t[logged]
    at = np.clip(np.searchsorted(t, of.grid), 1, len(t) - 1)
    at = np.where(of.grid - t[at - 1] < t[at] - of.grid, at - 1, at)
    own = float(np.median(np.diff(t))) if len(t) > 1 else 0.0
    return x[logged][at], np.abs(t[at] - of.grid) <= MAX_GAP / 2 * own
