"""Every equation by itself, as it is shown: what it errs with everything else as measured."""

from dataclasses import dataclass

from bench.diagnose.report import phrases
from bench.diagnose.result import Diagnosis
from bench.diagnose.settings import MATTERING


@dataclass(frozen=True)
class ShownEquation:
    """The errors of one equation in the unit in which they are shown."""

    equation: str
    output: str
    horizon: str
    unit: str
    nominal: float
    calibrated: float
    extended: float
    predictable: float
    floor: float


def shown_equations(diagnosis: Diagnosis) -> list[ShownEquation]:
    """Every equation that was judged by itself."""
    out = []
    for name, e in diagnosis.by_equation.items():
        unit, factor = phrases.shown(e.unit, e.output, [e.nominal, e.calibrated, e.extended])
        errors = [v * factor for v in (e.nominal, e.calibrated, e.extended, e.predictable, e.floor)]
        after = phrases.lasting(e.horizon_s)
        out.append(ShownEquation(phrases.named(name), phrases.named(e.output), after, unit, *errors))
    return out


def lines(diagnosis: Diagnosis) -> list[str]:
    """A line for each of several equations; the free runs say as much of a single one."""
    every = shown_equations(diagnosis)
    return [
        f"  {a.equation}, all else measured: {a.output} after {a.horizon}  "
        f"{phrases.number(a.nominal)} → {phrases.united(phrases.number(a.extended), a.unit)} "
        f"(best {phrases.number(a.predictable)}, noise {phrases.number(a.floor, 2)})"
        for a in (every if len(every) > 1 else [])
    ]


def better_told(diagnosis: Diagnosis) -> str:
    """A sentence where a regression on all measured signals predicts equations better than the model does; else ""."""
    less = {
        name: 1 - e.predictable / e.extended
        for name, e in diagnosis.by_equation.items()
        if e.extended > MATTERING.near * max(e.predictable, e.floor)
    }
    if not less:
        return ""
    said = phrases.listed(f"{phrases.percent(share)} less in {phrases.named(name)}" for name, share in less.items())
    return (
        f"A regression on all measured signals errs {said}: something is left that they tell and no effect of the "
        "catalogue explains."
    )
