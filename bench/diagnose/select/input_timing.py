"""When a measured input acts: the shift between its clock and that of the motion, estimated before any effect is.

Between two samples an input does not move in a straight line (a motor follows held commands along an exponential),
a log files it late, a filter delays the states. To first order all of these are one thing: the input acts as it is read
a fraction of a sample earlier or later. A term that follows the input's rate fits them all, so the shift is settled
first: in the weak form, beside the model's constants and every effect of the catalogue, with the noise of the
inputs taken off. Inputs are then read at the shifted times by all that follows.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.ndimage import convolve1d

from bench.diagnose.checks.shifts import lag_of
from bench.diagnose.logs.noise import Noise, noise_of
from bench.diagnose.logs.subject import Log, Subject
from bench.diagnose.regression.least_squares import equilibrium
from bench.diagnose.regression.linearise import Directions, directions
from bench.diagnose.regression.weak import Stack, TestFunctions, mean_rates
from bench.diagnose.select.search import Search, admissible, hop_of, noise_filters, shortened
from bench.diagnose.simulate.unmeasured import hidden
from registry.dynamics import PhysicsModel

WITHIN_SAMPLE = 0.5
"""Largest shift of a signal that need not act at once [samples]: what the path between two samples can make."""
SIGNIFICANT = 4.0
"""Standard errors from zero from which a shift is believed."""
NEGLIGIBLE = 0.01
"""Shift below which nothing is gained by reading the input anew [samples]."""
COARSE = 0.5
"""Shift from which the cross-correlation's estimate is the start [samples]; the regression alone finds smaller ones."""
STEPS = 3
"""Gauss–Newton steps."""
PROBE = 1e-3
"""Step of the one-sided difference in the shift [samples]."""
PRIOR = 3.0
"""1σ of the effects that are fitted beside the shift, in typical values."""


@dataclass(frozen=True)
class Shift:
    """By how much later than filed the inputs act, with its 95 % interval [samples]."""

    value: float
    low: float
    high: float


def prepared(
    subject: Subject, noise: Noise | None = None, tick: Callable[[str], None] = lambda what: None
) -> tuple[Subject, Noise]:
    """The subject with its inputs read when they act, with a note that says so, and the noise of it; once only.

    Nothing is shifted where the inputs are commands (they act when they are given), where some state is not measured,
    or where no shift can be told.

    Args:
        subject: model and measurements.
        noise: default `noise_of`.
        tick: called with what is being done.
    """
    noise = noise or noise_of(subject)
    if subject.timed:
        return subject, noise
    subject = replace(subject, timed=True)
    drives = drives_of(subject.model, subject.logs[0])
    if not subject.training or subject.model.input_hold == "previous" or not drives or hidden(subject.logs):
        return subject, noise
    tick("input timing")
    shift = _shift(subject, noise)
    if abs(shift.value) < NEGLIGIBLE:
        return subject, noise
    logs = tuple(replace(log, inputs=read_at(log.inputs, drives, shift.value)) for log in subject.logs)
    subject = replace(subject, logs=logs, notes=(*subject.notes, _said(subject, shift)))
    return subject, noise_of(subject)


def drives_of(model: PhysicsModel, log: Log) -> int:
    """Channels of the driving signal among a log's inputs."""
    return log.inputs.shape[1] - len(model.extras)


def read_at(inputs: torch.Tensor, drives: int, shift: float) -> torch.Tensor:
    """Inputs (N, m) of which the first ``drives`` are read ``shift`` samples later, by cubic interpolation."""
    whole = int(np.floor(shift))
    x, n = shift - whole, len(inputs)
    weights = [
        -x * (x - 1) * (x - 2) / 6,
        (x + 1) * (x - 1) * (x - 2) / 2,
        -(x + 1) * x * (x - 2) / 2,
        (x + 1) * x * (x - 1) / 6,
    ]
    at = torch.arange(n)
    out = inputs.clone()
    out[:, :drives] = sum(
        w * inputs[(at + whole + k).clamp(0, n - 1), :drives] for k, w in zip((-1, 0, 1, 2), weights, strict=True)
    )
    return out


def _shift(subject: Subject, noise: Noise) -> Shift:
    """The shift that all recordings share; zero where it is not significant."""
    instant = subject.model.drive_acts_at_once
    widest = np.inf if instant else WITHIN_SAMPLE
    start = _coarse(subject) if instant else 0.0
    value, error = start, 0.0
    for _ in range(STEPS):
        step, error = _step(subject, noise, value)
        value = float(np.clip(value + np.clip(step, -1, 1), -widest, widest))
        if abs(step) < NEGLIGIBLE / 2:
            break
    if abs(value) < SIGNIFICANT * error and not start:
        value = 0.0
    return Shift(value, value - 1.96 * error, value + 1.96 * error)


def _coarse(subject: Subject) -> float:
    """Shift by which the modelled motion agrees best with the measured one [samples]; 0: none that is clear."""
    lags = [lag_of(subject.model, log) for log in subject.logs]
    clear = [-by for by, how in lags if how > COARSE]
    middle = float(np.median(clear)) if 2 * len(clear) >= len(lags) and clear else 0.0
    return middle if abs(middle) > COARSE else 0.0


def _step(subject: Subject, noise: Noise, shift: float) -> tuple[float, float]:
    """Gauss–Newton step of the shift of all training recordings and its standard error [samples]."""
    search = Search(subject, (), lambda name: None, noise)
    model = subject.model
    logs = shortened(subject.of(subject.training))
    drives = drives_of(model, logs[0])
    seen = [replace(log, inputs=read_at(log.inputs, drives, shift)) for log in logs]
    stack = Stack.of(seen)
    candidates = [(name, kind) for name, kind in admissible(subject, model, None) if not kind.screen]

    def linearised(offset: torch.Tensor) -> Directions:
        here = replace(stack, inputs=stack.inputs + offset)
        later = torch.stack([read_at(u, drives, PROBE) for u in here.inputs])
        linear = directions(model, model, subject.uncertainty, here, candidates)
        moved = mean_rates(model, replace(here, inputs=later)).numpy()[..., list(linear.channels)]
        return replace(linear, columns=np.concatenate([linear.columns, (moved - linear.rates)[None] / PROBE]))

    linear = linearised(torch.zeros_like(stack.inputs))
    filters = [search.smoothing[model.state_channels[c].group] for c in linear.channels]
    tests = TestFunctions.over(stack.logs, hop_of(stack), filters)
    rows = linear.project(tests)
    whitening = noise_filters(rows, len(linear.own))
    white = np.random.default_rng(0).normal(size=stack.inputs.shape) * np.array(noise.inputs)
    again = linearised(torch.from_numpy(convolve1d(white, noise.input_smoothing.kernel(), axis=1))).project(tests)
    normal = rows.normal(whitening, rows.noise(again, whitening))
    precision = _precision(linear)
    gram = normal.total[:-1, :-1] + np.diag(precision)
    scale = equilibrium(np.diag(gram))
    inverse = np.linalg.inv(gram * np.outer(scale, scale) + 1e-9 * np.eye(len(gram))) * np.outer(scale, scale)
    beta = inverse @ normal.total[:-1, -1]
    blocks = normal.grams.sum(1)
    scores = blocks[:, :-1, -1] - blocks[:, :-1, :-1] @ beta
    scores -= scores.mean(0)
    spread = inverse @ (scores.T @ scores) @ inverse
    return float(beta[-1]), float(np.sqrt(max(spread[-1, -1], inverse[-1, -1])))


def _precision(linear: Directions) -> np.ndarray:
    """1/σ² of every column: what is known of the constants, a wide one for the effects, none for the shift."""
    out = np.zeros(len(linear.columns))
    for i, entry in enumerate(linear.own):
        out[i] = entry.scale**-2 if entry.constant else 0.0
    for start in linear.starts:
        for column, entry in zip(start.columns[len(start.columns) - len(start.entries) :], start.entries, strict=True):
            out[column] = (PRIOR * entry.scale) ** -2
    return out


def _said(subject: Subject, shift: Shift) -> str:
    channels = subject.logs[0].recording.input_channels
    signal = channels[0].group.replace("_", " ") if channels else "input"
    ms = 1e3 * subject.logs[0].dt
    by, samples = abs(shift.value) * ms, abs(shift.value)
    when = "later" if shift.value > 0 else "earlier"
    low, high = sorted(abs(x) * ms for x in (shift.low, shift.high))
    return (
        f"The {signal} acts {by:.3g} ms ({low:.3g} to {high:.3g} ms, {samples:.2f} samples) {when} than it is filed, "
        "and is read so everywhere: what happens between two samples, or a clock or filter that is late."
    )
