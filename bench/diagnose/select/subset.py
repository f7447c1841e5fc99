"""Which effects together explain a residual: best subsets on normal equations, judged on recordings not fitted."""

from collections.abc import Collection, Sequence
from copy import copy
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from bench.diagnose.regression.least_squares import Normal, steadied
from bench.diagnose.regression.linearise import Candidate, Linearization
from bench.diagnose.regression.parameters import Entry, Prior, sign_kept
from bench.diagnose.settings import SEARCHING, VERIFYING
from registry.dynamics import Effect


@dataclass(frozen=True, eq=False)
class Fit:
    """A set of effects beside what the model holds already, fitted together with the model's own numbers."""

    starts: tuple[Candidate, ...]
    columns: tuple[int, ...]
    beta: np.ndarray
    misfit: float
    """Squared whitened residual of the rows that were fitted."""
    prior: float
    """Squared distance of the constants from nominal, in their 1σ."""
    parameters: int
    """Parameters of the effects."""
    dropped: tuple[int, ...] = ()
    """Places in ``model.effects`` of effects that it does without."""
    fixed: tuple[int, ...] = ()
    """Places in ``columns`` of those whose coefficients were given, and not fitted."""

    @property
    def ids(self) -> tuple[str, ...]:
        """Added effects."""
        return tuple(i for s in self.starts for i in s.ids)

    @property
    def loss(self) -> float:
        """Twice the negative logarithm of the posterior, up to a constant."""
        return self.misfit + self.prior

    def numbers(self, own: int) -> list[tuple[Candidate, list[float]]]:
        """The added effects and the coefficients of each; ``own`` columns come first."""
        out, at = [], own
        for s in self.starts:
            out.append((s, self.beta[at : at + len(s.columns)].tolist()))
            at += len(s.columns)
        return out

    def effects(self, own: int) -> dict[str, Effect]:
        """The added effects with fitted parameters, by id; ``own`` columns come first."""
        found = [dict(zip(s.ids, s.effects_at(beta), strict=True)) for s, beta in self.numbers(own)]
        return {i: e for one in found for i, e in one.items()}


class Subsets:
    """Fits of subsets of the starts of a linearised model."""

    def __init__(self, linear: Linearization, normal: Normal, buried: Collection[int] = ()) -> None:
        """Prepare.

        Args:
            linear: the model and its rivals.
            normal: their normal equations.
            buried: columns that are mostly noise of the inputs. A regression takes their coefficients too small, which
                must not look like a weak motor: such a constant is left free here, and such an effect is not tried.
        """
        self.linear, self.normal, self.buried = linear, normal, buried
        self.starts = tuple(s for s in linear.starts if not set(s.columns) & set(buried))
        own: tuple[Entry, ...] = linear.own
        self.own = list(range(len(own)))
        known = Prior.of(own)
        self.prior, self.low, self.high = known.precision.copy(), known.low.copy(), known.high.copy()
        self.centre = known.centre
        self.anchor = self.prior.copy()
        """As the prior, and where that is none, weakly: what holds a constant of which some recordings say little."""
        self.stated = known
        self.drowned = [i for i in self.own if i in set(buried) and own[i].constant]
        for i in self.drowned:
            self.prior[i] = 0.0
            self.anchor[i] = max(abs(own[i].value), own[i].scale) ** -2
            self.low[i], self.high[i] = sign_kept(own[i].value)
        self.penalty = float(np.log(max(normal.rows, 2)))
        """What a further parameter costs (Schwarz's criterion)."""

    def freed(self, places: Collection[int], spread: float) -> "Subsets":
        """The same with only this relative 1σ known of the constants in these places, and their sign."""
        out = copy(self)
        out.prior, out.low, out.high = self.prior.copy(), self.low.copy(), self.high.copy()
        out.drowned = [i for i in self.drowned if i not in places]
        for i in places:
            value = self.linear.own[i].value
            out.prior[i], (out.low[i], out.high[i]) = (spread * value) ** -2, sign_kept(value)
        return out

    def holding(self, fit: Fit) -> "Subsets":
        """The same with the constants that noise buries held where a fit has them, to exchange effects.

        Free beside one effect and known beside another, a constant would lend the first what noise seems to explain.
        """
        out = copy(self)
        out.low, out.high, out.drowned = self.low.copy(), self.high.copy(), []
        out.low[self.drowned] = out.high[self.drowned] = fit.beta[self.drowned]
        return out

    def _known(self, own: Sequence[int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Precision and bounds of the model's own numbers where these are their columns.

        A constant that is left free because its column is noise has another column without an effect. Where that one
        is not noise, the constant is known as stated: freed, it would stand in for the effect that is dropped.
        """
        prior, low, high = self.prior.copy(), self.low.copy(), self.high.copy()
        told = [i for i in self.drowned if own[i] != self.own[i] and own[i] not in self.buried]
        prior[told], low[told], high[told] = (
            of[told] for of in (self.stated.precision, self.stated.low, self.stated.high)
        )
        return prior, low, high

    def fit(
        self,
        starts: Sequence[Candidate] = (),
        more: Sequence[int] = (),
        without: int | None = None,
        drop: Sequence[int] = (),
    ) -> Fit:
        """Fit the model's own numbers, those of ``starts`` and free columns ``more`` together.

        Args:
            starts: effects to add.
            more: columns with free coefficients.
            without: a fold that is not fitted.
            drop: places in ``model.effects`` of effects to do without; what needs them goes too, but stays with its
                numbers where one of ``starts`` will do: a wind acts through another drag.
        """
        removed, taken = self.linear.removed(drop)
        ids = {i for s in starts for i in s.ids}
        gone = {i for i in removed if i in drop or not self.linear.model.effects[i].met_by(ids)}
        own = self.linear.changed(self.own, drop, starts)
        columns = [*own, *(c for s in starts for c in s.columns), *more, *taken]
        extra = len(columns) - len(self.own)
        fixed = np.array([e.owner in removed for e in self.linear.own], dtype=bool)
        once = np.ones(len(taken))
        precision, low, high = self._known(own)
        low, high = np.where(fixed, 0.0, low), np.where(fixed, 0.0, high)
        low = np.concatenate([low, *(s.low for s in starts), np.full(len(more), -np.inf), once])
        high = np.concatenate([high, *(s.high for s in starts), np.full(len(more), np.inf), once])
        prior, centre = np.concatenate([precision, np.zeros(extra)]), np.concatenate([self.centre, np.zeros(extra)])
        beta, misfit = self.normal.fit(columns, prior, centre, low, high, without)
        count = sum(len(s.entries) for s in starts) + len(more)
        count += sum(not e.constant and e.owner not in gone for e in self.linear.own)
        distance = float((prior * (beta - centre) ** 2).sum())
        return Fit(
            tuple(starts),
            tuple(columns),
            beta,
            misfit,
            prior=distance,
            parameters=count,
            dropped=tuple(sorted(gone)),
            fixed=tuple(np.flatnonzero(low == high).tolist()),
        )

    @property
    def overdrawn(self) -> bool:
        """Whether more noise is taken off than there is in some direction of the model's own numbers.

        The estimate of the noise is wrong there, and normal equations without a bottom have no solution (Fuller,
        Measurement error models, 1987).
        """
        gram = self.normal.total[np.ix_(self.own, self.own)] + np.diag(self.prior)
        return bool(np.linalg.eigvalsh(steadied(gram, self.prior)[0]).min(initial=1.0) <= 0)

    def losses(self, fit: Fit) -> np.ndarray:
        """Squared whitened residuals (blocks, channels) of a fit."""
        return self.normal.losses(fit.columns, fit.beta)

    def cost(self, fit: Fit) -> float:
        """The loss and what its parameters cost."""
        return fit.loss + self.penalty * fit.parameters

    def held_out(
        self, starts: Sequence[Candidate] = (), more: Sequence[int] = (), drop: Sequence[int] = ()
    ) -> np.ndarray:
        """Losses (blocks, channels), each block's by a fit to the other folds."""
        out = np.empty((len(self.normal.fold), len(self.normal.channels)))
        for fold in np.unique(self.normal.fold):
            these = self.normal.fold == fold
            out[these] = self.losses(self.fit(starts, more, int(fold), drop))[these]
        return out

    def best(
        self, size: int, among: Sequence[Candidate], one_of: Sequence[Candidate] = (), keep: int = 12
    ) -> list[Fit]:
        """The ``keep`` best sets of ``size`` different effects by cost, best first; ``one_of`` must be in each."""
        found: dict[frozenset[str], Fit] = {}
        required = set(map(id, one_of))
        for chosen in combinations(among, size):
            ids = frozenset(i for s in chosen for i in s.ids)
            if len(ids) == sum(len(s.ids) for s in chosen) and (not one_of or required.intersection(map(id, chosen))):
                fit = self.fit(chosen)
                if ids not in found or fit.loss < found[ids].loss:
                    found[ids] = fit
        return sorted(found.values(), key=self.cost)[:keep]

    def covariance(self, fit: Fit) -> np.ndarray:
        """Covariance (p, p) of a fit's coefficients.

        The larger, coefficient by coefficient, of what white residuals would give and of a sandwich over blocks, which
        does not need them white, and counts the error of the noise that is taken off as well; coefficients at a bound
        count as free, those that were given have none.
        """
        own = self._known(fit.columns[: len(self.own)])[0]
        fitted = np.setdiff1d(np.arange(len(fit.columns)), fit.fixed)
        prior = np.concatenate([own, np.zeros(len(fit.columns) - len(own))])[fitted]
        index = [fit.columns[i] for i in fitted]
        posterior = self.normal.total[np.ix_(index, index)] + np.diag(prior)
        scaled, scale = steadied(posterior, prior)
        inverse = np.linalg.inv(scaled) * np.outer(scale, scale)
        scores = self.normal.scores(fit.columns, fit.beta)[:, fitted]
        scores = scores - scores.mean(0)  # their sum is what the priors and bounds pull
        blocks = len(scores)
        meat = scores.T @ scores * (blocks / max(1, blocks - 1)) + np.diag(prior)
        meat += self.normal.drawn_meat(fit.columns, fit.beta)[np.ix_(fitted, fitted)]
        white = inverse * max(1.0, fit.misfit / max(1, self.normal.rows - len(index)))
        sandwich = inverse @ meat @ inverse
        wider = np.sqrt(np.maximum(np.diag(sandwich) / np.maximum(np.diag(white), 1e-300), 1.0))
        out = np.zeros((len(fit.columns), len(fit.columns)))
        out[np.ix_(fitted, fitted)] = white * np.outer(wider, wider)
        return out


def acting(gains: np.ndarray) -> set[int]:
    """The channels in which an effect acts that gains this much in each (channels,)."""
    return {int(c) for c in np.flatnonzero(gains > VERIFYING.acts * gains.sum())}


def t_value(gains: np.ndarray) -> float:
    """Mean of the gains (blocks,) over its standard error."""
    if len(gains) < 2:
        return 0.0
    return float(gains.mean()) / max(float(gains.std(ddof=1)) / len(gains) ** 0.5, 1e-12)


def drowned(
    linear: Linearization, normal: Normal, noise: np.ndarray, by_channel: np.ndarray
) -> tuple[frozenset[int], frozenset[int]]:
    """Columns that are mostly noise, and the places of the channels in which the model's own numbers are.

    Args:
        linear: the model.
        normal: rows from which no noise was taken off.
        noise: (channels, c + 1, c + 1) what it makes of the products of all rows.
        by_channel: (channels, c + 1) power of every column.
    """
    power = by_channel.sum(0)[:-1]
    mostly = noise.sum(0).diagonal()[:-1] > SEARCHING.buried * power
    buried = frozenset(np.flatnonzero(mostly).tolist())
    buried -= _acting(Subsets(linear, normal), buried, noise, by_channel)
    hidden = [c for c in buried if c < len(linear.own)]
    return buried, frozenset(i for c in hidden for i in np.flatnonzero(by_channel[:, c] > 0.1 * power[c]).tolist())


def _acting(subsets: Subsets, buried: Collection[int], noise: np.ndarray, power: np.ndarray) -> frozenset[int]:
    """Columns of effects that explain more than all noise of the inputs could that the model's own numbers let in.

    What was taken for noise moves the vehicle then: a controller that acts on a noisy sensor makes inputs as lively.

    Args:
        subsets: of rows from which no noise was taken off.
        buried: columns that are mostly noise of the inputs.
        noise: (channels, c + 1, c + 1) what it makes of the products of all rows.
        power: (channels, c + 1) of every column.
    """
    bare = subsets.fit()
    index = [*bare.columns, -1]
    vector = np.append(-bare.beta, 1.0)
    left = np.array([vector @ of[np.ix_(index, index)] @ vector for of in noise])
    found: set[int] = set()
    for start in (s for s in subsets.starts if set(s.columns) & set(buried)):
        own = start.columns[len(start.columns) - len(start.entries) :]
        acts = power[:, own].any(1)
        if bare.loss - subsets.fit([start]).loss > left[acts].sum() + subsets.penalty * len(own):
            found |= set(own)
    return frozenset(found)
