"""How far apart manoeuvres take candidates, in units of measured noise, and what they tell of parameters.

Over short windows every candidate says where the states would be. What counts is the difference of two
predictions, whitened by the covariance of the errors that the model at hand makes over the recordings' own windows
(noise, smoothing and disturbances as they were measured), and as small as the rival's parameters can make it within
what is known of them: Atkinson and Fedorov, "The design of experiments for discriminating between two rival models",
Biometrika 62 (1975).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from bench.diagnose.logs.subject import Log, LogBatch, Subject
from bench.diagnose.regression.parameters import Entry, Prior, entries, probes, with_values
from bench.diagnose.regression.weak import midpoint_rates
from bench.diagnose.settings import SEPARATING
from bench.diagnose.simulate.free_run import Group, between, default_steps, groups, measured_windows, starts
from registry.dynamics import PhysicsModel


@dataclass(frozen=True, eq=False)
class Windows:
    """Short free runs, and how their errors are weighed."""

    steps: int
    """Samples of a window after its first."""
    points: np.ndarray
    """(points,) of them that are compared."""
    judged: tuple[Group, ...]
    whitening: np.ndarray
    """(d, d): L with Lᵀ L the inverse covariance of a window's errors, d = points · axes."""

    def begins(self, log: Log, every: int | None = None) -> np.ndarray:
        """Samples at which windows begin, one after the other unless ``every`` says."""
        return starts(log, self.steps, every or self.steps)

    def predicted(self, model: PhysicsModel, logs: Sequence[Log]) -> Tensor:
        """(…, windows, points, s): where the states would be at the points.

        As in a diagnosis, the model's rates are added up at the measured states, from what was measured at the window's
        beginning.
        """
        return integrated(model, logs, [self.begins(log) for log in logs], self.points)

    def measured(self, logs: Sequence[Log]) -> Tensor:
        """(windows, points, s): what was measured there."""
        at = [self.begins(log) for log in logs]
        return measured_windows(logs, at, self.steps)[:, torch.from_numpy(self.points)]

    def whitened(self, one: Tensor, other: Tensor) -> np.ndarray:
        """(…, windows, d): differences of two predictions in units of measured noise."""
        flat = difference(one, other, self.judged).flatten(-2).numpy()
        return np.asarray(np.nan_to_num(flat @ self.whitening.T, nan=1e6, posinf=1e6, neginf=-1e6))


def integrated(model: PhysicsModel, logs: Sequence[Log], at: Sequence[np.ndarray], points: np.ndarray) -> Tensor:
    """(…, windows, points, s): measured states at ``at`` and, from there, the integral of the model's rates."""
    stack = LogBatch.of(logs)
    size, begin = stack.states.shape[-1], stack.states.new_zeros(())
    path = (midpoint_rates(model, stack)[..., :size] * stack.dt).cumsum(-2)
    path = torch.cat([begin.expand(*path.shape[:-2], 1, size), path], dim=-2)  # (…, L, N, s)
    out = []
    for i, k in enumerate(at):
        first = torch.as_tensor(k)[:, None]
        then = first + torch.from_numpy(points)
        out.append(stack.states[i, first] + path[..., i, :, :][..., then, :] - path[..., i, :, :][..., first, :])
    return torch.cat(out, dim=-3)


def windows_of(subject: Subject, model: PhysicsModel) -> Windows:
    """Windows of the default horizon, weighed by what ``model`` errs by over the recordings."""
    logs = subject.logs
    steps = default_steps(logs)
    points = np.unique(np.linspace(0, steps, SEPARATING.points + 1).round().astype(int))[1:]
    moved = model.equation_names()
    judged = tuple(g for g in groups(model.state_channels, logs[0].measured) if g.name in moved)
    size = len(points) * sum(len(g.at) for g in judged)
    first = Windows(steps, points, judged, np.eye(size))
    errors = first.whitened(first.measured(logs), first.predicted(model, logs))
    return Windows(steps, points, judged, _whitening(errors))


def _whitening(errors: np.ndarray) -> np.ndarray:
    """L (d, d) of errors (n, d), with Lᵀ L = C⁻¹; a window that went astray does not count."""
    good = errors[np.isfinite(errors).all(1)]
    size = np.median(np.abs(good), axis=0) / 0.6745
    size = np.where(size > 0, size, 1e-12 + np.abs(good).max(0))
    scaled = (good / size)[(np.abs(good / size) < 6).all(1)]
    covariance = scaled.T @ scaled / max(1, len(scaled))
    covariance = (1 - SEPARATING.shrink) * covariance + SEPARATING.shrink * np.diag(np.diag(covariance))
    covariance = covariance + 1e-9 * np.eye(len(size))
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)) / size)


def difference(one: Tensor, other: Tensor, judged: Sequence[Group]) -> Tensor:
    """(…, axes): of measured states, of an attitude the rotation vector between two."""
    out = []
    for group in judged:
        a, b = one[..., list(group.at)], other[..., list(group.at)]
        if group.name == "attitude":
            out.append(2 * between(a, b) * torch.sign((a * b).sum(-1, keepdim=True)))
        else:
            out.append(a - b)
    return torch.cat(out, dim=-1)


@dataclass(frozen=True, eq=False)
class Candidate:
    """A model that explains the recordings, and what they and the user tell of its numbers."""

    name: str
    model: PhysicsModel
    where: tuple[Entry, ...]
    """P numbers."""
    known: np.ndarray
    """(P, P): precision, in scales of the numbers."""

    @property
    def scales(self) -> np.ndarray:
        """(P,) typical size of each number."""
        return np.array([e.scale for e in self.where])


def candidate(name: str, model: PhysicsModel, subject: Subject, windows: Windows) -> Candidate:
    """A fitted model as a candidate: known are its constants as stated, and all that the recordings tell."""
    where = tuple(entries(model, subject.uncertainty, subject.model))
    scales = np.array([e.scale for e in where])
    bare = Candidate(name, model, where, np.zeros((len(where), len(where))))
    _, slopes = predictions(bare, subject.logs, windows)
    flat = slopes.reshape(-1, len(where))
    stated = np.diag(Prior.of(where).precision * scales**2)
    return replace(bare, known=flat.T @ flat + stated)


def predictions(c: Candidate, logs: Sequence[Log], windows: Windows) -> tuple[Tensor, np.ndarray]:
    """Predictions (n, points, s), and whitened slopes (n, d, P) over the numbers in their scales."""
    if not c.where:
        base = windows.predicted(c.model, logs)
        return base, np.zeros((*windows.whitened(base, base).shape, 0))
    values, widths = probes(c.where)
    runs = windows.predicted(with_values(c.model, c.where, values), logs)
    slopes = windows.whitened(runs[1:], runs[:1])  # (P, n, d)
    return runs[0], np.moveaxis(slopes / (widths / c.scales)[:, None, None], 0, -1)


@dataclass(frozen=True, eq=False)
class Distance:
    """Between a candidate and the nearest that a rival's parameters come to it, window by window."""

    rest: np.ndarray
    """(W, n): squared distance of each window of W manoeuvres."""
    price: np.ndarray
    """(W,): what moving the parameters costs by what is known of them."""

    @property
    def total(self) -> np.ndarray:
        """(W,)."""
        return np.asarray(self.rest.sum(1) + self.price)

    def beyond(self, own: np.ndarray) -> "Distance":
        """Beyond the squared errors (W, n) that the truth itself makes."""
        return Distance(self.rest - own, self.price)


def distance(away: np.ndarray, slopes: np.ndarray, known: np.ndarray, often: float = 1.0) -> Distance:
    """min over δ of Σ ‖r − A δ‖² + δᵀ Λ δ, of one of the ``often`` repetitions.

    Args:
        away: (W, n, d) whitened differences r.
        slopes: (W, n, d, P) A, of the rival.
        known: (P, P) Λ.
        often: how often the manoeuvre is gone through; Λ is known once.
    """
    gram = np.einsum("wndp,wndq->wpq", slopes, slopes)
    moment = np.einsum("wndp,wnd->wp", slopes, away)
    prior = known / often + 1e-12 * np.eye(len(known))
    shift = np.linalg.solve(gram + prior, moment[..., None])[..., 0]
    left = away - np.einsum("wndp,wp->wnd", slopes, shift)
    return Distance((left**2).sum(-1), np.einsum("wp,pq,wq->w", shift, prior, shift))


def imitated(seen: Tensor, rival: Candidate, logs: Sequence[Log], windows: Windows, often: float = 1.0) -> Distance:
    """The same for one manoeuvre, with the rival's parameters sought by Gauss and Newton rather than in one step."""
    now, moved, best = rival, np.zeros(len(rival.where)), None
    low, high = (np.array([getattr(e, side) for e in rival.where]) for side in ("low", "high"))
    at = np.array([e.value for e in rival.where])
    for _ in range(SEPARATING.refits + 1):
        base, slopes = predictions(now, logs, windows)
        away = windows.whitened(seen, base)
        price = float(moved @ rival.known @ moved) / often
        found = Distance((away**2).sum(-1)[None], np.array([price]))
        if best is not None and found.total[0] >= best.total[0]:
            break
        best = found
        # Around where it is now, what is known still speaks of where it was.
        flat, prior = slopes.reshape(-1, len(at)), rival.known / often + 1e-12 * np.eye(len(at))
        step = np.linalg.solve(flat.T @ flat + prior, flat.T @ away.ravel() - prior @ moved)
        values = np.clip(at + (moved + step) * rival.scales, low, high)
        moved = (values - at) / rival.scales
        model = with_values(rival.model, rival.where, values)
        now = replace(
            rival,
            model=model,
            where=tuple(replace(e, value=float(v)) for e, v in zip(rival.where, values, strict=True)),
        )
    assert best is not None
    return best


def information(slopes: np.ndarray, known: np.ndarray, often: float = 1.0) -> np.ndarray:
    """Fisher information (W, P, P) of manoeuvres with slopes (W, n, d, P), gone through ``often`` times, and Λ."""
    return np.asarray(often * np.einsum("wndp,wndq->wpq", slopes, slopes) + known)


def log_determinant(information: np.ndarray, of: Sequence[int]) -> np.ndarray:
    """(W,): log det of the information on some of the numbers, the others being estimated beside them."""
    rest = [i for i in range(information.shape[-1]) if i not in of]
    whole = np.linalg.slogdet(information)[1]
    return np.asarray(whole - (np.linalg.slogdet(information[:, rest][:, :, rest])[1] if rest else 0.0))
