"""What was learnt of every equation and constant, as the contract has it."""

from collections.abc import Sequence
from dataclasses import replace

from bench.diagnose.by_equation import ConstantEstimate, EffectSaving, EquationResult
from bench.diagnose.logs.subject import Subject
from bench.diagnose.regression.parameters import entries
from bench.diagnose.result import NamedEffect, ParameterEstimate
from bench.diagnose.select.discovery import Discovery, Found
from bench.diagnose.select.verify import Estimate
from bench.diagnose.settings import EXTENDING
from bench.diagnose.simulate.equation_error import Saving
from registry.dynamics import PhysicsModel


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


def placed(found: Discovery, effects: Sequence[NamedEffect]) -> tuple[NamedEffect, ...]:
    """The effects, each with what it saves and the equation, or the axis of one, in which it saves most."""
    by_id = {f.id: f for f in found.found}
    return tuple(
        replace(e, saves=_saves(by_id[e.id]), acts_on=_most_saved(by_id[e.id])) if e.id in by_id else e for e in effects
    )


def _saves(found: Found) -> tuple[EffectSaving, ...]:
    """What an effect saves in every equation, and along the axes that it is worth a term on.

    At the longest horizon at which it is worth a term; where it is at none, at the longest.
    """
    in_order = sorted(found.savings, key=lambda s: (s.worth, s.horizon_s))
    chosen = {(s.equation, s.axis): s for s in in_order}
    return tuple(_shown(chosen[place]) for place in dict.fromkeys((s.equation, s.axis) for s in found.savings))


def _most_saved(found: Found) -> str:
    """Where an effect is worth a term and saves most; an equation as a whole comes before one of its axes."""
    shown = [(s.worth, not s.axis, s.share, s.where) for s in map(_shown, found.savings) if s.matters]
    return max(shown, key=lambda s: s[:3], default=(False, False, 0.0, ""))[3]


def _shown(s: Saving) -> EffectSaving:
    """A saving as it is shown.

    Without an effect the rest may be fitted to something worse than the calibrated model: no share is more than all.
    """
    share, low, high = (min(1.0, float(x)) for x in (s.share, s.low, s.high))
    return EffectSaving(
        equation=s.equation,
        axis=s.axis,
        horizon_s=s.horizon_s,
        share=share,
        low=low,
        high=high,
        matters=bool(s.matters),
        worth=bool(s.worth),
    )


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
            low, high = x.entry.interval(value, half)
        determined = high - low < EXTENDING.determined * 2 * EXTENDING.interval * prior.scale
        out[label] = ConstantEstimate(prior.value, value, low, high, x.entry.unit, determined)
    return out
