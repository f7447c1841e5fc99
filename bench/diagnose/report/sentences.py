"""The verdict of a diagnosis in sentences, and what each effect explains. Plain text, not escaped."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from bench.diagnose.by_equation import EffectSaving, InverseDynamics, ObscuredConstant
from bench.diagnose.evidence import LINES
from bench.diagnose.report import constant_words, equation_errors, learned_words
from bench.diagnose.report.phrases import estimate, lasting, listed, named, number, percent, shown, united
from bench.diagnose.result import ByGroup, Diagnosis, NamedEffect, Unexplained
from bench.diagnose.settings import MATTERING, TELLING
from registry.core import EFFECTS
from registry.dynamics import InternalEffect
from registry.terms.shapes import SHAPES

_FREE = "of the squared error of free runs above the noise floor"
_ALL = 0.995
"""Share of a learned term that is told as 100 %: what does all of it is an effect that the catalogue has."""


def headline(diagnosis: Diagnosis) -> str:
    """The verdict in one plain sentence."""
    if diagnosis.verdict == "data_problem":
        problem = diagnosis.data_problems[0] if diagnosis.data_problems else None
        what = f": {problem.kind} in {named(problem.signal)} of {problem.recording}" if problem else ""
        return f"The recordings must be mended before the model can be judged{what}."
    terms = [e for e in diagnosis.effects if e.learned]
    if diagnosis.verdict == "unknown_effect" and terms:
        known = all(e.term is not None and e.term.nearest and e.term.likeness >= _ALL for e in terms)
        lead = "No effect of the catalogue was found" if known else "The catalogue does not have what the model lacks"
        return f"{lead}; learned instead: {_in_short(terms)}."
    if diagnosis.verdict == "unknown_effect" and diagnosis.differing is not None:
        what = listed(map(named, diagnosis.differing.effects))
        return f"No one model holds for all recordings: they differ in {what}."
    effects = [(e.id, e.indistinguishable_from) for e in diagnosis.effects if e.found]
    left = diagnosis.unexplained
    seen = diagnosis.evidence
    line = verdict_line(diagnosis.verdict, effects, left.axes, left.follows, seen.obscured, seen.inverse)
    moved = [c for told in constant_words.moved(diagnosis) for c in told]
    if diagnosis.verdict == "nothing" and moved and diagnosis.evidence.calibrated >= TELLING.recalibrated:
        return f"{line.removesuffix('.')}, but stated constants are off: {constant_words.change(moved[0])}."
    beside = sum(e.share_explained for e in diagnosis.effects if e.found)
    if terms and sum(e.share_explained for e in terms) > beside:
        return f"{line.removesuffix('.')}; learned beside it, and worth more: {_in_short(terms)}."
    return line


def _in_short(terms: Sequence[NamedEffect]) -> str:
    """Learned terms in a headline: a formula of several numbers without them, any other in full; several by name."""
    if len(terms) > 1:
        return listed(named(e.name) for e in terms)
    (term,) = terms
    formula = term.term is not None and term.term.shape in SHAPES and bool(term.term.signals)
    if term.term is None or not formula or len(term.parameters) == 1:
        return term.described
    return f"{named(term.name)}, {term.term.formula}"


def verdict_line(
    verdict: str,
    effects: Sequence[tuple[str, Sequence[str]]],
    axes: Iterable[str],
    follows: Iterable[str],
    obscured: Iterable[ObscuredConstant],
    inverse: InverseDynamics | None = None,
) -> str:
    """A verdict on the model in one plain sentence, the same after a search for effects as after a whole diagnosis.

    Args:
        verdict: one of `VERDICTS` but "data_problem".
        effects: ids of those found, each with those that explain the recordings as well.
        axes: channels in which something systematic is left.
        follows: signals that it follows.
        obscured: constants that are not to be believed.
        inverse: what the input works against nevertheless.
    """
    if verdict == "named":
        tied = _tied(effects)
        or_else = f", and either {tied[0]}" if len(tied) == 1 else ""
        return f"The model lacks {listed(named(i) for i, rivals in effects if not rivals)}{or_else}."
    if verdict == "tie":
        tied = _tied(effects)
        if len(tied) > 1:
            return f"The model lacks {_count(tied)} effects that these recordings cannot name: {'; '.join(tied)}."
        return f"The model lacks something, and these recordings cannot tell whether it is {tied[0]}."
    if inverse is not None:
        return f"The {inverse.drive} works against {named(inverse.effect)}; forecasts by it gain nothing."
    if verdict == "unknown_effect":
        where, signals = list(dict.fromkeys(map(named, axes))), list(dict.fromkeys(map(named, follows)))
        acts = f"acts on {listed(where)}" if where else "moves the system"
        said = f" and follows {listed(signals)}" if signals else ""
        return f"Something systematic that is not in the catalogue {acts}{said}."
    if lost := not_understood(obscured):
        return f"No effect of the catalogue was found, and {listed(lost)} cannot be explained."
    return "No effect of the catalogue is missing as far as these recordings can show."


def ties(diagnosis: Diagnosis) -> list[str]:
    """ "rotor drag or linear drag" for every effect that the recordings cannot name."""
    return _tied([(e.id, e.indistinguishable_from) for e in diagnosis.effects])


def _tied(effects: Sequence[tuple[str, Sequence[str]]]) -> list[str]:
    return [listed(map(named, (i, *rivals)), "or") for i, rivals in effects if rivals]


def _count(items: Sequence[str]) -> str:
    words = ("no", "one", "two", "three", "four", "five", "six")
    return words[len(items)] if len(items) < len(words) else str(len(items))


def explanation(diagnosis: Diagnosis) -> str:
    """What follows the headline."""
    return " ".join((*paragraphs(diagnosis), *constant_words.miscalibrated(diagnosis)))


def paragraphs(diagnosis: Diagnosis) -> list[str]:
    """What follows the headline: what was found, then what is left; not what became of the stated constants."""
    found: list[str] = []
    beside, seen = diagnosis.verdict != "unknown_effect", diagnosis.evidence
    shares = [e.share_explained for e in diagnosis.effects if e.found or (e.learned and not beside)]
    if diagnosis.verdict == "data_problem":
        count = len(diagnosis.data_problems)
        more = f"{count} problems were found" if count > 1 else "One problem was found"
        return [f"{more}; no effect was looked for, because a damaged signal looks like missing physics."]
    if diagnosis.verdict == "nothing" and not not_understood(diagnosis.evidence.obscured):
        found.append(_nothing_more(diagnosis))
    if diagnosis.verdict == "named":
        each = "It explains" if len(shares) == 1 else "Together they explain"
        constants = _constants_first(diagnosis)
        if abs(sum(shares)) < 0.01 and any(e.saves for e in diagnosis.effects):
            found.append(
                f"{each} errors of single equations, each judged by itself; less than 1 % {_FREE} goes with that"
                f"{constants}."
            )
        else:
            found.append(f"{each} {percent(sum(shares))} {_FREE}{constants}.")
        if len(tied := ties(diagnosis)) > 1:
            more = f"{_count(tied).capitalize()} more effects act that these recordings cannot name"
            found.append(f"{more}: {'; '.join(tied)}.")
    if diagnosis.verdict == "tie":
        alone = f"Any of them explains about {percent(max(shares))}"
        several = f"Together, one of each explains about {percent(sum(shares))}"
        found += [] if seen.inverse else [f"{alone if len(shares) == 1 else several} {_FREE}."]
        found += dict.fromkeys(e.separate_by for e in diagnosis.effects if e.separate_by and not e.learned)
        found.append(f"What would tell most within what was recorded: {diagnosis.evidence.command('design')}.")
    if beside and (terms := [e for e in diagnosis.effects if e.learned]):
        names, gained = listed(e.name for e in terms), percent(sum(e.share_explained for e in terms))
        each = (
            "A term learned from what is left explains"
            if len(terms) == 1
            else "Terms learned from what is left explain"
        )
        found.append(f"{each} another {gained}: {names}.")
    if diagnosis.verdict == "unknown_effect" and shares:
        each = "it explains" if len(shares) == 1 else "together they explain"
        constants = _constants_first(diagnosis)
        found.append(f"On recordings not learned from, {each} {percent(sum(shares))} {_FREE}{constants}.")
    elif diagnosis.verdict == "unknown_effect" and diagnosis.differing is None:
        share = diagnosis.unexplained.share
        size = f"It makes {percent(share)} {_FREE}, and n" if share > 0 else "N"
        found.append(f"{size}o effect of the catalogue explains it on held-out recordings.")
    left = "" if diagnosis.verdict == "unknown_effect" else remainder(diagnosis)
    after = (
        learned_words.alike(diagnosis),
        forecasting(diagnosis),
        left,
        differing(diagnosis),
        _contradicted(diagnosis),
    )
    inverse = [] if seen.inverse is None else [constant_words.works_against(seen.inverse)]
    return [*inverse, *filter(None, (" ".join(found), *after))]


def forecasting(diagnosis: Diagnosis) -> str:
    """What is in the model for its forecasts alone; empty: nothing."""
    added = next((e for e in diagnosis.effects if e.forecast_only), None)
    if added is None:
        return ""
    fallen = listed(
        f"{named(g)} {number(factor * e.rmse)} → {united(number(factor * added.error_after[g].rmse), unit)}"
        for g, e in added.error_before.items()
        for unit, factor in [shown(e.unit, g, [e.rmse, added.error_after[g].rmse])]
    )
    return (
        f"Forecasts ask for {named(added.id)}, which no equation by itself confirms: with it free runs of held-out "
        f"recordings end nearer ({fallen}). A controller that brings these states back would look the same, so it is "
        "in the model and no finding."
    )


def differing(diagnosis: Diagnosis) -> str:
    """In what recordings differ, with the numbers of those that differ most; empty: in nothing that shows."""
    told = diagnosis.differing
    if told is None:
        return ""
    numbers = []
    for name in next(iter(told.by_recording.values())):
        found = sorted((p[name].value, recording) for recording, p in told.by_recording.items())
        ends = (f"{estimate(name, told.by_recording[r][name])} in {r}" for _, r in (found[0], found[-1]))
        numbers.append(f"{name} from {' to '.join(ends)}")
    rivals = f" ({listed(map(named, told.rivals), 'or')} would do nearly as well)" if told.rivals else ""
    return (
        f"Recordings differ in {listed(map(named, told.effects))}{rivals}: {'; '.join(numbers)}. With numbers of each "
        f"recording's own {percent(told.share)} is explained of the squared error that one number for all leaves where "
        f"it acts.{_one_by_one(diagnosis)}"
    )


def _contradicted(diagnosis: Diagnosis) -> str:
    """What only some of the recordings show; empty: nothing."""
    names = listed(map(named, diagnosis.evidence.contradicted_effects))
    return (
        f"The recordings that were learnt from show {names}, and those held out get worse with it: recordings differ, "
        f"and it is not named.{_one_by_one(diagnosis) if diagnosis.differing is None else ''}"
        if names
        else ""
    )


def _one_by_one(diagnosis: Diagnosis) -> str:
    """What to type where recordings differ; empty: they cannot be taken one by one."""
    of = diagnosis.evidence
    return f" What each of them says by itself: {of.command('diagnose', '--each-recording')}." if of.parted else ""


def _constants_first(diagnosis: Diagnosis) -> str:
    """What the calibration of constants took before any effect, where that is worth a clause."""
    before = diagnosis.evidence.calibrated
    return f"; the constants, calibrated first, explain {percent(before)}" if before >= TELLING.little_left else ""


def not_understood(obscured: Iterable[ObscuredConstant]) -> list[str]:
    """Equations of which a constant went where no such system has it, and nothing tells what it is."""
    return list(dict.fromkeys(c.equation for c in obscured if c.told is None))


def _nothing_more(diagnosis: Diagnosis) -> str:
    """What the error is made of where nothing is missing: noise, a disturbance, or what is faster than one."""
    lines = falls(diagnosis)
    if not _disturbed(diagnosis.unexplained):
        times = max((f.over_noise for f in lines), default=1.0)
        if times <= MATTERING.near:
            return "The error on held-out recordings is at the noise floor."
        left = (
            "not worth a term"
            if times <= TELLING.more_than_noise
            else "more than noise, but no measured signal explains enough of it on held-out recordings"
        )
        error = f"The error on held-out recordings is up to {number(times, 2)} times the noise floor"
        return f"{error}; what is left is {left}."
    if better := equation_errors.better_told(diagnosis):
        return better
    if any(f.observed for f in lines) or all(math.isnan(f.errors["disturbance"]) for f in lines):
        return (
            "What is left is more than noise and follows no measured signal: wind, something that swings, sticks or "
            "slips, or an input that was not logged."
        )
    return (
        "What is left follows no measured signal, and the moments before do not tell it, as they would of wind: noise, "
        "of which sensors that filter it show too little (`[processing] noise` states it), vibration, inputs between "
        "their samples, or something that swings."
    )


def _disturbed(left: Unexplained) -> bool:
    """Whether much is left that is no noise and goes with nothing that was measured."""
    return bool(left.axes) and not left.follows and not left.share < TELLING.little_left


def remainder(diagnosis: Diagnosis) -> str:
    """A sentence about what the extended model leaves; empty where nothing systematic is left."""
    left = diagnosis.unexplained
    if not left.axes:
        return ""
    axes, share = listed(map(named, left.axes)), percent(left.share)
    if left.share < TELLING.little_left:
        return f"Something systematic is left in {axes}; it makes {share} {_FREE}."
    size = f": {share} {_FREE}" if math.isfinite(left.share) else ""
    follows = f" It follows {listed(map(named, left.follows))}." if left.follows else ""
    swings = [e.id for e in diagnosis.effects if e.found and issubclass(EFFECTS.get(e.id), InternalEffect)]
    begins = f" Where {listed(map(named, swings))} begins a free run was not measured; some of it is that."
    return f"A systematic error is left in {axes}{size}.{follows}{begins if swings else ''}"


def observed(diagnosis: Diagnosis) -> str:
    """A sentence about what the past of the error tells; empty where it tells little."""
    helped = [f for f in falls(diagnosis) if f.observed]
    if not helped:
        return ""
    each = listed(
        f"{named(f.group)} after {f.horizon} from {f.text(f.after)} to {united(f.text('disturbance'), f.unit)}"
        for f in helped
    )
    return (
        f"A disturbance observer would bring {each}: that much of what the model leaves is slow, can be "
        "told from the moments before, and follows no measured signal that was found."
    )


def commands(diagnosis: Diagnosis) -> list[str]:
    """What to type to repeat the diagnosis, and to add what it found; in a tie, each of the effects by itself."""
    of = diagnosis.evidence
    if of.part:
        return [of.command("diagnose", *of.part)]
    adds = [[e.name for e in diagnosis.effects if diagnosis.verdict == "named" or not e.indistinguishable_from]]
    if diagnosis.verdict == "tie":
        adds = [[i] for e in diagnosis.effects[:1] for i in (e.id, *e.indistinguishable_from)]
    told = [of.command("design")] if ties(diagnosis) else []
    extends = [of.command("extend", *(w for i in some for w in ("--add", i))) for some in adds if some]
    return [of.command("diagnose"), *told, *extends]


def acts(saving: EffectSaving) -> str:
    """Where an effect saves: "forces", "torques about z"."""
    if not saving.axis:
        return named(saving.equation)
    kind, _, letter = saving.axis.rpartition(" ")
    how = {"force": "along", "torque": "about"}.get(kind)
    return f"{named(saving.equation)} {how} {letter}" if how else f"{named(saving.equation)}, {named(saving.axis)}"


def savings(effect: NamedEffect) -> list[EffectSaving]:
    """What an effect is worth a term for: an equation as a whole, or the axes of one that it is not."""
    whole = {s.equation for s in effect.saves if s.worth and not s.axis}
    return [s for s in effect.saves if s is effect.main or (s.worth and (not s.axis or s.equation not in whole))]


def explains(effect: NamedEffect) -> str:
    """Such as "explains 98 % in torques about z, 1 % in free runs": where it saves most, then of free runs."""
    if effect.forecast_only:
        return "for forecasts only"
    free = f"{percent(effect.share_explained)} in free runs"
    main = effect.main
    return f"explains {free}" if main is None else f"explains {percent(main.share)} in {acts(main)}, {free}"


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

    @property
    def over_noise(self) -> float:
        """The error that the diagnosis ends with, over that of noise alone; 1 where either is not known."""
        ratio = self.errors[self.after] / (self.errors["floor"] or math.nan)
        return 1.0 if math.isnan(ratio) else ratio

    @property
    def observed(self) -> bool:
        """Whether a disturbance observer lowers the error by enough to be told."""
        return self.errors["disturbance"] < TELLING.observer_helps * self.errors[self.after]

    @property
    def networked(self) -> bool:
        """Whether a network was asked what it leaves."""
        return not math.isnan(self.errors["network"])

    def text(self, model: str) -> str:
        """The error of a model."""
        error = self.errors[model]
        return "diverged" if math.isinf(error) else number(error)

    def width(self, model: str) -> str:
        """The error of a model as the length of a bar, of the largest."""
        error, top = self.errors[model], max((e for e in self.errors.values() if math.isfinite(e)), default=0.0)
        return f"{100 * (min(error, top) / top if top and not math.isnan(error) else 0):.1f}%"


def falls(diagnosis: Diagnosis) -> list[Fall]:
    """One for every output group."""
    lines: tuple[ByGroup, ...] = (
        diagnosis.error.nominal,
        diagnosis.error.calibrated,
        diagnosis.error.extended,
        diagnosis.disturbance_floor,
        diagnosis.ceiling or {},
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
        out.append(Fall(group, lasting(first.horizon_s), unit, by_model, after))
    return out
