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
from bench.diagnose.logs.rate_timing import moving_channels, rates_in_time, states_read_later
from bench.diagnose.logs.sample import shortened
from bench.diagnose.logs.subject import Subject, drives_of
from bench.diagnose.regression.least_squares import equilibrium
from bench.diagnose.regression.linearise import Linearization, directions
from bench.diagnose.regression.parameters import Prior, entries
from bench.diagnose.regression.rows import Rows
from bench.diagnose.regression.test_functions import TestFunctions
from bench.diagnose.regression.weak import LogBatch, mean_rates, own_states
from bench.diagnose.select.catalogue import admissible
from bench.diagnose.select.search import Search, noise_filters, stride_of
from bench.diagnose.settings import TIMING
from bench.diagnose.simulate.unmeasured import hidden
from registry.dynamics import PhysicsModel

_INPUTS, _SENSORS, _MOTION = range(3)
"""Places of the shifts."""


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

    Rates are read when they were what they say first (`logs.rate_timing`), position and velocity of a vehicle when its
    attitude tilts the forces. No input is shifted where some state is not measured, or where no shift can be told.
    Commands act when they are given, or later, which a lag or a delay says; earlier by a fraction of a sample where all
    else is filed late, as by a simulator that files the state before a step beside the rate after half of it.

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
    inputs, sensed, moving = _shifts(subject, noise)
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
    if abs(moving.value) >= TIMING.negligible:
        logs = tuple(states_read_later(log, moving_channels(subject.model), moving.value) for log in logs)
        notes.append(_motion_said(subject, moving))
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
    return bool(known and drives and subject.training) and not hidden(subject.logs)


def is_held(subject: Subject) -> bool:
    """Whether the inputs are commands that hold until the next sample."""
    return subject.model.input_hold == "previous"


def read_at(inputs: torch.Tensor, drives: int, shift: float, held: bool = False) -> torch.Tensor:
    """Inputs (N, m) of which the first ``drives`` are read ``shift`` samples later, by cubic interpolation.

    Of what is ``held`` until the next sample the mean over a sample is read: a part of this one and of the next.
    """
    whole = int(np.floor(shift))
    x, n = shift - whole, len(inputs)
    before, now, then, after = (inputs[(torch.arange(n) + whole + k).clamp(0, n - 1), :drives] for k in (-1, 0, 1, 2))
    out = inputs.clone()
    out[:, :drives] = (
        torch.lerp(now, then, x)  # to the bit what it is, until it changes
        if held
        else -x * (x - 1) * (x - 2) / 6 * before
        + (x + 1) * (x - 1) * (x - 2) / 2 * now
        + -(x + 1) * x * (x - 2) / 2 * then
        + (x + 1) * x * (x - 1) / 6 * after
    )
    return out


def _shifts(subject: Subject, noise: Noise) -> tuple[Shift, Shift, Shift]:
    """The shifts of the inputs, of the sensors and of the motion of a body that turns, which all recordings share.

    Zero where they are not significant.
    """
    held, nothing = is_held(subject), Shift(0.0, 0.0, 0.0)
    instant = subject.model.drive_acts_at_once and not held
    widest = np.array([np.inf if instant else TIMING.within_sample, np.inf, np.inf])
    latest = np.array([0.0 if held else -widest[0], -widest[1], -widest[2]])
    start = np.array([_coarse(subject) if instant else 0.0, 0.0, 0.0])
    value, error = start, np.full(len(start), np.inf)
    for _ in range(TIMING.linearised):
        fit = _Regression(subject, noise, float(value[_INPUTS]))
        if not fit.moves_apart(value):
            fit.leave(_MOTION)
            value[_MOTION] = 0.0
        for _ in range(TIMING.steps):
            step, error = fit.step(value)
            if not np.isfinite([*step, error[_INPUTS]]).all():
                return nothing, nothing, nothing  # nothing moves by which a shift could be told
            value = np.clip(value + np.clip(step, -1, 1), latest, widest)
            if (np.abs(step) < TIMING.negligible).all():
                break
        told = abs(value[_INPUTS]) >= TIMING.significant * error[_INPUTS]
        if not told or abs(value[_INPUTS] - fit.read_at) < TIMING.anew:
            break
    for which in (_INPUTS, _MOTION):
        value[which], error[which] = _shared(fit, value, which, error[which])
    sure = np.abs(value) >= TIMING.significant * error
    inputs, sensed, moving = (
        Shift(v, v - 1.96 * e, v + 1.96 * e) if t else nothing
        for v, e, t in zip(value.tolist(), error.tolist(), sure, strict=True)
    )
    return inputs, sensed, moving


def _shared(fit: "_Regression", shift: np.ndarray, which: int, error: float) -> tuple[float, float]:
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


class _Regression:
    """The weak form of the training recordings with the shifts of inputs and sensors as two more numbers."""

    def __init__(self, subject: Subject, noise: Noise, shift: float) -> None:
        """Linearise the model and every effect of the catalogue where inputs are read ``shift`` samples later."""
        self.read_at = shift
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
        places = {
            _SENSORS: [i for i, c in enumerate(self.linear.channels) if c >= self.stack.states.shape[-1]],
            _MOTION: [i for i, c in enumerate(self.linear.channels) if c in moving_channels(self.model)],
        }
        if self.held and self.model.description().turning:
            places.pop(_SENSORS)  # a lag behind the commands delays what is felt as well
        self.late = {which: at for which, at in places.items() if at}
        filters = [search.smoothing_of(self.model.measured_channels[c]) for c in self.linear.channels]
        self.tests = TestFunctions.over(self.stack.logs, stride_of(self.stack), filters)
        self.whitening = noise_filters(
            self.linear.project(self.tests), Prior.of(self.linear.own).loosened(self.linear.own)
        )

    def read(self, shift: float, noisy: bool = False) -> LogBatch:
        """The recordings with their inputs read ``shift`` samples later, once more with noise or not."""
        inputs = self.stack.inputs + self.drawn if noisy else self.stack.inputs
        return replace(self.stack, inputs=torch.stack([read_at(u, self.drives, shift, self.held) for u in inputs]))

    def moves_apart(self, shift: np.ndarray) -> bool:
        """Whether a body that turns moves by a clock of its own, beside the other shifts."""
        if _MOTION not in self.late:
            return False
        step, error = self.step(shift)
        return bool(abs(shift[_MOTION] + step[_MOTION]) >= TIMING.significant * error[_MOTION])

    def leave(self, which: int) -> None:
        """Ask no more for one of the shifts."""
        self.late.pop(which, None)

    @property
    def shifted(self) -> list[int]:
        """Which shifts are asked for, in the order of their columns."""
        return [_INPUTS, *self.late]

    def step(self, shift: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Gauss–Newton step (3,) of the shifts of inputs, sensors and motion, and its standard errors [samples].

        0 ± 0 for what there is none of.
        """
        rows, noise = self._whitened(shift)
        clear = self._clear(rows, noise)
        return self._solved(rows.only(clear), noise.only(clear))

    def apart(self, shift: np.ndarray, which: int) -> tuple[np.ndarray, np.ndarray]:
        """The same of one shift by every channel alone that it moves: steps (C,) and their standard errors."""
        if which not in self.shifted:
            return np.empty(0), np.empty(0)
        rows, noise = self._whitened(shift)
        column = len(self.linear.columns) + self.shifted.index(which)
        alone = [
            self._solved(rows.only([c]), noise.only([c])) for c in range(rows.channels) if column in rows.acting[c]
        ]
        steps, errors = (np.array([pair[i][which] for pair in alone]) for i in (0, 1))
        return steps, errors

    def _whitened(self, shift: np.ndarray) -> tuple[Rows, Rows]:
        """Rows at some shifts, and what more noise of the inputs makes of them."""
        rows, again = (self._rows(linear, shift, noisy) for linear, noisy in ((self.linear, False), (self.noisy, True)))
        return rows.whitened(self.whitening), rows.less(again).whitened(self.whitening)

    def _solved(self, rows: Rows, drawn: Rows) -> tuple[np.ndarray, np.ndarray]:
        """The step (3,) and its errors that rows, with what noise makes of them, tell."""
        normal = rows.normal().less(drawn.mean_gram())
        gram = normal.total[:-1, :-1] + np.diag(_precision(self.linear, len(normal.total) - 1))
        scale = equilibrium(np.diag(gram))
        inverse = np.linalg.inv(gram * np.outer(scale, scale) + 1e-9 * np.eye(len(gram))) * np.outer(scale, scale)
        beta = inverse @ normal.total[:-1, -1]
        scores = normal.scores(range(len(beta)), beta)
        scores -= scores.mean(0)
        spread = inverse @ (scores.T @ scores) @ inverse
        variance = np.maximum(np.diag(spread), np.diag(inverse))
        error = np.sqrt(np.where(variance > 0, variance, np.inf))  # what rows tell beyond noise may be nothing
        first, step, spread_of = len(self.linear.columns), np.zeros(3), np.zeros(3)
        step[self.shifted], spread_of[self.shifted] = np.where(np.isfinite(error), beta, 0.0)[first:], error[first:]
        return step, spread_of

    def _clear(self, rows: Rows, drawn: Rows) -> list[int]:
        """Channels of which some shift makes more than noise of the inputs does; all, where there is none.

        What is left of the others once that noise was taken off may be less than nothing, and cancels what is known.
        """
        shifts = slice(len(self.linear.columns), -1)
        made, noise = rows.power()[:, shifts], drawn.power()[:, shifts]
        every = np.arange(rows.channels)
        return list(every[((made > 0) & (2 * noise <= made)).any(1)]) or list(every)

    def _rows(self, linear: Linearization, shift: np.ndarray, noisy: bool) -> Rows:
        """Rows with a column for the shift of the inputs and for that of each kind of channels that is filed late."""

        def filed(rates: np.ndarray, late: np.ndarray) -> np.ndarray:
            """Rates (L, N − 1, channels) of which those of each kind are filed so many samples late."""
            out = rates.copy()
            for which, at in self.late.items():
                out[..., at] = [read_at(torch.from_numpy(x), len(at), -late[which]).numpy() for x in rates[..., at]]
            return out

        here, later = (
            mean_rates(self.model, self.read(u, noisy)).numpy()[..., list(linear.channels)]
            for u in (shift[_INPUTS], shift[_INPUTS] + TIMING.probe)
        )
        rates, moved = filed(here, shift), [filed(later, shift)]
        moved += [filed(here, shift + TIMING.probe * np.eye(3)[which]) for which in self.late]
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


def _in_ms(subject: Subject, shift: Shift) -> tuple[str, str]:
    """The size of a shift, and its interval."""
    ms = 1e3 * subject.logs[0].dt
    low, high = sorted(abs(x) * ms for x in (shift.low, shift.high))
    return f"{abs(shift.value) * ms:.3g} ms", f"{low:.3g} to {high:.3g} ms"


def _filed(subject: Subject, shift: Shift) -> str:
    by, between = _in_ms(subject, shift)
    return f"filed {by} ({between}) {'after' if shift.value > 0 else 'before'}"


def _sensor_said(subject: Subject, shift: Shift) -> str:
    signal = subject.model.sensed_channels[0].group.replace("_", " ")
    return (
        f"The {signal} is {_filed(subject, shift)} the motion that it shows, and is read so everywhere: a clock or a "
        "filter of the sensor."
    )


def _motion_said(subject: Subject, shift: Shift) -> str:
    return (
        f"Position and velocity are {_filed(subject, shift)} the attitude that tilts the forces, and are read so "
        "everywhere: a filter, or a clock of its own."
    )


def _said(subject: Subject, shift: Shift) -> str:
    channels = subject.logs[0].recording.input_channels
    signal = channels[0].group.replace("_", " ") if channels else "input"
    by, between = _in_ms(subject, shift)
    when = "earlier" if shift.value > 0 else "later"
    return (
        f"The {signal} acts {by} ({between}, {abs(shift.value):.2f} samples) {when} than it is filed, and is read so "
        "everywhere: what happens between two samples, or a clock or filter that is late."
    )
