"""Multi-step shooting: fit a model's numbers so that its free runs meet the measurement.

Each window starts at the measured state; the residual is the prediction's error along the window. Gauss–Newton with
one-sided differences, all probes and all windows in one batched free run.
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from bench.diagnose.logs.subject import Log, Subject
from bench.diagnose.regression.least_squares import bounded, equilibrium
from bench.diagnose.regression.parameters import Entry, Prior, entries, probes, with_values
from bench.diagnose.settings import SHOOTING
from bench.diagnose.simulate.free_run import (
    Group,
    between,
    clear_starts,
    default_steps,
    errors,
    followed,
    free_run,
    groups,
    measured_windows,
)
from registry.dynamics import PhysicsModel


@dataclass(frozen=True, eq=False)
class Shot:
    """A fit by shooting."""

    model: PhysicsModel
    before: float
    """Mean squared error of the windows over that of the model that was given."""
    after: float
    free: tuple[Entry, ...]
    covariance: np.ndarray
    """(P, P) of the free numbers, from blocks of windows."""


@np.errstate(over="ignore", invalid="ignore")  # a model that diverges costs infinitely much, and is not taken
def multiple_shooting(
    model: PhysicsModel,
    subject: Subject,
    names: Sequence[str],
    tick: Callable[[str], None] = lambda what: None,
    held: Collection[tuple[int, str]] = (),
) -> Shot:
    """Fit constants (within their uncertainty) and effects of ``model`` on the recordings ``names``.

    Args:
        model: to start from.
        subject: the recordings, and what is known of the constants.
        names: of recordings.
        tick: called with what is being done.
        held: owner and label of each number that stays as the model has it.
    """
    runs, where = _Runs.of(model, subject, names), _free(model, subject, held)
    first = runs.errors(model)
    size = _size(first)  # (1, points, axes)

    def cost(of: np.ndarray) -> float:
        return float(np.mean((of / size) ** 2))

    # As many independent observations as windows and axes: the points of one window err together.
    weight = len(first) * first.shape[2]
    best, current, last = model, where, cost(first)
    start = last
    gram, lost = np.eye(len(where)), np.zeros(len(where), dtype=bool)
    for _ in range(SHOOTING.steps):
        tick("shooting")
        values, widths = probes(current)
        off = runs.errors(with_values(best, current, values)) / size
        jacobian = ((off[1:] - off[0]) / widths[:, None, None, None]).reshape(len(widths), -1)
        lost = ~np.isfinite((jacobian**2).sum(1))
        jacobian[lost] = 0.0  # a number by which free runs diverge at the least step stays
        scale = weight / jacobian.shape[1]
        prior = Prior.of(current)
        gram = jacobian @ jacobian.T * scale + np.diag(prior.precision)
        moment = -jacobian @ off[0].ravel() * scale + prior.precision * prior.centre
        factor = equilibrium(np.diag(gram))
        scaled = gram * np.outer(factor, factor) + 1e-9 * np.eye(len(factor))
        step = bounded(scaled, moment * factor, prior.low / factor, prior.high / factor) * factor
        for shrink in (1.0, 0.3, 0.1):
            ahead = [np.clip(e.value + shrink * d, e.low, e.high) for e, d in zip(current, step, strict=True)]
            moved = with_values(best, current, np.array(ahead))
            now = cost(runs.errors(moved))
            if now < last:
                break
        else:
            break
        best, done = moved, now > last * (1 - SHOOTING.enough)
        current, last = _free(best, subject, held), now
        if done:
            break
    return Shot(best, start, last, tuple(current), np.linalg.pinv(gram) + np.diag(np.where(lost, np.inf, 0.0)))


def relative_error(one: PhysicsModel, other: PhysicsModel, subject: Subject, names: Sequence[str]) -> float:
    """Mean squared error of free runs of ``other`` on some recordings, each channel over that of ``one``."""
    return error_beside(one, subject, names)(other)


def relative_errors(
    one: PhysicsModel, others: Sequence[PhysicsModel], subject: Subject, names: Sequence[str]
) -> list[float]:
    """`relative_error` of each of several models."""
    return [*map(error_beside(one, subject, names), others)]


def error_beside(one: PhysicsModel, subject: Subject, names: Sequence[str]) -> Callable[[PhysicsModel], float]:
    """`relative_error` as a function of the other model: ``one`` runs free once for all of them."""
    runs = _Runs.of(one, subject, names)
    with np.errstate(over="ignore", invalid="ignore"):
        size = _size(runs.errors(one))

    @np.errstate(over="ignore", invalid="ignore")
    def error(other: PhysicsModel) -> float:
        return float(np.mean((runs.errors(other) / size) ** 2))

    return error


@dataclass(frozen=True, eq=False)
class _Runs:
    """The windows in which free runs are compared with what was measured."""

    logs: Sequence[Log]
    at: Sequence[np.ndarray]
    steps: int
    points: np.ndarray
    """(points,) samples after the start at which they are compared."""
    measured: torch.Tensor
    """(W, points, s)."""
    judged: Sequence[Group]

    @classmethod
    def of(cls, model: PhysicsModel, subject: Subject, names: Sequence[str]) -> "_Runs":
        """As long as free runs of ``model`` tell anything."""
        logs = subject.of(names)
        steps = default_steps(logs)
        every = max(steps // 2, sum(map(len, logs)) // SHOOTING.windows)
        at, judged = clear_starts(logs, steps, every), groups(model.state_channels, logs[0].measured)
        measured = measured_windows(logs, at, steps)
        told = followed(errors(free_run(model, logs, at, steps), measured, judged).mean(0), measured, judged)
        points = np.unique(np.linspace(0, told, SHOOTING.points + 1).round().astype(int))[1:]
        return cls(logs, at, told, points, measured[:, points], judged)

    def errors(self, model: PhysicsModel) -> np.ndarray:
        """(…, W, points, axes) of a model, or of many at once."""
        runs = free_run(model, self.logs, self.at, self.steps)[..., self.points, :]
        return _errors(runs, self.measured.expand(*runs.shape[:-1], -1), self.judged)


def _size(errors: np.ndarray) -> np.ndarray:
    """(1, points, axes) typical errors of (W, points, axes)."""
    return np.asarray(np.sqrt(np.mean(errors**2, axis=0, keepdims=True)) + 1e-300)


def _free(model: PhysicsModel, subject: Subject, held: Collection[tuple[int, str]]) -> list[Entry]:
    """The numbers of a model that are fitted."""
    return [e for e in entries(model, subject.uncertainty, subject.model) if (e.owner, e.label) not in held]


def _errors(predicted: torch.Tensor, measured: torch.Tensor, of: Sequence[Group]) -> np.ndarray:
    """(W, points, axes): differences, of an attitude the rotation vector; what diverged counts as a large error."""
    out = []
    for group in of:
        at = list(group.at)
        a, b = predicted[..., at], measured[..., at]
        if group.name == "attitude":
            out.append(2 * between(a, b) * torch.sign((a * b).sum(-1, keepdim=True)))
        else:
            out.append(a - b)
    found: np.ndarray = np.nan_to_num(torch.cat(out, dim=-1).numpy(), nan=1e6, posinf=1e6, neginf=-1e6)
    return found
