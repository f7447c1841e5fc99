"""What matters: what an effect saves on recordings that were not fitted, against all that could be saved there.

An effect may be significant and not worth a term. Each equation is judged by itself (`simulate.teacher_forced`), at a
short and at a long horizon. What can be explained at all is what the best predictor leaves: the extended model, helped
by a ridge regression of what it leaves on functions of every measured signal.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bench.diagnose.logs.noise import Noise
from bench.diagnose.logs.subject import Subject
from bench.diagnose.regression.generic import dictionary, follow
from bench.diagnose.regression.least_squares import ridge
from bench.diagnose.regression.weak import Stack
from bench.diagnose.select.verify import Trace
from bench.diagnose.simulate.teacher_forced import (
    Equation,
    Increments,
    equations,
    horizons,
    increments,
    noise_increments,
)
from registry.dynamics import PhysicsModel

SHARE = 0.05
"""Of the squared error that can be explained: what an effect must save to be named, in some equation."""
NEAR = 1.05
"""Error, relative to the best that can be reached, up to which nothing is worth a term."""
CLOSE = 1.5
"""Error, relative to the best that can be reached, up to which the effects of an equation are what they seem."""
SURE = 2.0
"""Standard errors over blocks of held-out recordings of a 95 % interval over blocks of held-out recordings."""
BLOCK = 4.0
"""Longest of these blocks [s]."""
BLOCKS = 8
"""Blocks at least, where recordings are long enough for that many horizons."""
TERMS = 8
"""Columns at most that are taken one by one."""
SHRINKAGE = np.logspace(-4, 2, 13)
"""Ridge penalties, relative to the mean eigenvalue, of which one is chosen on recordings left out."""


@dataclass(frozen=True)
class EquationError:
    """Root mean square errors of one equation at one horizon on held-out recordings, SI."""

    equation: str
    horizon_s: float
    unit: str
    models: dict[str, float]
    """By model."""
    predictable: float
    """What the last model leaves with the help of a regression on all measured signals."""
    floor: float
    """What measurement noise alone leaves."""

    @property
    def explainable(self) -> float:
        """Squared error of the calibrated model that could be explained."""
        return max(self.models["calibrated"] ** 2 - self._best**2, 0.0)

    @property
    def scale(self) -> float:
        """Squared error that shares are told of: what can be explained, but no less than what would matter."""
        return max(self.explainable, (NEAR**2 - 1) * self._best**2, 1e-300)

    @property
    def matters(self) -> bool:
        """Whether enough can be explained that anything is worth a term."""
        return self.models["calibrated"] > NEAR * self._best

    @property
    def _best(self) -> float:
        return min(self.models["extended"], self.predictable)

    @property
    def near_best(self) -> bool:
        """Whether no function of the measured signals predicts much better than the extended model."""
        return self.models["extended"] <= CLOSE * self.predictable and self.matters

    @property
    def unexplained(self) -> float:
        """Share of what can be explained that the extended model leaves, 0 to 1; 0 where it is near the best."""
        if self.models["extended"] <= NEAR * self.predictable:
            return 0.0
        left = self.models["extended"] ** 2 - self.predictable**2
        return left / max(self.models["calibrated"] ** 2 - self.predictable**2, left)


@dataclass(frozen=True)
class Saving:
    """What an effect saves of one equation's squared error on held-out recordings."""

    equation: str
    horizon_s: float
    share: float
    """Of what can be explained there."""
    low: float
    high: float
    """95 % over blocks of recordings."""
    matters: bool
    """Whether enough can be explained in this equation that anything is worth a term."""
    ratio: float = 1.0
    """Error with the effect, relative to that without."""

    @property
    def harms(self) -> bool:
        """Whether the equation is lost by it, for sure: what other equations gain is then not understood."""
        return self.ratio > CLOSE and self.high < 0

    @property
    def worth(self) -> bool:
        """Whether it is large enough, and sure."""
        return self.matters and self.share >= SHARE and self.low > 0


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
        self.held = Stack.of(subject.of(subject.held_out))
        self.horizons = horizons(self.held.logs)
        self.equations = equations(subject.model, Stack.of(subject.logs).measured)
        self._left: dict[PhysicsModel, Increments] = {}
        self._squares: dict[tuple[Increments, str, int], tuple[np.ndarray, np.ndarray]] = {}
        self._errors: dict[PhysicsModel, tuple[EquationError, ...]] = {}

    def increments(self, model: PhysicsModel) -> Increments:
        """What a model leaves of the held-out recordings."""
        if model not in self._left:
            self._left[model] = increments(model, self.held, self.noise)
        return self._left[model]

    def squares(self, left: Increments, equation: Equation, horizon: int) -> tuple[np.ndarray, np.ndarray]:
        """Squared errors (W,) and the block (W,) that each window is in."""
        key = (left, equation.name, horizon)
        if key not in self._squares:
            self._squares[key] = self._squared(left, equation, horizon)
        return self._squares[key]

    def _squared(self, left: Increments, equation: Equation, horizon: int) -> tuple[np.ndarray, np.ndarray]:
        errors, recording, first = left.over(horizon, max(1, horizon // 4))
        squared = (errors[:, list(equation.group.at)] ** 2).sum(1)
        if equation.sensed:
            squared = squared / (horizon * self.held.dt) ** 2
        whole = sum(map(len, self.held.logs))
        length = max(horizon, min(round(BLOCK / self.held.dt), whole // BLOCKS))
        block = np.unique(np.stack([recording, first // length]), axis=1, return_inverse=True)[1]
        return squared, block

    def errors(self, extended: PhysicsModel) -> tuple[EquationError, ...]:
        """Errors of every equation at every horizon, of the nominal, the calibrated and the extended model."""
        if extended in self._errors:
            return self._errors[extended]
        models = {"nominal": self.subject.model, "calibrated": self.calibrated, "extended": extended}
        shares = self._unpredictable(extended)
        out = []
        for equation in self.equations:
            for horizon in self.horizons:
                mean = {
                    name: float(self.squares(self.increments(model), equation, horizon)[0].mean())
                    for name, model in models.items()
                }
                chance = float(self.squares(self.chance, equation, horizon)[0].mean())
                out.append(
                    EquationError(
                        equation.name,
                        horizon * self.held.dt,
                        equation.group.unit,
                        {name: value**0.5 for name, value in mean.items()},
                        (mean["extended"] * shares[equation.name, horizon]) ** 0.5,
                        chance**0.5,
                    )
                )
        self._errors[extended] = tuple(out)
        return self._errors[extended]

    @cached_property
    def chance(self) -> Increments:
        """What noise alone leaves of the held-out recordings."""
        return noise_increments(self.calibrated, self.held, self.noise)

    def savings(self, without: PhysicsModel, full: PhysicsModel, errors: Sequence[EquationError]) -> tuple[Saving, ...]:
        """What ``full`` saves of the error of ``without``, of each of ``errors``.

        Without an effect nothing is worse than the calibrated model, which has none: where ``without`` is, because the
        rest was fitted beside the effect, the calibrated model stands for it.
        """
        out = []
        by_name = {e.name: e for e in self.equations}
        for error in errors:
            equation, horizon = by_name[error.equation], round(error.horizon_s / self.held.dt)
            others = (self.squares(self.increments(m), equation, horizon) for m in (without, self.calibrated))
            before, block = min(others, key=lambda found: float(found[0].mean()))
            after, _ = self.squares(self.increments(full), equation, horizon)
            gains = np.bincount(block, before - after) / np.maximum(np.bincount(block), 1)
            mean = float(gains.mean())
            spread = float(gains.std(ddof=1)) / len(gains) ** 0.5 if len(gains) > 1 else np.inf
            low, high = ((mean + side * SURE * spread) / error.scale for side in (-1, 1))
            ratio = float(after.mean() / max(before.mean(), 1e-300)) ** 0.5
            out.append(Saving(error.equation, error.horizon_s, mean / error.scale, low, high, error.matters, ratio))
        return tuple(out)

    def _unpredictable(self, model: PhysicsModel) -> dict[tuple[str, int], float]:
        """By equation and horizon: share of what a model leaves that no function of the signals explains, 0 to 1."""
        train = Stack.of(self.subject.of(self.subject.training))
        parts = [(stack, increments(model, stack, self.noise)) for stack in (train, self.held)]
        out = {}
        for equation in self.equations:
            of = [_projected(model, stack, left, equation) for stack, left in parts]
            for horizon in self.horizons:
                (x, y, fold), (held_x, held_y, _) = (p.windows(horizon) for p in of)
                out[equation.name, horizon] = _share_left(x, y, fold, held_x, held_y)
        return out


@dataclass(frozen=True, eq=False)
class _Projected:
    """What an equation leaves along the axes of the dictionary, and the functions that may explain it."""

    left: Increments
    functions: np.ndarray
    """(functions, L, N − 1)."""
    dt: float

    def windows(self, horizon: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Integrals (W, functions) and errors (W, axes) over windows, and the recording (W,) of each."""
        every = max(1, horizon // 2)
        y, recording, first = self.left.over(horizon, every)
        total = np.concatenate([np.zeros_like(self.functions[..., :1]), np.cumsum(self.functions, axis=-1)], axis=-1)
        x = total[:, recording, first + horizon] - total[:, recording, first]
        return x.T * self.dt, y, recording


def _projected(model: PhysicsModel, stack: Stack, left: Increments, equation: Equation) -> _Projected:
    at = equation.group.at
    words = dictionary(model, stack, at)
    along = [np.einsum("lnc,lnc->ln", axis, left.steps[..., list(at)]) for axis in words.axes if np.abs(axis).max() > 0]
    return _Projected(Increments(np.stack(along, axis=-1), left.valid), words.values, stack.dt)


def _share_left(x: np.ndarray, y: np.ndarray, fold: np.ndarray, held_x: np.ndarray, held_y: np.ndarray) -> float:
    """Share of the held-out squares of ``y`` (W, axes) that a regression on ``x`` (W, f) leaves, at most 1.

    For each axis the better one, with one recording left out after another, of ridge regression and of a few columns
    taken one by one.
    """
    size = np.sqrt((x**2).mean(0))
    x, held_x = (z[:, size > 0] / size[size > 0] for z in (x, held_x))
    left = total = 0.0
    for own, held in zip(y.T, held_y.T, strict=True):
        rows = np.column_stack([x, own])
        grams = [rows[fold == f].T @ rows[fold == f] for f in np.unique(fold)]
        whole = np.asarray(sum(grams))
        losses = {0.0: float((own**2).sum())}
        losses |= {float(s): _ridge_loss(grams, whole, s) for s in SHRINKAGE}
        penalty = min(losses, key=lambda s: losses[s])
        beta = np.zeros(x.shape[1])
        if penalty:
            inner = whole[:-1, :-1]
            beta = np.linalg.solve(inner + penalty * np.trace(inner) / len(inner) * np.eye(len(inner)), whole[:-1, -1])
        chosen = follow(grams, [], 0, TERMS)
        if chosen and losses[0.0] - sum(gain for _, gain in chosen) < losses[penalty]:
            index = [column for column, _ in chosen]
            beta = np.zeros(x.shape[1])
            beta[index] = ridge(whole[np.ix_([*index, -1], [*index, -1])], 1e-9)
        rest = float(((held - held_x @ beta) ** 2).sum())
        left, total = left + min(rest, float((held**2).sum())), total + float((held**2).sum())
    return left / max(total, 1e-300)


def _ridge_loss(grams: Sequence[np.ndarray], whole: np.ndarray, shrinkage: float) -> float:
    """Squares of the last column that the others leave, each part by a fit to the rest."""
    loss = 0.0
    for gram in grams:
        rest = (whole - gram)[:-1, :-1]
        strength = max(shrinkage * np.trace(rest) / len(rest), 1e-300)
        beta = np.linalg.solve(rest + strength * np.eye(len(rest)), (whole - gram)[:-1, -1])
        vector = np.append(-beta, 1.0)
        loss += float(vector @ gram @ vector)
    return loss


def trifle(name: str, savings: Sequence[Saving]) -> str:
    """A remark on an effect that is not worth a term."""
    best = max(savings, key=lambda s: (s.matters, s.share))
    if not best.matters:
        return f"A trace of {name.replace('_', ' ')} shows where hardly anything can be explained: not worth a term."
    low, share, high = (f"{100 * x:.0f}".replace("-", "−") for x in (best.low, best.share, best.high))
    return (
        f"A trace of {name.replace('_', ' ')} shows; it saves {share} % ({low} to {high}) of what can be explained in "
        f"{best.equation} on held-out recordings: not worth a term, or not for sure."
    )


def contradiction(name: str) -> str:
    """A remark on an effect that held-out recordings contradict."""
    return (
        f"{name.replace('_', ' ')} explains the recordings that were learnt from and makes the held-out ones worse: "
        "recordings differ, and it is not named."
    )


def faint_traces(traces: Sequence[Trace]) -> str:
    """A remark on what is left, significant and not worth a term."""
    signals = dict.fromkeys(t.signal.replace("_", " ") for t in traces[:2])
    return (
        f"A trace that follows {' and '.join(signals)} is left; less than {100 * SHARE:.0f} % of what can be explained "
        "goes with it on held-out recordings: not worth a term."
    )
