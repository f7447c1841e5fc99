"""What a diagnosis says of the constants that were stated. Plain text, not escaped."""

import math
from collections.abc import Sequence

from bench.diagnose.by_equation import InverseDynamics, ObscuredConstant
from bench.diagnose.evidence import Calibration
from bench.diagnose.report.phrases import lasting, listed, named, number, percent, shown, united
from bench.diagnose.result import Diagnosis
from bench.diagnose.settings import CALIBRATING, DECIDING, TELLING


def miscalibrated(diagnosis: Diagnosis) -> list[str]:
    """Sentences about base constants whose intervals exclude what was stated, and ratios of them that do."""
    ratios, parts, others = moved(diagnosis)
    found = [said for c in diagnosis.evidence.obscured for said in _obscured(c)]
    found += [f"Calibration moved stated constants: {_first(others)}."] if others else []
    if ratios:
        also = " also" if others else ""
        found.append(f"Calibration{also} moved ratios of stated constants: {_first(ratios)}.")
        found.append(f"{_either(ratios[0])}.")
    if parts:
        found.append(f"What is stated of the constants makes of these ratios: {_first(parts)}.")
    return [*found, *_stopped(diagnosis)]


def _stopped(diagnosis: Diagnosis) -> list[str]:
    """Sentences about constants that calibration took as far as it may; where free runs err far, with what to do."""
    squares = ((e.rmse, diagnosis.noise_floor[g].rmse) for g, e in diagnosis.error.extended.items())
    far = any(error**2 > DECIDING.high_excess * floor**2 for error, floor in squares)
    constants = listed(named(c.constant) for c in diagnosis.evidence.calibration if c.stopped and (far or c.moved))
    if not constants:
        return []
    advice = (
        "What may be further off needs a larger one under [physics.uncertainty] in dataset.toml; what cannot be stands "
        "for something else that is wrong."
    )
    return [
        f"Calibration stopped at {CALIBRATING.within:g} stated standard deviations of {constants}.",
        *[advice] * far,
    ]


def _obscured(c: ObscuredConstant) -> list[str]:
    """Sentences that are said of a constant that went where it cannot be, in place of its value."""
    name = named(c.constant)
    way = f"{number(c.times, 2)} times" if c.times > 1 else f"{number(c.times, 2)} of"
    many = c.equation.endswith("s")
    what = f"{c.equation.capitalize()} are" if many else f"The equation of {c.equation} is"
    said = [f"{what} not understood: the {name} would go to {way} what was stated, which is not to be believed."]
    if c.repeats:
        said.append(
            f"Beside the {name} as stated, what is left there is slow ({percent(c.repeats)} of it follows from its own "
            f"past): something that nobody measured, and that the inputs cancel, hides the {name}."
        )
    if c.told is not None:
        numbers = listed(f"{named(n)}: about {_plain(n, *x)}" for n, x in c.told.numbers.items())
        said.append(
            f"Given the moments before, the inputs do tell: {numbers}; the squared error of the next "
            f"{lasting(c.told.horizon_s)} on recordings not learned from falls by {percent(c.told.saves)} so "
            f"({percent(c.told.low)} to {percent(c.told.high)}). Free runs do not know these moments, and the model "
            "that was fitted for them keeps the other number."
        )
    elif c.finer:
        said.append(f"With --set {c.finer} the {named(c.group)} are read from a finer sensor, which may tell.")
    return said


def works_against(found: InverseDynamics) -> str:
    """A sentence on inverse dynamics."""
    friction, mass = (
        f"{number(value)}{unit} ({number(low)} to {number(high)})"
        for (value, low, high), unit in ((found.friction, f" {found.unit}"), (found.mass, " times what was stated"))
    )
    return (
        f"By inverse dynamics (a regression of the {found.drive} on the motion that was measured, while it moves) the "
        f"{found.drive} works against {named(found.effect)} of {friction}, which explains {percent(found.saves)} "
        f"({percent(found.low)} to {percent(found.high)}) of the squared {found.drive} that the model leaves, on "
        f"recordings left out one by one; what it accelerates comes out as {mass}. Free runs driven by the "
        f"{found.drive} gain nothing by it: what nobody measured, and the {found.drive} cancels, accelerates it more."
    )


def _plain(name: str, value: float, unit: str) -> str:
    unit, factor = shown(unit, name, [value])
    return united(number(value * factor), unit)


def moved(diagnosis: Diagnosis) -> tuple[list[Calibration], list[Calibration], list[Calibration]]:
    """What calibration moved, most first by stated uncertainties: ratios, constants within such, other constants.

    Recordings tell a ratio; how it is shared between its two constants follows from what is stated of each. The end of
    what is stated of a constant is no result, and nor is a ratio with it.
    """
    hidden = {c.constant for c in diagnosis.evidence.obscured}
    ends = {c.constant for c in diagnosis.evidence.calibration if c.stopped}
    told = [
        c
        for c in diagnosis.evidence.calibration
        if not hidden & c.constants and ends.isdisjoint(c.constant.split(" / "))
    ]
    far = [c for c in told if c.moved and abs(c.sigma) >= TELLING.constant_moved]
    far.sort(key=lambda c: -abs(c.sigma))
    ratios, alone = ([c for c in far if (" / " in c.constant) is both] for both in (True, False))
    within = {name for c in ratios for name in c.constant.split(" / ")}
    parts, others = ([c for c in alone if (c.constant in within) is part] for part in (True, False))
    return ratios, parts, others


def far(diagnosis: Diagnosis) -> list[str]:
    """Such as "inertia about x: 9.8 times what was stated (7.7 to 12)", of constants that calibration moved so far."""
    hidden, found = {c.constant for c in diagnosis.evidence.obscured}, []
    for c in diagnosis.evidence.calibration:
        if " / " in c.constant or hidden & c.constants or not c.nominal:
            continue
        times, *ends = (v / c.nominal for v in (c.calibrated, c.low, c.high))
        if 1 / TELLING.constant_far <= times <= TELLING.constant_far:
            continue
        low, high = (number(x, 2) for x in sorted(ends))
        span = ", where calibration stopped" if c.stopped else f" ({low} to {high})" if math.isfinite(sum(ends)) else ""
        found.append(f"{named(c.constant)}: {number(times, 2)} times what was stated{span}")
    return found


def _first(moved: Sequence[Calibration]) -> str:
    """The first of what moved, and how many others did; a single other one is as short to name as to count."""
    rest = len(moved) - TELLING.constants
    first, more = (moved[: TELLING.constants], [f"{rest} more"]) if rest > 1 else (moved, [])
    return listed([*map(change, first), *more])


def _either(ratio: Calibration) -> str:
    """What each constant of a moved ratio would be if it alone were off."""
    over, under = map(named, ratio.constant.split(" / "))
    by = ratio.calibrated / ratio.nominal
    ways = [
        f"{name} {number(100 * abs(x - 1), 2)} % {'higher' if x > 1 else 'lower'}"
        for name, x in ((over, by), (under, 1 / by))
    ]
    return f"To these recordings {listed(ways, 'or')} is the same"


def change(c: Calibration) -> str:
    """Such as "thrust coefficient by 5.6 % (4.3 % to 6.9 %; 2.8 σ)", σ being the stated uncertainty.

    Far off, "inertia about x to 83 times what was stated (34 to 130)".
    """
    if (times := c.calibrated / c.nominal) > TELLING.constant_times:
        low, high = sorted(v / c.nominal for v in (c.low, c.high))
        return (
            f"{named(c.constant)} to {number(times, 2)} times what was stated ({number(low, 2)} to {number(high, 2)})"
        )
    value, *ends = (100 * (v / c.nominal - 1) for v in (c.calibrated, c.low, c.high))
    low, high = sorted(ends)
    digits = max(0, min(3, 1 - math.floor(math.log10(high - low)))) if high > low else 1
    by, least, most = (f"{x:.{digits}f} %".replace("-", "−") for x in (value, low, high))
    return f"{named(c.constant)} by {by} ({least} to {most}; {abs(c.sigma):.1f} σ)"
