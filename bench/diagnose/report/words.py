"""How a diagnosis is put in words: numbers with units, and the verdict in a sentence. Plain text, not escaped."""

import math
import re
import shlex
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from bench.diagnose.result import LINES, ByGroup, Calibration, DataProblem, Diagnosis, NamedEffect, ParameterEstimate
from registry.core import EFFECTS
from registry.units import display

_MILLI = {"m": "mm", "s": "ms", "V": "mV", "N": "mN", "N m": "mN m", "kg": "g"}
_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
NOTHING = "–"
LITTLE = 0.02
"""Share of the squared error above the floor below which a reader need not know what it follows."""
OFF = 2.0
"""Stated uncertainties beyond which a calibrated constant is marked."""
SLIGHTLY = 0.1
"""Stated uncertainties below which nobody is told that a constant moved, however sure it is."""
MENTIONED = 2
"""Constants, and ratios of them, that are said to be off; the page has them all."""


def shown(si_unit: str, signal: str = "", values: Iterable[float] = ()) -> tuple[str, float]:
    """The unit in which a signal is shown and the factor from SI: degrees, and milli- where all values are small."""
    unit, factor = display(si_unit, signal)
    largest = max((abs(v) for v in values if math.isfinite(v)), default=math.inf)
    if unit in _MILLI and largest < 0.1:
        unit, factor = _MILLI[unit], 1e3 * factor
    return _in_brackets(unit.replace("^2", "²").replace("^3", "³")), factor


def _in_brackets(unit: str) -> str:
    """With what it is divided by in brackets, where that is several units."""
    above, slash, below = unit.partition("/")
    return f"{above}/({below})" if slash and " " in below else unit


def united(value: str, unit: str) -> str:
    """A shown value and its unit; "1" is none."""
    return value if unit == "1" else f"{value} {unit}"


def named(identifier: str) -> str:
    """ "rotor_drag", "body_rates.p" and "inertia[2]" (about z) as words."""
    about = re.sub(r"\binertia\[([012])\]", lambda found: f"inertia about {'xyz'[int(found[1])]}", identifier)
    return about.replace("_", " ").replace(".", " ")


def number(value: float, digits: int = 3) -> str:
    """A value to so many significant digits, with a power of ten where it is very small or large."""
    if not math.isfinite(value):
        return NOTHING
    rounded = float(f"{value:.{digits - 1}e}")
    exponent = math.floor(math.log10(abs(rounded))) if rounded else 0
    if -4 < exponent < 5:
        return f"{rounded:.{max(0, digits - 1 - exponent)}f}".replace("-", "−")
    return f"{rounded / 10.0**exponent:.{digits - 1}f}×10{str(exponent).translate(_SUPERSCRIPT)}".replace("-", "−")


def percent(share: float) -> str:
    """A share in whole per cent."""
    if not math.isfinite(share):
        return NOTHING
    if 0 < share < 0.01:
        return "< 1 %"
    if -0.01 < share < 0:
        return f"−{-100 * share:.1g} %"
    return f"{100 * share:.0f} %".replace("-", "−")


def estimate(name: str, p: ParameterEstimate) -> str:
    """Such as "0.120 kg/s (0.110 to 0.130)": with as many digits as the interval warrants."""
    value, low, high, unit = estimate_parts(name, p)
    return united(value, unit) + (f" ({low} to {high})" if low != NOTHING else "")


def estimate_parts(name: str, p: ParameterEstimate) -> tuple[str, str, str, str]:
    """Value, low, high and unit as they are shown."""
    finite = [v for v in (p.value, p.low, p.high) if math.isfinite(v)]
    unit, factor = shown(p.unit, name, finite)
    half, largest = (p.high - p.low) / 2 * factor, max((abs(v) * factor for v in finite), default=0.0)
    digits = 3
    if math.isfinite(half) and half > 0 and largest > 0:
        # Two digits of half the interval at the most, one at the least.
        digits = min(6, max(2, math.floor(math.log10(largest)) - math.floor(math.log10(half) + 0.02) + 2))
    return number(p.value * factor, digits), number(p.low * factor, digits), number(p.high * factor, digits), unit


def typeset(text: str) -> str:
    """Numbers and units as they are printed: "2.8e-08 kg m^2" becomes "2.8×10⁻⁸ kg m²", "0.15 1" has no unit."""
    text = re.sub(
        r"(\d)e([+-]?)0*(\d+)\b", lambda m: f"{m[1]}×10{(m[2].strip('+') + m[3]).translate(_SUPERSCRIPT)}", text
    )
    text = re.sub(r"\^(-?\d+)", lambda m: m[1].translate(_SUPERSCRIPT), text)
    return re.sub(r"(?<=[=,] )-(?=\d)", "−", re.sub(r"(?<=\d) 1(?=[,;]|$)", "", text))


def about(effect: str) -> tuple[str, str]:
    """What an effect is, in a line, and its equation; empty for one that is not registered here."""
    if effect not in EFFECTS.names():
        return "", ""
    return EFFECTS.summary(effect), EFFECTS.get(effect).equation


def listed(items: Iterable[str], last: str = "and") -> str:
    """ "a, b and c"."""
    *head, tail = list(items) or [""]
    return f"{', '.join(head)} {last} {tail}" if head else tail


def rows(problem: DataProblem) -> str:
    """Where a data problem is, in samples from 0."""
    if problem.rows is None:
        return "all samples"
    first, end = problem.rows
    return f"sample {first}" if first == end else f"samples {first} to {end}"


def gathered(problems: Sequence[DataProblem]) -> list[str]:
    """A line for every kind of problem of a signal: which recordings have it, and what it is in the first of them."""
    alike: dict[tuple[str, str], list[DataProblem]] = {}
    for p in problems:
        alike.setdefault((p.signal, p.kind), []).append(p)
    out = []
    for (signal, kind), found in alike.items():
        names, first = list(dict.fromkeys(p.recording for p in found)), found[0]
        more = [f"{len(names) - 2} more"] if len(names) > 3 else []
        where = listed([*(names[:2] if more else names), *more])
        again = f", {len(found)} times" if len(found) > len(names) else ""
        at = f", {rows(first)}" if len(found) == 1 else ""
        detail = first.detail if len({p.detail for p in found}) == 1 else f"in {first.recording}: {first.detail}"
        out.append(f"{where}, {named(signal)}{at}: {kind}{again}; {detail}")
    return out


@dataclass(frozen=True)
class Fall:
    """How the error of one output group falls, as it is shown."""

    group: str
    horizon: str
    unit: str
    errors: dict[str, float]
    """By model, in the order of `LINES`, in ``unit``; NaN: there is none; infinite: the free run diverged."""
    after: str
    """The model that the diagnosis ends with: "extended", or "calibrated" where no effect was added."""

    def text(self, model: str) -> str:
        """The error of a model."""
        error = self.errors[model]
        return "diverged" if math.isinf(error) else number(error)


def falls(diagnosis: Diagnosis) -> list[Fall]:
    """One for every output group."""
    lines: tuple[ByGroup, ...] = (
        diagnosis.error.nominal,
        diagnosis.error.calibrated,
        diagnosis.error.extended,
        diagnosis.noise_floor,
    )
    out = []
    for group in dict.fromkeys(g for line in lines for g in line):
        found = [line.get(group) for line in lines]
        first = next(e for e in found if e is not None)
        unit, factor = shown(first.unit, group, [e.rmse for e in found if e is not None])
        errors = [math.nan if e is None else e.rmse * factor for e in found]
        by_model = dict(zip(LINES, errors, strict=True))
        after = "extended" if diagnosis.effects else "calibrated"
        out.append(Fall(group, f"{first.horizon_s:g} s", unit, by_model, after))
    return out


def headline(diagnosis: Diagnosis) -> str:
    """The verdict in one plain sentence."""
    if diagnosis.verdict == "data_problem":
        problem = diagnosis.data_problems[0] if diagnosis.data_problems else None
        what = f": {problem.kind} in {named(problem.signal)} of {problem.recording}" if problem else ""
        return f"The recordings must be mended before the model can be judged{what}."
    if diagnosis.verdict == "named":
        sure = [named(e.id) for e in diagnosis.effects if not e.indistinguishable_from and not e.learned]
        return f"The model lacks {listed(sure)}."
    if diagnosis.verdict == "tie":
        tied = ties(diagnosis)
        if len(tied) > 1:
            return f"The model lacks {_count(tied)} effects that these recordings cannot name: {'; '.join(tied)}."
        return f"The model lacks something, and these recordings cannot tell whether it is {tied[0]}."
    if diagnosis.verdict == "unknown_effect" and diagnosis.effects:
        return f"What the model lacks is not in the catalogue; described as: {'; '.join(_terms(diagnosis))}."
    if diagnosis.verdict == "unknown_effect":
        left = diagnosis.unexplained
        acts = f"acts on {listed(map(named, left.axes))}" if left.axes else "moves the system"
        follows = f" and follows {listed(map(named, left.follows))}" if left.follows else ""
        return f"Something systematic that is not in the catalogue {acts}{follows}."
    return "No effect of the catalogue is missing as far as these recordings can show."


def _terms(diagnosis: Diagnosis) -> list[str]:
    return [e.described for e in diagnosis.effects if e.learned]


def ties(diagnosis: Diagnosis) -> list[str]:
    """ "rotor drag or linear drag" for every effect that the recordings cannot name."""
    tied = [(e.id, *e.indistinguishable_from) for e in diagnosis.effects if e.indistinguishable_from]
    return [listed(map(named, ids), "or") for ids in tied]


def _count(items: Sequence[str]) -> str:
    words = ("no", "one", "two", "three", "four", "five", "six")
    return words[len(items)] if len(items) < len(words) else str(len(items))


def explanation(diagnosis: Diagnosis) -> str:
    """What follows the headline."""
    return " ".join(sentences(diagnosis))


def sentences(diagnosis: Diagnosis) -> list[str]:
    """What follows the headline: what was found, then what is left, then what became of the stated constants."""
    found: list[str] = []
    beside = diagnosis.verdict != "unknown_effect"
    shares = [e.share_explained for e in diagnosis.effects if not (beside and e.learned)]
    if diagnosis.verdict == "data_problem":
        count = len(diagnosis.data_problems)
        more = f"{count} problems were found" if count > 1 else "One problem was found"
        return [f"{more}; no effect was looked for, because a damaged signal looks like missing physics."]
    if diagnosis.verdict == "nothing":
        found.append(
            "The error on held-out recordings is at the noise floor, or does not repeat from one recording to the next."
        )
    if diagnosis.verdict == "named":
        each = "It explains" if len(shares) == 1 else "Together they explain"
        constants = _constants_first(diagnosis)
        found.append(f"{each} {percent(sum(shares))} of the squared error above the noise floor{constants}.")
        if tied := ties(diagnosis):
            more = "One more is" if len(tied) == 1 else f"{_count(tied).capitalize()} more are"
            found.append(f"{more} there that these recordings cannot name: {'; '.join(tied)}.")
    if diagnosis.verdict == "tie":
        alone = f"Any of them explains about {percent(max(shares))}"
        several = f"One of each, together, explain about {percent(sum(shares))}"
        found.append(f"{alone if len(shares) == 1 else several} of the squared error above the noise floor.")
        found += dict.fromkeys(e.separate_by for e in diagnosis.effects if e.separate_by)
    if beside and _terms(diagnosis):
        gained = sum(e.share_explained for e in diagnosis.effects if e.learned)
        found.append(
            f"What is left is not in the catalogue; described as: {'; '.join(_terms(diagnosis))}, it makes another "
            f"{percent(gained)}."
        )
    if diagnosis.verdict == "unknown_effect" and diagnosis.effects:
        each = "It explains" if len(shares) == 1 else "Together they explain"
        found.append(
            f"{each} {percent(sum(shares))} of the squared error above the noise floor{_constants_first(diagnosis)}, "
            "on recordings that were not learned from."
        )
    elif diagnosis.verdict == "unknown_effect":
        share = diagnosis.unexplained.share
        size = f"It makes {percent(share)} of the squared error above the noise floor, and n" if share > 0 else "N"
        found.append(f"{size}o effect of the catalogue explains it on held-out recordings.")
    left = "" if diagnosis.verdict == "unknown_effect" else remainder(diagnosis)
    return [*filter(None, (" ".join(found), left, miscalibrated(diagnosis)))]


def _constants_first(diagnosis: Diagnosis) -> str:
    """What the calibration of constants took before any effect, where that is worth a clause."""
    before = diagnosis.evidence.calibrated
    return f", the constants calibrated before them {percent(before)}" if before >= LITTLE else ""


def remainder(diagnosis: Diagnosis) -> str:
    """A sentence about what the extended model leaves; empty where nothing systematic is left."""
    left = diagnosis.unexplained
    if not left.axes:
        return ""
    if left.share < LITTLE:
        return f"What is still systematic, in {listed(map(named, left.axes))}, makes {percent(left.share)} of it."
    share = f"{percent(left.share)} of the squared error above the floor" if math.isfinite(left.share) else "An error"
    follows = f" and follows {listed(map(named, left.follows))}" if left.follows else ""
    return f"{share} is still systematic in {listed(map(named, left.axes))}{follows}."


def miscalibrated(diagnosis: Diagnosis) -> str:
    """A sentence about base constants whose intervals exclude what was stated, and ratios of them that do."""
    moved = [c for c in diagnosis.evidence.calibration if c.moved and abs(c.sigma) >= SLIGHTLY]
    alone, ratios = ([c for c in moved if (" / " in c.constant) is both] for both in (False, True))
    if not moved:
        return ""
    if not alone:
        return f"Calibration moved ratios of stated constants, of which either may be off: {_first(ratios)}."
    better = f"; known better are ratios: {_first(ratios)}" if ratios else ""
    return f"Calibration moved stated constants: {_first(alone)}{better}."


def _first(moved: Sequence[Calibration]) -> str:
    """The constants that moved most by their stated uncertainties, and how many others did."""
    first = sorted(moved, key=lambda c: -abs(c.sigma))[:MENTIONED]
    more = [f"{len(moved) - len(first)} more"] if len(moved) > len(first) else []
    return listed([*map(change, first), *more])


def change(c: Calibration) -> str:
    """Such as "thrust coefficient by 5.6 % (4.3 % to 6.9 %; 2.8 σ)", σ being the stated uncertainty."""
    value, *ends = (100 * (v / c.nominal - 1) for v in (c.calibrated, c.low, c.high))
    low, high = sorted(ends)
    digits = max(0, min(3, 1 - math.floor(math.log10(high - low)))) if high > low else 1
    by, least, most = (f"{x:.{digits}f} %".replace("-", "−") for x in (value, low, high))
    return f"{named(c.constant)} by {by} ({least} to {most}; {abs(c.sigma):.1f} σ)"


def commands(diagnosis: Diagnosis) -> list[str]:
    """What to type to repeat the diagnosis, and to add its effects one by one."""
    source = shlex.quote(diagnosis.evidence.source or "DATA")
    adds = [
        shlex.quote(e.name) for e in diagnosis.effects if diagnosis.verdict == "named" or not e.indistinguishable_from
    ]
    if diagnosis.verdict == "tie":
        adds = [i for e in diagnosis.effects[:1] for i in (e.id, *e.indistinguishable_from)]
    return [f"bench diagnose {source}", *(f"bench extend {source} --add {i}" for i in adds)]


def parameters(effect: NamedEffect) -> str:
    """All parameters of an effect in a line."""
    return ", ".join(f"{name} = {estimate(name, p)}" for name, p in effect.parameters.items())
