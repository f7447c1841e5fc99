"""What a search for missing effects has learnt."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import pandas as pd

from bench.analysis.display import Displayed, draw_bars, new_axes
from bench.diagnose.by_equation import InverseDynamics, ObscuredConstant
from bench.diagnose.result import effect_frame
from bench.diagnose.select.choose import RejectedCandidate
from bench.diagnose.select.verify import Estimate, Ratio, ResidualTerm
from bench.diagnose.settings import MATTERING
from bench.diagnose.simulate.equation_error import EquationError, Saving
from registry.core import EFFECTS
from registry.dynamics import Effect, PhysicsModel

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True, eq=False)
class Found:
    """An effect that the model lacks."""

    id: str
    effect: Effect
    estimates: tuple[Estimate, ...]
    gain: float
    """Squared whitened residual that it saves, given the others."""
    rivals: tuple[str, ...]
    """Effects that explain the data as well."""
    savings: tuple[Saving, ...] = ()
    """What it saves on held-out recordings, equation by equation."""

    @property
    def share(self) -> float:
        """The largest share that it saves of what can be explained in an equation; 0 where none was judged."""
        return max((s.share for s in self.savings if s.matters), default=0.0)


def supported(ids: Sequence[str], model: PhysicsModel) -> list[str]:
    """Those of some effects, in order, whose needs the others or ``model`` meet: wind acts through a drag."""
    left = list(ids)
    while True:
        there = {*left, *model.provides, *(EFFECTS.name_of(type(e)) for e in model.effects)}
        kept = [i for i in left if EFFECTS.get(i).met_by(there)]
        if len(kept) == len(left):
            return kept
        left = kept


def needs_first(found: Sequence[Found]) -> tuple[Found, ...]:
    """In order, but each after what it needs, if that is among them: effects are added one after another."""
    rest, out = list(found), list[Found]()
    while rest:
        waiting = [f for f in rest if {o.id for o in rest} & set(EFFECTS.get(f.id).requires)]
        ready = next(f for f in rest if f not in waiting or len(waiting) == len(rest))
        out.append(ready)
        rest.remove(ready)
    return tuple(out)


@dataclass(frozen=True, eq=False)
class Discovery(Displayed):
    """What was learnt."""

    calibrated: PhysicsModel
    """The given model with constants fitted within their uncertainty."""
    model: PhysicsModel
    """With the effects found."""
    found: tuple[Found, ...]
    rounds: tuple[tuple[RejectedCandidate, ...], ...]
    traces: tuple[ResidualTerm, ...]
    constants: tuple[Estimate, ...]
    ratios: tuple[Ratio, ...] = ()
    confounders: tuple[str, ...] = ()
    """Effects that would imitate what is left, and were not named."""
    faint: tuple[ResidualTerm, ...] = ()
    """What the rest goes with where all of it is too little to say that something is left."""
    notes: tuple[str, ...] = ()
    """What was done, in sentences."""
    equations: tuple[EquationError, ...] = ()
    """Held-out errors equation by equation."""
    along_axes: tuple[EquationError, ...] = ()
    """The same along the axes of every equation."""
    remarks: tuple[str, ...] = ()
    """Sentences about what is there and is not worth a term."""
    contradicted_effects: tuple[str, ...] = ()
    """Effects that the training recordings are sure of and held-out ones contradict; not named."""
    uncertainty: Mapping[str, float] = field(default_factory=dict)
    """Relative 1σ of constants as stated, and of those that were let go; see `select.release`."""
    stated: Mapping[str, float] | None = None
    """The same before any was let go; None: none is ever, where sets are compared by simulation."""
    memory: int | None = None
    """Order of the autoregression that whitened the rows; see `select.search`."""
    long_windows: bool = False
    """Whether the rows are as long as a free run."""
    obscured: tuple[ObscuredConstant, ...] = ()
    """Constants of which these recordings say nothing that could be believed."""
    let_go: Mapping[str, str] = field(default_factory=dict)
    """The constants that were let go, each with the equation that it acts in most."""
    inverse: InverseDynamics | None = None
    """What the input works against where it seems to do nothing."""

    @property
    def verdict(self) -> str:
        """The first that holds: "named", "tie", "unknown_effect" or "nothing"."""
        if any(not f.rivals for f in self.found):
            return "named"
        if self.found:
            return "tie"
        return "unknown_effect" if self.traces else "nothing"

    @property
    def headline(self) -> str:
        """The verdict, and what it is about."""
        left = [f"{t.axis} follows {t.signal}" for t in self.traces]
        return f"{self.verdict}: {', '.join([f.id for f in self.found] or left) or 'no effect is missing'}"

    def clearer(self, other: "Discovery") -> bool:
        """Whether it is to be believed in place of another one, by errors on held-out recordings.

        It saves an equation that the other one loses, other than by a constant that only it let go (a huge inertia errs
        little where a controller holds a vehicle), and loses none, for what nobody understands errs a little more or
        less in any answer; or it names what the other one chose and then took for an imitation, every equation is
        better and none is lost; or the other one leaves nothing that asks for an explanation, this one saves what
        matters where its effects act, be it along one axis, nothing is worse, and it says something else. Whitened rows
        are mostly what a controller answers where that works against something light: its inertia grows, and what
        resists looks small.
        """
        pairs = list(zip(self.equations, other.equations, strict=True))
        ratios = [mine.models["extended"] / max(its.models["extended"], 1e-300) for mine, its in pairs]
        sought = not other.found and {f.id for f in self.found} <= set(other.confounders)
        if sought and max(ratios) < 1 / MATTERING.near and not any(e.lost for e in self.equations):
            return True
        settled = not other.traces and not any(e.lost for e in other.equations)
        acts = {(s.equation, s.axis) for f in self.found for s in f.savings if s.worth}
        axes = zip(self.along_axes, other.along_axes, strict=True)
        better = any(mine.better(its) for mine, its in (*pairs, *axes) if (mine.equation, mine.axis) in acts)
        if settled and better and not any(mine.worse(its) for mine, its in pairs):
            return not _agree(self, other)
        saved = 1 / MATTERING.lost
        freed = {equation for name, equation in self.let_go.items() if name not in other.let_go}
        told = [r for r, (mine, _) in zip(ratios, pairs, strict=True) if mine.equation not in freed]
        return min(told, default=1.0) < saved and math.prod(ratios) < saved and max(ratios) < MATTERING.lost

    def told_apart(self, other: "Discovery") -> "Discovery":
        """With those rivals only that another search, which names the same effects, has too.

        Whitened rows of short windows show little of what is slow, and few moments of them may agree with a rival.
        """
        its = {f.id: f.rivals for f in other.found}
        if its.keys() != {f.id for f in self.found}:
            return self
        found = (replace(f, rivals=tuple(r for r in f.rivals if r in its[f.id])) for f in self.found)
        return replace(self, found=tuple(found))

    def to_frame(self) -> pd.DataFrame:
        """The effects found, one row a parameter.

        Returns:
            effect, parameter, value, low, high (95 %, SI), unit, share_explained (largest in one equation, 0 to 1),
            indistinguishable_from.
        """
        return effect_frame(
            (f.id, x.entry.label, x.value, x.low, x.high, x.entry.unit, f.share, f.rivals)
            for f in self.found
            for x in f.estimates
        )

    def plot(self) -> "Axes":
        """What each effect saves of an equation's squared error that can be explained, with 95 % intervals."""
        (axes,) = new_axes(1)
        rows = [(f"{f.id}, {s.axis or s.equation}", s) for f in self.found for s in f.savings]
        shares = {"share": [100 * s.share for _, s in rows]}
        limits = [[100 * getattr(s, end) for _, s in rows] for end in ("low", "high")]
        draw_bars(axes, [name for name, _ in rows], shares, "share of what can be explained [%]", limits)
        return axes


def _agree(one: Discovery, other: Discovery) -> bool:
    """Whether both name the same, with every number within the interval that the other one has of it."""
    a, b = ({(f.id, x.entry.label): x for f in d.found for x in f.estimates} for d in (one, other))
    return a.keys() == b.keys() and all(
        a[k].low <= b[k].value <= a[k].high and b[k].low <= a[k].value <= b[k].high for k in a
    )


def trifle(name: str, savings: Sequence[Saving]) -> str:
    """A remark on an effect that is not worth a term."""
    if not savings:
        return f"A trace of {name.replace('_', ' ')} shows; nothing held out confirms it: it does not act there."
    best = max(savings, key=lambda s: (s.matters, s.low))
    if not best.matters:
        return f"A trace of {name.replace('_', ' ')} shows where hardly anything can be explained: not worth a term."
    low, share, high = (f"{100 * x:.0f}".replace("-", "−") for x in (best.low, best.share, best.high))
    return (
        f"A trace of {name.replace('_', ' ')} shows; it saves {share} % ({low} to {high}) of what can be explained in "
        f"{best.equation} on held-out recordings: not worth a term, or not for sure."
    )


def faint_traces(traces: Sequence[ResidualTerm]) -> str:
    """A remark on what is left, significant and not worth a term."""
    signals = dict.fromkeys(t.signal.replace("_", " ") for t in traces[:2])
    return (
        f"A trace that follows {' and '.join(signals)} is left; less than {100 * MATTERING.share:.0f} % of what can be "
        "explained goes with it on held-out recordings: not worth a term."
    )
