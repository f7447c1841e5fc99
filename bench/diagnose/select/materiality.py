"""What matters: what an effect saves on recordings that were not fitted, against all that could be saved there.

An effect may be significant and not worth a term. Each equation is judged by itself (`simulate.teacher_forced`), at a
short and at a long horizon, and along each axis of the body: yaw makes little of the error of all torques, and is what
some effects are about. What can be explained at all is what the best predictor leaves: the extended model, helped
by a ridge regression of what it leaves on functions of every measured signal.
"""

from collections.abc import Collection
from dataclasses import replace
from functools import cached_property

import numpy as np

from bench.analysis.stats import rare_gain, relative_gain, uneven_gain
from bench.diagnose.logs.noise import Noise
from bench.diagnose.logs.sample import shortened
from bench.diagnose.logs.subject import LogBatch, Subject, measured
from bench.diagnose.regression.columns import moves
from bench.diagnose.regression.generic import dictionary
from bench.diagnose.regression.weak import midpoint_rates
from bench.diagnose.settings import MATTERING
from bench.diagnose.simulate.equation_error import EquationError, Saving
from bench.diagnose.simulate.offsets import attitude_offsets, less_offsets
from bench.diagnose.simulate.predictable import Signals, left_of
from bench.diagnose.simulate.teacher_forced import (
    Equation,
    Increments,
    equations,
    horizons,
    increments,
    noise_increments,
)
from registry.dynamics import PhysicsModel


class Weighing:
    """The held-out recordings, equation by equation."""

    def __init__(self, subject: Subject, noise: Noise, calibrated: PhysicsModel) -> None:
        """Prepare.

        Args:
            subject: measurements and the nominal model; inputs are read when they act.
            noise: of the measurements.
            calibrated: the model without the effects to be weighed, its constants fitted.
        """
        self.subject, self.noise, self.calibrated = subject, noise, calibrated
        self.held = LogBatch.of(shortened(subject.of(subject.held_out), MATTERING.longest))
        self.horizons = horizons(self.held.logs)
        self.equations = equations(subject.model, measured(subject.logs))
        self._left: dict[PhysicsModel, Increments] = {}
        self._noise: dict[PhysicsModel, Increments] = {}
        self._squares: dict[tuple[Increments, str, str, int], tuple[np.ndarray, np.ndarray]] = {}
        self._errors: dict[PhysicsModel, tuple[EquationError, ...]] = {}

    def bounded(self, model: PhysicsModel) -> "Weighing":
        """The same with the inputs' noise cut to what the errors of ``model`` leave room for.

        Inputs that move as fast as they are sampled look noisier than they are: a controller answers its own noisy
        sensors, and the system follows. What noise alone would leave is no more than what a model does leave, in each
        equation and over each horizon that noise of the inputs makes more of than that of the states.
        """
        if self.noise.inputs_stated or not any(self.noise.inputs):
            return self
        still = replace(self.noise, inputs=(0.0,) * len(self.noise.inputs))
        parts = self.increments(model), self.chance, noise_increments(self.calibrated, self.held, still)
        shares = [1.0]
        for equation in self.equations:
            for horizon in self.horizons:
                left, every, states = (float(self.squares(x, equation, "", horizon)[0].mean()) for x in parts)
                if every > 2 * states:
                    shares.append((left - states) / (every - states))
        smaller = max(min(shares), 0.0) ** 0.5
        noise = replace(self.noise, inputs=tuple(smaller * sigma for sigma in self.noise.inputs))
        return self if smaller == 1 else Weighing(self.subject, noise, self.calibrated)

    def increments(self, model: PhysicsModel) -> Increments:
        """What a model leaves of the held-out recordings."""
        if model not in self._left:
            self._left[model] = increments(model, self.held, self.noise)
        return self._left[model]

    def squares(self, left: Increments, equation: Equation, axis: str, horizon: int) -> tuple[np.ndarray, np.ndarray]:
        """Squared errors (W,) of an equation along an axis (empty: along all), and the block (W,) of each window."""
        key = (left, equation.name, axis, horizon)
        if key not in self._squares:
            self._squares[key] = self._squared(left, equation, axis, horizon)
        return self._squares[key]

    def _squared(self, left: Increments, equation: Equation, axis: str, horizon: int) -> tuple[np.ndarray, np.ndarray]:
        errors, _, block = self._windows(left, equation, axis, horizon)
        return (errors**2).sum(1), block

    def _windows(
        self, left: Increments, equation: Equation, axis: str, horizon: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Errors (W, c) of an equation along an axis (empty: along all), the recording and the block (W,) of each."""
        at = list(equation.group.at)
        if axis:
            left, at = self._signals[1].of(equation.group.at).along(left, [axis]), [0]
        errors, recording, first = left.over(horizon, max(1, horizon // 4))
        scale = 1 / (horizon * self.held.dt) if equation.sensed else 1.0
        return errors[:, at] * scale, recording, self._blocks(recording, first, horizon)

    def _by_recording(self, error: EquationError, left: Increments) -> tuple[float, ...]:
        """Root mean square error in each recording, less what offsets of that recording explain."""
        equation, horizon = self._place(error)
        signals, every = self._signals[1].of(equation.group.at), max(1, horizon // 4)
        bodily = [a for a in signals.axes if not a.startswith("world")] or list(signals.axes)
        axes = [error.axis] if error.axis else bodily
        errors, *offsets = (signals.along(x, axes).over(horizon, every)[0] for x in (left, *self._offsets))
        return less_offsets(errors, offsets, left.over(horizon, every)[1])

    @cached_property
    def _offsets(self) -> tuple[Increments, ...]:
        return attitude_offsets(self.calibrated, self.held, self.noise)

    def blocks(self, left: Increments, horizon: int) -> np.ndarray:
        """The block (W,) of each window over a horizon."""
        _, recording, first = left.over(horizon, max(1, horizon // 4))
        return self._blocks(recording, first, horizon)

    def _blocks(self, recording: np.ndarray, first: np.ndarray, horizon: int) -> np.ndarray:
        whole = sum(map(len, self.held.logs))
        length = max(horizon, min(round(MATTERING.block * self.held.logs[0].pace), whole // MATTERING.blocks))
        return np.unique(recording * whole + first // length, return_inverse=True)[1]

    def errors(self, extended: PhysicsModel, along_axes: bool = False) -> tuple[EquationError, ...]:
        """Errors of every equation at every horizon, of the nominal, the calibrated and the extended model.

        ``along_axes``: along each axis, not of the equation as a whole.
        """
        own = self.noise_alone(extended)
        return tuple(
            replace(
                e,
                own_floor=float(self._at(e, own)[0].mean()) ** 0.5,
                by_recording=self._by_recording(e, self.increments(extended)),
            )
            for e in self.by_axis(extended)
            if bool(e.axis) is along_axes
        )

    def by_axis(self, extended: PhysicsModel) -> tuple[EquationError, ...]:
        """Errors as in `errors`, without its own floor and recordings, and those along the axes of every equation."""
        if extended in self._errors:
            return self._errors[extended]
        models = {"nominal": self.subject.model, "calibrated": self.calibrated, "extended": extended}
        shares = self._unpredictable(extended)
        out = []
        for (equation, axis, horizon), share in shares.items():
            mean = {
                name: float(self.squares(self.increments(model), equation, axis, horizon)[0].mean())
                for name, model in models.items()
            }
            chance = float(self.squares(self.chance, equation, axis, horizon)[0].mean())
            out.append(
                EquationError(
                    equation.name,
                    horizon * self.held.dt,
                    equation.group.unit,
                    models={name: value**0.5 for name, value in mean.items()},
                    predictable=(mean["extended"] * share) ** 0.5,
                    floor=chance**0.5,
                    axis=axis,
                )
            )
        self._errors[extended] = tuple(out)
        return self._errors[extended]

    @property
    def chance(self) -> Increments:
        """What noise alone leaves of the held-out recordings."""
        return self.noise_alone(self.calibrated)

    def noise_alone(self, model: PhysicsModel) -> Increments:
        """What noise alone leaves of them beside a model, which may let more noise of the inputs in."""
        if model not in self._noise:
            self._noise[model] = noise_increments(model, self.held, self.noise)
        return self._noise[model]

    def savings(
        self,
        without: PhysicsModel,
        full: PhysicsModel,
        extended: PhysicsModel,
        channels: Collection[int] | None = None,
        calibrated: bool = True,
    ) -> tuple[Saving, ...]:
        """What ``full`` saves of the error of ``without``, of each error of `by_axis` of ``extended``.

        Without an effect nothing is worse than the calibrated model, which has none, nor than the one as stated: where
        ``without`` is, because the rest was fitted beside the effect, the better of them stands for it. Where no
        ``calibrated`` model will do, ``without`` is what could be explained. Of an axis only
        what is worth a term, unless other axes pay for it: the equation as a whole may not err more, or, where the
        effect acts along some axes only and constants moved along the others, hardly more.

        Where an effect does not act, that is outside of some ``channels``, only constants moved: that is no harm that
        it does. But constants that are bent without it may speak for it, where nothing else does.
        """
        out: list[Saving] = []
        others = [self.increments(m) for m in (without, self.subject.model, *[self.calibrated] * calibrated)]
        acts = {e.name for e in self.equations if channels is None or not set(channels).isdisjoint(e.group.at)}
        everywhere = {e.name for e in self.equations if channels is None or set(channels).issuperset(e.group.at)}
        for error in self.by_axis(extended):
            best = min(others, key=lambda left: float(self._at(error, left)[0].mean()))
            (before, block), (after, _) = (self._at(error, left) for left in (best, self.increments(full)))
            if not calibrated:
                error = replace(error, models={**error.models, "calibrated": float(before.mean()) ** 0.5})
            gains = np.bincount(block, before - after) / np.maximum(np.bincount(block), 1)
            mean = float(gains.mean())
            spread = float(gains.std(ddof=1)) / len(gains) ** 0.5 if len(gains) > 1 else np.inf
            low, high = ((mean + side * MATTERING.sure * spread) / error.scale for side in (-1, 1))
            if low <= 0 < mean:
                by_block = [np.bincount(block, squares) for squares in (before, after)]
                steady = relative_gain(by_block[0], by_block[1], MATTERING.sure) * float(before.mean())
                low = max(low, uneven_gain(gains) / error.scale, steady / error.scale)
            if low <= 0 < mean:
                low = max(low, self._rare(error, best, self.increments(full)) / error.scale)
            ratio = float(after.mean() / max(before.mean(), 1e-300)) ** 0.5
            share = mean / error.scale
            saving = Saving(
                error.equation, error.horizon_s, share, low, high, matters=error.matters, ratio=ratio, axis=error.axis
            )
            here = (error.equation, error.horizon_s, "")
            whole = next((s for s in out if (s.equation, s.horizon_s, s.axis) == here), saving)
            paid = MATTERING.near if error.equation not in everywhere else 1.0
            if not error.axis or (saving.worth and whole.ratio <= paid):
                out.append(saving)
        there = tuple(s for s in out if s.equation in acts)
        return there if any(s.worth for s in there) else (*there, *(s for s in out if s not in there and s.worth))

    def could_rescue(self, without: PhysicsModel, full: PhysicsModel) -> bool:
        """Whether any of `savings` could be a rescue: asked first, since what can be explained takes long to tell."""
        others = [self.increments(m) for m in (without, self.calibrated, self.subject.model)]
        return any(
            self._at(place, self.increments(full))[0].mean() * MATTERING.lost**2
            < min(self._at(place, left)[0].mean() for left in others)
            for place in self.by_axis(without)
        )

    def _rare(self, place: EquationError, without: Increments, full: Increments) -> float:
        """See `stats.rare_gain`."""
        equation, horizon = self._place(place)
        (before, recording, block), (after, *_) = (
            self._windows(left, equation, place.axis, horizon) for left in (without, full)
        )
        return rare_gain(before, after, recording, block, MATTERING.sure)

    def channels_moved(self, before: PhysicsModel, after: PhysicsModel) -> frozenset[int]:
        """The channels whose rates on the held-out recordings differ between two models, or are no numbers."""
        change = (midpoint_rates(after, self.held) - midpoint_rates(before, self.held)).nan_to_num(nan=np.inf).numpy()
        return frozenset(c for c in range(change.shape[-1]) if moves(change[..., c]))

    def refutes(self, other: PhysicsModel, full: PhysicsModel, extended: PhysicsModel) -> bool:
        """Whether ``full`` surely saves what is worth a term, or an equation that ``other`` loses, not to noise alone.

        A stronger motor passes on more of the noise of its inputs, and is no worse for that.
        """
        worse = [s for s in self.savings(other, full, extended) if s.worth or s.rescues]
        if not worse:
            return False
        errors, chance = self.increments(other), self.noise_alone(other)
        means = ((self._at(s, errors)[0].mean(), self._at(s, chance)[0].mean()) for s in worse)
        return any(level > MATTERING.near**2 * floor for level, floor in means)

    def noisier(self, without: PhysicsModel, full: PhysicsModel) -> bool:
        """Whether ``full`` lets so much more noise of the inputs in that some error would matter for that alone."""
        chances = [self.noise_alone(m) for m in (without, full)]
        means = ([self._at(e, c)[0].mean() for c in chances] for e in self.by_axis(full) if not e.axis)
        return any(after > MATTERING.near**2 * before for before, after in means)

    def _at(self, place: EquationError | Saving, left: Increments) -> tuple[np.ndarray, np.ndarray]:
        """`squares` of the equation, along the axis and over the horizon of an error or a saving."""
        equation, horizon = self._place(place)
        return self.squares(left, equation, place.axis, horizon)

    def _place(self, of: EquationError | Saving) -> tuple[Equation, int]:
        """The equation and the horizon, in samples, of an error or a saving."""
        (equation,) = (e for e in self.equations if e.name == of.equation)
        return equation, round(of.horizon_s / self.held.dt)

    def _unpredictable(self, model: PhysicsModel) -> dict[tuple[Equation, str, int], float]:
        """By equation, axis and horizon: share of what a model leaves that no function of the signals explains.

        The axis is empty for all together.
        """
        left = increments(model, self.train, self.noise), self.increments(model)
        out = {}
        for equation in self.equations:
            signals = [s.of(equation.group.at) for s in self._signals]
            axes = signals[0].axes
            for horizon in self.horizons:
                folds, held = (s.folds(of, horizon) for s, of in zip(signals, left, strict=True))
                rest, total = left_of(folds, np.asarray(sum(held)), len(axes))
                out[equation, "", horizon] = float(rest.sum() / max(total.sum(), 1e-300))
                for axis, some, all_ in zip(axes, rest, total, strict=True):
                    if len(equation.group.at) > 1 and not axis.startswith("world"):
                        out[equation, axis, horizon] = float(some / max(all_, 1e-300))
        return out

    @cached_property
    def train(self) -> LogBatch:
        """The recordings that are learnt from."""
        return LogBatch.of(shortened(self.subject.of(self.subject.training), MATTERING.longest))

    @cached_property
    def _signals(self) -> tuple[Signals, Signals]:
        """Of the recordings that are learnt from and of those held out; the same whatever the model lacks."""
        at = tuple(c for e in self.equations for c in e.group.at)
        learnt = dictionary(self.calibrated, self.train, at)
        held = dictionary(self.calibrated, self.held, at, like=learnt)
        return Signals(learnt, at, self.train.dt), Signals(held, at, self.held.dt)
