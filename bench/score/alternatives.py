"""What one would do instead, on the same logs: sparse regression, regression with BIC, a plain weak form.

All three get what helps them: what an accelerometer shows, if there is one, the columns of every effect of the
catalogue, channels scaled by their noise, constants that may move within their uncertainty, bounds of the parameters,
two Gauss–Newton steps once effects are chosen, and the thresholds below: those with the most exact sets less false
names, as shares, on cases of the development seed.
"""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pysindy
from scipy.signal import savgol_filter

from bench.diagnose.compare import compare
from bench.diagnose.logs.subject import LogBatch, Subject
from bench.diagnose.regression.least_squares import bounded, ridge
from bench.diagnose.regression.linearise import Candidate, Linearization, directions
from bench.diagnose.regression.parameters import entries, with_values
from bench.diagnose.select.catalogue import admissible
from bench.score.case import Case
from bench.score.chains import measured
from registry.core import EFFECTS
from registry.dynamics import Effect, PhysicsModel

SMOOTH = (9, 2)
"""Window [samples] and order of the Savitzky–Golay filter that differentiates."""
WINDOW = 0.3
"""Of the plain weak form [s]."""
THRESHOLD = 0.2
"""Of PySINDy's STLSQ: least contribution of a column, relative to what is to be explained."""
SHRINK = 0.01
"""Its ridge penalty, a row."""
GAIN_BIC, GAIN_WEAK = 0.15, 0.6
"""Least gain (log of the squared residual) of a further effect."""
MAX_TERMS = 5
"""Effects at most."""
MEASURED = ("single", "pair", "triple")
"""Conditions in which the error on held-out recordings is asked for."""

Rows = Callable[[Linearization], list[np.ndarray]]
"""Columns and, last, what is to be explained: a recording (c + 1, rows, channels)."""


@dataclass(frozen=True)
class Said:
    """What an alternative says of a case."""

    named: dict[str, dict[str, float]]
    """Effects with parameters; none: "nothing"."""
    error: dict[str, float] = field(default_factory=dict)
    """On held-out recordings by output group, at the longest horizon of `compare`."""


def attempt_all(case: Case, cache: Path) -> dict[str, Said]:
    """The answers of all alternatives to one case."""
    who, _ = measured(case, cache)
    catalogue = [n for n in EFFECTS.names() if n not in case.catalogue_without]
    models = attempts(who, catalogue)
    errors: dict[str, dict[str, float]] = {name: {} for name in models}
    if case.condition in MEASURED:
        compared = compare(who, models)
        errors = {n: {g: e.rmse for g, e in compared.error(n).items()} for n in models}
    held = len(who.model.effects)
    return {name: Said(_named(model.effects[held:]), errors[name]) for name, model in models.items()}


def attempts(who: Subject, catalogue: Sequence[str]) -> dict[str, PhysicsModel]:
    """By alternative, the model with the effects that it names."""
    stack = LogBatch.of(who.of(who.training))
    linear = directions(who.model, who.model, who.uncertainty, stack, admissible(who, who.model, catalogue))
    nominal = {e.label: e.value for e in entries(who.model, who.uncertainty) if e.constant}
    pointwise, weak = (Problem(linear, rows(linear), nominal) for rows in (accelerations, changes))
    chosen = {
        "pysindy": (_sparse(pointwise), accelerations),
        "bic": (_forward(pointwise, _bic), accelerations),
        "weak_form": (_forward(weak, _flight_held_out), changes),
    }
    return {name: _refined(who, nominal, linear, effects, rows) for name, (effects, rows) in chosen.items()}


def accelerations(linear: Linearization) -> list[np.ndarray]:
    """Differentiated velocity and rates, and what an accelerometer shows, against the model's, sample by sample."""
    out = []
    for i, log in enumerate(linear.stack.logs):
        paths, count = log.paths[:, list(linear.channels)], len(log) - 1
        slope = savgol_filter(paths, *SMOOTH, deriv=1, delta=linear.stack.dt, axis=0)
        left = (slope[1:] + slope[:-1]) / 2 - linear.rates[i, :count]
        columns = np.asarray(linear.columns)[:, i, :count]
        out.append(_offset_free(linear, np.concatenate([columns, left[None]])))
    return out


def changes(linear: Linearization) -> list[np.ndarray]:
    """Changes of velocity, rates and the accelerometer's integral over windows in a row, against the model's."""
    length, dt, out = max(1, round(WINDOW / linear.stack.dt)), linear.stack.dt, []
    for i, log in enumerate(linear.stack.logs):
        starts = np.arange(0, len(log) - 1, length)[: (len(log) - 1) // length]
        paths = log.paths[:, list(linear.channels)]
        used = starts[-1] + length
        columns = np.add.reduceat(np.asarray(linear.columns)[:, i, :used], starts, axis=1) * dt
        model = np.add.reduceat(linear.rates[i, :used], starts, axis=0) * dt
        left = paths[starts + length] - paths[starts] - model
        out.append(_offset_free(linear, np.concatenate([columns, left[None]])))
    return out


def _offset_free(linear: Linearization, rows: np.ndarray) -> np.ndarray:
    """Rows (c + 1, n, channels) of a recording, without the offset that a sensor of rates has in it."""
    sensor = np.array(linear.channels) >= linear.stack.states.shape[-1]
    return rows - np.where(sensor, rows.mean(1, keepdims=True), 0.0)


class Problem:
    """Least squares for the effects of a linearised model, with its constants beside them."""

    def __init__(self, linear: Linearization, rows: Sequence[np.ndarray], nominal: dict[str, float]) -> None:
        self.linear = linear
        own = linear.own
        self.own = list(range(len(own)))
        self.prior = np.array([e.scale**-2 if e.constant else 0.0 for e in own])
        self.centre = np.array([nominal[e.label] - e.value if e.constant else 0.0 for e in own])
        self.bounds = np.array([(e.low - e.value, e.high - e.value) for e in own]).reshape(-1, 2)
        stacked = np.concatenate(rows, axis=1)
        noise = [_spread(stacked[:, :, c]) for c in range(stacked.shape[2])]
        self.rows = [(x / noise).reshape(len(x), -1) for x in rows]
        """A recording: (c + 1, rows · channels), in units of noise."""
        self.grams = np.stack([x @ x.T for x in self.rows])
        self.count = sum(x.shape[1] for x in self.rows)

    def fit(self, starts: Sequence[Candidate] = (), without: int | None = None) -> np.ndarray:
        """Coefficients (c,) of all columns, those of other effects 0."""
        gram = self.grams.sum(0) - (0.0 if without is None else self.grams[without])
        index = [*self.own, *(c for s in starts for c in s.columns)]
        low = np.concatenate([self.bounds[:, 0], *(s.low for s in starts)])
        high = np.concatenate([self.bounds[:, 1], *(s.high for s in starts)])
        prior = np.concatenate([self.prior, np.zeros(len(index) - len(self.own))])
        centre = np.concatenate([self.centre, np.zeros(len(index) - len(self.own))])
        normal = gram[np.ix_(index, index)] + np.diag(prior)
        size = np.sqrt(np.maximum(np.diag(normal), 1e-300))
        moment = (gram[index, -1] + prior * centre) / size
        scaled = normal / np.outer(size, size) + 1e-9 * np.eye(len(index))
        out = np.zeros(len(gram) - 1)
        out[index] = bounded(scaled, moment, low * size, high * size) / size
        return out

    def losses(self, beta: np.ndarray) -> np.ndarray:
        """Squared residual of each recording (recordings,)."""
        vector = np.append(-beta, 1.0)
        return np.asarray(np.einsum("i,fij,j->f", vector, self.grams, vector))

    def effects(self, beta: np.ndarray, starts: Sequence[Candidate]) -> list[Effect]:
        """The effects that these coefficients stand for."""
        return [e for s in starts for e in s.effects_at(beta[list(s.columns)].tolist())]


def _bic(problem: Problem, starts: Sequence[Candidate]) -> float:
    """Schwarz's criterion over samples, and the least gain; a sample."""
    loss = float(problem.losses(problem.fit(starts)).sum())
    price = sum(len(s.entries) for s in starts) * np.log(problem.count) / problem.count
    return float(np.log(loss / problem.count) + price + GAIN_BIC * len(starts))


def _flight_held_out(problem: Problem, starts: Sequence[Candidate]) -> float:
    """Residual of each recording by a fit to the others, and the least gain."""
    flights = range(len(problem.grams))
    loss = sum(float(problem.losses(problem.fit(starts, i))[i]) for i in flights)
    return float(np.log(loss / problem.count) + GAIN_WEAK * len(starts))


def _forward(problem: Problem, criterion: Callable[[Problem, Sequence[Candidate]], float]) -> list[Effect]:
    """Whole effects, one after another, as long as the criterion falls."""
    chosen: list[Candidate] = []
    now = criterion(problem, chosen)
    while len(chosen) < MAX_TERMS:
        left = [s for s in problem.linear.starts if s.id not in {c.id for c in chosen}]
        found = [(criterion(problem, [*chosen, s]), i) for i, s in enumerate(left)]
        best, i = min(found, default=(np.inf, 0))
        if best >= now:
            break
        now = best
        chosen.append(left[i])
    return problem.effects(problem.fit(chosen), chosen)


def _sparse(problem: Problem) -> list[Effect]:
    """Sequentially thresholded least squares over the columns of all effects; an effect is named by any of its own."""
    x = np.concatenate(problem.rows, axis=1)
    # What the constants can explain within their uncertainty is taken off everything first.
    own = np.concatenate([x[problem.own], np.diag(np.sqrt(problem.prior))], axis=1)
    rest = np.concatenate([x[len(problem.own) :], np.zeros((len(x) - len(own), len(own)))], axis=1)
    basis = np.linalg.qr(own.T)[0] if len(own) else np.zeros((rest.shape[1], 0))
    rest = rest - (rest @ basis) @ basis.T
    # An effect that is not linear in its parameters enters as it is at each value of its grid.
    first = len(problem.own)
    library = [
        (s, k) for s in problem.linear.starts for k in s.columns[: None if s.effect == s.effect.neutral() else 1]
    ]
    size = np.maximum(np.sqrt((rest**2).mean(1)), 1e-300)
    features = np.stack([rest[k - first] / size[k - first] for _, k in library], axis=1)
    target = rest[-1:].T / size[-1]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # "sparsity parameter is too big": nothing was found
        model = pysindy.SINDy(
            pysindy.STLSQ(threshold=THRESHOLD, alpha=SHRINK * len(features)), pysindy.IdentityLibrary()
        )
        model.fit(features, t=problem.linear.stack.dt, x_dot=target)
    weight = np.abs(model.coefficients()[0])
    best: dict[str, tuple[float, Candidate]] = {}
    for w, (start, _) in zip(weight, library, strict=True):
        if w > best.get(start.id, (0.0, start))[0]:
            best[start.id] = (float(w), start)
    chosen = [s for _, s in sorted(best.values(), key=lambda pair: -pair[0])][: 2 * MAX_TERMS]
    return problem.effects(problem.fit(chosen), chosen)


def _refined(
    who: Subject, nominal: dict[str, float], linear: Linearization, effects: Sequence[Effect], rows: Rows
) -> PhysicsModel:
    """The model with these effects, all numbers fitted again where they act."""
    model = replace(who.model, effects=(*who.model.effects, *effects))
    for _ in range(3):
        here = directions(model, who.model, who.uncertainty, linear.stack)
        step = Problem(here, rows(here), nominal).fit()[: len(here.own)]  # behind them stand the effects' removals
        values = [float(np.clip(e.value + b, e.low, e.high)) for e, b in zip(here.own, step, strict=True)]
        model = with_values(model, here.own, np.array(values))
    return model


def _spread(x: np.ndarray) -> float:
    """What all columns (c + 1, rows) together leave of the last: its standard deviation."""
    left = x[-1] - ridge(x @ x.T) @ x[:-1]
    return max(float(left.std()), 1e-300)


def _named(effects: Sequence[Effect]) -> dict[str, dict[str, float]]:
    return {
        EFFECTS.name_of(type(e)): {p.name: float(p.value) for p in e.parameters() if p.uncertainty > 0} for e in effects
    }
