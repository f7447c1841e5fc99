"""What a diagnosis does about an effect that no catalogue has: it is learned, added and fitted, and drawn."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from bench.diagnose.compare import above_floor
from bench.diagnose.confirm import Setup, idle_effects
from bench.diagnose.extend import Extension, extend, ordered
from bench.diagnose.fit import fit_parameters
from bench.diagnose.learn.all_terms import learn_all_terms, left_by
from bench.diagnose.learn.curve import curve, nearest
from bench.diagnose.learn.learn import learn, worthy
from bench.diagnose.learn.modes.answered import answered
from bench.diagnose.learn.waves import folded
from bench.diagnose.learned_shape import LearnedCurve
from bench.diagnose.logs.noise import Noise
from bench.diagnose.logs.subject import Subject
from bench.diagnose.regression.linearise import Linearization
from bench.diagnose.regression.parameters import entries
from bench.diagnose.report import phrases
from bench.diagnose.report.learned_words import known_as
from bench.diagnose.result import NamedEffect, ParameterEstimate
from bench.diagnose.select.discovery import Discovery, Found, supported
from bench.diagnose.select.materiality import Weighing
from bench.diagnose.select.search import Search
from bench.diagnose.select.timing.reading import retimed
from bench.diagnose.settings import DECIDING, EXTENDING, MATTERING
from bench.diagnose.simulate.equation_error import EquationError
from bench.diagnose.simulate.unmeasured import hidden
from registry.core import EFFECTS
from registry.dynamics import Effect, InternalEffect, PhysicsModel
from registry.effects.learned_term import LearnedTerm
from registry.effects.waves.hidden_mode import HiddenMode
from registry.effects.waves.periodic_term import PeriodicTerm
from registry.terms.shapes import SHAPES, SPLINE


@dataclass(frozen=True, eq=False)
class Learned:
    """What was learned."""

    extension: Extension
    """The model with the terms."""
    subject: Subject
    """The measurements, with inputs read when they act beside these."""


def learned(
    subject: Subject,
    model: PhysicsModel,
    noise: Noise,
    *,
    found: Sequence[Found],
    named: Sequence[NamedEffect],
    tick: Callable[[str], None],
    horizon_s: float | None,
    filed: Subject,
    doubtful: bool,
    much: bool,
    little: bool = False,
) -> Learned | None:
    """The model with the terms that held-out recordings confirm; None: there are none, or free runs do not gain.

    Args:
        subject: measurements, and the nominal model.
        model: calibrated, with the effects of the catalogue that were found.
        noise: of the measurements.
        found: these effects; terms are added after them.
        named: these effects as they are fitted without terms.
        tick: called with what is being done.
        horizon_s: longest horizon of the comparison [s].
        filed: the measurements, with inputs as they were filed.
        doubtful: whether the search for effects did not say that something is left.
        much: whether free runs err so much still that it may be a hidden mode.
        little: whether they err so little that only what stands out of noise is sought.
    """
    read, terms = _sought(subject, model, noise, filed, tick, doubtful=doubtful, much=much, little=little)
    read_again, subject = read is not subject, read
    if not terms:
        return None
    names = [f.id for f in found]
    beside = _Beside(subject, model, noise, {f.id: f.rivals for f in found}, tick, horizon_s)
    done = beside(names, terms)
    idle = idle_effects(subject, done)
    if idle and not (_outdoes(done) or (read_again and _outdoes_given_the_past(subject, model, noise, terms, tick))):
        return None  # the terms only say in other words what a named effect says
    if idle:  # they imitated what is learned now
        names = supported([n for n in names if n not in idle], subject.model)
        done = beside(names, terms)
    pruned = _pruned(done, terms, named, lambda fewer: beside(names, fewer))
    return None if pruned is None else Learned(pruned, subject)


def _sought(
    subject: Subject,
    model: PhysicsModel,
    noise: Noise,
    filed: Subject,
    tick: Callable[[str], None],
    *,
    much: bool,
    doubtful: bool = False,
    little: bool = False,
) -> tuple[Subject, tuple[Effect, ...]]:
    """The terms that a model lacks, and the measurements, with inputs read when they act beside these."""
    terms = learn_all_terms(subject, model, noise, tick, doubtful=doubtful, much=much, little=little)
    if any(isinstance(t, HiddenMode) for t in terms) and subject.logs is not filed.logs:
        # A mode that nobody has added yet looks like an input that acts at another time.
        subject = retimed(filed, replace(model, effects=(*model.effects, *terms)), noise)
        terms = learn_all_terms(subject, model, noise, tick, doubtful=doubtful, much=much)
    return subject, terms


@dataclass(frozen=True)
class _Beside:
    """Adds terms after effects of the catalogue, and fits all."""

    subject: Subject
    model: PhysicsModel
    """With these effects, and perhaps more."""
    noise: Noise
    rivals: Mapping[str, tuple[str, ...]]
    tick: Callable[[str], None]
    horizon_s: float | None

    def __call__(self, names: Sequence[str], terms: Sequence[Effect]) -> Extension:
        """The extension with the effects of these ids and these terms."""
        base = self.subject.model
        whole = ordered(self.model, len(base.effects), names)
        start = replace(whole, effects=(*whole.effects, *terms))
        asked: list[str | Effect] = [*names, *terms]
        return extend(
            self.subject, base, asked, self.tick, self.noise, rivals=self.rivals, start=start, horizon_s=self.horizon_s
        )


def instead(run: Setup, found: Discovery, before: Extension, told: Learned | None, much: bool) -> Learned | None:
    """What is learned without the named effects that may only imitate it, where that forecasts better; else ``told``.

    Terms are learned with no effect of the equations in which something is left, and of these effects those are added
    again that save enough beside the terms. Training recordings choose, recordings held out confirm. What is known
    gives way to formulas and modes, not to a spline, which may be anything.

    Args:
        run: what most steps need.
        found: with the effects that free runs confirm.
        before: the model with these.
        told: what was learned beside them; None: nothing.
        much: whether the named effects leave so much that what they imitate may be a hidden mode.
    """
    subject, known = run.subject, len(run.subject.model.effects)
    doubted = _doubted(found, told, strained(subject, before.model))
    names = supported([f.id for f in found.found if f.id not in doubted], subject.model)
    doubted = [f.id for f in found.found if f.id not in names]
    if not doubted or not subject.held_out or hidden(subject.logs):
        return told
    run.tick("without what may be an imitation")
    bare = ordered(before.model, known, names)
    model, _ = fit_parameters(subject, bare, run.noise, run.tick, through_simulator=False)
    read, terms = _sought(subject, model, run.noise, run.filed, run.tick, much=much)
    if not terms:
        return told
    # What needs another effect that may go is not added again: without it more is left, and the first answer stands.
    own = ordered(before.model, known, [i for i in doubted if i in supported([*names, i], subject.model)]).effects[
        known:
    ]
    search = Search(read, (), run.tick, run.noise)
    with torch.no_grad():
        kept = worthy(read, run.noise, search, model, [*own, *terms], doubtful=False)
    if any(e is k for e in own for k in kept):  # beside the largest terms a small one was not sought
        grown = replace(model, effects=(*model.effects, *terms))
        terms = (*terms, *learn(read, grown, run.noise, run.tick))
        with torch.no_grad():
            kept = worthy(read, run.noise, search, model, [*own, *terms], doubtful=False)
    terms = tuple(t for t in terms if any(t is k for k in kept))
    again = {EFFECTS.name_of(type(e)) for e in own if any(e is k for k in kept)}
    names = supported([f.id for f in found.found if f.id in again or f.id not in doubted], subject.model)
    curved = any(isinstance(t, LearnedTerm) and t.shape == SPLINE for t in terms)
    if not terms or curved or len(names) == len(found.found):
        return told
    rivals = {f.id: f.rivals for f in found.found}
    beside = _Beside(read, before.model, run.noise, rivals, run.tick, run.horizon_s)
    pruned = _pruned(beside(names, terms), terms, (), lambda fewer: beside(names, fewer))
    if pruned is None:
        return told
    other = Learned(pruned, read)
    return other if _better(run, other, Learned(before, subject) if told is None else told, told is None) else told


def strained(subject: Subject, model: PhysicsModel) -> bool:
    """Whether calibration took a constant as far from what was stated as it may: it stands for something else."""
    return any(e.stopped(e.value) for e in entries(model, subject.uncertainty, subject.model))


def _doubted(found: Discovery, told: Learned | None, strained: bool = False) -> list[str]:
    """The effects that act in an equation in which something was learned, or else much is left; or all of them.

    One with states of its own is not doubted: free runs do not know how it begins, nor how a mode does that is learned.
    """
    mine = [f for f in found.found if not isinstance(f.effect, InternalEffect)]
    if not found.equations or strained:
        return [f.id for f in mine]
    left = {e.equation for e in found.equations if _much_left(e)}
    if told is not None:
        left = {e.acts_on for e in told.extension.effects if e.learned}
    return [f.id for f in mine if any(s.equation in left and s.worth for s in f.savings)]


def _much_left(error: EquationError) -> bool:
    """Whether an equation errs far above the noise floor still, and by more than a number slightly off would leave."""
    left, all_of_it = (error.models[m] ** 2 - error.floor**2 for m in ("extended", "calibrated"))
    high = error.models["extended"] > DECIDING.high_excess**0.5 * max(error.floor, 1e-300)
    return high and left >= DECIDING.imitated**2 * all_of_it


def _better(run: Setup, other: Learned, before: Learned, alone: bool) -> bool:
    """Whether free runs of other terms err clearly less, or no more with fewer effects and terms and fewer numbers.

    Both of the recordings that were learnt from and of those held out. Where effects of the catalogue stand ``alone``,
    fewer is no reason: they are known, and a term is not; nor is it beside what swings, which free runs say little of.
    """
    both, horizon_s = (before, other), before.extension.comparison.horizon_s[-1]
    swings = any(isinstance(e, (HiddenMode, PeriodicTerm)) for e in before.extension.model.effects)
    terms, numbers = ([f(b.extension.effects) for b in both] for f in (len, _numbers))
    simpler = not (alone or swings) and terms[1] < terms[0] and numbers[1] < numbers[0]
    for names in (run.subject.training, run.subject.held_out):
        (was, now), drawn = above_floor([(b.subject, b.extension.model) for b in both], run.noise, names, horizon_s)
        sure = np.quantile(drawn[:, 0] - drawn[:, 1], 0.025) > 0 and 1 + was > MATTERING.near**2 * (1 + now)
        clear = bool(sure) and now * MATTERING.lost**2 < was
        if not (clear or (simpler and 1 + now <= MATTERING.near**2 * (1 + was))):
            return False
    return True


def _numbers(effects: Sequence[NamedEffect]) -> int:
    """How many parameters effects have."""
    return sum(len(e.parameters) for e in effects)


def _pruned(
    done: Extension,
    terms: Sequence[Effect],
    named: Sequence[NamedEffect],
    beside: Callable[[Sequence[Effect]], Extension],
) -> Extension | None:
    """The extension without terms that are not needed or spoil what is named; None: nothing is gained by the others.

    Args:
        done: with all terms.
        terms: these.
        named: the effects as they are fitted without terms.
        beside: fits the named effects with fewer terms.
    """
    while (nothing := _nothing(done)) is not None:
        terms = tuple(t for i, t in enumerate(terms) if i != nothing)
        if not terms:
            return None
        done = beside(terms)
    while (needless := _needless(done)) is not None and len(terms) > 1:
        fewer = tuple(t for i, t in enumerate(terms) if i != needless)
        simpler = beside(fewer)
        if _explained(simpler) < _explained(done):
            break  # the other terms need it
        done, terms = simpler, fewer
    while _spoils(done, named):
        shares = [e.share_explained for e in done.effects if e.learned]
        terms = tuple(t for i, t in enumerate(terms) if i != int(np.argmin(shares)))
        if not terms:
            return None
        done = beside(terms)
    # A share that is no number is one of nothing: there was no error to take.
    taken = sum(e.share_explained for e in done.effects if e.learned)
    return done if taken > DECIDING.least_share else None


def _nothing(done: Extension) -> int | None:
    """The place among the learned terms of the first that may as well be none: the interval of its size holds zero."""
    sizes = [_sizes(e) for e in done.effects if e.learned]
    return next((i for i, of in enumerate(sizes) if of and all(p.low <= 0 <= p.high for p in of)), None)


def _sizes(effect: NamedEffect) -> list[ParameterEstimate]:
    """The parameters of what was learned that are all zero where it does nothing."""
    found = [p for n, p in effect.parameters.items() if n not in ("frequency", "damping", "time constant")]
    shape = SHAPES.get(effect.term.shape) if effect.term is not None and effect.term.signals else None
    return found if shape is None else found[: shape.linear]


def _needless(done: Extension) -> int | None:
    """The place among the learned terms of the first that lowers the error of held-out free runs by nothing."""
    shares = [e.share_explained for e in done.effects if e.learned]
    return next((i for i, share in enumerate(shares) if share <= DECIDING.least_share), None)


def _spoils(done: Extension, named: Sequence[NamedEffect]) -> bool:
    """Whether terms that explain too little to be worth one move what is named out of where it was."""
    if sum(e.share_explained for e in done.effects if e.learned) >= MATTERING.share:
        return False
    before = {e.id: e.parameters for e in named}
    now = ((before[e.id], e.parameters) for e in done.effects if not e.learned and e.id in before)
    return any(not p.low <= after[n].value <= p.high for was, after in now for n, p in was.items() if n in after)


def _explained(done: Extension) -> float:
    """Share of the error of held-out free runs that all effects and terms explain."""
    return sum(e.share_explained for e in done.effects)


def _outdoes(done: Extension) -> bool:
    """Whether the terms leave so little of what the named effects leave that those cannot have been the cause."""
    before, floor = [e for e in done.effects if not e.learned][-1].error_after, done.comparison.error("floor")
    then, now = (done.comparison.above_floor(e) for e in (before, done.comparison.error("extended")))
    far = [g for g in before if before[g].rmse > EXTENDING.telling * floor[g].rmse]
    return bool(far) and all(now[g] < EXTENDING.given_up * then[g] for g in far)


def _outdoes_given_the_past(
    subject: Subject, model: PhysicsModel, noise: Noise, terms: Sequence[Effect], tick: Callable[[str], None]
) -> bool:
    """The same of hidden modes: free runs do not know how these begin, the errors of rates given the past do."""
    swinging = any(isinstance(t, HiddenMode) for t in terms)
    return swinging and left_by(subject, model, noise, terms, tick).whole < EXTENDING.given_up


def judged(subject: Subject, noise: Noise, found: Discovery, extension: Extension) -> Discovery:
    """What was learnt, with effects, constants and errors of equations as the model with learned terms has them."""
    there = {e.id for e in extension.effects}
    gone = tuple(f.id for f in found.found if f.id not in there)
    notes = tuple(f"{n} imitated what is described by a learned term, and is not named." for n in gone)
    left = tuple(f for f in found.found if f.id in there)
    found = replace(found, found=left, confounders=(*found.confounders, *gone), notes=(*found.notes, *notes))
    found = replace(found, constants=extension.constants, ratios=())
    if not found.equations:
        return found
    return replace(found, equations=Weighing(subject, noise, found.calibrated).errors(extension.model))


def likened(subject: Subject, noise: Noise, extension: Extension) -> Extension:
    """The extension whose learned functions of signals say what they are most like."""
    model = extension.model
    first = len(model.effects) - len(extension.effects)
    if hidden(subject.logs) or not any(isinstance(e, LearnedTerm) for e in model.effects[first:]):
        return extension
    linear = Search(subject, None, lambda what: None, noise).look(model, broad=False).linear
    effects = tuple(
        _likened(e, linear, first + i) if isinstance(model.effects[first + i], LearnedTerm) else e
        for i, e in enumerate(extension.effects)
    )
    return replace(extension, effects=effects)


def _likened(effect: NamedEffect, linear: Linearization, place: int) -> NamedEffect:
    term, like = linear.model.effects[place], nearest(linear, place)
    assert effect.term is not None and isinstance(term, LearnedTerm)
    told = replace(effect.term, known_as=known_as(term, linear.model))
    if like is None:
        return replace(effect, term=told)
    told = replace(told, nearest=like.effects, likeness=like.share)
    first = like.effects[0]
    manoeuvre = f"To tell it from {phrases.named(first)}: {EFFECTS.get(first).manoeuvre}."
    return replace(effect, term=told, separate_by=manoeuvre)


def curves(subject: Subject, noise: Noise, extension: Extension) -> tuple[LearnedCurve, ...]:
    """The shapes of the terms that were learned, over the data."""
    model = extension.model
    first = len(model.effects) - len(extension.effects)
    terms = ((first + i, e) for i, e in enumerate(extension.effects) if e.learned)
    drawn = (_drawn(subject, model, noise, place, e) for place, e in terms)
    return tuple(c for c in drawn if c is not None)


def _drawn(subject: Subject, model: PhysicsModel, noise: Noise, place: int, effect: NamedEffect) -> LearnedCurve | None:
    """The shape of the term in ``model.effects[place]``; None: no recording is long enough for it."""
    if isinstance(model.effects[place], PeriodicTerm):
        return folded(subject, model, noise, place)
    if isinstance(model.effects[place], HiddenMode):
        return answered(subject, model, noise, place)
    return curve(subject, noise, model, place, effect)
