"""When a rate was measured: its shift against the signal of which it is the derivative, told by these two alone.

A rate that comes out of backward differences, a denoiser or a chip of its own is filed a little late. In a swing of
angular frequency ω a rate that is late by d looks like a damping that is too small by ω² d: a pendulum of 1.3 Hz with
1 ms of it seems to lose no energy at all.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch

from bench.diagnose.logs.consistency import Pair, change, pairs
from bench.diagnose.logs.subject import Log, Subject
from bench.diagnose.settings import TIMING
from registry.dynamics import PhysicsModel

Array = np.ndarray


def rates_in_time(subject: Subject) -> Subject:
    """The subject with every rate and its signal read at the same times, with a note; what shows no shift is left.

    Of a machine the rate is read when it was what it says. Of a vehicle the pose is: its rates stand beside what drives
    and what feels it, and moving them would part them from these. Position and velocity stay with the attitude.
    """
    if not subject.logs:
        return subject
    logs, notes = subject.logs, list(subject.notes)
    pose = subject.model.description().turning is not None  # the pair of the attitude comes first
    held = subject.model.input_hold == "previous" and not pose  # what damps a vehicle is slow against its sampling
    measured = [m and i not in subject.slopes for i, m in enumerate(logs[0].measured)]  # a slope is in time
    for pair in pairs(subject.model, tuple(measured)):
        shift = 0.0 if pair.rate in subject.differences else shift_of(logs, pair, held)
        if abs(shift) >= TIMING.negligible:
            places, by = (pair.channels, -shift) if pose else (pair.rates, shift)
            if pair.turns:
                logs = pose_read_later(subject.model, logs, by, by)
            else:
                logs = tuple(states_read_later(log, places, by) for log in logs)
            late, against = (pair.signal, pair.rate) if pose else (pair.rate, pair.signal)
            notes.append(_said(late, against, 1e3 * by / logs[0].rate))
    return subject if logs is subject.logs else replace(subject, logs=logs, notes=tuple(notes))


def shift_of(logs: Sequence[Log], pair: Pair, held: bool = False) -> float:
    """By how many samples later than filed the rate of a pair is to be read in all logs; 0: no shift is significant.

    A clock is late by the same in all: parts of recordings that disagree make the shift uncertain. Where inputs are
    ``held`` over each sample a rate that bends in between looks late too, and what is left must be more than that.
    """
    each = math.ceil(TIMING.blocks / len(logs))
    sums = np.array([part for log in logs for part in _sums(log, pair, held, each)]).reshape(-1, 3)
    along, bent, size = sums.T
    if len(sums) < TIMING.blocks // 2 or not size.sum():
        return 0.0
    value, bend = float((along - bent).sum() / size.sum()), float(bent.sum() / size.sum())
    error = float(np.sqrt(((along - bent - value * size) ** 2).sum()) / size.sum())
    largest = TIMING.within_window * TIMING.window * logs[0].pace
    return value if max(TIMING.significant * error, abs(bend)) <= abs(value) <= largest else 0.0


def _sums(log: Log, pair: Pair, held: bool, parts: int) -> list[tuple[float, float, float]]:
    """What each part of a log says of the shift: Σ m d, Σ b d and Σ d².

    m is what the rate misses of the signal's changes over a window, d its own change, by which it misses less where it
    is read a sample later: nothing is differentiated. b is what it misses where it bends between two samples.
    """
    window = max(4, round(TIMING.window * log.pace))
    weights = np.hanning(window + 2)[1:-1]
    first = np.arange(0, len(log) - window, max(1, window // 2))
    at = first[:, None] + np.arange(window + 1)
    at = at[log.valid.numpy()[at].all(axis=1)]
    if len(at) < 4 * parts:
        return []
    states = log.states.numpy()
    signal, rate = states[:, list(pair.channels)], states[:, list(pair.rates)]

    def weighed(x: Array) -> Array:
        """What x (N − 1, c) adds up to over every window."""
        return np.einsum("jkc,k->jc", x[at[:, :-1]], weights)

    missing = weighed(change(signal, pair.turns)) - weighed((rate[1:] + rate[:-1]) / 2) / log.rate
    bent = weighed(_bent(log, pair)) if held else np.zeros_like(missing)
    moved = weighed(np.diff(rate, axis=0)) / log.rate
    return [
        (float((moved[p] * missing[p]).sum()), float((moved[p] * bent[p]).sum()), float((moved[p] ** 2).sum()))
        for p in np.array_split(np.arange(len(at)), parts)
    ]


def _bent(log: Log, pair: Pair) -> Array:
    """What the mean of its two ends misses of the integral of a rate over each sample (N − 1, c), inputs held.

    Of a smooth rate v that is −(v̇(dt) − v̇(0)) dt²/12. As long as v̇ does not jump it adds up to nothing; where inputs
    do, it does not. How v̇ changes with rate and signal is read off the log, as of a linear system.
    """
    x = log.states.numpy()
    places = [*pair.rates, *pair.channels]
    steps, middle = np.diff(x[:, places], axis=0), (x[1:, places] + x[:-1, places]) / 2
    acting = np.concatenate([middle, log.inputs[:-1].numpy(), np.ones((len(middle), 1))], axis=1)
    scale = 1 / np.maximum(np.abs(acting).max(axis=0), 1e-300)
    good = (log.valid[1:] & log.valid[:-1]).numpy()
    gains = np.linalg.lstsq((acting * scale)[good], steps[good][:, : len(pair.rates)], rcond=None)[0] * scale[:, None]
    return np.asarray(-steps @ gains[: len(places)] * log.dt / 12)


def _unit(log: Log, places: Sequence[int]) -> Log:
    """With the quaternion in these places at length one."""
    states = log.states.clone()
    states[:, list(places)] /= torch.linalg.norm(states[:, list(places)], dim=1, keepdim=True)
    return replace(log, states=states)


def moving_channels(model: PhysicsModel) -> tuple[int, ...]:
    """Places of the states that say where a body that turns is and how fast it moves."""
    moving = model.description().moving
    return tuple(i for i, c in enumerate(model.state_channels) if c.group in moving)


def pose_read_later(model: PhysicsModel, logs: Sequence[Log], moved: float, turned: float) -> tuple[Log, ...]:
    """Logs of a body that turns with position and velocity, and with its attitude, read so many samples later."""
    attitude = next(pair for pair in pairs(model, logs[0].measured) if pair.turns)
    out = (states_read_later(log, moving_channels(model), moved) for log in logs)
    if not turned:
        return tuple(out)
    return tuple(_unit(states_read_later(log, attitude.channels, turned), attitude.channels) for log in out)


def states_read_later(log: Log, places: Sequence[int], shift: float) -> Log:
    """The log with the states in some places read ``shift`` samples later; by cubic interpolation."""
    from scipy.interpolate import CubicSpline  # slow to import, and seldom needed

    states, at = log.states.clone(), np.arange(len(log), dtype=float)
    later = np.clip(at + shift, 0, len(log) - 1)
    states[:, list(places)] = torch.from_numpy(CubicSpline(at, states[:, list(places)].numpy())(later))
    inside = torch.from_numpy((at + shift >= 0) & (at + shift <= len(log) - 1))
    return replace(log, states=states, valid=log.valid & inside)


def _said(late: str, against: str, ms: float) -> str:
    signal, other = (s.replace("_", " ").replace(".", " ") for s in (late, against))
    by = f"{abs(ms):.3g} ms {'late' if ms > 0 else 'early'}"
    return (
        f"The clock of the {signal} is {by} against that of the {other}, and is corrected: differences to the sample "
        "before, a filter, or a device of its own."
    )
