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
from bench.diagnose.logs.parts import in_parts
from bench.diagnose.logs.rate_timing import rates_in_time
from bench.diagnose.logs.sample import shortened
from bench.diagnose.logs.subject import Log, Subject
from bench.diagnose.regression.least_squares import equilibrium
from bench.diagnose.regression.linearise import Linearization, directions
from bench.diagnose.regression.parameters import Prior, entries
from bench.diagnose.regression.rows import Rows
from bench.diagnose.regression.test_functions import TestFunctions
from bench.diagnose.regression.weak import LogBatch, mean_rates, own_states
from bench.diagnose.select.search import Search, admissible, noise_filters, stride_of
from bench.diagnose.settings import TIMING
from bench.diagnose.simulate.unmeasured import hidden
from registry.dynamics import PhysicsModel


@dataclass(frozen=True)
class Shift:
    """By how much later than filed something is to be read, with its 95 % interval [samples]."""

    value: float
    low: float
    high: float


def prepared(
    subject: Subject, noise: Noise | None = None, tick: Callable[[str], None] = lambda what: None
) -> tuple[Subject, Noise]:
    """The subject with its inputs read when they act, with a note that says so, and the noise of it; once only.

    Rates are read when they were what they say first (`logs.rate_timing`). No input is shifted where some state is not
    measured, or where no shift can be told. Commands act when they are given, or later, which a lag or a delay says;
    earlier by a fraction of a sample where all else is filed late, as by a simulator that files the state before a step
    beside the rate after half of it. The clocks of vehicles are checked by themselves.

    Args:
        subject: model and measurements.
        noise: default `noise_of`.
        tick: called with what is being done.
    """
    noise = noise or noise_of(subject)
    if subject.timed:
        return subject, noise
    subject = in_parts(subject)
    filed = subject.logs
    subject = rates_in_time(replace(subject, timed=True))
    if not _tells_time(subject):
        return subject, noise
    tick("input timing")
    inputs, sensed = _shifts(subject, noise)
    logs, notes = subject.logs, list(subject.notes)
    if abs(inputs.value) >= TIMING.negligible:
        drives, held = drives_of(subject.model, subject.logs[0]), is_held(subject)
        logs = tuple(replace(log, inputs=read_at(log.inputs, drives, inputs.value, held)) for log in logs)
        notes.append(_said(subject, inputs))
    if abs(sensed.value) >= TIMING.negligible:
        paths = (log.sensed for log in logs)
        read = [None if path is None else read_at(path, path.shape[1], sensed.value) for path in paths]
        logs = tuple(replace(log, sensed=path) for log, path in zip(logs, read, strict=True))
        notes.append(_sensor_said(subject, sensed))
    if logs is subject.logs:
        return subject, noise
    subject = replace(subject, logs=logs, notes=tuple(notes))
    # A rate that is read between its samples is smoother than what was measured.
    measured = (replace(log, states=was.states) for log, was in zip(logs, filed, strict=True))
    return subject, noise_of(replace(subject, logs=tuple(measured)))


def retimed(filed: Subject, model: PhysicsModel, noise: Noise) -> Subject:
    """Measurements whose inputs are as filed, with these read when they act beside all that ``model`` has."""
    read, _ = prepared(replace(filed, model=model), noise)
    return replace(read, model=filed.model)


def mistimed(read: Subject, model: PhysicsModel, noise: Noise) -> bool:
    """Whether inputs act at another time than they are ``read`` now, beside all that ``model`` has."""
    beside = replace(read, model=model)
    return _tells_time(beside) and abs(_shifts(beside, noise)[0].value) >= TIMING.negligible


def _tells_time(subject: Subject) -> bool:
    """Whether recordings could tell when their inputs act, and it is for the clock to say."""
    known, drives = entries(subject.model, subject.uncertainty), drives_of(subject.model, subject.logs[0])
    held_of_vehicle = is_held(subject) and subject.model.description().turning
    return bool(known and drives and subject.training) and not (held_of_vehicle or hidden(subject.logs))


def drives_of(model: PhysicsModel, log: Log) -> int:
    """Channels of the driving signal among a log's inputs."""
    return log.inputs.shape[1] - len(model.extras)


def is_held(subject: Subject) -> bool:
    """Whether the inputs are commands that hold until the next sample."""
    return subject.model.input_hold == "previous"


def read_at(inputs: torch.Tensor, drives: int, shift: float, held: bool = False) -> torch.Tensor:
    """Inputs (N, m) of which the first ``drives`` are read ``shift`` samples later, by cubic interpolation.

    Of what is ``held`` until the next sample the mean over a sample is read: a part of this one and of the next.
    """
    whole = int(np.floor(shift))
    x, n = shift - whole, len(inputs)
    weights = (
        [0.0, 1 - x, x, 0.0]
        if held
        else [
            -x * (x - 1) * (x - 2) / 6,
            (x + 1) * (x - 1) * (x - 2) / 2,
            -(x + 1) * x * (x - 2) / 2,
            (x + 1) * x * (x - 1) / 6,
        ]
    )
    at = torch.arange(n)
    out = inputs.clone()
    out[:, :drives] = sum(
        w * inputs[(at + whole + k).clamp(0, n - 1), :drives] for k, w in zip((-1, 0, 1, 2), weights, strict=True)
    )
    return out


def _shifts(subject: Subject, noise: Noise) -> tuple[Shift, Shift]:
    """The shifts of the inputs and of the sensors that all recordings share; zero where they are not significant."""
    held, nothing = is_held(subject), Shift(0.0, 0.0, 0.0)
    instant = subject.model.drive_acts_at_once and not held
    widest = np.array([np.inf if instant else TIMING.within_sample, np.inf])
    latest = np.array([0.0 if held else -widest[0], -widest[1]])
    start = np.array([_coarse(subject) if instant else 0.0, 0.0])
    fit = _Regression(subject, noise, start[0])
    value, error = start, np.full(2, np.inf)
    for _ in range(TIMING.steps):
        step, error = fit.step(value)
        if not np.isfinite([step, error]).all():
            return nothing, nothing  # nothing moves by which a shift could be told
        value = np.clip(value + np.clip(step, -1, 1), latest, widest)
        if (np.abs(step) < TIMING.negligible).all():
            break
    value[0], error[0] = _shared(fit, value, error[0])
    told = np.abs(value) >= TIMING.significant * error
    inputs, sensed = (
        Shift(v, v - 1.96 * e, v + 1.96 * e) if t else nothing
        for v, e, t in zip(value.tolist(), error.tolist(), told, strict=True)
    )
    return inputs, sensed


def _shared(fit: "_Regression", shift: np.ndarray, error: float) -> tuple[float, float]:
    """The shift of the inputs that every channel has, and its standard error [samples].

    A clock is late for all channels alike (χ² of their own shifts). Where they disagree, what delays some of them is no
    clock but something that the model lacks, such as drag that grows with the square of the rates: the clock is late by
    no more than the least of those that tell it.
    """
    steps, errors = fit.apart(shift)
    known = np.isfinite(steps) & np.isfinite(errors) & (errors > 0)
    steps, errors = steps[known], errors[known]
    if len(steps) < 2:
        return float(shift[0]), error
    weights = errors**-2
    spread = float((weights * (steps - weights @ steps / weights.sum()) ** 2).sum())
    freedom = len(steps) - 1
    if spread <= freedom + TIMING.significant * (2 * freedom) ** 0.5:
        return float(shift[0]), error
    alone, clear = shift[0] + steps, errors < abs(shift[0]) / TIMING.significant
    if not clear.any():
        return 0.0, np.inf
    least = np.flatnonzero(clear)[np.abs(alone[clear]).argmin()]
    return float(alone[least]), float(errors[least])


def _coarse(subject: Subject) -> float:
    """Shift by which the modelled motion agrees best with the measured one [samples]; 0: none that is clear."""
    model, own = subject.model, dict[str, torch.Tensor]()
    if model.internal_size:
        with torch.no_grad():
            own = {log.name: own_states(model, LogBatch.of([log]))[0] for log in subject.logs}
    lags = [lag_of(model, log, own.get(log.name)) for log in subject.logs]
    clear = [-by for by, how in lags if how > TIMING.coarse]
    middle = float(np.median(clear)) if 2 * len(clear) >= len(lags) and clear else 0.0
    return middle if abs(middle) > TIMING.coarse else 0.0


class _Regression:
    """The weak form of the training recordings with the shifts of inputs and sensors as two more numbers."""

    def __init__(self, subject: Subject, noise: Noise, shift: float) -> None:
        """Linearise the model and every effect of the catalogue where inputs are read ``shift`` samples later."""
        self.model, self.drives, self.held = subject.model, drives_of(subject.model, subject.logs[0]), is_held(subject)
        self.stack = LogBatch.of(shortened(subject.of(subject.training), TIMING.longest))
        search = Search(subject, (), lambda name: None, noise)
        candidates = [(name, kind) for name, kind in admissible(subject, self.model, None) if not kind.screen]
        white = np.random.default_rng(0).normal(size=self.stack.inputs.shape) * np.array(noise.inputs)
        self.drawn = torch.from_numpy(convolve1d(white, noise.input_smoothing.kernel(), axis=1))
        here, noisy = self.read(shift), self.read(shift, noisy=True)
        self.linear, self.noisy = (
            directions(self.model, self.model, subject.uncertainty, stack, candidates) for stack in (here, noisy)
        )
        filters = [search.smoothing_of(self.model.measured_channels[c]) for c in self.linear.channels]
        self.tests = TestFunctions.over(self.stack.logs, stride_of(self.stack), filters)
        self.whitening = noise_filters(
            self.linear.project(self.tests), Prior.of(self.linear.own).loosened(self.linear.own)
        )

    def read(self, shift: float, noisy: bool = False) -> LogBatch:
        """The recordings with their inputs read ``shift`` samples later, once more with noise or not."""
        inputs = self.stack.inputs + self.drawn if noisy else self.stack.inputs
        return replace(self.stack, inputs=torch.stack([read_at(u, self.drives, shift, self.held) for u in inputs]))

    def step(self, shift: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Gauss–Newton step (2,) of the shifts of inputs and sensors, and its standard errors [samples].

        Without sensors 0 ± 0 for these.
        """
        return self._solved(*self._whitened(shift))

    def apart(self, shift: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The same of the inputs by every channel alone: steps (C,) and their standard errors."""
        rows, noise = self._whitened(shift)
        alone = [self._solved(rows.of(c), noise.of(c)) for c in range(rows.channels) if self._moved(rows, c)]
        steps, errors = (np.array([pair[i][0] for pair in alone]) for i in (0, 1))
        return steps, errors

    def _moved(self, rows: Rows, channel: int) -> bool:
        """Whether a shift of the inputs moves a channel."""
        return len(self.linear.columns) in rows.acting[channel]

    def _whitened(self, shift: np.ndarray) -> tuple[Rows, Rows]:
        """Rows at some shifts, and what more noise of the inputs makes of them."""
        rows, again = (self._rows(linear, shift, noisy) for linear, noisy in ((self.linear, False), (self.noisy, True)))
        return rows.whitened(self.whitening), rows.less(again).whitened(self.whitening)

    def _solved(self, rows: Rows, drawn: Rows) -> tuple[np.ndarray, np.ndarray]:
        """The step (2,) and its errors that rows, with what noise makes of them, tell."""
        normal = rows.normal().less(drawn.mean_gram())
        gram = normal.total[:-1, :-1] + np.diag(_precision(self.linear, len(normal.total) - 1))
        scale = equilibrium(np.diag(gram))
        inverse = np.linalg.inv(gram * np.outer(scale, scale) + 1e-9 * np.eye(len(gram))) * np.outer(scale, scale)
        beta = inverse @ normal.total[:-1, -1]
        scores = normal.scores(range(len(beta)), beta)
        scores -= scores.mean(0)
        spread = inverse @ (scores.T @ scores) @ inverse
        error = np.sqrt(np.maximum(np.diag(spread), np.diag(inverse)))
        shifts, step, spread_of = slice(len(self.linear.columns), None), np.zeros(2), np.zeros(2)
        found = len(beta[shifts])
        step[:found], spread_of[:found] = beta[shifts], error[shifts]
        return step, spread_of

    def _sensors(self, linear: Linearization) -> list[int]:
        """Places, among the channels, of what sensors show of the rates."""
        return [i for i, c in enumerate(linear.channels) if c >= self.stack.states.shape[-1]]

    def _rows(self, linear: Linearization, shift: np.ndarray, noisy: bool) -> Rows:
        """Rows with a column for the shift of the inputs and, where there are sensors, one for theirs."""
        at, (inputs, sensors) = self._sensors(linear), shift.tolist()

        def filed(rates: np.ndarray, late: float) -> np.ndarray:
            """Rates (L, N − 1, channels) of which those of sensors are filed so many samples late."""
            out = rates.copy()
            if at:
                out[..., at] = [read_at(torch.from_numpy(x), len(at), -late).numpy() for x in rates[..., at]]
            return out

        here, later = (
            mean_rates(self.model, self.read(u, noisy)).numpy()[..., list(linear.channels)]
            for u in (inputs, inputs + TIMING.probe)
        )
        rates, moved = filed(here, sensors), [filed(later, sensors)]
        if at:
            moved.append(filed(here, sensors + TIMING.probe))
        columns = linear.columns.with_more([(m - rates) / TIMING.probe for m in moved])
        return replace(linear, rates=rates, columns=columns).project(self.tests)


def _precision(linear: Linearization, count: int) -> np.ndarray:
    """1/σ² (``count``,) of every column: as known of constants, wide for effects, none for the shift."""
    out = np.zeros(count)
    out[: len(linear.own)] = Prior.of(linear.own).precision
    for start in linear.starts:
        for column, entry in zip(start.columns[len(start.columns) - len(start.entries) :], start.entries, strict=True):
            out[column] = (TIMING.prior * entry.scale) ** -2
    return out


def _sensor_said(subject: Subject, shift: Shift) -> str:
    signal = subject.model.sensed_channels[0].group.replace("_", " ")
    ms = 1e3 * subject.logs[0].dt
    low, high = sorted(abs(x) * ms for x in (shift.low, shift.high))
    when = "after" if shift.value > 0 else "before"
    return (
        f"The {signal} is filed {abs(shift.value) * ms:.3g} ms ({low:.3g} to {high:.3g} ms) {when} the motion that it "
        "shows, and is read so everywhere: a clock or a filter of the sensor."
    )


def _said(subject: Subject, shift: Shift) -> str:
    channels = subject.logs[0].recording.input_channels
    signal = channels[0].group.replace("_", " ") if channels else "input"
    ms = 1e3 * subject.logs[0].dt
    by, samples = abs(shift.value) * ms, abs(shift.value)
    when = "earlier" if shift.value > 0 else "later"
    low, high = sorted(abs(x) * ms for x in (shift.low, shift.high))
    return (
        f"The {signal} acts {by:.3g} ms ({low:.3g} to {high:.3g} ms, {samples:.2f} samples) {when} than it is filed, "
        "and is read so everywhere: what happens between two samples, or a clock or filter that is late."
    )
