"""Fit a model with unmeasured states by multi-step shooting: every window begins where it must to be met best.

Many starting points and many subsets of windows are fitted in one batch of free runs (Levenberg–Marquardt with
one-sided differences; the windows' beginnings are eliminated from the normal equations).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from bench.diagnose.logs.subject import Log, LogBatch, Subject
from bench.diagnose.regression.driving import memories
from bench.diagnose.regression.least_squares import bounded, equilibrium
from bench.diagnose.regression.parameters import Entry, Prior, entries, with_values
from bench.diagnose.settings import SIMULATING
from bench.diagnose.simulate.roll import roll
from bench.diagnose.simulate.unmeasured import completed, hidden
from registry.dynamics import PhysicsModel


@dataclass(frozen=True, eq=False)
class Windows:
    """Stretches of recordings that are simulated each from a beginning of its own."""

    logs: tuple[Log, ...]
    inputs: Tensor
    """(W, T + 1, m)."""
    states: Tensor
    """(W, T + 1, s) as measured."""
    log: np.ndarray
    """(W,) of which recording."""
    first: np.ndarray
    """(W,) sample at which a window begins."""

    @classmethod
    def of(cls, logs: Sequence[Log]) -> "Windows":
        """Windows one after the other over every recording."""
        whole = sum(map(len, logs))
        length = min(SIMULATING.window, max(1, whole // SIMULATING.windows), *(len(log) - 1 for log in logs))
        places = [(i, k) for i, log in enumerate(logs) for k in range(0, len(log) - length, length)]
        places = [(i, k) for i, k in places if logs[i].valid[k : k + length + 1].all()]
        pieces = [slice(k, k + length + 1) for _, k in places]
        inputs = torch.stack([logs[i].inputs[p] for (i, _), p in zip(places, pieces, strict=True)])
        states = torch.stack([logs[i].states[p] for (i, _), p in zip(places, pieces, strict=True)])
        return cls(tuple(logs), inputs, states, *(np.array(x) for x in zip(*places, strict=True)))

    def shortened(self, samples: int) -> "Windows":
        """Only the first ``samples`` steps of each."""
        return replace(self, inputs=self.inputs[:, : samples + 1], states=self.states[:, : samples + 1])


@dataclass(frozen=True, eq=False)
class StartingPoint:
    """What a fit goes out from."""

    model: PhysicsModel
    begun: np.ndarray
    """(W, H): the unmeasured states at the beginnings of the windows."""


@dataclass(frozen=True, eq=False)
class Simulated(StartingPoint):
    """A model fitted to windows."""

    where: tuple[Entry, ...]
    """With the values fitted."""
    loss: np.ndarray
    """(W,) sum of squared errors of each window."""
    errors: np.ndarray
    """(W, T, seen)."""
    gram: np.ndarray
    """(P, P): JᵀJ of the numbers, with beginnings eliminated."""


def starts(windows: Windows, models: Sequence[PhysicsModel]) -> list[StartingPoint]:
    """Models, which differ in numbers only, and the beginnings as they simulate the whole recordings."""
    where = entries(models[0], {})
    values = [[e.value for e in entries(m, {})] for m in models]
    path = completed(
        with_values(models[0], where, torch.tensor(values, dtype=torch.float64)), LogBatch.of(windows.logs)
    )
    begun = path[..., windows.log, windows.first, :][..., list(hidden(windows.logs))].expand(len(models), -1, -1)
    return [StartingPoint(m, b) for m, b in zip(models, begun.numpy(), strict=True)]


def fit(
    subject: Subject,
    windows: Windows,
    begins: Sequence[StartingPoint],
    weights: np.ndarray | None = None,
    steps: int | None = None,
) -> list[Simulated]:
    """Fit models, which differ in numbers only, each on its share of the windows.

    Args:
        subject: tells what is known of the constants.
        windows: to fit on.
        begins: starting points.
        weights: (models, W) 1 where a window counts; default: everywhere. Beginnings are always sought.
        steps: at most; default: `SIMULATING.steps`.
    """
    runs = _Runs.of(subject, windows, begins)
    fits = _Fits.at(runs, begins, np.ones((len(begins), len(windows.log))) if weights is None else weights)
    for _ in range(SIMULATING.steps if steps is None else steps):
        fits.judge(*fits.proposed())
        if (fits.patience >= 2).all():
            break
    return fits.results()


@dataclass(frozen=True, eq=False)
class _Runs:
    """Free runs of a model over the windows: errors r(p, b) of its P numbers p and of the beginnings b."""

    model: PhysicsModel
    template: tuple[Entry, ...]
    """Its numbers."""
    first: np.ndarray
    """(Q, P) the numbers of the Q fits at their start."""
    windows: Windows
    past: Tensor
    """(Q, W, k) own states and memories of the effects at the beginnings of the windows."""
    at: tuple[int, ...]
    """H places of the unmeasured states."""
    seen: tuple[int, ...]
    """Places of the measured ones."""
    nudge: np.ndarray
    """(H,) steps of the difference quotients in the beginnings."""

    @classmethod
    def of(cls, subject: Subject, windows: Windows, begins: Sequence[StartingPoint]) -> "_Runs":
        models = [b.model for b in begins]
        where = [entries(m, subject.uncertainty, subject.model) for m in models]
        first = np.array([[e.value for e in w] for w in where])
        past = _past(with_values(models[0], where[0], torch.from_numpy(first)), windows)
        return cls(
            model=models[0],
            template=tuple(where[0]),
            first=first,
            windows=windows,
            past=past.expand(len(models), -1, -1),
            at=tuple(hidden(windows.logs)),
            seen=tuple(i for i, m in enumerate(windows.logs[0].measured) if m),
            nudge=1e-4 * (np.abs(np.stack([b.begun for b in begins])).mean((0, 1)) + 1e-2),
        )

    @cached_property
    def ends(self) -> tuple[np.ndarray, np.ndarray]:
        """(P,) lowest and (P,) highest values of the numbers."""
        low, high = (np.array([getattr(e, side) for e in self.template]) for side in ("low", "high"))
        return low, high

    def errors(self, values: np.ndarray, begun: np.ndarray) -> np.ndarray:
        """r: (B, W, T, seen) with numbers (B, P) from beginnings (B, W, H), B a multiple of Q."""
        states, seen = self.windows.states, list(self.seen)
        model = with_values(self.model, self.template, torch.from_numpy(values))
        state = states[:, 0].expand(len(values), -1, -1).clone()
        state[..., list(self.at)] = torch.from_numpy(begun)
        before = self.past.repeat_interleave(len(values) // len(self.past), 0)
        run = roll(model, torch.cat([state, before], dim=-1), self.windows.inputs, self.windows.logs[0].dt)
        found = run[..., 1:, seen] - states[:, 1:, seen]
        far = SIMULATING.far
        out: np.ndarray = np.clip(np.nan_to_num(found.numpy(), nan=far, posinf=far, neginf=-far), -far, far)
        return out

    def slopes(self, values: np.ndarray, begun: np.ndarray, errors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """∂r/∂p (Q, P, W, N) and ∂r/∂b (Q, H, W, N), N = T · seen, by one-sided differences within the bounds.

        Args:
            values: (Q, P).
            begun: (Q, W, H).
            errors: (Q, W, T, seen) there.
        """
        (many, count), size, free = begun.shape[:2], len(self.template), len(self.at)
        step = np.array([e.scale for e in self.template]) * 1e-4
        signs = np.where(values + step <= self.ends[1], step, -step)  # (Q, P)
        probed = np.concatenate(
            [values[:, None] + np.eye(size) * signs[:, None], np.repeat(values[:, None], free, 1)], 1
        )
        starts = np.repeat(begun[:, None], size + free, 1)
        for h in range(free):
            starts[:, size + h, :, h] += self.nudge[h]
        found = self.errors(probed.reshape(-1, size), starts.reshape(-1, count, free))
        found = found.reshape(many, size + free, count, -1) - errors.reshape(many, 1, count, -1)
        return found[:, :size] / signs[:, :, None, None], found[:, size:] / self.nudge[None, :, None, None]


@dataclass(frozen=True, eq=False)
class _Normal:
    """Normal equations of one fit with the beginnings eliminated (variable projection, window by window).

    With J = ∂r/∂p and B = ∂r/∂b, the beginnings that meet numbers p + δ best move by −K (r + J δ), where
    K = (BᵀB + λ)⁻¹ Bᵀ; what is left is least where JᵀMJ δ = −JᵀM r, with M = 1 − B K.
    """

    jacobian: np.ndarray
    """J: (W, N, P)."""
    begin: np.ndarray
    """B: (W, N, H)."""
    residual: np.ndarray
    """r: (W, N, 1)."""
    onto: np.ndarray
    """K: (W, H, N)."""
    gram: np.ndarray
    """JᵀMJ: (P, P), over the windows that count."""
    moment: np.ndarray
    """−JᵀM r: (P,), over the same."""

    @classmethod
    def of(
        cls, numbers: np.ndarray, beginnings: np.ndarray, errors: np.ndarray, weights: np.ndarray, damping: float
    ) -> "_Normal":
        """Of slopes (P, W, N) and (H, W, N), errors (W, T, seen), weights (W,) and λ as a share of mean BᵀB."""
        jacobian, begin = numbers.transpose(1, 2, 0), beginnings.transpose(1, 2, 0)  # (W, N, P), (W, N, H)
        residual = errors.reshape(len(errors), -1, 1)
        inner = begin.transpose(0, 2, 1) @ begin
        inner = inner + np.eye(len(beginnings)) * (damping * np.diagonal(inner, axis1=1, axis2=2).mean() + 1e-9)
        onto = np.linalg.solve(inner, begin.transpose(0, 2, 1))  # (W, H, N)
        left = residual - begin @ (onto @ residual)
        slope = jacobian - begin @ (onto @ jacobian)
        w = weights[:, None, None]
        gram = (w * (jacobian.transpose(0, 2, 1) @ slope)).sum(0)
        moment = -(w * (jacobian.transpose(0, 2, 1) @ left)).sum(0)[:, 0]
        return cls(jacobian, begin, residual, onto, gram, moment)

    def step(self, prior: Prior, power: float, damping: float) -> np.ndarray:
        """δ (P,) within the bounds of ``prior``: (JᵀMJ + σ² Λ + λ diag JᵀMJ) δ = −JᵀM r + σ² Λ (centre).

        Args:
            prior: Λ, its precision, and its centre.
            power: σ², the variance of one observation.
            damping: λ of Levenberg and Marquardt.
        """
        gram = self.gram + np.diag(prior.precision * power) + np.diag(np.diag(self.gram)) * damping
        moment = self.moment + prior.precision * power * prior.centre
        factor = equilibrium(np.diag(gram))
        scaled = gram * np.outer(factor, factor) + 1e-9 * np.eye(len(factor))
        return np.asarray(bounded(scaled, moment * factor, prior.low / factor, prior.high / factor) * factor)

    def beginnings(self, step: np.ndarray) -> np.ndarray:
        """K (r + J δ): (W, H), by how much the beginnings fall at a step δ (P,) of the numbers."""
        return np.asarray((self.onto @ (self.residual + self.jacobian @ step[:, None]))[..., 0])

    def promised(self, step: np.ndarray) -> np.ndarray:
        """(W,) sums of squared errors after a step δ (P,), as far as r is linear."""
        left = self.residual + self.jacobian @ step[:, None]
        return np.asarray(((left - self.begin @ (self.onto @ left)) ** 2).sum((1, 2)))


@dataclass(eq=False)
class _Fits:
    """Where Q fits stand."""

    runs: _Runs
    weights: np.ndarray
    """(Q, W)."""
    values: np.ndarray
    """(Q, P)."""
    begun: np.ndarray
    """(Q, W, H)."""
    errors: np.ndarray
    """(Q, W, T, seen)."""
    cost: np.ndarray
    """(Q,) weighted sum of squared errors."""
    grams: np.ndarray
    """(Q, P, P)."""
    damping: np.ndarray
    """(Q,) of Levenberg and Marquardt."""
    patience: np.ndarray
    """(Q,) steps in a row that gained nothing much, or promised no more; one that went too far tells nothing."""

    @classmethod
    def at(cls, runs: _Runs, begins: Sequence[StartingPoint], weights: np.ndarray) -> "_Fits":
        values, begun = runs.first.copy(), np.stack([b.begun for b in begins])
        errors, (many, size) = runs.errors(values, begun), values.shape
        return cls(
            runs=runs,
            weights=weights,
            values=values,
            begun=begun,
            errors=errors,
            cost=np.asarray((weights * _loss(errors)).sum(1)),
            grams=np.zeros((many, size, size)),
            damping=np.full(many, 1e-3),
            patience=np.zeros(many, dtype=int),
        )

    def proposed(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Numbers (Q, P) and beginnings (Q, W, H) after a step of every fit, and the cost (Q,) that it promises."""
        numbers, beginnings = self.runs.slopes(self.values, self.begun, self.errors)
        values, begun, promised = self.values.copy(), self.begun.copy(), self.cost.copy()
        for q in range(len(values)):
            normal = _Normal.of(numbers[q], beginnings[q], self.errors[q], self.weights[q], self.damping[q])
            self.grams[q] = normal.gram
            # One window is worth about one independent observation for every time the level turns; 1σ of what is
            # left weighs what is known of the constants.
            power = self.cost[q] / max(1.0, self.weights[q].sum())
            step = normal.step(Prior.of(self.runs.template, self.values[q]), power, self.damping[q])
            values[q] = np.clip(self.values[q] + step, *self.runs.ends)
            begun[q] = self.begun[q] - normal.beginnings(step)
            promised[q] = self.weights[q] @ normal.promised(step)
        return values, begun, promised

    def judge(self, values: np.ndarray, begun: np.ndarray, promised: np.ndarray) -> None:
        """Go to numbers (Q, P) and beginnings (Q, W, H) where they are better; else damp the next step more."""
        tried = self.runs.errors(values, begun)
        now = (self.weights * _loss(tried)).sum(1)
        better = now < self.cost
        hoped = 1 - np.where(better, now, promised) / np.maximum(self.cost, 1e-300)
        self.values[better], self.begun[better], self.errors[better] = values[better], begun[better], tried[better]
        self.cost = np.where(better, now, self.cost)
        self.damping = np.clip(np.where(better, self.damping / 5, self.damping * 8), 1e-9, 1e6)
        idle = hoped <= SIMULATING.enough
        self.patience = np.where(idle, self.patience + 1, np.where(better, 0, self.patience))

    def results(self) -> list[Simulated]:
        """Model by model."""
        out, template = [], self.runs.template
        for q, values in enumerate(self.values):
            where = tuple(replace(e, value=float(v)) for e, v in zip(template, values, strict=True))
            out.append(
                Simulated(
                    model=with_values(self.runs.model, template, values),
                    begun=self.begun[q],
                    where=where,
                    loss=_loss(self.errors[q][None])[0],
                    errors=self.errors[q],
                    gram=self.grams[q],
                )
            )
        return out


def _loss(errors: np.ndarray) -> np.ndarray:
    """(B, W) sums of squared errors (B, W, T, seen)."""
    return np.asarray((errors**2).sum((2, 3)))


def _past(model: PhysicsModel, windows: Windows) -> Tensor:
    """Own states (zero) and memories (…, W, k) of the effects at the beginnings, as the inputs until then left them."""
    own = windows.states.new_zeros(len(windows.log), model.internal_size)
    if not model.input_effects():
        return own
    found = memories(model, LogBatch.of(windows.logs))[..., windows.log, windows.first, :]
    return torch.cat([own.expand(*found.shape[:-1], -1), found], dim=-1)
