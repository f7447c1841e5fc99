"""Faults of the data of machines that are no vehicles: all of it at rest, and a drive that is filed inverted.

What a vehicle's signals say of each other is told by physics that all vehicles share; of a machine only its model is
known, so that what is asked here is coarse and must be plain.
"""

from collections.abc import Set
from dataclasses import replace

import numpy as np

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
    slopes = frozenset(subject.slopes)
    found = [p for log, by in zip(subject.logs, strong, strict=True) for p in _at_rest(subject.model, log, slopes, by)]
    return found or _inverted(subject)


def _at_rest(model: PhysicsModel, log: Log, slopes: Set[int], strong: bool) -> list[DataProblem]:
    """All that was measured stands still although the drive moves: from first to last, or at a speed that is not 0.

    Friction holds a machine for a while, at rest, and where the drive is not ``strong`` beside other recordings. Of a
    position that repeats its value the states that are ``slopes`` of it say nothing else.
    """
    at = [i for i, known in enumerate(log.measured) if known and i not in slopes]
    valid, x = log.valid.numpy(), log.states.numpy()[:, at]
    pushed = ~held(log.inputs.numpy()[:, : drives_of(model, log)])
    rates = [i for i, c in enumerate(at) if model.state_channels[c].group in _rates_of_others(model)]
    out = []
    for a, b in runs(held(x) & valid):
        whole = strong and b - a >= valid.sum() - 1
        moving = bool(rates) and bool(x[a, rates].any())
        long = b - a >= max(FREEZING.held_samples, round(FREEZING.held * log.pace))
        if long and (whole or moving) and pushed[a:b].any():
            names = " and ".join(dict.fromkeys(model.state_channels[i].group for i in at)).replace("_", " ")
            drive = log.recording.input_channels[0].group
            detail = f"{names} repeat one value for {b - a} samples ({(b - a) * log.dt:.4g} s) while {drive} goes on."
            first = model.state_channels[at[0]].group
            out.append(DataProblem(log.name, first, "frozen", (a, b - 1), detail.replace("repeat", _verb(names))))
    return out


def _verb(names: str) -> str:
    return "repeat" if " and " in names else "repeats"


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
