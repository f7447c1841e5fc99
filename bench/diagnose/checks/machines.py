"""Faults of the data of machines that are no vehicles: all of it at rest, and a drive that is filed inverted.

What a vehicle's signals say of each other is told by physics that all vehicles share; of a machine only its model is
known, so that what is asked here is coarse and must be plain.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from bench.diagnose.checks.description.mistake import line
from bench.diagnose.logs.subject import Log, LogBatch, Subject, drives_of, named_drive
from bench.diagnose.regression.parameters import entries, probes, with_values
from bench.diagnose.regression.weak import midpoint_rates
from bench.diagnose.result import DataProblem
from bench.diagnose.settings import FREEZING, INVERTING, LINEARISING
from registry.datasets.reading.cleaning import held, runs
from registry.dynamics import PhysicsModel
from registry.dynamics.model import RATE_OF

Array = np.ndarray


def machine_problems(subject: Subject) -> list[DataProblem]:
    """Recordings in which nothing moves while the drive does, and drives that act with the other sign."""
    drives = drives_of(subject.model, subject.logs[0])
    if subject.model.vehicle or not drives:
        return []
    pushed = [
        float(log.inputs[log.valid, :drives].std(0).max()) if log.valid.sum() > 1 else 0.0 for log in subject.logs
    ]
    strong = [by >= FREEZING.pushed * float(np.median(pushed)) for by in pushed]
    stretches = [s for log, by in zip(subject.logs, strong, strict=True) for s in _standing(subject, log, by)]
    stood = Counter(s.speeds for s in stretches)
    # A machine at rest reads the same speed every time, be it the half count of a sensor that has no zero.
    found = [s.problem for s in stretches if s.whole or (any(s.speeds) and stood[s.speeds] == 1)]
    return found or _inverted(subject)


def standstills(subject: Subject) -> list[DataProblem]:
    """A remark where a machine often rests, once while its drive went about as far as what moves it: it is held."""
    model, log = subject.model, subject.logs[0]
    at = [i for i in range(len(model.state_channels)) if all(each.measured[i] for each in subject.logs)]
    known = {model.state_channels[i].group for i in at if i not in subject.slopes}
    if model.vehicle or drives_of(model, log) != 1 or not known & _rates_of_others(model):
        return []
    parts = [(each, a, b) for each in subject.logs for a, b in _rests(each, at)]
    resting = sum(b - a for _, a, b in parts)
    ends = [(float(u.min()), float(u.max())) for each, a, b in parts for u in [each.inputs[a:b, 0]]]
    low, high = max(ends, key=lambda e: e[1] - e[0], default=(0.0, 0.0))
    usual = float(torch.cat([each.inputs[each.valid, 0] for each in subject.logs]).abs().median())
    share = resting / max(1, sum(int(each.valid.sum()) for each in subject.logs))
    if share < FREEZING.rests or high - low < usual or high == low:
        return []
    drive = log.recording.input_channels[0]
    detail = (
        f"The machine stands still in {100 * share:.0f} % of the samples, once while {named_drive(log, 0)} goes from "
        f"{low:.2g} to {high:.2g} {drive.unit}, which moves nothing: dry friction, a brake or a stop holds it, or the "
        "drive has a dead zone."
    )
    return [DataProblem(log.name, drive.group, "standstill", None, detail)]


def _rests(log: Log, at: Sequence[int]) -> Iterator[tuple[int, int]]:
    """Runs of samples in which these states repeat their values for long."""
    for a, b in runs(held(log.states.numpy()[:, at]) & log.valid.numpy()):
        if b - a >= max(FREEZING.held_samples, round(FREEZING.held * log.pace)):
            yield a, b


@dataclass(frozen=True)
class _Stretch:
    """A part of a recording in which all that was measured stands still."""

    whole: bool
    """Whether it is all of a recording in which the drive is as strong as in others."""
    speeds: tuple[float, ...]
    """What the speeds read there."""
    problem: DataProblem


def _standing(subject: Subject, log: Log, strong: bool) -> Iterator[_Stretch]:
    """Where all that was measured stands still for long although the drive moves; friction may hold a machine so.

    Of a position that repeats its value the states that are slopes of it say nothing else. ``strong``: whether the
    drive is, beside that of other recordings.
    """
    model = subject.model
    at = [i for i, known in enumerate(log.measured) if known and i not in subject.slopes]
    valid, x = log.valid.numpy(), log.states.numpy()[:, at]
    pushed = ~held(log.inputs.numpy()[:, : drives_of(model, log)])
    rates = [i for i, c in enumerate(at) if model.state_channels[c].group in _rates_of_others(model)]
    names = " and ".join(dict.fromkeys(model.state_channels[i].group for i in at)).replace("_", " ")
    for a, b in _rests(log, at):
        if not pushed[a:b].any():
            continue
        drive, verb = log.recording.input_channels[0].group, "repeat" if " and " in names else "repeats"
        detail = f"{names} {verb} one value for {b - a} samples ({(b - a) * log.dt:.4g} s) while {drive} goes on."
        problem = DataProblem(log.name, model.state_channels[at[0]].group, "frozen", (a, b - 1), detail)
        yield _Stretch(strong and b - a >= valid.sum() - 1, tuple(x[a, rates]), problem)


def _rates_of_others(model: PhysicsModel) -> set[str]:
    known = {c.group for c in model.state_channels}
    return {rate for signal, rate in RATE_OF.items() if signal in known}


def _inverted(subject: Subject) -> list[DataProblem]:
    out = []
    for j, channel in enumerate(subject.logs[0].recording.input_channels[: drives_of(subject.model, subject.logs[0])]):
        told = {log.name: _acts(subject, log, j) for log in subject.logs}
        known = {name: by for name, by in told.items() if by is not None}
        if len(known) < len(told) / 2 or max(known.values(), default=0.0) >= 0:
            continue
        middle = float(np.median(list(known.values())))
        detail = (
            f"{named_drive(subject.logs[0], j)} acts with the other sign: what was measured follows {middle:.2f} times "
            f"what the model makes of it, and least is left so.{_mended(subject, channel.group, j)}"
        )
        rows = {log.name: (0, len(log) - 1) for log in subject.logs}
        out += [DataProblem(name, channel.group, "swapped sign", rows[name], detail) for name in known]
    return out


def _mended(subject: Subject, signal: str, place: int) -> str:
    """The line of dataset.toml with the sign of one column changed; empty: there is none."""
    if subject.folder is None or signal not in subject.folder.description.signals:
        return ""
    read = subject.folder.description.signals[signal]
    if place >= len(read.columns):
        return ""
    columns = list(read.columns)
    columns[place] = columns[place][1:] if columns[place].startswith("-") else f"-{columns[place]}"
    return f" dataset.toml should have: {line(signal, replace(read, columns=tuple(columns)))}"


def _acts(subject: Subject, log: Log, place: int) -> float | None:
    """How many times what the model makes of a drive the motion follows where that is surely less than 0; 1: as filed.

    Both sides are means over windows, beside the states and what the model's constants do without the drive: what
    damping and springs that are off do is theirs. A drive that acts late may be against the motion of now, and is
    looked at with every delay. None: nothing is told for sure.
    """
    model, stack = subject.model, LogBatch.of([log])
    still = stack.inputs.clone()
    still[..., place] = log.inputs[log.valid, place].mean()
    undriven = replace(stack, inputs=still)
    rates, own = (midpoint_rates(model, s)[0].numpy() for s in (stack, undriven))
    size = log.states.shape[1]
    caused, seen = (rates - own)[:, :size], log.states.diff(dim=0).numpy() / log.dt - own[:, :size]
    good = log.valid.numpy()[:-1] & log.valid.numpy()[1:]
    length = max(2, round(INVERTING.window * log.pace))
    if length > len(caused):
        return None
    latest = max(1, round(INVERTING.latest * log.pace / length))
    c, y, x, free = (
        _means(s, length) for s in (caused, seen, stack.between[0].numpy(), _directions(subject, undriven))
    )
    whole = _means(good[:, None].astype(float), length)[latest:, 0] == 1
    found = []
    for channel in (i for i, known in enumerate(log.measured) if known and caused[good, i].any()):
        beside = np.column_stack([np.ones(whole.sum()), x[latest:][whole][:, list(log.measured)]])
        if len(beside) < INVERTING.least * beside.shape[1]:
            return None
        more = np.column_stack([beside, free[latest:, channel][whole]])
        if len(more) >= INVERTING.least * more.shape[1]:
            beside = more
        fits = [
            _fit(c[latest - k : len(c) - k, channel][whole], y[latest:, channel][whole], beside)
            for k in range(latest + 1)
        ]
        by, left, without = fits[0]
        filed = min((left for slope, left, _ in fits if slope > 0), default=without)
        lowest, highest = INVERTING.between
        if -highest < by < -lowest and left < INVERTING.better * filed:
            found.append(by)
        elif filed < INVERTING.better * without:
            found.append(1.0)
    return max(found, default=None)


def _directions(subject: Subject, stack: LogBatch) -> Array:
    """How the rates of each state answer the model's constants (N − 1, s, constants)."""
    where = entries(subject.model, subject.uncertainty)
    if not where:
        return np.zeros((stack.states.shape[1] - 1, stack.states.shape[-1], 0))
    first, *moved = midpoint_rates(with_values(subject.model, where, probes(where)[0]), stack)[:, 0].numpy()
    return np.stack([m - first for m in moved], axis=-1)[:, : stack.states.shape[-1]]


def _means(x: Array, length: int) -> Array:
    """(N // length, …) of a series (N, …)."""
    count = len(x) // length
    return np.asarray(x[: count * length].reshape(count, length, *x.shape[1:]).mean(axis=1))


def _fit(cause: Array, effect: Array, beside: Array) -> tuple[float, float, float]:
    """By how much ``effect`` (J,) follows ``cause`` (J,) beside other columns; squares left with it and without."""
    left, sizes, _ = np.linalg.svd(beside / np.maximum(np.abs(beside).max(0), 1e-300), full_matrices=False)
    basis = left[:, sizes > LINEARISING.affine * sizes[0]]  # constants may act alike
    a, b = (x - basis @ (basis.T @ x) for x in (cause, effect))
    power = float(a @ a)
    by = float(a @ b) / power if power > 0 else 0.0
    return by, float(b @ b) - by * by * power, float(b @ b)
