"""By how much inputs, sensors and the motion of a body that turns are to be read earlier or later than filed."""

from dataclasses import dataclass

import numpy as np
import torch

from bench.diagnose.checks.shifts import lag_of
from bench.diagnose.logs.noise import Noise
from bench.diagnose.logs.subject import LogBatch, Subject
from bench.diagnose.regression.weak import own_states
from bench.diagnose.select.timing.regression import FORCES, INPUTS, MOTION, ShiftRegression, is_held
from bench.diagnose.settings import TIMING


@dataclass(frozen=True)
class Shift:
    """By how much later than filed something is to be read, with its 95 % interval [samples]."""

    value: float
    low: float
    high: float


def shifts_of(subject: Subject, noise: Noise) -> tuple[Shift, Shift, Shift, Shift]:
    """The shifts of the inputs, of the sensors, of the motion of a body that turns and of the inputs in its forces.

    All recordings share them. Zero where they are not significant.
    """
    held, nothing = is_held(subject), Shift(0.0, 0.0, 0.0)
    instant = subject.model.drive_acts_at_once and not held
    widest = np.array([np.inf if instant else TIMING.within_sample, np.inf, np.inf, np.inf])
    latest = np.array([0.0 if held else -widest[INPUTS], *-widest[1:]])
    value = np.array([_coarse(subject) if instant else 0.0, 0.0, 0.0, 0.0])
    error = np.full(len(value), np.inf)
    for _ in range(TIMING.linearised):
        fit = ShiftRegression(subject, noise, float(value[INPUTS]))
        for _ in range(TIMING.steps):
            step, error = fit.step(value)
            if not np.isfinite([*step, error[INPUTS]]).all():
                return nothing, nothing, nothing, nothing  # nothing moves by which a shift could be told
            moved = value + np.clip(step, -1, 1)
            if abs(moved[MOTION]) < TIMING.significant * error[MOTION]:
                fit.leave(MOTION)
                moved[[MOTION, FORCES]] = 0.0
            if held or not TIMING.significant * error[FORCES] <= abs(moved[FORCES]) < TIMING.within_sample:
                moved[FORCES] = 0.0
            value = np.clip(moved, latest, widest)
            if (np.abs(step) < TIMING.negligible).all():
                break
        told = abs(value[INPUTS]) >= TIMING.significant * error[INPUTS]
        if not told or abs(value[INPUTS] - fit.read_at) < TIMING.anew:
            break
    for which in (INPUTS, MOTION):
        value[which], error[which] = _shared(fit, value, which, error[which])
    sure = (np.abs(value) >= TIMING.significant * error) & (value != 0)
    sure[FORCES] &= sure[MOTION]
    inputs, sensed, moving, forced = (
        Shift(v, v - 1.96 * e, v + 1.96 * e) if t else nothing
        for v, e, t in zip(value.tolist(), error.tolist(), sure, strict=True)
    )
    return inputs, sensed, moving, forced


def _shared(fit: ShiftRegression, shift: np.ndarray, which: int, error: float) -> tuple[float, float]:
    """One of the shifts as every channel has it, and its standard error [samples].

    A clock is late for all channels alike (χ² of their own shifts). Where they disagree by less than filters of the
    sensors and the path between two samples can make, it is late as they say on the whole. What delays some of them
    more is no clock but something that the model lacks, such as drag that grows with the square of the rates: the clock
    is late as those say that are near the least of those that tell it.
    """
    steps, errors = fit.apart(shift, which)
    known = np.isfinite(steps) & np.isfinite(errors) & (errors > 0)
    steps, errors = steps[known], errors[known]
    if len(steps) < 2:
        return float(shift[which]), error
    weights = errors**-2
    spread = float((weights * (steps - weights @ steps / weights.sum()) ** 2).sum())
    freedom = len(steps) - 1
    if spread <= freedom + TIMING.significant * (2 * freedom) ** 0.5:
        return float(shift[which]), error
    alone, clear = shift[which] + steps, errors < abs(shift[which]) / TIMING.significant
    if not clear.any():
        return 0.0, np.inf
    least = alone[clear][np.abs(alone[clear]).argmin()]
    near = clear & (np.abs(alone - least) <= TIMING.within_sample)
    return float(weights[near] @ alone[near] / weights[near].sum()), float(weights[near].sum() ** -0.5)


def _coarse(subject: Subject) -> float:
    """Shift by which the modelled motion agrees best with the measured one [samples]; 0: none that is clear."""
    model, own = subject.model, dict[str, torch.Tensor]()
    if model.internal_size:
        with torch.no_grad():
            own = {log.name: own_states(model, LogBatch.of([log]))[0] for log in subject.logs}
    lags = [lag_of(model, log, own.get(log.name)) for log in subject.logs]
    clear = [-lag.by for lag in lags if lag.agreement > TIMING.coarse]
    middle = float(np.median(clear)) if 2 * len(clear) >= len(lags) and clear else 0.0
    return middle if abs(middle) > TIMING.coarse else 0.0
