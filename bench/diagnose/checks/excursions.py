"""Samples that lie far off, and places where samples are missing: what stands out from everything else."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from bench.diagnose.logs.consistency import (
    Pair,
    View,
    accumulated,
    beyond_rate,
    change,
    modelled,
    outlying,
    slope,
    spread,
)
from bench.diagnose.result import DataProblem
from bench.diagnose.settings import READING, SPIKING
from registry.datasets.reading.cleaning import fill, runs, widen

Array = np.ndarray
Outlier = tuple[int, int, float, float]
"""First and last sample, strength, size."""


@dataclass(frozen=True)
class Event:
    """An excursion."""

    problem: DataProblem
    strength: float
    """Its size over the least that would be looked at."""


def standing_out(events: Sequence[Event]) -> tuple[list[DataProblem], list[DataProblem]]:
    """Excursions that are far larger than all others of their signal and kind in any recording, and the others.

    What a sensor does again and again at every size is its nature; such events are summed up.
    """
    stopping: list[DataProblem] = []
    minor: list[DataProblem] = []
    for kind in dict.fromkeys((e.problem.signal, e.problem.kind) for e in events):
        alike = sorted((e for e in events if (e.problem.signal, e.problem.kind) == kind), key=lambda e: -e.strength)
        following = [*(e.strength for e in alike[1:]), 1.0]
        apart = [i for i, e in enumerate(alike) if e.strength > SPIKING.ratio * following[i]]
        first = apart[-1] + 1 if apart else 0
        far, rest = ([e.problem for e in part] for part in (alike[:first], alike[first:]))
        for recording in dict.fromkeys(p.recording for p in far):
            some = [p for p in far if p.recording == recording]
            stopping += some if len(some) <= SPIKING.listed else [_summed(some)]
        if rest:
            minor.append(_noted(rest))
    return stopping, minor


def _summed(alike: list[DataProblem]) -> DataProblem:
    """Problems of one kind, largest first, as one."""
    largest = alike[0]
    if len(alike) == 1:
        return largest
    rows = [p.rows for p in alike if p.rows is not None]
    span = (min(a for a, _ in rows), max(b for _, b in rows))
    return replace(largest, rows=span, detail=f"{len(alike)} times, the largest: {largest.detail}")


def _noted(alike: list[DataProblem]) -> DataProblem:
    """Problems of one kind, largest first, as one whose sentence says by itself what it is and where."""
    largest, where = alike[0], {p.recording for p in alike}
    first, last = largest.rows or (0, 0)
    rows = f"sample {first}" if first == last else f"samples {first} to {last}"
    if largest.kind != "spike":
        lead = "The clock jumps"
    elif len(alike) == 1:
        lead = f"{largest.signal.replace('_', ' ').capitalize()} stand{'' if largest.signal.endswith('s') else 's'} out"
    else:
        lead = f"Single samples of {largest.signal.replace('_', ' ')} stand out"
    if len(alike) == 1:
        at = f"in {largest.recording} at {rows}"
    elif len(where) == 1:
        at = f"{len(alike)} times in {largest.recording}, the largest at {rows}"
    else:
        at = f"{len(alike)} times in {len(where)} recordings, the largest in {largest.recording} at {rows}"
    return replace(largest, detail=f"{lead} {at}: {largest.detail}")


def excursions(view: View) -> list[Event]:
    """Spikes of states and inputs, and jumps of the clock. ``view`` is left with the spikes of states bridged."""
    spikes, jumps = [*_spikes(view), *_input_spikes(view)], _jumps(view)
    # Where samples are missing a rate and the slope beside it differ for a moment.
    return [s for s in spikes if not any(_beside(s, j) for j in jumps)] + jumps


def _beside(spike: Event, jump: Event) -> bool:
    return spike.strength < jump.strength and _near(spike.problem.rows or (0, 0), jump.problem.rows or (0, 0))


def _near(rows: tuple[int, int], others: tuple[int, int]) -> bool:
    return rows[0] - READING.half_width <= others[1] and others[0] <= rows[1] + READING.half_width


# --------------------------------------------------------------------------------------------------------- spikes


def _spikes(view: View) -> list[Event]:
    def integrated(pair: Pair) -> tuple[Array, Array]:
        y = accumulated(np.where(_steps(view.usable)[:, None], view.steps(pair), 0.0))
        return y, accumulated(change(view.x[:, pair.channels], pair.turns))

    def measured(pair: Pair) -> tuple[Array, Array]:
        own = view.x[:, pair.rates]
        return own - slope(view.x[:, pair.channels], pair.turns, view.dt), own

    found = []
    for pair in view.pairs:  # what integrates comes first: its spikes show in its slope on either side
        found += _of_signal(view, pair.signal, pair.channels, partial(integrated, pair), pair.rate)
    for pair in view.pairs:
        found += _of_signal(view, pair.rate, pair.rates, partial(measured, pair), pair.signal)
    return found


def _of_signal(
    view: View, signal: str, channels: tuple[int, ...], read: Callable[[], tuple[Array, Array]], other: str
) -> list[Event]:
    """Spikes of a signal, whose excursions and own changes ``read`` gives of the view as it is now; it bridges them."""
    found = _bridging(view, channels, list(_outliers(*read(), view.usable)))
    if found:  # on a clock that is not even, a part of a spike is in the sample beside it, too small to be seen so far
        again = _outliers(*read(), view.usable)
        _bridging(view, channels, [e for e in again if any(_near(e[:2], of[:2]) for of in found)])
    return [Event(_spike(view, signal, a, b, size, other), strength) for a, b, strength, size in found]


def _bridging(view: View, channels: tuple[int, ...], found: list[Outlier]) -> list[Outlier]:
    """``found``, once the view goes straight from the sample before each of them to that behind it."""
    if found:
        view.x[:, channels] = _bridged(view.x[:, channels], [(a, b) for a, b, _, _ in found])
        if len(channels) == 4:
            view.x[:, channels] /= np.linalg.norm(view.x[:, channels], axis=1, keepdims=True)
    return found


def _outliers(y: Array, own: Array, usable: Array) -> list[Outlier]:
    """Excursions of y (N, c) that are the signal's ``own`` (N, c): first, last, strength, size.

    They are up to `READING.half_width` samples long.

    In ``y`` the motion itself has cancelled; in ``own`` it has not, but faults of the other signal are not in it.
    """
    if usable.sum() < 4 * READING.ends:
        return []
    far, confirmed = outlying(y), outlying(own)
    noise = spread(np.diff(y, 2, axis=0)[usable[1:-1]]) / 6**0.5
    limit = np.maximum(SPIKING.distance * noise, SPIKING.tail * np.quantile(np.abs(far[usable]), 0.99, axis=0))
    limit = np.maximum(limit, 1e-9 * np.abs(own).max(axis=0) + 1e-300)
    strength = np.where((far * confirmed > 0.5 * far * far) & usable[:, None], np.abs(far) / limit, 0.0)
    found, greatest = [], strength.max(axis=1)
    for a, b in runs(greatest > 1):
        # The median beside a spike moves a little: only what is of its size belongs to it.
        core = a + np.flatnonzero(greatest[a:b] > 0.3 * greatest[a:b].max())
        if np.ptp(core) < READING.half_width:
            k = a + int(greatest[a:b].argmax())
            size = np.abs(far[k, strength[k].argmax()])
            found.append((int(core[0]), int(core[-1]), float(greatest[k]), float(size)))
    return found


def _spike(view: View, signal: str, first: int, last: int, size: float, other: str) -> DataProblem:
    known = view.model.signal(signal)
    unit = "rad" if signal == "attitude" or known is None else known.unit
    samples = "one sample lies" if first == last else f"{last - first + 1} samples lie"
    detail = f"{samples} {size:.3g} {unit} from the neighbours, which {other} does not confirm."
    return DataProblem(view.log.name, signal, "spike", (first, last), detail)


def _bridged(x: Array, rows: Sequence[tuple[int, int]]) -> Array:
    bad = np.zeros(len(x), dtype=bool)
    for first, last in rows:
        bad[first : last + 1] = True
    return fill(x, bad)


def _input_spikes(view: View) -> list[Event]:
    """A measured input far off for a moment, without the motion that it would have caused."""
    rates = tuple(c for p in view.pairs for c in p.rates)
    if view.model.input_hold == "previous" or not rates or not view.driving.shape[1] or not view.usable.any():
        return []
    mean = np.abs(view.driving[view.usable]).mean()
    candidates = [c for c in _outliers(view.driving, view.driving, view.usable) if c[3] > SPIKING.input * mean]
    if not 0 < len(candidates) <= SPIKING.listed:
        return []  # what comes again and again is how the system is driven
    inputs = view.log.inputs.numpy().copy()
    inputs[:, : view.driving.shape[1]] = _bridged(view.driving, [(a, b) for a, b, _, _ in candidates])
    given = view.beyond_model(rates)
    view.rates = modelled(view.model, view.log, inputs)
    without = view.beyond_model(rates)
    noise = np.maximum(spread(np.diff(without, axis=0)[view.usable[1:-1]]) / 2**0.5, 1e-12)
    found = []
    for first, last, strength, size in candidates:
        near, wide = slice(first - 2, last + 2), slice(max(0, first - SPIKING.response), last + SPIKING.response)
        usual = np.median(without[wide], axis=0)
        wrong, right = (float((((e[near] - usual) / noise) ** 2).sum()) for e in (given, without))
        # Smoothing spreads an answer over time but keeps its sum.
        total, rest = (float((((e[wide] - usual).sum(axis=0) / noise) ** 2).sum()) for e in (given, without))
        if wrong - right > SPIKING.distance**2 and right < 0.3 * wrong and rest < 0.3 * total:
            found.append(Event(_spike(view, view.drive, first, last, size, "the motion"), strength))
    return found


# ---------------------------------------------------------------------------------------------------------- jumps


def _jumps(view: View) -> list[Event]:
    """Places where several signals go on from elsewhere at once: samples are missing there."""
    kinematic = {p.signal: view.steps(p) for p in view.pairs}
    dynamic = {p.rate: view.beyond_model(p.rates) for p in view.pairs}
    usable = _steps(view.usable)
    if not kinematic or len({**kinematic, **dynamic}) < 2 or usable.sum() < 4 * READING.ends:
        return []
    sizes = {s: _sizes(e, usable) for s, e in {**kinematic, **dynamic}.items()}
    around = {s: np.max([z, np.roll(z, 1), np.roll(z, -1)], axis=0) for s, z in sizes.items()}
    # Two signals at least, one of them kinematic: what the model says alone may be wrong.
    second = np.sort(list(around.values()), axis=0)[-2]
    strength = np.minimum(second, np.max([around[s] for s in kinematic], axis=0))
    found = []
    for a, b in runs(strength > 1):
        k = a + int(np.sum([sizes[s][a:b] for s in kinematic], axis=0).argmax())
        who = [s for s in sizes if around[s][k] > 1]
        if max(_between(view, p, k) for p in view.pairs if p.signal in who) < SPIKING.lost:
            continue  # a turn too sharp for the sampling
        detail = f"{' and '.join(who)} jump together between samples {k} and {k + 1}: samples are missing there."
        problem = DataProblem(view.log.name, "time", "clock jump", (k, k + 1), detail)
        found.append(Event(problem, float(strength[a:b].max())))
    return found


def _between(view: View, pair: Pair, step: int) -> float:
    """How much further than its rate says a signal goes over a step, over what the rate changes about it.

    A rate that goes from one sample to the next without a turn makes a half at most, however fast it goes; where a
    sample is missing of a steady motion, it has no limit. Of the signals as they were measured.
    """
    first = max(step - 1, 0)
    x = view.log.states.numpy()[first : step + 3]
    beyond = float(np.linalg.norm(beyond_rate(x, pair, view.dt)[step - first]))
    changes = float(np.linalg.norm(np.ptp(x[:, pair.rates], axis=0)))
    return beyond / max(view.dt * changes, 1e-300)


def _sizes(steps: Array, usable: Array) -> Array:
    """Each step (N − 1,) against its neighbours, over the least that is looked at; the greatest of the axes."""
    far = np.abs(outlying(steps))
    noise = spread(np.diff(steps, axis=0)[widen(~usable, 1)[1:] == 0]) / 2**0.5
    limit = np.maximum(SPIKING.distance * noise, SPIKING.tail * np.quantile(far[usable], 0.99, axis=0))
    return np.where(usable, np.where(limit > 0, far / np.maximum(limit, 1e-300), 0.0).max(axis=1), 0.0)


def _steps(usable: Array) -> Array:
    """Steps (N − 1,) between two usable samples."""
    out: Array = usable[1:] & usable[:-1]
    return out
