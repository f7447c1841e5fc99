"""How many effects, and which: best subsets, each larger one paid for on recordings that were not fitted."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bench.analysis.stats import uneven_gain
from bench.diagnose.regression.linearise import Candidate
from bench.diagnose.regression.parameters import with_values
from bench.diagnose.select.search import View
from bench.diagnose.select.subset import Fit, t_value
from bench.diagnose.settings import CHOOSING, VERIFYING
from registry.dynamics import PhysicsModel


@dataclass(frozen=True)
class RejectedCandidate:
    """A candidate that was not taken, in one round."""

    id: str
    gain: float
    """Share of what the round could explain, 0 to 1."""
    low: float
    high: float
    text: str
    """Its parameters."""
    why: str


def choose(view: View) -> tuple[Fit, list[list[Fit]]]:
    """The set of effects to add to a view's model, and by size the sets it was chosen from.

    Sets are compared by loss and number of parameters; a larger one must gain on recordings not fitted.
    """
    subsets, starts = view.subsets, view.subsets.starts
    taken, fields = subsets.fit(), [[subsets.fit()]]
    among: Sequence[Candidate] = starts
    promising: dict[tuple[str, ...], Candidate] = {}
    for size in range(1, CHOOSING.most + 1):
        grown = _grown(view, fields[-1][0]) if size > 2 else []
        if size > CHOOSING.largest:
            field = grown
        else:
            among = [*among, *(f.starts[-1] for f in grown if f.starts[-1] not in among)]
            field = subsets.best(size, among, list(promising.values()) if size == 2 else ())
        if not field:
            break
        fields.append(field)
        if size == 1:
            promising = {s.ids: s for f in field for s in f.starts}
        larger = next((f for f in field if within_bounds(view, f) and accepted(view, taken, f)), None)
        if larger is not None:
            larger = _simplest(view, larger, field)
        if larger is None and size >= 2:
            break
        taken = larger or taken
        if size == 2:
            best: dict[tuple[str, ...], Candidate] = {}
            for s in (s for f in field for s in f.starts):
                best.setdefault(s.ids, s)
            among = list(best.values())[:10]
    return taken, fields


def _grown(view: View, fit: Fit) -> list[Fit]:
    """The best sets of one effect more than ``fit``, of every other effect its best start, best first.

    They hold what shows only beside the others, and so in no smaller set.
    """
    known, best = set(fit.ids), dict[tuple[str, ...], Fit]()
    for s in view.subsets.starts:
        if known.isdisjoint(s.ids):
            larger = view.subsets.fit((*fit.starts, s))
            if s.ids not in best or larger.loss < best[s.ids].loss:
                best[s.ids] = larger
    return sorted(best.values(), key=view.subsets.cost)[:5]


def within_bounds(view: View, fit: Fit) -> bool:
    """Whether no parameter of the added effects is pushed to a bound that is not its neutral value."""
    return all(s.within_bounds(beta) for s, beta in fit.numbers(len(view.linear.own)))


def _simplest(view: View, best: Fit, field: list[Fit]) -> Fit:
    """The set with the fewest parameters among those of a field that are not worse than the best for sure.

    How much that is counts in each channel by itself: beside a large drag what an effect adds to the torques is a small
    share of everything, and may be much of what is explained there.
    """
    subsets = view.subsets
    level = subsets.losses(best)
    explained = np.maximum((subsets.losses(subsets.fit()) - level).sum(0), 0.0)
    everything = max(sum(view.explained.values()), subsets.fit().misfit - best.misfit)
    small = np.maximum(CHOOSING.relevant * explained, CHOOSING.visible * view.floor / len(explained))

    def alike(f: Fit) -> bool:
        # Where the model is exact a small difference is sure; where it is not, the blocks disagree.
        more = subsets.losses(f) - level
        t, worse = t_value(more.sum(1)), subsets.cost(f) - subsets.cost(best)
        trifling = worse < CHOOSING.relevant * everything and bool((more.sum(0) < small).all())
        return f.parameters < best.parameters and (
            (t < CHOOSING.surely and trifling) or (t < CHOOSING.distinct and worse < CHOOSING.simpler * best.misfit)
        )

    rivals = [f for f in field if alike(f) and within_bounds(view, f)]
    return min(rivals, key=lambda f: (f.parameters, f.loss), default=best)


def accepted(view: View, smaller: Fit, larger: Fit, drop: Sequence[int] = ()) -> bool:
    """Whether the larger set is worth its additional parameters; ``drop`` belongs to the smaller one."""
    subsets = view.subsets
    gained, relief = smaller.misfit - larger.misfit, smaller.prior - larger.prior
    price = subsets.penalty * (larger.parameters - smaller.parameters)
    if gained + relief <= price:
        return False
    if gained > -CHOOSING.doubted and gained + relief > price + CHOOSING.doubted and relief > CHOOSING.doubted:
        return True  # constants that would otherwise lie far outside what is known of them
    if price <= 0 and gained > 0:
        return True
    left = smaller.misfit - view.floor
    clears = left > view.floor and gained > CHOOSING.clearing * left
    there = view.explained_where((subsets.losses(smaller) - subsets.losses(larger)).sum(0))
    if gained < CHOOSING.relevant * there and not clears:
        return False
    saved = (subsets.held_out(smaller.starts, drop=drop) - subsets.held_out(larger.starts)).sum(1)
    # A large effect acts where the manoeuvre is, so its gains are as uneven as they are sure: their logarithm is not.
    levels = np.log(np.maximum(subsets.losses(smaller).sum(1), 1e-9) / np.maximum(subsets.losses(larger).sum(1), 1e-9))
    sure = max(t_value(saved), t_value(levels))
    everywhere = all(saved[subsets.normal.fold == f].sum() > 0 for f in np.unique(subsets.normal.fold))
    # Beside noise that is fast and large, what is slow gains little, however much of a forecast it is: where every
    # recording confirms it, forecasts are asked (`worthy`).
    if gained < CHOOSING.visible * view.floor and not (everywhere and sure > CHOOSING.significant):
        return False
    if everywhere and gained > CHOOSING.large * view.floor:
        return True  # from few manoeuvres, but from some of every recording
    if saved.sum() <= 0 or sure > CHOOSING.significant:
        return bool(saved.sum() > 0)
    plain = gained > CHOOSING.plain * view.floor
    return plain and (sure > CHOOSING.sure or uneven_gain(saved) > 0)


def select_across_views(views: Sequence[View]) -> tuple[View, Fit, list[list[Fit]]]:
    """The choice with the inputs' noise taken off, less what would not be chosen with the inputs as they are."""
    view = views[0]
    fit, fields = choose(view)
    if len(views) > 1 and view.overcorrected(fit):
        return select_across_views(views[1:])
    for other in views[1:]:
        subsets, kept = other.subsets, list(fit.starts)
        for s in fit.starts:
            rest = [r for r in kept if r is not s]
            if not accepted(other, subsets.fit(rest), subsets.fit(kept)):
                kept = rest
        fit = view.subsets.fit(kept)
    # The view whose constants lie nearest to what is known of them.
    nearest = min(views, key=lambda v: v.subsets.fit(fit.starts).prior)
    return nearest, nearest.subsets.fit(fit.starts), fields


def updated(view: View, fit: Fit) -> PhysicsModel:
    """The view's model with the fit's numbers and effects."""
    own = view.linear.own
    values = np.array([np.clip(e.value + b, e.low, e.high) for e, b in zip(own, fit.beta, strict=False)])
    model = with_values(view.linear.model, own, values)
    added = fit.effects(len(own)).values()
    return replace(model, effects=(*model.effects, *added))


def compared(view: View, fit: Fit, fields: list[list[Fit]]) -> tuple[tuple[RejectedCandidate, ...], ...]:
    """By size, the sets that the chosen one was taken from."""
    return tuple(_round(view, field, chosen) for field, chosen in zip(fields[1:], _chain(fit, fields), strict=False))


def _chain(fit: Fit, fields: list[list[Fit]]) -> list[Fit]:
    """By size, the set of the field that leads to the chosen one."""
    out = []
    for field in fields[1:]:
        inside = [f for f in field if set(f.ids) <= set(fit.ids)]
        out.append(inside[0] if inside else field[0])
    return out


def _round(view: View, field: list[Fit], chosen: Fit) -> tuple[RejectedCandidate, ...]:
    """The sets of one size, as a reader compares them."""
    subsets = view.subsets
    base = subsets.fit()
    scale = max(base.loss - view.floor, 1.0)
    base_blocks, level = subsets.losses(base).sum(1), subsets.losses(chosen).sum(1)
    unit, out = view.linear.model.effect_unit, []
    for f in sorted(field, key=lambda f: -(f is chosen))[:8]:
        blocks = subsets.losses(f).sum(1)
        gains = base_blocks - blocks
        half = 1.96 * float(gains.std(ddof=1)) * len(gains) ** 0.5 if len(gains) > 1 else 0.0
        share = (base.loss - f.loss) / scale
        margin, t = subsets.cost(f) - subsets.cost(chosen), t_value(blocks - level)
        text = "; ".join(
            f"{i}: "
            + ", ".join(f"{p.name} = {p.value:.3g} {unit(p.unit)}" for p in e.parameters() if p.uncertainty > 0)
            for i, e in f.effects(len(subsets.own)).items()
        )
        if f is chosen:
            why = ""
        elif margin < VERIFYING.odds:
            why = f"explains as much, with {f.parameters} parameters against {chosen.parameters}"
        else:
            rest = max(f.misfit - view.floor, 0.0) / view.floor
            why = f"leaves {rest:.2g} times the noise unexplained (t = {t:.1f} against the best)"
        low, high = share - half / scale, share + half / scale
        out.append(RejectedCandidate(id=" + ".join(f.ids), gain=share, low=low, high=high, text=text, why=why))
    return tuple(out)
