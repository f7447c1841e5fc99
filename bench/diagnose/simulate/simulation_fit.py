"""Fit a model with unmeasured states by multi-step shooting: every window begins where it must to be met best.

Many starting points and many subsets of windows are fitted in one batch of free runs (Levenberg–Marquardt with
one-sided differences; the windows' beginnings are eliminated from the normal equations).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from bench.diagnose.logs.subject import Log, Subject
from bench.diagnose.regression.least_squares import bounded, equilibrium
from bench.diagnose.regression.parameters import Entry, Prior, entries, with_values
from bench.diagnose.regression.weak import Stack, memories, narrowed
from bench.diagnose.simulate.unmeasured import completed, hidden
from registry.dynamics import PhysicsModel

WINDOW = 128
"""Samples of a window."""
STEPS = 16
"""Levenberg–Marquardt steps at most."""
ENOUGH = 2e-3
"""Relative fall of the cost below which a fit is finished."""
FAR = 1e3
"""An error, in units of what is measured, that stands for a free run that diverged."""


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
        length = min(WINDOW, *(len(log) - 1 for log in logs))
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
class Start:
    """What a fit goes out from."""

    model: PhysicsModel
    begun: np.ndarray
    """(W, H): the unmeasured states at the beginnings of the windows."""


@dataclass(frozen=True, eq=False)
class Simulated(Start):
    """A model fitted to windows."""

    where: tuple[Entry, ...]
    """With the values fitted."""
    loss: np.ndarray
    """(W,) sum of squared errors of each window."""
    errors: np.ndarray
    """(W, T, seen)."""
    gram: np.ndarray
    """(P, P): JᵀJ of the numbers, with beginnings eliminated."""


def starts(windows: Windows, models: Sequence[PhysicsModel]) -> list[Start]:
    """Models, which differ in numbers only, and the beginnings as they simulate the whole recordings."""
    where = entries(models[0], {})
    values = [[e.value for e in entries(m, {})] for m in models]
    path = completed(with_values(models[0], where, torch.tensor(values, dtype=torch.float64)), Stack.of(windows.logs))
    begun = path[..., windows.log, windows.first, :][..., list(hidden(windows.logs))].expand(len(models), -1, -1)
    return [Start(m, b) for m, b in zip(models, begun.numpy(), strict=True)]


def fit(
    subject: Subject,
    windows: Windows,
    begins: Sequence[Start],
    weights: np.ndarray | None = None,
    steps: int = STEPS,
) -> list[Simulated]:
    """Fit models, which differ in numbers only, each on its share of the windows.

    Args:
        subject: tells what is known of the constants.
        windows: to fit on.
        begins: starting points.
        weights: (models, W) 1 where a window counts; default: everywhere. Beginnings are always sought.
        steps: at most.
    """
    models = [b.model for b in begins]
    where = [entries(m, subject.uncertainty, subject.model) for m in models]
    weights = np.ones((len(models), len(windows.log))) if weights is None else weights
    template, size = where[0], len(where[0])
    at, seen = hidden(windows.logs), [i for i, m in enumerate(windows.logs[0].measured) if m]
    values = np.array([[e.value for e in w] for w in where])
    begun = np.stack([b.begun for b in begins])  # (Q, W, H)
    past = _past(with_values(models[0], template, torch.from_numpy(values)), windows).expand(len(models), -1, -1)
    low, high = (np.array([getattr(e, side) for e in template]) for side in ("low", "high"))
    step_of = np.array([e.scale for e in template]) * 1e-4
    nudge = 1e-4 * (np.abs(begun).mean((0, 1)) + 1e-2)

    def run(of: np.ndarray, starts: np.ndarray) -> np.ndarray:
        """Errors (B, W, T, seen) with numbers (B, P) from beginnings (B, W, H)."""
        model = with_values(models[0], template, torch.from_numpy(of))
        state = windows.states[:, 0].expand(len(of), -1, -1).clone()
        state[..., list(at)] = torch.from_numpy(starts)
        before = past.repeat_interleave(len(of) // len(models), 0)
        found = _run(model, torch.cat([state, before], dim=-1), windows)[..., 1:, seen] - windows.states[:, 1:, seen]
        out: np.ndarray = np.clip(np.nan_to_num(found.numpy(), nan=FAR, posinf=FAR, neginf=-FAR), -FAR, FAR)
        return out

    def loss(errors: np.ndarray) -> np.ndarray:
        return np.asarray((errors**2).sum((2, 3)))

    many, count = len(models), len(windows.log)
    errors = run(values, begun)
    damping = np.full(many, 1e-3)
    cost = np.asarray((weights * loss(errors)).sum(1))
    grams = np.zeros((many, size, size))
    patience = np.zeros(many, dtype=int)
    for _ in range(steps):
        signs = np.where(values + step_of <= high, step_of, -step_of)  # (Q, P)
        probed = np.concatenate(
            [values[:, None] + np.eye(size) * signs[:, None], np.repeat(values[:, None], len(at), 1)], 1
        )
        starts = np.repeat(begun[:, None], size + len(at), 1)
        for h in range(len(at)):
            starts[:, size + h, :, h] += nudge[h]
        found = run(probed.reshape(-1, size), starts.reshape(-1, count, len(at)))
        found = found.reshape(many, size + len(at), count, -1) - errors.reshape(many, 1, count, -1)
        slopes = found[:, :size] / signs[:, :, None, None]
        own = found[:, size:] / nudge[None, :, None, None]
        new_values, new_begun = values.copy(), begun.copy()
        for q in range(many):
            jacobian, begin = slopes[q].transpose(1, 2, 0), own[q].transpose(1, 2, 0)  # (W, N, P), (W, N, H)
            residual = errors[q].reshape(count, -1, 1)
            inner = begin.transpose(0, 2, 1) @ begin
            inner = inner + np.eye(len(at)) * (damping[q] * np.diagonal(inner, axis1=1, axis2=2).mean() + 1e-9)
            onto = np.linalg.solve(inner, begin.transpose(0, 2, 1))  # (W, H, N)
            left = residual - begin @ (onto @ residual)
            slope = jacobian - begin @ (onto @ jacobian)
            w = weights[q][:, None, None]
            gram = (w * (jacobian.transpose(0, 2, 1) @ slope)).sum(0)
            moment = -(w * (jacobian.transpose(0, 2, 1) @ left)).sum(0)[:, 0]
            # One window is worth about one independent observation for every time the level turns; 1σ of what is
            # left weighs what is known of the constants.
            power = cost[q] / max(1.0, weights[q].sum())
            grams[q] = gram
            prior = Prior.of(template, values[q])
            gram = gram + np.diag(prior.precision * power) + np.diag(np.diag(gram)) * damping[q]
            moment = moment + prior.precision * power * prior.centre
            factor = equilibrium(np.diag(gram))
            scaled = gram * np.outer(factor, factor) + 1e-9 * np.eye(size)
            step = bounded(scaled, moment * factor, prior.low / factor, prior.high / factor) * factor
            new_values[q] = np.clip(values[q] + step, low, high)
            new_begun[q] = begun[q] - (onto @ (residual + jacobian @ step[:, None]))[..., 0]
        tried = run(new_values, new_begun)
        now = (weights * loss(tried)).sum(1)
        better = now < cost
        gained = np.where(better, 1 - now / np.maximum(cost, 1e-300), 0.0)
        values[better], begun[better], errors[better] = new_values[better], new_begun[better], tried[better]
        cost = np.where(better, now, cost)
        damping = np.clip(np.where(better, damping / 5, damping * 8), 1e-9, 1e6)
        patience = np.where(gained > ENOUGH, 0, patience + 1)
        if (patience >= 2).all():
            break
    out = []
    for q in range(many):
        model = with_values(models[0], template, values[q])
        fitted = tuple(replace(e, value=float(v)) for e, v in zip(template, values[q], strict=True))
        out.append(Simulated(model, begun[q], fitted, loss(errors[q][None])[0], errors[q], grams[q]))
    return out


def _past(model: PhysicsModel, windows: Windows) -> Tensor:
    """Own states (zero) and memories (…, W, k) of the effects at the beginnings, as the inputs until then left them."""
    own = windows.states.new_zeros(len(windows.log), model.internal_size)
    if not model.input_effects():
        return own
    found = memories(model, Stack.of(windows.logs))[..., windows.log, windows.first, :]
    return torch.cat([own.expand(*found.shape[:-1], -1), found], dim=-1)


def _run(model: PhysicsModel, state: Tensor, windows: Windows) -> Tensor:
    """States (B, W, T + 1, s) of free runs from full states (B, W, full)."""
    size, narrow, dt = windows.states.shape[-1], narrowed(model), windows.logs[0].dt
    inputs, out = windows.inputs.expand(*state.shape[:-1], *windows.inputs.shape[-2:]), [state[..., :size]]
    for k in range(inputs.shape[-2] - 1):
        state = narrow.step(state, inputs[..., k, :], inputs[..., k + 1, :], dt)
        out.append(state[..., :size])
    return torch.stack(out, dim=-2)
