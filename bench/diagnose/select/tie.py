"""What makes a tie: which effects would explain the recordings as well as one that was found.

Two kinds of evidence, and a rule for each: normal equations, where every state was measured, and sets of effects that
were simulated, where one was not. Thresholds: `Verifying`, and `Growing` of the second, in `bench.diagnose.settings`.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from bench.diagnose.regression.least_squares import equilibrium
from bench.diagnose.regression.linearise import Candidate
from bench.diagnose.regression.parameters import Entry
from bench.diagnose.select.search import View
from bench.diagnose.select.simulated.simulated_set import SimulatedSet
from bench.diagnose.select.subset import Fit, Subsets, t_value
from bench.diagnose.settings import CHOOSING, EXTENDING, GROWING, VERIFYING
from registry.core import EFFECTS

SAME = ({"rotor_gyroscopic_torque", "rotor_reaction_torque"},)
"""Effects that share a constant: not rivals of each other."""


def rivals(view: View, place: int) -> dict[str, Candidate]:
    """Effects that would explain the data as well as the one in this place of the model, the likeliest first.

    One of them makes a tie. It is as likely, within what blocks of the recordings differ; it gains most of what the
    effect gains; and where the effect leaves nothing but noise, it does not leave plainly more. Parameters count that
    differ from no effect: a torque of three axes of which two act is no larger than an offset of two. One that does
    what the effect does with more of them is no other explanation: four rotors that all lift too much are a scale.
    """
    known, current = view.subsets, view.subsets.fit()
    subsets = known.holding(current)
    own = EFFECTS.name_of(type(view.linear.model.effects[place]))
    level = subsets.losses(current).sum(1)
    best: dict[str, tuple[float, Candidate]] = {}
    without = known.cost(known.fit(drop=[place]))
    mine = {i: e for i, e in enumerate(view.linear.own) if e.owner == place}
    parameters = _acting(subsets, subsets.fit(), mine)

    def misses(other: Fit) -> bool:
        exact = current.misfit < VERIFYING.exact * view.floor
        return exact and other.misfit - view.floor > VERIFYING.loud * view.floor

    def replaces(s: Candidate) -> bool:
        gained = without - known.cost(known.fit([s], drop=[place]))
        return gained > VERIFYING.replaces * (without - known.cost(current))

    for s in subsets.starts:
        if s.through is not None or any({own, s.id} <= same for same in SAME):
            continue
        other = subsets.fit([s], drop=[place])
        worse, limit = other.loss - current.loss, VERIFYING.odds + _spread(subsets.losses(other).sum(1), level)
        if misses(other) or worse + subsets.penalty * (1 - parameters) >= limit:
            continue  # its parameters are costly to count
        first = len(view.linear.own) + len(s.columns) - len(s.entries)
        more = _acting(subsets, other, dict(enumerate(s.entries, first))) - parameters
        if more > 0 and spanned(known.normal.total, list(mine), s.columns):
            continue
        margin = worse + subsets.penalty * more
        if margin < min(limit, best.get(s.id, (np.inf, s))[0]) and replaces(s):
            best[s.id] = margin, s
    return {name: start for name, (_, start) in sorted(best.items(), key=lambda item: item[1][0])}


def spanned(gram: np.ndarray, columns: Sequence[int], by: Sequence[int]) -> bool:
    """Whether some columns are sums of others, by the products (columns, columns) of all."""
    own, others = list(columns), list(by)
    scale = equilibrium(gram.diagonal())
    products = gram * np.outer(scale, scale)
    sums = np.linalg.lstsq(products[np.ix_(others, others)], products[np.ix_(others, own)], rcond=1e-12)[0]
    left = products[np.ix_(own, own)] - products[np.ix_(own, others)] @ sums
    return bool(np.all(np.abs(left.diagonal()) < VERIFYING.spanned * products.diagonal()[own]))


def _spread(other: np.ndarray, level: np.ndarray) -> float:
    """By how much blocks (B,) may differ before one set counts as worse than another, which leaves ``level`` of them.

    Nothing where it leaves far more, and in every block, as their logarithms say: few moments, in which much happens,
    make nearly all of such a difference, and its spread over blocks is as large as itself then.
    """
    difference, floor = other - level, 1e-9
    if len(difference) < 2:
        return 0.0
    ratios = np.log(np.maximum(other, floor) / np.maximum(level, floor))
    if difference.sum() > CHOOSING.simpler * level.sum() and t_value(ratios) > CHOOSING.distinct:
        return 0.0
    return CHOOSING.distinct * float(difference.std(ddof=1)) * len(difference) ** 0.5


def _acting(subsets: Subsets, fit: Fit, entries: Mapping[int, Entry]) -> int:
    """How many parameters, by place in a fit, differ from no effect by more than chance; one at least."""
    spread = np.sqrt(np.maximum(np.diag(subsets.covariance(fit)), 0.0))
    away = [abs(e.value + fit.beta[i] - e.neutral) > EXTENDING.interval * spread[i] for i, e in entries.items()]
    return max(1, sum(map(bool, away)))


def does_as_well(other: SimulatedSet, taken: SimulatedSet) -> bool:
    """Whether another set of the same size explains windows as well as the one taken, or nearly."""
    margin = other.criterion(taken)
    return margin < VERIFYING.odds or (
        margin < GROWING.disputed * VERIFYING.odds and t_value(other.log_gain(taken)) < GROWING.sure
    )
