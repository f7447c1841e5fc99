"""Free runs through whole recordings, begun anew at an interval, thinned so that a page can hold them."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from bench.diagnose.evidence import AFTER, Flight, Path, Signal, Trace
from bench.diagnose.logs.noise import Noise
from bench.diagnose.logs.subject import Log, LogBatch, Subject
from bench.diagnose.regression.weak import mean_rates
from bench.diagnose.settings import PLAYING
from bench.diagnose.simulate.free_run import (
    Group,
    default_steps,
    errors,
    free_run,
    groups,
    margin,
    measured_windows,
    starts,
)
from registry.datasets.reading.rotations import euler_from_quaternion
from registry.dynamics import PhysicsModel

Piece = tuple[int, np.ndarray]
"""The first sample of a piece of a line, and its values (n,)."""


def flights(
    subject: Subject,
    nominal: PhysicsModel,
    after: PhysicsModel,
    noise: Noise,
    horizon_s: float | None = None,
    most: int | None = None,
    points: int | None = None,
) -> tuple[Flight, ...]:
    """What both models make of whole recordings: held-out ones, those with the greatest error first; then others.

    Args:
        subject: measurements, their inputs read at the times at which they act.
        nominal: the model before.
        after: the model that the diagnosis ends with.
        noise: tells how far a filter of the measurements reaches.
        horizon_s: after which a free run begins anew [s]; default `free_run.default_steps`.
        most: recordings, at most; default: `PLAYING.recordings`.
        points: of all lines together, default `PLAYING.points`; recordings beyond them are left out, and the end of
            the first where it has more.
    """
    most, points = most or PLAYING.recordings, points or PLAYING.points
    fitted = [n for n in subject.training if n not in subject.held_out]
    logs = subject.of([*subject.held_out, *fitted[: max(0, most - len(subject.held_out))]])
    if not logs:
        return ()
    steps, clear = default_steps(logs, horizon_s), margin(logs, noise.half_width)
    models, left = {"nominal": nominal, AFTER: after}, points
    found: list[Flight] = []
    at = [starts(log, steps, steps, clear) for log in logs]
    with torch.no_grad():
        together = {n: free_run(m, logs, at, steps) for n, m in models.items()} if any(map(len, at)) else {}
        parts = {n: run.split([len(k) for k in at]) for n, run in together.items()}
        runs = [{n: p[i] for n, p in parts.items()} for i in range(len(logs))]
        order = _order(nominal, logs, at, runs, steps, len(subject.held_out))
        for i in order[:most]:
            log, held_out = logs[i], logs[i].name in subject.held_out
            flight = _flight(log, held_out, models, at[i], runs[i], steps)
            while not found and flight.points > left and flight.samples > 2 * steps:
                end = max(2 * steps, flight.samples * left // flight.points)
                kept = int(np.searchsorted(at[i] + steps, end))
                some = {n: run[:kept] for n, run in runs[i].items()}
                shorter = _flight(log.part(slice(end), log.name), held_out, models, at[i][:kept], some, steps)
                flight = replace(shorter, whole=len(log))
            if found and flight.points > left:
                break
            found.append(flight)
            left -= flight.points
    return tuple(found)


def _order(
    model: PhysicsModel,
    logs: Sequence[Log],
    at: Sequence[np.ndarray],
    runs: Sequence[dict[str, Tensor]],
    steps: int,
    held_out: int,
) -> list[int]:
    """Held-out recordings by the median error of the nominal model's free runs, greatest first; then the others."""
    shown = groups(model.state_channels, [all(m) for m in zip(*(log.measured for log in logs), strict=True)])
    error = np.zeros((len(logs), len(shown)))
    for i in range(held_out):
        if len(at[i]) and shown:
            squared = errors(runs[i]["nominal"], measured_windows([logs[i]], [at[i]], steps), shown)
            error[i] = np.median(squared.mean(1).nan_to_num(1e12, 1e12).numpy(), axis=0)
    scaled = (error / np.maximum(error.max(0, initial=0.0), 1e-300)).sum(1)
    return [*sorted(range(held_out), key=lambda i: -scaled[i]), *range(held_out, len(logs))]


def _flight(
    log: Log, held_out: bool, models: dict[str, PhysicsModel], at: np.ndarray, runs: dict[str, Tensor], steps: int
) -> Flight:
    nominal = models["nominal"]
    shown = groups(nominal.state_channels, log.measured)
    signals = [_signal(log, group, at, runs, nominal) for group in shown]
    if log.sensed is not None:
        signals.append(_sensed(log, models))
    path = _path(log, shown, at, runs, steps)
    return Flight(
        log.name,
        held_out,
        log.dt,
        samples=len(log),
        whole=len(log),
        restart_s=steps * log.dt,
        signals=tuple(signals),
        path=path,
    )


def _signal(log: Log, group: Group, at: np.ndarray, runs: dict[str, Tensor], model: PhysicsModel) -> Signal:
    names, states = [model.state_channels[i].name for i in group.at], log.states[:, list(group.at)].numpy()
    predicted = {n: run[..., list(group.at)].numpy() for n, run in runs.items()}
    if group.name == "attitude":
        names, states = [f"attitude.{n}" for n in ("roll", "pitch", "yaw")], euler(states)
        predicted = {n: euler(run, states[at]) for n, run in predicted.items()}
    traces = []
    for c, name in enumerate(names):
        series = {n: [(k, y) for k, y in zip(at, run[..., c], strict=True)] for n, run in predicted.items()}
        left = {n: run[..., c] - states[at[:, None] + np.arange(run.shape[1]), c] for n, run in predicted.items()}
        traces.append(_trace(name, states[:, c], log.valid.numpy(), series, {n: _rms(v) for n, v in left.items()}))
    return Signal(group.name, group.unit, tuple(traces))


def _sensed(log: Log, models: dict[str, PhysicsModel]) -> Signal:
    """What a sensor of rates showed, and what it would show by each model at the measured states.

    The offset of the sensor in this recording, as each model has it, is taken off that model.
    """
    assert log.sensed is not None
    channels = models["nominal"].sensed_channels
    size, good = log.states.shape[1], (log.valid[:-1] & log.valid[1:]).numpy()
    seen = np.diff(log.sensed.numpy(), axis=0) / log.dt
    told = {n: mean_rates(m, LogBatch.of([log]))[0, :, size:].numpy() for n, m in models.items()}
    traces = []
    for c, channel in enumerate(channels):
        off = {n: rates[:, c] - seen[:, c] for n, rates in told.items()}
        offset = {n: v[good].mean() if good.any() else 0.0 for n, v in off.items()}
        series = {n: _pieces(rates[:, c] - offset[n], good) for n, rates in told.items()}
        rms = {n: _rms(v[good] - offset[n]) for n, v in off.items()}
        traces.append(_trace(channel.name, seen[:, c], good, series, rms))
    return Signal(channels[0].group, channels[0].unit, tuple(traces), sensed=True)


def _trace(
    name: str, measured: np.ndarray, good: np.ndarray, models: dict[str, list[Piece]], rms: dict[str, float]
) -> Trace:
    """A channel with its lines thinned; of models that run away only the direction is kept."""
    low, high = (f(measured[good], initial=measured[good][:1].sum()) for f in (np.min, np.max))
    span = float(high - low) or 1.0
    lines = {"measured": _pieces(measured, good)}
    beyond = PLAYING.far * span
    lines |= {n: [(k, y.clip(low - beyond, high + beyond)) for k, y in p] for n, p in models.items()}
    thinned = {n: _thinned(pieces, PLAYING.finest * span) for n, pieces in lines.items()}
    return Trace(name, thinned, rms)


def _path(log: Log, shown: Sequence[Group], at: np.ndarray, runs: dict[str, Tensor], steps: int) -> Path | None:
    by_name = {g.name: g for g in shown}
    place, judged = by_name.get("position"), by_name.get("velocity") or by_name.get("position")
    if place is None or judged is None or len(place.at) < 2 or not len(at):
        return None
    truth = measured_windows([log], [at], steps)
    off = {n: errors(run, truth, [judged])[..., 0].mean(-1).sqrt().numpy() for n, run in runs.items()}
    thin = np.unique(np.linspace(0, steps, min(steps, 12) + 1).round().astype(int))
    stretches = tuple(window[thin][:, list(place.at[:2])] for window in truth.numpy())
    return Path(stretches, judged.name, judged.unit, off)


def euler(quaternions: np.ndarray, begin: np.ndarray | None = None) -> np.ndarray:
    """Roll, pitch and yaw (…, N, 3) [rad] of unit quaternions xyzw (…, N, 4), without jumps of a full turn.

    With ``begin`` (…, 3), the turns are counted so that the first sample is nearest to it.
    """
    angles: np.ndarray = np.unwrap(euler_from_quaternion(quaternions), axis=-2)
    if begin is not None:
        turns = np.round((begin - angles[..., 0, :]) / (2 * math.pi))
        angles = angles + 2 * math.pi * turns[..., None, :]
    return angles


def _rms(left: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(left)))) if left.size and np.isfinite(left).all() else math.nan


def _pieces(y: np.ndarray, good: np.ndarray) -> list[Piece]:
    """A series (N,) in pieces of good samples."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], good.astype(int), [0]])))
    return [(int(a), y[a:b]) for a, b in edges.reshape(-1, 2)]


def _thinned(pieces: Sequence[Piece], finest: float) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
    """Of each piece sample numbers and values of the points between which straight lines show all others."""
    stays: dict[int, np.ndarray] = {}
    for size in {len(y) for _, y in pieces}:
        alike = [i for i, (_, y) in enumerate(pieces) if len(y) == size]
        stays |= zip(alike, _needed(np.stack([pieces[i][1] for i in alike]), finest), strict=True)
    return tuple((first + (at := np.flatnonzero(stays[i])), y[at]) for i, (first, y) in enumerate(pieces))


def _needed(y: np.ndarray, finest: float) -> np.ndarray:
    """Which samples (K, N) of series (K, N) are drawn.

    From fine to coarse, a point stays if it is off the line between its neighbours of that level, or if a finer one
    that stays leans on it.
    """
    size, step = y.shape[1], 1
    stays = ~np.isfinite(y)
    stays[:, [0, -1]] = True
    while step < size - 1:
        middle = np.arange(step, size - 1, 2 * step)
        after = np.minimum(middle + step, size - 1)
        share = step / (step + after - middle)
        line = y[:, middle - step] * (1 - share) + y[:, after] * share
        with np.errstate(invalid="ignore"):
            kept = stays[:, middle] | ~(np.abs(y[:, middle] - line) <= finest)
        for place in (middle, middle - step, after):
            stays[:, place] |= kept
        step *= 2
    return stays
