"""Effects that a search has found, added and fitted, as far as free runs of held-out recordings confirm them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import torch

from bench.diagnose.compare import compare
from bench.diagnose.extend import Extension, extend, ordered, shares_of, squared_errors, stage
from bench.diagnose.fit import fit_parameters
from bench.diagnose.logs.noise import Noise
from bench.diagnose.logs.subject import LogBatch, Subject
from bench.diagnose.regression.parameters import entries
from bench.diagnose.regression.weak import midpoint_rates
from bench.diagnose.result import NamedEffect, ParameterEstimate
from bench.diagnose.select.discovery import Discovery, supported
from bench.diagnose.select.search import Search
from bench.diagnose.select.simulated.forecasting import forecasting
from bench.diagnose.select.step import settled
from bench.diagnose.select.verify import Estimate, at_bound, estimates, ratios
from bench.diagnose.settings import DECIDING
from bench.diagnose.summaries import parameter_estimates
from registry.core import EFFECTS
from registry.dynamics import InternalEffect, PhysicsModel


@dataclass(frozen=True, eq=False)
class Setup:
    """What most steps need."""

    subject: Subject
    noise: Noise
    tick: Callable[[str], None]
    horizon_s: float | None
    """Longest horizon of the comparisons [s]."""
    filed: Subject
    """The measurements, with inputs as they were filed."""
    catalogue: Sequence[str] | None = None
    """Ids of the effects to choose from; None: all."""


_NO_BETTER = (
    "explained the rates of the recordings that were learnt from, but did not make the forecast of recordings better, "
    "and so is not named."
)
_AT_BOUND = (
    "fits best at the end of its physical range, where it imitates something else, and so is not named; the rest was "
    "fitted again without it."
)
_OTHERWISE = "fits what recordings differ in, in other words, and so is not named."


def confirmed(run: Setup, found: Discovery) -> tuple[Discovery, Extension | None, bool]:
    """The effects found, added and fitted, as far as free runs of held-out recordings confirm them.

    Returns:
        What was learnt, the extended model (None: without effects), and whether free runs refute all of them.
    """
    extension = _added(run, found)
    if extension is not None:
        vanished = [e.id for e in extension.effects if _changes_nothing(e)]
        if vanished:
            found = _unnamed(found, vanished, _NO_BETTER)
            extension = _added(run, found)
    # Where no equation could be judged, sets were compared with their bounds already.
    while extension is not None and found.equations and (imitation := _at_bound(run, extension)):
        found = _unnamed(found, [imitation], _AT_BOUND)
        extension = _added(run, found)
        if extension is None:
            return found, None, True
    if extension is None:
        return found, None, False
    # Where each equation was judged by itself, a free run that is lost in another one refutes nothing.
    if len({e.equation for e in found.equations}) < 2 and sum(e.share_explained for e in extension.effects) < 0:
        return _unnamed(found, [f.id for f in found.found], _NO_BETTER), None, True
    return found, extension, False


def _at_bound(run: Setup, extension: Extension) -> str | None:
    """The effect at a bound that is not neutral that explains least of free runs, after all was fitted; None: none."""
    first = len(run.subject.model.effects)
    numbers = entries(extension.model, run.subject.uncertainty, run.subject.model)
    last = [Estimate(e, e.value, e.low, e.high) for e in numbers]
    pushed = [e for i, e in enumerate(extension.effects, first) if at_bound(last, i)]
    return min(pushed, key=lambda e: e.share_explained).id if pushed else None


def _changes_nothing(effect: NamedEffect) -> bool:
    """Whether free runs of all groups of outputs err as much without an effect: it follows how rates are computed."""
    pairs = ((e.rmse**2, effect.error_after[g].rmse ** 2) for g, e in effect.error_before.items())
    return all(abs(before - after) <= DECIDING.least_share * before for before, after in pairs)


def _added(run: Setup, found: Discovery) -> Extension | None:
    """The model with the effects found, fitted; None: there are none."""
    if not found.found:
        return None
    base, names = run.subject.model, [f.id for f in found.found]
    return extend(
        run.subject,
        base,
        names,
        run.tick,
        run.noise,
        rivals={f.id: f.rivals for f in found.found},
        start=ordered(found.model, len(base.effects), names),
        horizon_s=run.horizon_s,
    )


def calibrated_only(run: Setup, found: Discovery) -> Extension:
    """The calibrated model, to which no effect is added, and its errors."""
    subject, model, numbers = run.subject, found.calibrated, found.constants
    # A model with effects was fitted so that free runs meet the measurements, and stays so; in the weak form a slope in
    # place of a rate is filtered twice, which free runs do not see.
    if subject.model.effects or subject.slopes:
        model, estimated = fit_parameters(subject, subject.model, run.noise, run.tick)
        numbers = tuple(estimated)
    comparison = compare(subject, {"calibrated": model}, noise=run.noise, horizon_s=run.horizon_s)
    return Extension(
        model=model,
        effects=(),
        comparison=comparison,
        stages=tuple(stage(n, comparison.error(n)) for n in ("nominal", "calibrated", "floor")),
        constants=numbers,
        calibrated=0.0,
    )


def otherwise_told(run: Setup, found: Discovery) -> tuple[Discovery, Extension]:
    """What is left to say where all effects found are what recordings differ in, and the calibrated model."""
    view, model = settled(Search(run.subject, (), run.tick, run.noise, memory=0), found.calibrated)
    fit = view.subsets.fit()
    constants, of_them = tuple(x for x in estimates(view, fit) if x.entry.constant), tuple(ratios(view, fit))
    found = _unnamed(found, [f.id for f in found.found], _OTHERWISE)
    found = replace(found, calibrated=model, constants=constants, ratios=of_them)
    return found, calibrated_only(run, found)


def with_forecasting(run: Setup, extension: Extension) -> Extension:
    """The extended model with an effect that no equation confirms and without which its free runs err far more.

    It is left out where held-out recordings do not gain by it. Numbers that act in other equations stay as they were
    told; an interval that moved is no narrower than by how much.
    """
    subject, before = run.subject, extension.comparison
    model, numbers = forecasting(subject, extension.model, run.catalogue, run.tick)
    if model is extension.model:
        return extension
    after = compare(subject, {"extended": model}, noise=run.noise, horizon_s=before.horizon_s[-1])
    last = f"+ {len(extension.effects)}" if extension.effects else "calibrated"
    lines = {last if n == "extended" else n: of for n, of in before.lines.items() if n not in ("disturbance", "floor")}
    after = replace(after, lines={**lines, **{n: of for n, of in after.lines.items() if n != "nominal"}})
    squared = squared_errors(subject, after, ("nominal", "calibrated", last, "extended", "floor"))
    *_, share = shares_of([squared[n] for n in ("nominal", "calibrated", last, "extended")], squared["floor"])
    if share <= 0:
        return extension
    first, effect = len(extension.model.effects), model.effects[-1]
    added = NamedEffect(
        EFFECTS.name_of(type(effect)),
        parameter_estimates([x for x in numbers if x.entry.owner == first]),
        share_explained=share,
        error_before=after.error(last),
        error_after=after.error("extended"),
        forecast_only=True,
    )
    told = [
        replace(e, parameters=e.parameters | _moved(e.parameters, [x for x in numbers if x.entry.owner == place]))
        for place, e in enumerate(extension.effects, first - len(extension.effects))
    ]
    stages = (*extension.stages[:-1], stage(added.id, added.error_after), stage("floor", after.error("floor")))
    return replace(extension, model=model, effects=(*told, added), comparison=after, stages=stages)


def idle_effects(subject: Subject, done: Extension) -> set[str]:
    """The named effects that may as well be none, as far as the intervals of their parameters tell."""
    first = len(done.model.effects) - len(done.effects)
    named = [(place, e) for place, e in enumerate(done.effects, first) if not e.learned]
    return {e.id for place, e in named if _neutral(subject, done.model, place, e)}


def _neutral(subject: Subject, model: PhysicsModel, place: int, effect: NamedEffect) -> bool:
    """Whether parameters may as well be those that make it no effect, whatever the others are then."""
    neutral = {p.name: float(p.neutral) for p in EFFECTS.get(effect.id).neutral().parameters() if p.uncertainty > 0}
    told = {name: p for name, p in effect.parameters.items() if name in neutral}
    may_be = {name: neutral[name] for name, p in told.items() if p.low <= neutral[name] <= p.high}
    own = model.effects[place]
    if len(may_be) == len(told) or not may_be or isinstance(own, InternalEffect):
        return len(may_be) == len(told)
    stack = LogBatch.of(subject.of(subject.training[:1]))
    less, none = ([*model.effects[:place], *e, *model.effects[place + 1 :]] for e in ([replace(own, **may_be)], []))
    with torch.no_grad():
        return torch.equal(*(midpoint_rates(replace(model, effects=tuple(e)), stack) for e in (less, none)))


def _moved(before: Mapping[str, ParameterEstimate], now: Sequence[Estimate]) -> dict[str, ParameterEstimate]:
    """Parameters that were fitted once more."""
    out = {}
    for x in (x for x in now if x.entry.label in before):
        was = before[x.entry.label]
        half = max((was.high - was.low) / 2, abs(x.value - was.value))
        low, high = x.entry.interval(x.value, half)
        out[x.entry.label] = replace(was, value=x.value, low=low, high=high)
    return out


def _unnamed(found: Discovery, names: Sequence[str], why: str) -> Discovery:
    """What is left to say when the last model takes back effects that were found."""
    kept = supported([f.id for f in found.found if f.id not in names], found.calibrated)
    left, names = tuple(f for f in found.found if f.id in kept), [f.id for f in found.found if f.id not in kept]
    note = f"{', '.join(names)} {why}"
    return replace(found, found=left, confounders=(*found.confounders, *names), notes=(*found.notes, note))
