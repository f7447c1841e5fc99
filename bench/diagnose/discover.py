"""Which effects of the catalogue a model lacks: weak form, whitened, best subsets, judged on recordings not fitted."""

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from bench.diagnose.logs.load import subject_of
from bench.diagnose.logs.noise import Noise
from bench.diagnose.logs.parts import refuse_short
from bench.diagnose.logs.subject import Subject
from bench.diagnose.select.choose import compared, select_across_views
from bench.diagnose.select.closed_loop.given_past import idle, revealed
from bench.diagnose.select.closed_loop.inverse_dynamics import with_inverse_dynamics
from bench.diagnose.select.discovery import Discovery, Found, faint_traces, needs_first
from bench.diagnose.select.materiality import Weighing
from bench.diagnose.select.release import contradicted, equations_of_freed
from bench.diagnose.select.search import Search, View
from bench.diagnose.select.simulated import by_simulation
from bench.diagnose.select.step import advanced, next_step, settled, without
from bench.diagnose.select.subset import Fit
from bench.diagnose.select.tie import rivals
from bench.diagnose.select.timing.reading import prepared, reread
from bench.diagnose.select.verify import estimates, least_imitation, left_over, ratios
from bench.diagnose.select.worthy import Choice, rival_that_saves, saved, worth_naming
from bench.diagnose.settings import DISCOVERING, MATTERING, SEARCHING, VERIFYING
from bench.diagnose.simulate.beginning import after_beginning
from bench.diagnose.simulate.unmeasured import hidden
from bench.execution.parallel import side_by_side
from registry.contracts import Dataset
from registry.core import EFFECTS
from registry.dynamics import PhysicsModel


def discover(
    subject: str | Path | Dataset | Subject,
    catalogue: Sequence[str] | None = None,
    tick: Callable[[str], None] = lambda what: None,
    noise: Noise | None = None,
) -> Discovery:
    """Find what the model of ``subject`` lacks; where a state is not measured, by fitting simulations.

    Args:
        subject: model and measurements, or the folder or name that `load` reads; effects are sought in its training
            recordings, and weighed on the others.
        catalogue: ids of the effects to choose from; default: all that are registered.
        tick: called with what is being done.
        noise: default `noise.noise_of`.

    Raises:
        BenchError: an unknown id, or recordings too short or too few to learn from.
    """
    return read_and_discovered(subject_of(subject), catalogue, tick, noise)[2]


def read_and_discovered(
    filed: Subject,
    catalogue: Sequence[str] | None = None,
    tick: Callable[[str], None] = lambda what: None,
    noise: Noise | None = None,
) -> tuple[Subject, Noise, Discovery]:
    """The measurements with inputs read when they act, their noise, and what the model lacks; see `discover`.

    What is missing makes inputs look late: play on the way to a machine, a moment of the air in wind that nobody knew.
    Where they act at another time beside what was found they are read again, and what errs less on held-out recordings
    is kept, or what says as much with fewer effects. What a lag or a delay that was found remembers of the time before
    a recording is left out, and the rest searched again from what was found, where the recording does not begin so.
    """
    refuse_short(filed)
    subject, noise = prepared(filed, noise, tick)
    if hidden(subject.logs):
        return subject, noise, by_simulation.discover(subject, catalogue, tick)
    found = _searched(subject, catalogue, tick, noise)
    if not filed.timed and found.found and (read := reread(filed, subject, found.model, noise)) is not None:
        again = _searched(read, catalogue, tick, noise, before=found)
        errors = [[max(e.models["extended"], 1e-300) for e in d.equations] for d in (found, again)]
        rise = [math.log(b / a) for a, b in zip(*errors, strict=False)]
        if sum(rise) < (len(again.found) < len(found.found)) * len(rise) * math.log(MATTERING.near):
            subject, found = read, again
    if (later := after_beginning(subject, found.model, noise)) is not subject:
        search = Search(later, catalogue, tick, noise, memory=found.memory, long_windows=found.long_windows)
        subject, found = later, _discovered(search, noise, begun=found)
    return subject, noise, with_inverse_dynamics(found, subject, noise, catalogue)


def _searched(
    subject: Subject,
    catalogue: Sequence[str] | None,
    tick: Callable[[str], None],
    noise: Noise,
    before: Discovery | None = None,
) -> Discovery:
    """What a model lacks of measurements whose states were all measured and whose inputs are read when they act.

    ``before`` is what another reading of the inputs told: rows are weighed as there, and only ties looked at again.
    """
    search = partial(Search, subject, catalogue, tick, noise)
    seen = search() if before is None else search(memory=before.memory, long_windows=before.long_windows)
    first = _discovered(seen, noise)
    # Traces beside what was found tell what is left in other words, unless an equation was missed altogether.
    told = bool(first.found and first.traces) and not any(e.missed for e in first.equations)
    lost = not told and any(e.lost for e in first.equations)
    short = before is None and (lost or first.verdict == "unknown_effect")
    # In short windows noise buries what long ones add up, and nothing is predictable then either.
    tied, slow = any(f.rivals for f in first.found), lost or any(e.left for e in first.equations)
    views = [False] * short + [True] * (slow and (before is None or tied))

    def tells(long: bool) -> bool:
        part = Search(subject, catalogue, lambda _: None, noise, memory=0, long_windows=long, longest=SEARCHING.glance)
        return _replaces(_discovered(part, noise), first, told)

    # What another view of the rows is right about is large: a part of them shows whether it says anything new.
    parts = [v for v in views if sum(map(len, seen.stack.logs)) > SEARCHING.glance and not (v and tied)]
    silent = {v for v, new in zip(parts, side_by_side(tells, parts), strict=True) if not new}
    for long in (v for v in views if v not in silent):
        again = _discovered(search(memory=0, long_windows=long), noise)
        if _replaces(again, first, told):
            return again
        if long:
            first = first.told_apart(again)
    return _balanced(subject, catalogue, tick, noise, first)


def _replaces(again: Discovery, first: Discovery, told: bool) -> bool:
    """Whether another answer is clearer; where the first one has ``told`` what is left, of other effects only.

    Other numbers of the same effects do not say more of it.
    """
    more = {f.id for f in again.found} - {f.id for f in first.found if told}
    return bool(more) and again.clearer(first)


def _balanced(
    subject: Subject,
    catalogue: Sequence[str] | None,
    tick: Callable[[str], None],
    noise: Noise,
    first: Discovery,
) -> Discovery:
    """What the inputs balance, where a first answer says that they do nothing and this one understands them; else that.

    Only of a system of which nothing else is known: beside other equations a hidden inertia is a riddle of its own. The
    torque of a joint that turns at constant speed accelerates nothing, it balances friction: a huge inertia forecasts
    such recordings, and beside that nothing is missing. With the inertia as stated, what the torque works against is
    nearly all there is to see.
    """
    free = first.let_go
    if not free or not subject.held_out:
        return first
    weighing = Weighing(subject, noise, first.calibrated)
    alone = {e.name for e in weighing.equations} <= set(free.values())
    if not alone or not idle(weighing, first.calibrated, free.values()):
        return first
    again = _discovered(Search(subject, catalogue, tick, noise, memory=0, as_stated=free), noise)
    explained = {s.equation for f in again.found for s in f.savings if s.worth}
    lost = {e.equation for e in again.equations if e.lost}
    if not explained - lost >= set(free.values()):
        return first
    names = " and ".join(name.replace("_", " ") for name in free)
    note = (
        f"The {names} was held near what was stated: left free it would go where the inputs do nothing, and that would "
        "forecast these recordings without what the inputs work against."
    )
    return replace(again, notes=(*again.notes, note))


def _discovered(search: Search, noise: Noise, begun: Discovery | None = None) -> Discovery:
    """What one way of weighing the rows finds, from nothing or from what was found where ``begun``."""
    stated = search.subject
    if begun is None:
        first, fit, fields = _first(search, stated.model)
        bare, rounds = advanced(search, first, first.subsets.fit()).model, compared(first, fit, fields)
        search, view = _begun_again(search, stated, _exchanged(search, first, fit, fields))
    else:
        bare, first, rounds = stated.model, None, begun.rounds
        view = _exchanged(search, *_first(search, replace(bare, effects=begun.model.effects)))
    subject = search.subject
    search.tick("weigh")
    _, calibrated = settled(search, bare, first)
    if search.subject is not stated:  # what a model with that constant leaves is no noise of this one
        _, calibrated = settled(search, calibrated)
    weighing = Weighing(subject, noise, calibrated).bounded(calibrated) if subject.held_out else None
    worthy, remarks, contradicted_effects = worth_naming(search, view, weighing)
    if weighing is not None and (other := rival_that_saves(view, weighing, worthy)) is not None:
        view = _viewed(search, other, (), view.explained)
        worthy, remarks, contradicted_effects = worth_naming(search, view, weighing)
    hidden_constants = revealed(search, view, worthy.fit, worthy.model, stated, weighing)
    known_groups = _exhausted(weighing, worthy.model) | {c.group for c in hidden_constants if c.told is not None}
    lost = weighing is not None and any(e.lost for e in weighing.errors(worthy.model))
    named, confounders = _understood(view, worthy, len(subject.model.effects), known_groups, lost)
    chosen, sought = worthy, [_names(view)[i] for i in (*named, *confounders)]
    gone = {*worthy.dropped, *confounders}
    while gone:  # numbers that stood beside what is gone may be far off, and what was worth a term may save nothing
        view = _relinearised(search, view, gone)
        chosen, *_ = worth_naming(search, view, weighing)
        named = [i for i in range(len(subject.model.effects), len(_names(view))) if i not in chosen.dropped]
        gone = set(chosen.dropped)
    found = _found(weighing, chosen, named, worthy.model, sure=not confounders)
    errors, along = ((), ()) if weighing is None else (weighing.errors(chosen.model, axes) for axes in (False, True))
    traces, total = left_over(view, chosen.dropped)
    unknown = total > VERIFYING.left * view.floor
    if unknown and errors and not contradicted_effects and not any(e.unexplained >= MATTERING.share for e in errors):
        unknown, remarks = False, (*remarks, faint_traces(traces))
    return Discovery(
        calibrated=calibrated,
        model=chosen.model,
        found=found,
        rounds=rounds,
        traces=tuple(traces) if unknown else (),
        constants=tuple(x for x in estimates(view, chosen.fit) if x.entry.constant),
        ratios=tuple(ratios(view, chosen.fit)),
        confounders=tuple(sorted({*sought} - {f.id for f in found})),
        faint=tuple(t for t in traces if t.gain > DISCOVERING.faint_trace),
        notes=(*subject.notes, *search.notes),
        equations=errors,
        along_axes=along,
        remarks=remarks,
        contradicted_effects=contradicted_effects,
        uncertainty=subject.uncertainty,
        stated=stated.uncertainty,
        memory=search.memory,
        long_windows=search.long_windows,
        obscured=hidden_constants,
        let_go=equations_of_freed(view, subject),
    )


def _first(search: Search, model: PhysicsModel) -> tuple[View, Fit, list[list[Fit]]]:
    """The first choice of effects beside a model's, with stated constants let go where recordings contradict them."""
    views = search.views(search.look(model))
    view, fit, fields = select_across_views(views)
    while search.let_go(contradicted(view, fit)):
        views = [search.as_known(v) for v in views]
        view, fit, fields = select_across_views(views)
    return view.light(), fit, fields


def _found(
    weighing: Weighing | None, chosen: Choice, named: Sequence[int], extended: PhysicsModel, sure: bool
) -> tuple[Found, ...]:
    """The effects in these places of the view's model, those that save most first.

    Args:
        weighing: the held-out recordings; None: there are none.
        chosen: the model with these effects.
        named: their places.
        extended: the model that says what can be explained.
        sure: whether nothing imitates them, so that it is worth asking what explains the recordings as well.
    """
    view, numbers = chosen.view, estimates(chosen.view, chosen.fit)
    effects = {EFFECTS.name_of(type(e)): e for e in reversed(chosen.model.effects)}
    names = _names(view)
    found = [
        Found(
            id=names[i],
            effect=effects[names[i]],
            estimates=tuple(x for x in numbers if x.entry.owner == i),
            gain=view.subsets.fit(drop=[*chosen.dropped, i]).misfit - chosen.fit.misfit,
            rivals=_rivals(view, weighing, chosen, i, extended) if sure else (),
            savings=saved(weighing, chosen, i, extended),
        )
        for i in named
    ]
    return needs_first(sorted(found, key=lambda f: (-f.share, -f.gain)))


def _names(view: View) -> list[str]:
    """Ids of the effects of a view's model, by place."""
    return [EFFECTS.name_of(type(e)) for e in view.linear.model.effects]


def _exchanged(search: Search, view: View, fit: Fit, fields: list[list[Fit]]) -> View:
    """The view of the chosen effects, exchanged, added and dropped one by one until nothing changes.

    An effect that ends with numbers that no such thing has is an imitation, and so is one that swings faster than half
    the sampling rate (Nyquist): it bends what inputs do between samples. It is sought no more, and the others again.
    """
    everything = view.explainable()
    shortlist = {i for field in fields[1:] for f in field[:8] for i in f.ids}
    known = len(search.subject.model.effects)
    model = advanced(search, view, fit).model
    seen = 2 * search.subject.logs[0].dt
    while True:
        view = _one_by_one(search, view, model, shortlist, everything)
        model = view.linear.model
        effects = model.effects
        odd = [i for i in range(known, len(effects)) if not effects[i].possible_in(model) or effects[i].fastest < seen]
        if not odd:
            return view
        gone = {EFFECTS.name_of(type(effects[i])) for i in odd}
        all_of_them = EFFECTS.names() if search.catalogue is None else search.catalogue
        search.catalogue = [name for name in all_of_them if name not in gone]
        model = without(model, odd)


def _begun_again(search: Search, stated: Subject, view: View) -> tuple[Search, View]:
    """A search that begins with the effects found and the constants as stated, where no more are let go; else this.

    A constant is let go while effects are unknown that other equations tell of: what goes with the velocity through the
    air only a huge inertia makes small as long as the wind is unknown, and from there no step leads back. Where further
    ones are let go on the second way, what was chosen while they were held had bent them.
    """
    effects = view.linear.model.effects
    if search.subject is stated or len(effects) == len(stated.model.effects):
        return search, view
    again = search.of(stated)
    other, fit, fields = _first(again, replace(stated.model, effects=effects))
    if again.subject is not stated:
        return search, view
    other = _exchanged(again, other.light(), fit, fields)
    free = [set(s.subject.uncertainty.items()) - set(stated.uncertainty.items()) for s in (again, search)]
    return (again, other) if free[0] <= free[1] else (search, view)


def _one_by_one(
    search: Search, view: View, model: PhysicsModel, shortlist: set[str], everything: Mapping[int, float]
) -> View:
    """The view of a model's effects, exchanged, added and dropped one by one until nothing changes.

    In between, and once a constant was let go, the numbers are fitted: all is judged beside numbers that move no more.
    """
    known, past = len(search.subject.model.effects), list[PhysicsModel]()
    _, model = settled(search, model, view)
    for _ in range(DISCOVERING.exchanges):
        search.tick("what is left")
        view = view.light()
        view = _viewed(search, model, shortlist, everything)
        while search.let_go(contradicted(view, view.subsets.fit())):
            (_, model), view = settled(search, model, view), view.light()
            view = _viewed(search, model, shortlist, everything)
        step = next_step(search, view, known, past)
        past.append(view.linear.model)
        if not math.isfinite(step.loss) or not step.exchanged:
            break
        _, model = settled(search, step.model, view)
    return view


def _relinearised(search: Search, view: View, dropped: Collection[int]) -> View:
    """The view of a model without the effects in these places, its numbers fitted anew until they move no more."""
    _, model = settled(search, without(view.linear.model, sorted(dropped)), view)
    return _viewed(search, model, (), view.explained)


def _viewed(search: Search, model: PhysicsModel, only: Collection[str], explained: Mapping[int, float]) -> View:
    """The view of a model whose constants lie nearest to what is known of them; ``only``: see `Search.look`."""
    return min(search.views(search.look(model, only), explained), key=lambda v: v.subsets.fit().prior)


def _exhausted(weighing: Weighing | None, model: PhysicsModel) -> set[str]:
    """Groups of channels whose equations are predicted as well as any function of the measured signals would."""
    if weighing is None:
        return set()
    errors = weighing.by_axis(model)
    left = {e.equation for e in errors if e.unexplained >= MATTERING.share}
    return {e.group.name for e in weighing.equations if e.name not in left}


def _understood(
    view: View, worthy: Choice, known: int, known_groups: Collection[str], lost: bool
) -> tuple[list[int], list[int]]:
    """Places of the effects that are what they seem, and of those that only imitate something else.

    What is left of an equation is known where nothing predicts it better, or where the inputs seem to do nothing and
    do, beside a slow disturbance. The effect that explains least goes first: two that share what they explain would
    both seem less than what is left. Little is left in the rows where they were whitened by what is left itself, so
    that nothing is taken for understood where forecasts of an equation are ``lost``.
    """
    channels = enumerate(view.linear.channels)
    known_channels = {k for k, c in channels if view.linear.model.measured_channels[c].group in known_groups}
    first = len(view.linear.columns)
    gone = set(worthy.dropped)
    while True:
        left = [i for i in range(known, len(view.linear.model.effects)) if i not in gone]
        traces, total = left_over(view, sorted(gone))
        explained = [t for t in traces if view.reach[t.column - first] <= known_channels]
        total -= view.floor * sum(t.gain for t in explained)
        least = None
        if lost or total > VERIFYING.left * view.floor:
            rest = [t for t in traces if t not in explained]
            least = least_imitation(view, left, rest, sorted(gone))
        if least is None:
            return left, sorted(gone - set(worthy.dropped))
        gone |= view.linear.removed([least])[0]


def _rivals(
    view: View, weighing: Weighing | None, chosen: Choice, place: int, extended: PhysicsModel
) -> tuple[str, ...]:
    """Effects that explain the recordings as well as the one in this place, those held out too."""
    candidates = rivals(view, place)
    if weighing is None:
        return tuple(candidates)
    fitted = {name: chosen.exchanged(place, start) for name, start in candidates.items()}
    return tuple(
        name
        for name, model in fitted.items()
        if all(e.possible_in(model) for e in model.effects) and not weighing.refutes(model, chosen.model, extended)
    )
