"""Whether inputs and motion are filed at the same times."""

from collections.abc import Mapping
from functools import cache
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from bench.diagnose.logs.consistency import Array, pairs, slope
from bench.diagnose.logs.filters import savitzky_golay
from bench.diagnose.logs.subject import Log, Subject
from bench.diagnose.regression.driving import acting
from bench.diagnose.result import DataProblem
from bench.diagnose.settings import SHIFTING
from registry.datasets.reading.cleaning import agreements, extent, peak, widen
from registry.dynamics import PhysicsModel


class Lag(NamedTuple):
    """By how many samples motion follows what acts."""

    by: float
    agreement: float
    """Correlation at this lag, 0 where nothing is told."""
    low: float
    high: float
    """Between which it lies as far as the recording tells (`Shifting.sure`)."""


UNTOLD = Lag(0.0, 0.0, 0.0, 0.0)


def shifts(subject: Subject, own: Mapping[str, Tensor]) -> tuple[list[DataProblem], list[DataProblem]]:
    """Recordings whose inputs are shifted against those of the others, and a shift that all of them share.

    ``own`` are by recording the own states (N, i) of the model's effects, where they are known.
    The first stop the analysis; the second is a suspicion, since a delay or a lag of the vehicle looks the same.
    """
    lags = {log.name: lag_of(subject.model, log, own.get(log.name)) for log in subject.logs}
    clear = {name: lag.by for name, lag in lags.items() if lag.agreement > SHIFTING.clear}
    if not clear:
        return [], []
    middle = float(np.median(list(clear.values())))
    blurred = SHIFTING.blurred * max((s.smoothing.window for s in subject.slopes.values()), default=0)
    signal = subject.logs[0].recording.input_channels[0].group
    by_name = {log.name: log for log in subject.logs}
    problems = []
    for name, lag in clear.items():
        others = [v for other, v in clear.items() if other != name]
        usual = float(np.median(others)) if others else lag
        spread = max((abs(v - usual) for v in others), default=0.0)
        if (
            len(others) >= 3
            and lags[name].agreement > SHIFTING.least_correlation
            and abs(lag) > SHIFTING.suspect  # else it is in time, and the others lag by what they do more of
            and not lags[name].low - SHIFTING.suspect < usual < lags[name].high + SHIFTING.suspect
            and abs(lag - usual) > max(SHIFTING.different, SHIFTING.apart * spread, blurred)
        ):
            ms = 1e3 * by_name[name].dt
            detail = (
                f"the motion comes {lag:.1f} samples ({lag * ms:.3g} ms) after what {signal} says, in the other "
                f"recordings {usual:.1f} ({usual * ms:.3g} ms): the two were shifted against each other."
            )
            problems.append(DataProblem(name, signal, "time shift", (0, len(by_name[name]) - 1), detail))
    if (
        problems
        or abs(middle) <= SHIFTING.suspect
        or 2 * len(clear) < len(lags)
        or min(clear.values()) * max(clear.values()) <= 0
    ):
        return problems, []
    ms = 1e3 * subject.logs[0].dt
    side = "after" if middle > 0 else "before"
    cause = (
        "a time shift of the log, or an input_delay or motor_lag of the vehicle, which look the same."
        if middle > 0
        else "a time shift of the log, with inputs filed too late, which a negative input_delay would mimic."
    )
    detail = (
        f"the motion comes {abs(middle):.1f} samples ({abs(middle) * ms:.3g} ms) {side} what {signal} says: {cause}"
    )
    sentence = f"in {len(clear)} of {len(lags)} recordings {detail}"
    sure = sum(lags[name].high < -SHIFTING.suspect for name in clear)
    if middle < -max(SHIFTING.certain, blurred) and 2 * sure > len(clear):
        # No vehicle moves before its inputs: what acts is filed too late, whatever else is missing.
        return [
            DataProblem(n, signal, "time shift", (0, len(by_name[n]) - 1), f"{sentence} No input_delay explains that.")
            for n in clear
        ], []
    return [], [DataProblem(next(iter(clear)), signal, "time shift", None, sentence)]


def lag_of(model: PhysicsModel, log: Log, internal: Tensor | None = None) -> Lag:
    """By how many samples motion follows what acts.

    What goes with the rates themselves is left out: missing damping makes motion lead what drives it. The own states
    (N, i) of the model's effects are ``internal``, zero where nobody knows them.
    """
    count = log.inputs.shape[1] - len(model.extras)
    valid = extent(~widen(~log.valid.numpy(), 2))
    among = pairs(model, log.measured)
    turning = [p for p in among if p.turns] or among
    if not count or not turning or valid.stop - valid.start < 2 * SHIFTING.slow:
        return UNTOLD
    channels = [c for p in turning for c in (p.rates[:2] if p.turns else p.rates)]
    x, lagging = log.states.numpy(), bool(model.input_effects())
    inputs = acting(model, log) if lagging else log.inputs
    steady = inputs.clone()
    steady[:, :count] = inputs[valid, :count].mean(dim=0)
    own, forced = (_rates(model, log, u, internal)[:, channels] for u in (steady, inputs))
    moving = x[:, channels]
    caused, seen = forced - own, slope(moving, False, log.dt) - own
    cause, effect, beside = (_band(a[valid]) for a in (caused, seen, moving))
    score = agreements(cause, effect, SHIFTING.widest, beside)
    by, how = peak(score)
    low, high = _told(score, cause.size / SHIFTING.smoothing)
    # A held command acts after its sample: the slope about a sample has half of it from the step before. What delays
    # and lags of the model make of it is told at the sample.
    early = 0.5 if model.input_hold == "previous" and not lagging else 0.0
    return Lag(by - early, how, min(low, by) - early, max(high, by) - early)


def _told(score: Array, count: float) -> tuple[float, float]:
    """Between which lags correlations (2 w + 1,) of ``count`` independent samples leave it, by their likelihood."""
    best, widest = int(np.argmax(score)), len(score) // 2
    left = 1 - np.clip(score, 0, 1 - 1e-12) ** 2
    missing = count / 2 * np.log(left / left[best]) - SHIFTING.sure**2 / 2
    ends = []
    for side in (missing[best::-1], missing[best:]):
        beyond = next((i for i, x in enumerate(side) if x > 0), None)
        ends.append(len(side) - 1 if beyond is None else beyond - side[beyond] / (side[beyond] - side[beyond - 1]))
    return best - ends[0] - widest, best + ends[1] - widest


def _band(x: Array) -> Array:
    """What is neither noise nor slow of signals (N, c), where a whole window tells (N − `SHIFTING.slow` + 1, c)."""
    return np.stack([np.convolve(column, _weights(), "valid") for column in x.T], axis=1)


@cache
def _weights() -> Array:
    """Of the samples in a window: those of a short local quadratic less those of a long one, which are symmetric."""
    short, slow = (savitzky_golay(window, 2) for window in (SHIFTING.smoothing, SHIFTING.slow))
    return np.asarray(np.pad(short, (len(slow) - len(short)) // 2) - slow)


def _rates(model: PhysicsModel, log: Log, inputs: Tensor, internal: Tensor | None) -> Array:
    state = torch.cat(
        [log.states, log.states.new_zeros(len(log), model.internal_size) if internal is None else internal], dim=1
    )
    with torch.no_grad():
        out: Array = model.derivative(state, inputs, torch.zeros_like(inputs)).numpy()
    return out
