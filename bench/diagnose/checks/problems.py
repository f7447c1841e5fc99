"""Faults of the data, looked for before any physics is blamed.

Signals are held against each other: a position against the integral of the velocity, an attitude against that of the
body rates, and only where nothing else was measured against what the nominal model says. A fault stops the analysis,
so that each must stand far above what noise, violent manoeuvres and missing physics do to the same quantities.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from torch import Tensor

from bench.diagnose.checks.alignment import alignment
from bench.diagnose.checks.disagreements import Disagreement, disagreements, told
from bench.diagnose.checks.excursions import Event, excursions, standing_out
from bench.diagnose.checks.machines import machine_problems, standstills
from bench.diagnose.checks.shifts import shifts
from bench.diagnose.logs.consistency import Pair, View, accumulated, change, integral, slope, spread
from bench.diagnose.logs.subject import Log, Subject
from bench.diagnose.result import DataProblem
from bench.diagnose.settings import FREEZING, LEAVING, READING
from registry.datasets.reading.cleaning import held, runs
from registry.dynamics import PhysicsModel

Array = np.ndarray


class Checked(NamedTuple):
    """What is wrong with the data, and what may be."""

    problems: tuple[DataProblem, ...]
    """These stop the analysis."""
    suspicions: tuple[DataProblem, ...]
    """What an effect would explain as well, such as a time shift of all recordings; for the notes."""

    @property
    def only_shifts(self) -> bool:
        """Whether nothing but time shifts stops the analysis; they may be gone once inputs are read when they act."""
        return all(p.kind == "time shift" for p in self.problems)


Known = dict[str, tuple[list[DataProblem], list[Event], list[Disagreement]]]
"""What recordings say each by itself, by name."""


def problems(subject: Subject, own: Mapping[str, Tensor] | None = None, known: Known | None = None) -> Checked:
    """Look for faults in every recording of ``subject``.

    Rows are samples of the recording from 0, first and last; None: all.

    Args:
        subject: model and measurements.
        own: by recording the own states (N, i) of the model's effects, where they are known.
        known: what recordings of this subject said before each by itself, with the same model; entered here.
    """
    found: list[DataProblem] = []
    events: list[Event] = []
    apart: list[Disagreement] = []
    known = {} if known is None else known
    for log in subject.logs:
        if log.name not in known:
            known[log.name] = _of_log(subject.model, log)
        faults, excursions, disagreeing = known[log.name]
        found += faults
        events += excursions
        apart += disagreeing
    stopping, minor = standing_out(events)
    found += stopping
    minor += [] if found else told(apart)  # a jump or a spike is told by itself
    found = found or machine_problems(subject)
    if not found:
        shifted, suspected = shifts(subject, own or {})
        found, minor = shifted, [*suspected, *standstills(subject), *minor]
    order = {log.name: i for i, log in enumerate(subject.logs)}
    found.sort(key=lambda p: (order[p.recording], p.rows or (0, 0)))
    return Checked(tuple(found), tuple(minor))


def contradictions(subject: Subject) -> Checked:
    """`problems` whatever the model lacks: what every command but a diagnosis tells.

    When inputs act is judged by a diagnosis alone, beside what it finds missing: an absorber on a spring looks like a
    clock that is late.
    """
    return Checked(*(tuple(p for p in some if p.kind != "time shift") for some in problems(subject)))


def without_damaged(subject: Subject, found: Sequence[DataProblem]) -> Subject | None:
    """The subject without the recordings that have these faults; None: they are too many, and the faults stop it all.

    One damaged recording of many is what a fleet brings every day; a fault of many is one of how they are made or read.
    """
    damaged = {p.recording for p in found}
    if not 0 < len(damaged) <= LEAVING.share * len(subject.logs):
        return None
    logs = tuple(log for log in subject.logs if log.name not in damaged)
    training, held_out = (tuple(n for n in part if n not in damaged) for part in (subject.training, subject.held_out))
    if not training or not held_out:
        return None
    some = "One recording is" if len(damaged) == 1 else f"{len(damaged)} recordings are"
    note = f"{some} left out, with damaged data: {', '.join(log.name for log in subject.logs if log.name in damaged)}."
    return replace(subject, logs=logs, training=training, held_out=held_out, notes=(*subject.notes, note))


def _of_log(model: PhysicsModel, log: Log) -> tuple[list[DataProblem], list[Event], list[Disagreement]]:
    broken = list(_broken(log))
    if broken or len(log) < 4 * READING.ends:
        return broken, [], []
    view = View(model, log)
    found = list(_clipped(view)) or list(_frozen(view))
    for problem in found:
        assert problem.rows is not None
        view.ignore(problem.rows)
    wrong, sound = alignment(view.log, view.pairs, view.x, view.rates, view.usable)
    if any(p.kind == "unrelated" for p in wrong):  # then it does not say either that a signal stands still too long
        found = [p for p in found if p.kind != "frozen"]
    found += wrong
    view.pairs = sound
    events = [] if wrong else excursions(view)
    return found, events, [] if found else disagreements(view)


# ------------------------------------------------------------------------------------------- one sample for itself


def _broken(log: Log) -> Iterator[DataProblem]:
    valid = log.valid.numpy()
    columns, channels = log.recording.pick([c.name for c in log.recording.channels])
    wrong = ~np.isfinite(columns) & valid[:, None]
    for signal in dict.fromkeys(c.group for c in channels):
        bad = wrong[:, [c.group == signal for c in channels]].any(axis=1)
        if bad.any():
            rows = _rows(bad)
            yield DataProblem(log.name, signal, "not finite", rows, f"{int(bad.sum())} samples are no finite number.")
    at = [i for i, c in enumerate(channels) if c.group == "attitude"]
    if len(at) == 4 and not wrong[:, at].any():
        length = np.linalg.norm(columns[:, at], axis=1)
        bad = (np.abs(length - 1) > FREEZING.unit_length) & valid
        if bad.any():
            worst = float(length[bad][np.abs(length[bad] - 1).argmax()])
            detail = f"{int(bad.sum())} quaternions are not of unit length, one has length {worst:.3g}."
            yield DataProblem(log.name, "attitude", "quaternion", _rows(bad), detail)


def _rows(bad: Array) -> tuple[int, int]:
    at = np.flatnonzero(bad)
    return int(at[0]), int(at[-1])


# ------------------------------------------------------------------------------------ values that repeat themselves


def _clipped(view: View) -> Iterator[DataProblem]:
    """A rate that often stands at its extreme while what it integrates to says that it was beyond."""
    for pair in view.pairs:
        told = slope(view.x[:, pair.channels], pair.turns, view.dt)
        noise = spread((view.x[:, pair.rates] - told)[view.usable])
        for axis, channel in enumerate(pair.rates):
            x = view.x[:, channel]
            for side in (1, -1):
                extreme = (side * x).max()
                at = [r for r in runs((side * x == extreme) & view.usable) if r[1] - r[0] >= 3]
                rows = [k for a, b in at for k in range(a, b)]
                if len(at) < 2 or np.mean(side * told[rows, axis]) < extreme + 6 * noise[axis] + 0.02 * abs(extreme):
                    continue
                c = view.model.state_channels[channel]
                detail = (
                    f"{c.name} stands at {side * extreme:.4g} {c.unit} in {len(rows)} samples while {pair.signal} says "
                    f"up to {side * np.max(side * told[rows, axis]):.4g}: the sensor is saturated."
                )
                yield DataProblem(view.log.name, pair.rate, "clipped", (at[0][0], at[-1][1] - 1), detail)


def _frozen(view: View) -> Iterator[DataProblem]:
    """A sensor that repeats its value while the other one says that it changes."""
    valid = view.log.valid.numpy()
    shortest = max(FREEZING.held_samples, round(FREEZING.held * view.log.pace))
    moving = ~held(view.x[:, list(view.log.measured)])
    for pair in view.pairs:
        for signal, own, other in ((pair.signal, pair.channels, pair.rates), (pair.rate, pair.rates, pair.channels)):
            still = held(view.x[:, own]) & valid
            if not still.any():
                continue
            partner = ~held(view.x[:, other])
            told = accumulated(integral(view.x[:, pair.rates], view.dt))
            if signal == pair.rate:
                told = slope(view.x[:, pair.channels], pair.turns, view.dt)
            noise = spread(np.diff(told, 2, axis=0)[view.usable[1:-1]])
            for a, b in runs(still):
                if b - a < shortest or partner[a:b].mean() < 0.9:
                    continue
                if _repeats(still, valid, a, b):
                    # Its resolution is coarse: it must have missed far more than it usually changes at once.
                    inside = (told if signal == pair.rate else _told(view, pair, a, b))[a + 1 : b - 1]
                    moved = np.abs(inside - inside[0]).max(axis=0)
                    usual = np.quantile(np.abs(change(view.x[:, own], len(own) == 4)), 0.99, axis=0)
                    if not (moved > np.maximum(10 * noise, 5 * usual)).any():
                        continue
                yield _frozen_problem(view, signal, a, b, pair.rate if own is pair.channels else pair.signal)
    driving = view.driving
    if view.model.input_hold == "previous" or driving.shape[1] < 2:
        return  # a command may well stand still
    still = held(driving) & valid
    resting = ((driving == driving.min(axis=0)) | (driving == driving.max(axis=0)) | (driving == 0)).all(axis=1)
    for a, b in runs(still & ~resting):
        if b - a >= shortest and not _repeats(still, valid, a, b) and moving[a:b].mean() > 0.9:
            yield _frozen_problem(view, view.drive, a, b, "the motion")


def _told(view: View, pair: Pair, first: int, end: int) -> Array:
    """What the rate says of its signal (N, c), less its own zero: a sensor at rest must not seem to miss a drift.

    The zero is by how much the rate exceeds the signal's changes outside of ``first`` to ``end``.
    """
    steps = integral(view.x[:, pair.rates], view.dt)
    outside = view.usable[1:] & view.usable[:-1]
    outside[max(0, first - 1) : end] = False
    excess = (steps - change(view.x[:, pair.channels], pair.turns))[outside]
    return accumulated(steps - excess.mean(axis=0) if len(excess) else steps)


def _repeats(still: Array, valid: Array, first: int, end: int) -> bool:
    """Whether a signal repeats values by nature: it does so elsewhere as well."""
    elsewhere = valid.copy()
    elsewhere[first:end] = False
    return bool(still[elsewhere].sum() > FREEZING.rare * max(1, elsewhere.sum()))


def _frozen_problem(view: View, signal: str, first: int, end: int, other: str) -> DataProblem:
    count = end - first
    detail = f"{signal} repeats one value for {count} samples ({count * view.dt:.2f} s) while {other} goes on changing."
    return DataProblem(view.log.name, signal, "frozen", (first, end - 1), detail)
