"""What was learnt of every equation and constant, as the contract has it."""

from collections.abc import Sequence
from dataclasses import replace

from bench.diagnose.by_equation import ConstantEstimate, EffectSaving, EquationResult
from bench.diagnose.logs.subject import Subject
from bench.diagnose.regression.parameters import entries
from bench.diagnose.result import NamedEffect, ParameterEstimate
from bench.diagnose.select.discovery import Discovery, Found
from bench.diagnose.select.materiality import Saving
from bench.diagnose.select.verify import Estimate
from registry.dynamics import PhysicsModel

_NORMAL = 1.96
"""Half of a 95 % interval in standard deviations."""
_NARROWED = 0.5
"""Width of an interval, relative to the stated one, below which the recordings determine a constant."""


def parameter_estimates(found: Sequence[Estimate]) -> dict[str, ParameterEstimate]:
    """By name, what was estimated of an effect."""
    return {x.entry.label: ParameterEstimate(x.value, x.low, x.high, x.entry.unit) for x in found}


def equation_results(found: Discovery, model: PhysicsModel, extended: bool) -> dict[str, EquationResult]:
    """Every equation at its longest horizon.

    Args:
        found: what was learnt.
        model: any with the states of the recordings.
        extended: whether effects were named; without them the calibrated model is the last.
    """
    output = {equation: group for group, equation in model.equation_names().items()}
    longest = {e.equation: e for e in sorted(found.equations, key=lambda e: e.horizon_s)}
    return {
        name: EquationResult(
            output=output.get(name, name),
            horizon_s=e.horizon_s,
            unit=e.unit,
            nominal=e.models["nominal"],
            calibrated=e.models["calibrated"],
            extended=e.models["extended" if extended else "calibrated"],
            predictable=e.predictable,
            floor=e.floor,
        )
        for name in dict.fromkeys(e.equation for e in found.equations)
        for e in [longest[name]]
    }


def effect_savings(found: Discovery, effects: Sequence[NamedEffect]) -> dict[str, tuple[EffectSaving, ...]]:
    """By the id of a named effect, what it saves in every equation at its longest horizon.

    And along the axes that it is worth a term on, where it is not in the equation as a whole.
    Without the effect the rest may be fitted to something worse than the calibrated model: no share is more than all.
    """
    by_id = {f.id: f for f in found.found}
    out = {}
    for e in effects:
        if e.id not in by_id:
            continue  # it was learned after the search
        savings = by_id[e.id].savings
        longest = {(s.equation, s.axis): s for s in sorted(savings, key=lambda s: s.horizon_s)}
        worth = {s.equation for (_, axis), s in longest.items() if s.worth and not axis}
        shown = [s for (equation, axis), s in longest.items() if not axis or equation not in worth]
        if shown:
            out[e.id] = tuple(
                EffectSaving(_where(s), _most(s.share), _most(s.low), _most(s.high), s.matters) for s in shown
            )
    return out


def placed(found: Discovery, effects: Sequence[NamedEffect]) -> tuple[NamedEffect, ...]:
    """The effects, each with the equation in which it saves most."""
    by_id = {f.id: f for f in found.found}
    return tuple(replace(e, acts_on=_most_saved(by_id[e.id])) if e.id in by_id else e for e in effects)


def _most_saved(found: Found) -> str:
    whole_first = ((s.worth, not s.axis, _most(s.share), s) for s in found.savings if s.matters)
    best = max(whole_first, key=lambda found: found[:3], default=None)
    return _where(best[-1]) if best else ""


def _where(saving: Saving) -> str:
    return f"{saving.equation}: {saving.axis}" if saving.axis else saving.equation


def _most(share: float) -> float:
    return min(1.0, float(share))


def constant_estimates(
    subject: Subject, model: PhysicsModel, numbers: Sequence[Estimate]
) -> dict[str, ConstantEstimate]:
    """Constants of the base model that have an uncertainty.

    Args:
        subject: with the stated constants and their uncertainty.
        model: the one that the diagnosis ends with, whose values are given.
        numbers: the fit that the intervals are taken from.
    """
    stated = {e.label: e for e in entries(subject.model, subject.uncertainty) if e.constant}
    last = {e.label: e.value for e in entries(model, subject.uncertainty, subject.model) if e.constant}
    out = {}
    for x in numbers:
        label = x.entry.label
        if not x.entry.constant or label not in stated or label not in last:
            continue
        prior, value = stated[label], last[label]
        low, high = float(x.low), float(x.high)  # numpy's comparisons are no JSON
        if abs(value - x.value) > 1e-9 * prior.scale:  # two estimates that differ are worth no more than that
            half = float(max((high - low) / 2, abs(value - x.value)))
            low, high = max(value - half, x.entry.low), min(value + half, x.entry.high)
        determined = high - low < _NARROWED * 2 * _NORMAL * prior.scale
        out[label] = ConstantEstimate(prior.value, value, low, high, x.entry.unit, determined)
    return out
