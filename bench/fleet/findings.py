"""From the answers on single vehicles to what the fleet says: means, spreads, who differs, who drifts."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import ndtri

from bench.analysis.random_effects import Fit, adjusted, differences, fit
from bench.fleet.result import DAYS, Answer, Deviation, Drift, Number, Quantity, day

_Z = float(ndtri(0.975))
FEWEST_DATES = 3
"""Of a drift: a line through two dates leaves nothing to judge it by."""


def quantities(answers: Sequence[Answer]) -> tuple[Quantity, ...]:
    """Every parameter over the vehicles that lack its effect, with tests of each against the others."""
    found = []
    for (system, effect, parameter, unit), of in _gathered(answers).items():
        by: dict[str, list[Number]] = {}
        for answer, number in of:
            by.setdefault(answer.vehicle, []).append(number)
        fits = {vehicle: _mean(numbers) for vehicle, numbers in by.items()}
        y = np.array([f.beta[0] for f in fits.values()])
        s = np.array([math.sqrt(f.covariance[0, 0]) for f in fits.values()])
        whole, tests = fit(y, s), differences(y, s) if len(y) > 1 else []
        deviations = [
            Deviation(vehicle, float(y[i]), float(y[i] - _Z * s[i]), float(y[i] + _Z * s[i]),
                      float(tests[i].others.beta[0]) if tests else math.nan, tests[i].p if tests else math.nan)
            for i, vehicle in enumerate(fits)
        ]  # fmt: skip
        mean = (float(whole.beta[0]), *whole.interval())
        spread = (whole.between, whole.heterogeneity)
        found.append(Quantity(system, effect, parameter, unit, *mean, *spread, vehicles=tuple(deviations)))
    levels = iter(adjusted([d.p for q in found for d in q.vehicles]))
    return tuple(replace(q, vehicles=tuple(replace(d, adjusted=next(levels)) for d in q.vehicles)) for q in found)


def drifts(answers: Sequence[Answer]) -> tuple[Drift, ...]:
    """How every dated parameter moves: in each vehicle with three dates or more, and over vehicles with one each."""
    found = []
    for what, of in _gathered([a for a in answers if a.date]).items():
        by: dict[str, list[tuple[Answer, Number]]] = {}
        for answer, number in of:
            by.setdefault(answer.vehicle, []).append((answer, number))
        single = [pair for own in by.values() if len(own) == 1 for pair in own]
        for vehicle, own in (*by.items(), ("", single)):
            dates = [answer.date for answer, _ in own]
            if len(set(dates)) >= FEWEST_DATES:
                line = _line(dates, [number for _, number in own])
                slope, ordered = (float(line.beta[1]), *line.interval(1)), tuple(sorted(dates))
                found.append(Drift(vehicle, *what, *slope, level=float(line.beta[0]), dates=ordered, p=line.p_value(1)))
    levels = adjusted([d.p for d in found])
    return tuple(replace(d, adjusted=level) for d, level in zip(found, levels, strict=True))


def _gathered(answers: Sequence[Answer]) -> dict[tuple[str, str, str, str], list[tuple[Answer, Number]]]:
    """By system, effect, parameter and unit, in the order of the names."""
    found: dict[tuple[str, str, str, str], list[tuple[Answer, Number]]] = {}
    for answer in answers:
        for number in answer.numbers:
            if number.usable:
                found.setdefault((answer.system, *number.quantity), []).append((answer, number))
    return dict(sorted(found.items()))


def _errors(numbers: Sequence[Number]) -> tuple[np.ndarray, np.ndarray]:
    """Values (k,) and their standard errors (k,)."""
    return np.array([n.value for n in numbers]), np.array([(n.high - n.low) / (2 * _Z) for n in numbers])


def _mean(numbers: Sequence[Number]) -> Fit:
    """Of a vehicle that was diagnosed on several dates."""
    return fit(*_errors(numbers))


def _line(dates: Sequence[str], numbers: Sequence[Number]) -> Fit:
    """Value against time [years] from the mean date."""
    at = np.array([day(d) for d in dates]) / DAYS
    return fit(*_errors(numbers), np.column_stack([np.ones(len(at)), at - at.mean()]))
