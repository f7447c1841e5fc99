"""Step 4: add effects to a model, fit all of it, and show the error on recordings not fitted."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from bench.analysis.display import Displayed
from bench.diagnose.compare import Comparison, compare, refuse_long
from bench.diagnose.evidence import Stage
from bench.diagnose.fit import fit_parameters, released, started
from bench.diagnose.learn.all_terms import learn_all_terms
from bench.diagnose.learn.candidates import equation_of
from bench.diagnose.learn.learn import learn
from bench.diagnose.learn.modes.modes import modes
from bench.diagnose.learn.request import is_request, parsed
from bench.diagnose.learn.spectral_line import Line
from bench.diagnose.learn.waves import periodic, told, waves
from bench.diagnose.learned_shape import RELAXATION, SWING, WAVE
from bench.diagnose.logs.load import subject_of
from bench.diagnose.logs.noise import Noise
from bench.diagnose.logs.parts import refuse_short
from bench.diagnose.logs.subject import Subject
from bench.diagnose.regression.parameters import effect_entries
from bench.diagnose.report import learned_words
from bench.diagnose.result import ByGroup, NamedEffect
from bench.diagnose.select.timing.reading import prepared
from bench.diagnose.select.verify import Estimate
from bench.diagnose.settings import MATTERING
from bench.diagnose.simulate.unmeasured import hidden
from bench.diagnose.summaries import parameter_estimates
from registry.contracts import Dataset
from registry.core import EFFECTS
from registry.dynamics import Effect, PhysicsModel, unsuited
from registry.effects.learned_term import LearnedTerm
from registry.effects.waves.hidden_mode import HiddenMode
from registry.effects.waves.periodic_term import PeriodicTerm
from registry.errors import BenchError

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True, eq=False)
class Extension(Displayed):
    """A model with effects added, and its errors."""

    model: PhysicsModel
    effects: tuple[NamedEffect, ...]
    """The added ones, in order."""
    comparison: Comparison
    """Lines "nominal", "calibrated", "+ id" after each effect, "extended", "floor", and that of an observer."""
    stages: tuple[Stage, ...]
    constants: tuple[Estimate, ...]
    calibrated: float
    """Share of the squared error above the floor that calibration takes before any effect."""
    notes: tuple[str, ...] = ()
    """On inputs that are read at another time than filed, and on stated constants that recordings contradict."""

    @property
    def last(self) -> ByGroup:
        """Error of ``model``."""
        return self.comparison.error("extended" if self.effects else "calibrated")

    @property
    def headline(self) -> str:
        """How far the error falls."""
        steps = {s.name: ", ".join(f"{g} {e:.3g}" for g, e in s.error.items()) for s in self.stages}
        return "Held-out rms error: " + "; ".join(f"{name}: {error}" for name, error in steps.items())

    def to_frame(self) -> pd.DataFrame:
        """One row a stage and group of outputs: "nominal", "calibrated", each effect added, "floor".

        Returns:
            stage, group, rmse (in the unit named, SI), unit, horizon_s.
        """
        units, horizon = {g.name: g.unit for g in self.comparison.groups}, self.comparison.horizon_s[-1]
        return pd.DataFrame(
            [(s.name, g, e, units[g], horizon) for s in self.stages for g, e in s.error.items()],
            columns=["stage", "group", "rmse", "unit", "horizon_s"],
        )

    def plot(self) -> "list[Axes]":
        """Error against the horizon, model by model: matplotlib axes, one a group of outputs."""
        return self.comparison.plot()


def extend(
    subject: str | Path | Dataset | Subject,
    model: PhysicsModel,
    add: str | Sequence[str | Effect],
    tick: Callable[[str], None] = lambda what: None,
    noise: Noise | None = None,
    rivals: Mapping[str, tuple[str, ...]] | None = None,
    start: PhysicsModel | None = None,
    horizon_s: float | None = None,
) -> Extension:
    """Add effects to ``model`` and fit all numbers again, with stated constants let go that recordings contradict.

    Args:
        subject: measurements, and the nominal model; or the folder or name that `load` reads.
        model: with the effects it has so far.
        add: an id or several of effects, learned terms, or what asks for such: "learned", "force_z ~ height".
        tick: called with what is being done.
        noise: default `noise.noise_of`.
        rivals: by id, effects that explain the data as well.
        start: ``model`` with all of ``add`` (effects and terms, no requests) in that order, its numbers near where they
            belong: the last fit starts there, since constants that were fitted without an effect may be too far off;
            default: the ids before the first term or request at the best of their search grids in one regression of
            all of them, what follows, or all where a state is not measured, one after another.
        horizon_s: longest horizon of the comparison [s].

    Raises:
        BenchError: an effect that the catalogue or the system does not have, the model has already, or is given twice;
            a term that cannot be learned.
    """
    subject, add = subject_of(subject), [add] if isinstance(add, str) else add
    refuse_short(subject)
    refuse_long(subject, horizon_s)
    subject, noise = prepared(subject, noise, tick)
    _check_added(subject, model, add)
    if start is None and (ids := _leading_ids(add)) and not hidden(subject.logs):
        subject, start = released(*started(subject, model, ids, noise, tick), noise, tick)
    chain = _Chain(*fit_parameters(subject, model, noise, tick, through_simulator=not add))
    given = () if start is None else start.effects[len(model.effects) :]
    for i, item in enumerate(add):
        added = [given[i]] if i < len(given) else _starts(subject, chain.model, item, noise, tick, model)
        for j, effect in enumerate(added):
            last = i == len(add) - 1 and j == len(added) - 1
            grown = replace(chain.model, effects=(*chain.model.effects, effect))
            whole = start if start is not None and i == len(given) - 1 else grown
            chain.append(*fit_parameters(subject, whole, noise, tick, through_simulator=last))
    comparison = compare(subject, chain.lines(), noise=noise, horizon_s=horizon_s)
    if _errs_more_on_the_way(subject, chain, comparison):
        chain.models = _better_on_the_way(subject, chain, len(model.effects), noise)
        comparison = compare(subject, chain.lines(), noise=noise, horizon_s=horizon_s)
    lines = {
        i: told(subject, chain.model, noise, i)
        for i, e in enumerate(chain.model.effects)
        if isinstance(e, PeriodicTerm)
    }
    return _extension(subject, chain, comparison, first=len(model.effects), rivals=rivals or {}, lines=lines)


def ordered(model: PhysicsModel, known: int, names: Sequence[str]) -> PhysicsModel:
    """``model`` with its first ``known`` effects, and after them those of these names in their order."""
    own = {EFFECTS.name_of(type(e)): e for e in model.effects[known:]}
    return replace(model, effects=(*model.effects[:known], *(own[n] for n in names)))


class _Chain:
    """A model as it grows, effect by effect."""

    def __init__(self, calibrated: PhysicsModel, numbers: list[Estimate]) -> None:
        self.models, self.numbers = [calibrated], numbers

    @property
    def model(self) -> PhysicsModel:
        """The last one."""
        return self.models[-1]

    def append(self, model: PhysicsModel, numbers: list[Estimate]) -> None:
        """Add the model with one effect more, and what was estimated of it."""
        self.models.append(model)
        self.numbers = numbers

    def lines(self) -> dict[str, PhysicsModel]:
        """By the name of its line in a comparison."""
        names = ["calibrated", *(f"+ {i}" for i in range(1, len(self.models)))]
        if len(names) > 1:
            names[-1] = "extended"
        return dict(zip(names, self.models, strict=True))


def _errs_more_on_the_way(subject: Subject, chain: _Chain, comparison: Comparison) -> bool:
    """Whether free runs are worse with an effect more, before all are there."""
    squared = squared_errors(subject, comparison, chain.lines())
    return any(b > a for a, b in pairwise([*squared.values()][:-1]))


def _better_on_the_way(subject: Subject, chain: _Chain, known: int, noise: Noise) -> list[PhysicsModel]:
    """The models of ``chain``; one on the way is the last one without what is added later where free runs are better.

    The weak form fits a model that lacks something to what is between two samples, which a free run may not survive.
    Chosen on the recordings that are learnt from.
    """
    last, out = chain.model, list(chain.models)
    cut = {i: replace(last, effects=last.effects[: known + i]) for i in range(1, len(out) - 1)}
    both = {f"weak {i}": out[i] for i in cut} | {f"cut {i}": m for i, m in cut.items()}
    squared = squared_errors(subject, compare(subject, both, names=subject.training, noise=noise), both)
    for i, model in cut.items():
        if squared[f"cut {i}"] < squared[f"weak {i}"]:
            out[i] = model
    return out


def _leading_ids(add: Sequence[str | Effect]) -> list[str]:
    """The ids of effects before the first term or request for one."""
    ids: list[str] = []
    for item in add:
        if isinstance(item, Effect) or is_request(item):
            break
        ids.append(item)
    return ids


def _check_added(subject: Subject, model: PhysicsModel, add: Sequence[str | Effect]) -> None:
    """Raise `BenchError` for what cannot be added to ``model``."""
    held = [EFFECTS.name_of(type(e)) for e in model.effects]
    for name in add:
        if isinstance(name, Effect):
            continue
        if is_request(name):
            parsed(name, subject.model)
            continue
        if name in held:
            raise BenchError(f"The model has {name} already.")
        if add.count(name) > 1:
            raise BenchError(f"{name} is given twice: an effect is added once.")
        kind = EFFECTS.get(name)
        if kind.learned:
            raise BenchError(
                f'{name} holds what was learned from recordings: "learned" in its place seeks what is there, '
                '"AXIS ~ SIGNAL" a term that is suspected.'
            )
        if not kind.suits(type(subject.model)):
            raise BenchError(unsuited(name, kind, type(subject.model)))


def _extension(
    subject: Subject,
    chain: _Chain,
    comparison: Comparison,
    first: int,
    rivals: Mapping[str, tuple[str, ...]],
    lines: Mapping[int, Line | None],
) -> Extension:
    """What each effect from the ``first`` on takes of the error, in the order in which they were added."""
    order = list(chain.lines())
    squared = squared_errors(subject, comparison, ("nominal", *order, "floor"))
    taken, *shares = shares_of([squared[n] for n in ("nominal", *order)], squared["floor"])
    effects = tuple(
        _named(
            effect,
            chain.model,
            [x for x in chain.numbers if x.entry.owner == first + i],
            share=share,
            before=comparison.error(order[i]),
            after=comparison.error(order[i + 1]),
            rivals=rivals,
            line=lines.get(first + i),
        )
        for i, (effect, share) in enumerate(zip(chain.model.effects[first:], shares, strict=True))
    )
    stages = [stage(n, comparison.error(n)) for n in ("nominal", "calibrated")]
    stages += [stage(e.name, e.error_after) for e in effects]
    return Extension(
        model=chain.model,
        effects=effects,
        comparison=comparison,
        stages=(*stages, stage("floor", comparison.error("floor"))),
        constants=tuple(x for x in chain.numbers if x.entry.constant),
        calibrated=taken,
        notes=subject.notes,
    )


def _starts(
    subject: Subject,
    model: PhysicsModel,
    item: str | Effect,
    noise: Noise,
    tick: Callable[[str], None],
    given: PhysicsModel,
) -> list[Effect]:
    """The effects that one item of `extend` adds to ``model``, with parameters from which a fit starts.

    ``given`` is the model before its constants were calibrated, and before anything was added.
    """
    if isinstance(item, Effect):
        return [item]
    if is_request(item):
        asked = parsed(item, model)
        if asked is None:
            terms = learn_all_terms(subject, model, noise, tick, much=_errs_much(subject, (given, model), noise))
        elif asked.signals[0] in (SWING, RELAXATION):
            order = 2 if asked.signals[0] == SWING else 1
            terms = tuple(m for m in modes(subject, model, noise) if m.order == order and asked.axis in m.axes)
        elif asked.signals == (WAVE,):
            terms = tuple(periodic(line) for line in waves(subject, model, noise) if line.axis == asked.axis)
        else:
            terms = learn(subject, model, noise, tick, asked)
        if not terms:
            raise BenchError("Nothing is left that held-out recordings would confirm as a term: none is learned.")
        return list(terms)
    tick(item)
    return [started(subject, model, [item], noise, tick)[1].effects[-1]]


def _errs_much(subject: Subject, models: Sequence[PhysicsModel], noise: Noise) -> bool:
    """Whether free runs of the best of some models err so far above the noise that a hidden mode is worth a search."""
    comparison = compare(subject, {str(i): m for i, m in enumerate(models)}, noise=noise)
    errors = [comparison.error(str(i)) for i in range(len(models))]
    floor = comparison.error("floor")
    return any(min(e[g].rmse for e in errors) > MATTERING.lost * floor[g].rmse for g in floor)


def _named(
    effect: Effect,
    model: PhysicsModel,
    found: Sequence[Estimate],
    share: float,
    before: ByGroup,
    after: ByGroup,
    rivals: Mapping[str, tuple[str, ...]],
    line: Line | None,
) -> NamedEffect:
    """An effect that was added to ``model``, with what was estimated of it; of a wave what its ``line`` says."""
    name = EFFECTS.name_of(type(effect))
    # Where it acts nowhere any more, such as above what a signal reaches or much faster than samples, nothing was
    # estimated.
    untold = (Estimate(e, e.value, e.low, e.high) for e in effect_entries(effect, owner=0))
    numbers = parameter_estimates([*untold]) | parameter_estimates(found)
    if isinstance(effect, LearnedTerm):
        term, numbers = learned_words.described(effect, model, list(numbers.values()))
        return NamedEffect(
            name, numbers, share, before, after, acts_on=equation_of(model, effect.axis), learned=True, term=term
        )
    if isinstance(effect, HiddenMode):
        term, numbers = learned_words.described_mode(effect, model, numbers)
        where = equation_of(model, effect.axes[0])
        return NamedEffect(name, numbers, share, before, after, acts_on=where, learned=True, term=term)
    if isinstance(effect, PeriodicTerm) and line is not None:
        term, numbers, single = learned_words.described_wave(line, model)
        wave = NamedEffect(name, numbers, share, before, after, learned=True, term=term, by_recording=single)
        return replace(wave, acts_on=equation_of(model, effect.axis))
    alike = rivals.get(name, ())
    return NamedEffect(
        name, numbers, share, before, after, indistinguishable_from=alike, separate_by=_separate(name, alike)
    )


def shares_of(squared: Sequence[float], floor: float) -> list[float]:
    """What each step after the first takes of the squared error above the floor, NaN where there is none.

    Calibrated to other recordings, constants may make it worse: effects that take that back take no more than all.

    Args:
        squared: of the nominal model, the calibrated one, and with one effect more each.
        floor: squared error below which it falls by chance only.
    """
    above, pairs = max(squared[:2]) - floor, pairwise(squared)
    gone = (a - (max(b, floor) if a > floor else b) for a, b in pairs)
    return [g / above if above > 0 else float("nan") for g in gone]


def squared_errors(subject: Subject, comparison: Comparison, names: Iterable[str]) -> dict[str, float]:
    """By model, the squared error of its free runs over scaled outputs."""
    scale = _scales(subject, comparison)
    return {name: pooled(comparison.error(name), scale) for name in names}


def pooled(error: ByGroup, scale: dict[str, float]) -> float:
    """Squared error over scaled outputs."""
    return float(sum((e.rmse / scale[g]) ** 2 for g, e in error.items()))


def _scales(subject: Subject, comparison: Comparison) -> dict[str, float]:
    """By group, how much it varies over the held-out recordings."""
    out = {}
    for g in comparison.groups:
        x = np.concatenate([log.states.numpy()[:, list(g.at)] for log in subject.of(comparison.recordings)])
        out[g.name] = float(np.sqrt(((x - x.mean(0)) ** 2).sum(1).mean())) or 1.0
    return out


def stage(name: str, error: ByGroup) -> Stage:
    """A step of the waterfall."""
    return Stage(name, {g: e.rmse for g, e in error.items()})


def _separate(name: str, rivals: Sequence[str]) -> str:
    """What to fly or do so that an effect and its rivals part."""
    if not rivals:
        return ""
    phrase: str = EFFECTS.get(name).manoeuvre or EFFECTS.get(rivals[0]).manoeuvre
    return f"To tell {name} from {', '.join(rivals)}: {phrase}." if phrase else ""
