"""The shape of a learned term with its 95 % band, to be drawn, and the effects of the catalogue that are like it."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import scipy  # scipy.optimize is imported when it is used
import torch

from bench.diagnose.learn.candidates import dynamic_axes, paths, with_axes
from bench.diagnose.learned_shape import LearnedCurve
from bench.diagnose.logs.noise import Noise
from bench.diagnose.logs.subject import Subject
from bench.diagnose.regression.linearise import Candidate, Linearization
from bench.diagnose.regression.test_functions import TestFunctions
from bench.diagnose.regression.weak import mean_rates, midpoint_rates
from bench.diagnose.result import NamedEffect
from bench.diagnose.select.search import Search
from bench.diagnose.settings import SKETCHING, TELLING
from registry.dynamics import PhysicsModel
from registry.effects.learned_term import LearnedTerm
from registry.terms import signals as known
from registry.terms.unit_algebra import product

_NORMAL = 1.96


def curve(subject: Subject, noise: Noise, model: PhysicsModel, place: int, effect: NamedEffect) -> LearnedCurve:
    """The shape of the term in ``model.effects[place]`` over the training recordings.

    Args:
        subject: measurements.
        noise: of them.
        model: fitted.
        place: of the term among its effects.
        effect: what is known about the term's parameters.
    """
    term = model.effects[place]
    assert isinstance(term, LearnedTerm)
    search = Search(subject, (), lambda what: None, noise)
    with torch.no_grad():
        x, left = _left(search, model, place, term)
        low, high = (float(np.quantile(x, q)) for q in (SKETCHING.inner, 1 - SKETCHING.inner))
        grid = np.linspace(low, high, SKETCHING.points)
        view = search.views(search.look(model, broad=False))[0]
        half = _half_widths(view.subsets.covariance(view.subsets.fit()), view.linear.own, place, effect)
        y, band = _band(term, grid, half)
    thin = slice(None, None, max(1, len(x) // SKETCHING.dots))
    units, whole = known.available(model), known.axes_of(type(model))[term.axis]
    per = product((whole, 1), *((units[s], -1) for s in term.signals[1:]))
    axis = known.quantity_of(type(model), term.axis)
    return LearnedCurve(
        x_signal=term.signals[0] if term.signals else "time",
        x_unit=units[term.signals[0]] if term.signals else "s",
        y_quantity=axis if len(term.signals) < 2 else f"{axis} over {term.signals[1]}",
        y_unit=per,
        x=tuple(grid.tolist()),
        y=tuple(y.tolist()),
        low=tuple((y - band).tolist()),
        high=tuple((y + band).tolist()),
        dots_x=tuple(x[thin].tolist()),
        dots_y=tuple(left[thin].tolist()),
    )


def _left(search: Search, model: PhysicsModel, place: int, term: LearnedTerm) -> tuple[np.ndarray, np.ndarray]:
    """The first signal, and what is left along the axis without the term (over the second): means over windows."""
    rest = replace(model, effects=tuple(e for i, e in enumerate(model.effects) if i != place))
    base, stack = len(rest.effects), search.stack
    with_all = with_axes(rest)
    at = dynamic_axes(rest).index(term.axis)
    unit = replace(with_all.effects[base + at], values=(1.0,))  # type: ignore[call-arg]
    rates = mean_rates(rest, stack).numpy()
    plain, added = (midpoint_rates(m, stack) for m in (rest, replace(rest, effects=(*rest.effects, unit))))
    direction = (added - plain).numpy()
    channels = [c for c in stack.measured if np.abs(direction[..., c]).max() > 0 and c < stack.states.shape[-1]]
    tests = TestFunctions.over(
        stack.logs, search.stride, [search.smoothing_of(model.measured_channels[c]) for c in channels]
    )
    followed = paths(rest, stack)
    first = (
        followed[term.signals[0]]
        if term.signals
        else np.broadcast_to(np.arange(rates.shape[1]) * stack.dt, rates.shape[:2])
    )
    second = followed[term.signals[1]] if len(term.signals) > 1 else np.ones_like(first)
    xs, ys = [], []
    for i, log in enumerate(stack.logs):
        measured = tests.increment(i, log.paths[:, channels])
        rows, unit_rows = (
            np.stack([tests.integral(i, j, r[i, :, c], stack.dt) for j, c in enumerate(channels)], axis=-1)
            for r in (rates, direction * second[..., None])
        )
        power = (unit_rows**2).sum(-1)
        centre = np.minimum(tests.centres[i], rates.shape[1] - 1)
        good = power > 1e-3 * power.mean() if len(power) else power > 0
        amount = ((measured - rows) * unit_rows).sum(-1)[good] / power[good]
        xs.append(first[i, centre[good]])
        ys.append(amount)
    return np.concatenate(xs), np.concatenate(ys)


def _half_widths(covariance: np.ndarray, own: object, place: int, effect: NamedEffect) -> np.ndarray:
    """Covariance (P, P) of the term's parameters: correlations of the weak form, sizes of the last fit's intervals."""
    index = [j for j, e in enumerate(own) if e.owner == place]  # type: ignore[arg-type, var-annotated]
    block = covariance[np.ix_(index, index)]
    spread = np.sqrt(np.maximum(np.diag(block), 1e-300))
    told = np.array([(p.high - p.low) / 2 / _NORMAL for p in effect.parameters.values()])
    told = np.where(np.isfinite(told), told, spread)
    out: np.ndarray = block / np.outer(spread, spread) * np.outer(told, told)
    return out


def _band(term: LearnedTerm, grid: np.ndarray, covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The function on a grid, and half the width of its 95 % band."""
    x = torch.from_numpy(grid)
    values = torch.tensor(term.values, dtype=torch.float64)
    y = replace(term, values=values).function(x).numpy()
    slopes = []
    for i, v in enumerate(term.values):
        step = 1e-5 * (abs(v) or max(map(abs, term.values)) or 1.0)
        moved = values.clone()
        moved[i] += step
        slopes.append((replace(term, values=moved).function(x).numpy() - y) / step)
    slope = np.stack(slopes)
    variance = np.einsum("in,ij,jn->n", slope, covariance, slope)
    return y, _NORMAL * np.sqrt(np.maximum(variance, 0.0))


@dataclass(frozen=True)
class Likeness:
    """What a term is like."""

    effects: tuple[str, ...]
    """Ids of the effects of the catalogue that come nearest to it."""
    share: float
    """Of the squared rates that the term makes of the recordings, what the first of them would make too, 0 to 1."""


def nearest(linear: Linearization, place: int) -> Likeness | None:
    """The candidates that tell most of what the effect in a place of the model does; None: none tells much.

    Rates of all groups of channels on which the term acts count alike, over all recordings that ``linear`` is of.
    """
    gone = linear.columns.responses[linear.removals[place]]
    group = {c: linear.model.measured_channels[c].group for c in gone}
    power = dict.fromkeys(group.values(), 0.0)
    for c, x in gone.items():
        power[group[c]] += float(np.mean(x**2))
    scale = {c: power[g] ** 0.5 for c, g in group.items()}
    y = -np.concatenate([x.ravel() / scale[c] for c, x in gone.items()])  # what goes with the term is what it does
    shares: dict[str, float] = {}
    for s in (s for s in linear.starts if s.through is None):
        shares[s.id] = max(shares.get(s.id, 0.0), _told(linear, s, gone, scale, y))
    best = max(shares.values(), default=0.0)
    near = sorted((i for i in shares if shares[i] >= best - TELLING.as_near), key=lambda i: -shares[i])
    return Likeness(tuple(near[: TELLING.nearest]), best) if best >= TELLING.alike else None


def _told(
    linear: Linearization, start: Candidate, gone: Mapping[int, np.ndarray], scale: Mapping[int, float], y: np.ndarray
) -> float:
    """R² of a candidate, with numbers that it may have, on what the term does: what pushes away is no spring."""
    zeros = np.zeros(linear.columns.shape)
    columns = [
        np.concatenate([linear.columns.responses[j].get(c, zeros).ravel() / scale[c] for c in gone])
        for j in start.columns
    ]
    x, low, high = np.stack(columns, axis=1), np.array(start.low), np.array(start.high)
    acts = np.isfinite(x).all(0) & (np.abs(x).max(0) > 0)
    given = acts & (low == high)  # an effect that is not linear in its numbers, as it is at this value of them
    rest = y - x[:, given] @ low[given]
    free = acts & ~given
    if free.any():
        size = np.linalg.norm(x[:, free], axis=0)
        triangle = np.asarray(np.linalg.qr(np.column_stack([x[:, free] / size, rest]), mode="r"))
        ends = low[free] * size, high[free] * size
        fit = scipy.optimize.lsq_linear(triangle[:, :-1], triangle[:, -1], ends, method="bvls")
        rest = rest - x[:, free] @ (fit.x / size)
    return float(1 - rest @ rest / (y @ y))
