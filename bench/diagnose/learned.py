"""What a diagnosis does about an effect that no catalogue has: it is learned, added and fitted, and drawn."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy  # scipy.optimize is imported when it is used

from bench.diagnose.extend import Extension, extend, ordered
from bench.diagnose.learn.all_terms import learn_all_terms, left_by
from bench.diagnose.learn.curve import curve
from bench.diagnose.learn.modes.answered import answered
from bench.diagnose.learn.waves import folded
from bench.diagnose.learned_shape import LearnedCurve
from bench.diagnose.logs.noise import Noise
from bench.diagnose.logs.subject import Subject
from bench.diagnose.regression.linearise import Candidate, Linearization
from bench.diagnose.report import phrases
from bench.diagnose.report.learned_words import known_as
from bench.diagnose.result import NamedEffect
from bench.diagnose.select.discovery import Discovery, Found, supported
from bench.diagnose.select.input_timing import retimed
from bench.diagnose.select.materiality import Weighing
from bench.diagnose.select.search import Search
from bench.diagnose.settings import DECIDING, EXTENDING, MATTERING, TELLING
from bench.diagnose.simulate.unmeasured import hidden
from registry.core import EFFECTS
from registry.dynamics import Effect, PhysicsModel
from registry.effects.learned_term import LearnedTerm
from registry.effects.waves.hidden_mode import HiddenMode
from registry.effects.waves.periodic_term import PeriodicTerm


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
    terms = learn_all_terms(subject, model, noise, tick, doubtful=doubtful, much=much, little=little)
    read_again = any(isinstance(t, HiddenMode) for t in terms) and subject.logs is not filed.logs
    if read_again:
        # A mode that nobody has added yet looks like an input that acts at another time.
        subject = retimed(filed, replace(model, effects=(*model.effects, *terms)), noise)
        terms = learn_all_terms(subject, model, noise, tick, doubtful=doubtful, much=much)
    if not terms:
        return None
    names = [f.id for f in found]
    rivals = {f.id: f.rivals for f in found}

    def beside(names: Sequence[str], terms: Sequence[Effect]) -> Extension:
        """Terms, added after those of the effects found that are named."""
        base = subject.model
        whole = ordered(model, len(base.effects), names)
        start = replace(whole, effects=(*whole.effects, *terms))
        asked: list[str | Effect] = [*names, *terms]
        return extend(subject, base, asked, tick, noise, rivals=rivals, start=start, horizon_s=horizon_s)

    done = beside(names, terms)
    idle = {e.id for e in done.effects if not e.learned and _neutral(e)}
    if idle and not (_outdoes(done) or (read_again and _outdoes_given_the_past(subject, model, noise, terms, tick))):
        return None  # the terms only say in other words what a named effect says
    if idle:  # they imitated what is learned now
        names = supported([n for n in names if n not in idle], subject.model)
        done = beside(names, terms)
    pruned = _pruned(done, terms, named, lambda fewer: beside(names, fewer))
    return None if pruned is None else Learned(pruned, subject)


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


def _neutral(effect: NamedEffect) -> bool:
    """Whether every parameter may as well be the one that makes it no effect."""
    neutral = {p.name: float(p.neutral) for p in EFFECTS.get(effect.id).neutral().parameters() if p.uncertainty > 0}
    return all(p.low <= neutral[name] <= p.high for name, p in effect.parameters.items() if name in neutral)


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
