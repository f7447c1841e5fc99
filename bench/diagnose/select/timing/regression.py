"""The weak form with the shifts of inputs, sensors and motion as more numbers beside constants and effects."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch

from bench.diagnose.logs.noise import Noise
from bench.diagnose.logs.rate_timing import moving_channels
from bench.diagnose.logs.sample import shortened
from bench.diagnose.logs.subject import LogBatch, Subject, drives_of
from bench.diagnose.regression.least_squares import Normal, equilibrium
from bench.diagnose.regression.linearise import Linearization, directions
from bench.diagnose.regression.parameters import Prior
from bench.diagnose.regression.rows import Rows, noise_filters
from bench.diagnose.regression.test_functions import TestFunctions, stride_of
from bench.diagnose.regression.weak import mean_rates
from bench.diagnose.select.catalogue import admissible
from bench.diagnose.select.search import Search
from bench.diagnose.settings import TIMING
from bench.diagnose.simulate.teacher_forced import with_noise

INPUTS, SENSORS, MOTION, FORCES = range(4)
"""Places of the shifts: of the inputs; of the sensors; of position and velocity; of the inputs in these two's equations
against those elsewhere.

An estimator turns what it feels by its attitude and adds that up. Each comes late by a filter or an integration step of
its own, and so do the rates that are logged: no one clock of the inputs suits all of them.
"""


def is_held(subject: Subject) -> bool:
    """Whether the inputs are commands that hold until the next sample."""
    return subject.model.input_hold == "previous"


def reading_weights(shift: float, held: bool = False) -> tuple[int, tuple[float, ...]]:
    """The first sample, counted from the one asked for, and the weights with which inputs are read ``shift`` later."""
    whole = int(np.floor(shift))
    x = shift - whole
    if held:
        return whole, (1 - x, x)
    return whole - 1, (
        -x * (x - 1) * (x - 2) / 6,
        (x + 1) * (x - 1) * (x - 2) / 2,
        -(x + 1) * x * (x - 2) / 2,
        (x + 1) * x * (x - 1) / 6,
    )


def read_at(inputs: torch.Tensor, drives: int, shift: float, held: bool = False) -> torch.Tensor:
    """Inputs (N, m) of which the first ``drives`` are read ``shift`` samples later, by cubic interpolation.

    Of what is ``held`` until the next sample the mean over a sample is read: a part of this one and of the next.
    """
    (first, weights), n = reading_weights(shift, held), len(inputs)
    near = [inputs[(torch.arange(n) + first + k).clamp(0, n - 1), :drives] for k in range(len(weights))]
    out = inputs.clone()
    if held:
        out[:, :drives] = torch.lerp(near[0], near[1], weights[1])  # to the bit what it is, until it changes
    else:
        out[:, :drives] = sum(w * x for w, x in zip(weights, near, strict=True))
    return out


class ShiftRegression:
    """The weak form of the training recordings with the shifts as more numbers."""

    def __init__(self, subject: Subject, noise: Noise, shift: float) -> None:
        """Linearise the model and every effect of the catalogue where inputs are read ``shift`` samples later."""
        self.read_at = shift
        self.model, self.drives, self.held = subject.model, drives_of(subject.model, subject.logs[0]), is_held(subject)
        self.stack = LogBatch.of(shortened(subject.of(subject.training), TIMING.longest))
        search = Search(subject, (), lambda name: None, noise)
        candidates = [(name, kind) for name, kind in admissible(subject, self.model, None) if not kind.screen]
        self.once_more = with_noise(self.model, self.stack, noise)
        here, noisy = self.read(shift), self.read(shift, noisy=True)
        spread = subject.uncertainty
        self.linear = directions(self.model, self.model, spread, here, candidates)
        self.noisy = directions(self.model, self.model, spread, noisy, candidates, like=self.linear)
        places = {
            SENSORS: [i for i, c in enumerate(self.linear.channels) if c >= self.stack.states.shape[-1]],
            MOTION: [i for i, c in enumerate(self.linear.channels) if c in moving_channels(self.model)],
        }
        if self.held and self.model.description().turning:
            places.pop(SENSORS)  # a lag behind the commands delays what is felt as well
        self.late = {which: at for which, at in places.items() if at}
        filters = [search.smoothing_of(self.model.measured_channels[c]) for c in self.linear.channels]
        self.tests = TestFunctions.over(self.stack.logs, stride_of(self.stack), filters)
        self.whitening = noise_filters(
            self.linear.project(self.tests), Prior.of(self.linear.own).loosened(self.linear.own)
        )

    def read(self, shift: float, noisy: bool = False) -> LogBatch:
        """The recordings with their inputs read ``shift`` samples later, once more with noise or not."""
        stack = self.once_more if noisy else self.stack
        return replace(stack, inputs=torch.stack([read_at(u, self.drives, shift, self.held) for u in stack.inputs]))

    def leave(self, which: int) -> None:
        """Ask no more for one of the shifts."""
        self.late.pop(which, None)

    @property
    def shifted(self) -> list[int]:
        """Which shifts are asked for, in the order of their columns."""
        return [INPUTS, *self.late]

    def step(self, shift: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Gauss–Newton step (4,) of the shifts at ``shift`` (4,), and its standard errors [samples].

        0 ± 0 for what there is none of. The inputs' shift is told by all equations, with the motion read as it is now;
        that of the motion with a shift of the inputs of its own beside it.
        """
        rows, noise = self._whitened(shift)
        clear = self._clear(rows, noise)
        normal = rows.only(clear).normal().less(noise.only(clear).mean_gram())
        step, error = self._solved(normal, [which for which in self.shifted if which != MOTION])
        if MOTION in self.late:
            moved, spread = self._solved(normal, [*self.shifted, FORCES])
            step[[MOTION, FORCES]], error[[MOTION, FORCES]] = moved[[MOTION, FORCES]], spread[[MOTION, FORCES]]
        return step, error

    def apart(self, shift: np.ndarray, which: int) -> tuple[np.ndarray, np.ndarray]:
        """The same of one shift by every channel alone that it moves: steps (C,) and their standard errors."""
        if which not in self.shifted:
            return np.empty(0), np.empty(0)
        rows, noise = self._whitened(shift)
        column = len(self.linear.columns) + self.shifted.index(which)
        alone = [
            self._solved(rows.only([c]).normal().less(noise.only([c]).mean_gram()), self.shifted)
            for c in range(rows.channels)
            if column in rows.acting[c]
        ]
        steps, errors = (np.array([pair[i][which] for pair in alone]) for i in (0, 1))
        return steps, errors

    def _whitened(self, shift: np.ndarray) -> tuple[Rows, Rows]:
        """Rows at some shifts, and what noise that is added once more makes of them."""
        rows, again = (self._rows(linear, shift, noisy) for linear, noisy in ((self.linear, False), (self.noisy, True)))
        return rows.whitened(self.whitening), rows.less(again).whitened(self.whitening)

    def _solved(self, normal: Normal, asked: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
        """The step (4,) and its errors that normal equations tell, noise taken off, where these shifts are asked."""
        first = len(self.linear.columns)
        at = [*range(first), *(first + [*self.shifted, FORCES].index(which) for which in asked)]
        gram = normal.total[np.ix_(at, at)] + np.diag(_precision(self.linear, len(at)))
        scale = equilibrium(np.diag(gram))
        inverse = np.linalg.inv(gram * np.outer(scale, scale) + 1e-9 * np.eye(len(gram))) * np.outer(scale, scale)
        beta = inverse @ normal.total[at, -1]
        scores = normal.scores(at, beta)
        scores -= scores.mean(0)
        spread = inverse @ (scores.T @ scores) @ inverse
        variance = np.maximum(np.diag(spread), np.diag(inverse))
        error = np.sqrt(np.where(variance > 0, variance, np.inf))  # what rows tell beyond noise may be nothing
        step, spread_of = np.zeros(4), np.zeros(4)
        step[asked], spread_of[asked] = np.where(np.isfinite(error), beta, 0.0)[first:], error[first:]
        return step, spread_of

    def _clear(self, rows: Rows, drawn: Rows) -> list[int]:
        """Channels of which some shift makes more than noise does; all, where there is none.

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

        def at(inputs: float) -> np.ndarray:
            """Rates (L, N − 1, channels) where inputs are read so many samples later, in forces as they act."""
            out = self._rates(linear, inputs, noisy)
            if shift[FORCES]:
                out[..., moving] = self._rates(linear, inputs + shift[FORCES], noisy)[..., moving]
            return out

        moving = self.late.get(MOTION, [])
        here, later = at(shift[INPUTS]), at(shift[INPUTS] + TIMING.probe)
        rates, moved = filed(here, shift), [filed(later, shift)]
        moved += [filed(here, shift + TIMING.probe * np.eye(len(shift))[which]) for which in self.late]
        if moving:
            moved.append(rates.copy())
            moved[-1][..., moving] = moved[INPUTS][..., moving]
        columns = linear.columns.with_more([(m - rates) / TIMING.probe for m in moved])
        return replace(linear, rates=rates, columns=columns).project(self.tests)

    def _rates(self, linear: Linearization, inputs: float, noisy: bool) -> np.ndarray:
        """Modelled rates (L, N − 1, channels) with the inputs read so many samples later."""
        return mean_rates(self.model, self.read(inputs, noisy)).numpy()[..., list(linear.channels)]


def _precision(linear: Linearization, count: int) -> np.ndarray:
    """1/σ² (``count``,) of every column: as known of constants, wide for effects, none for the shift."""
    out = np.zeros(count)
    out[: len(linear.own)] = Prior.of(linear.own).precision
    for start in linear.starts:
        for column, entry in zip(start.columns[len(start.columns) - len(start.entries) :], start.entries, strict=True):
            out[column] = (TIMING.prior * entry.scale) ** -2
    return out
