"""When a rate was measured: its shift against the signal of which it is the derivative, told by these two alone.

A rate that comes out of backward differences, a denoiser or a chip of its own is filed a little late. In a swing of
angular frequency ω a rate that is late by d looks like a damping that is too small by ω² d: a pendulum of 1.3 Hz with
1 ms of it seems to lose no energy at all.
"""

from dataclasses import replace

import numpy as np
import torch

from bench.diagnose.logs.consistency import Pair, pairs
from bench.diagnose.logs.subject import Log, Subject
from bench.diagnose.settings import TIMING

Array = np.ndarray


def rates_in_time(subject: Subject) -> Subject:
    """The subject with every rate read when it was what it says, with a note; vehicles, which have checks of their own,
    and what shows no shift are left as they are."""
    if subject.model.description().turning or not subject.logs:
        return subject
    logs, notes = list(subject.logs), list(subject.notes)
    measured = [m and i not in subject.slopes for i, m in enumerate(subject.logs[0].measured)]  # a slope is in time
    for pair in pairs(subject.model, tuple(measured)):
        shifts = np.array([shift_of(log, pair) for log in logs])
        if np.abs(shifts).max() < TIMING.negligible:
            continue
        logs = [
            _read(log, pair, d) if abs(d) >= TIMING.negligible else log for log, d in zip(logs, shifts, strict=True)
        ]
        notes.append(_said(pair, 1e3 * shifts / logs[0].rate))
    return subject if len(notes) == len(subject.notes) else replace(subject, logs=tuple(logs), notes=tuple(notes))


def shift_of(log: Log, pair: Pair) -> float:
    """By how many samples later than filed the rate of a pair is to be read in a log; 0: no shift is significant.

    Changes of the signal over windows, against means of the rate and its changes over the same: nothing is
    differentiated.
    """
    window = min(max(4, round(TIMING.window * log.rate)), len(log) // (4 * TIMING.blocks))
    if window < 4:
        return 0.0
    states, valid = log.states.numpy(), log.valid.numpy()
    signal, rate = states[:, list(pair.channels)], states[:, list(pair.rates)]
    weights = np.hanning(window + 2)[1:-1]
    first = np.arange(0, len(log) - window, max(1, window // 2))
    at = first[:, None] + np.arange(window + 1)
    at = at[valid[at].all(axis=1)]
    if len(at) < 4 * TIMING.blocks:
        return 0.0

    def changes(x: Array) -> Array:
        return np.einsum("jkc,k->jc", np.diff(x[at], axis=1), weights)

    means = np.einsum("jkc,k->jc", (rate[at][:, 1:] + rate[at][:, :-1]) / 2, weights) / log.rate
    missing, moved = changes(signal) - means, changes(rate) / log.rate  # of a rate that is read a sample later
    parts = [
        (float((moved[p] * missing[p]).sum()), float((moved[p] ** 2).sum()))
        for p in np.array_split(np.arange(len(at)), TIMING.blocks)
    ]
    along, size = np.array(parts).T
    if size.sum() == 0:
        return 0.0
    value = float(along.sum() / size.sum())
    error = float(np.sqrt(((along - value * size) ** 2).sum()) / size.sum())
    return value if TIMING.significant * error <= abs(value) <= TIMING.within_window * window else 0.0


def _read(log: Log, pair: Pair, shift: float) -> Log:
    """The log with the rate of a pair read ``shift`` samples later."""
    from scipy.interpolate import CubicSpline  # slow to import, and seldom needed

    states, at = log.states.clone(), np.arange(len(log), dtype=float)
    later = np.clip(at + shift, 0, len(log) - 1)
    places = list(pair.rates)
    states[:, places] = torch.from_numpy(CubicSpline(at, states[:, places].numpy())(later))
    inside = torch.from_numpy((at + shift >= 0) & (at + shift <= len(log) - 1))
    return replace(log, states=states, valid=log.valid & inside)


def _said(pair: Pair, ms: Array) -> str:
    rate, signal = pair.rate.replace("_", " "), pair.signal.replace("_", " ")
    low, high = sorted(np.abs(ms[[np.abs(ms).argmin(), np.abs(ms).argmax()]]).tolist())
    by = f"{high:.3g} ms" if high - low < 0.05 * high else f"{low:.3g} to {high:.3g} ms"
    when = "after" if np.median(ms) > 0 else "before"
    return (
        f"The {rate} is filed {by} {when} the {signal} of which it is the derivative, and is read so everywhere: by "
        "differences to the sample before, a filter, or a clock of its own."
    )
