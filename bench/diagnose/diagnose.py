"""All four steps in one: compare, locate, discover, extend."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import torch

from bench.diagnose.answer import Steps, answer, stopped
from bench.diagnose.checks.description.checklist import check_subject
from bench.diagnose.checks.problems import Checked, Known, problems, without_damaged
from bench.diagnose.compare import refuse_long
from bench.diagnose.confirm import Setup, calibrated_only, confirmed, otherwise_told, with_forecasting
from bench.diagnose.discover import read_and_discovered
from bench.diagnose.extend import Extension
from bench.diagnose.learned import Learned, curves, instead, judged, learned, likened, strained
from bench.diagnose.locate import locate
from bench.diagnose.logs.load import load
from bench.diagnose.logs.noise import Noise
from bench.diagnose.logs.parts import in_parts, refuse_short
from bench.diagnose.logs.sample import give_back, sampled
from bench.diagnose.logs.subject import LogBatch, Subject
from bench.diagnose.regression.weak import own_states
from bench.diagnose.result import DataProblem, Diagnosis, DifferingEffect, check_kinds
from bench.diagnose.select.differing import differing
from bench.diagnose.select.discovery import Discovery
from bench.diagnose.settings import DECIDING, LEARNING, MATTERING
from bench.diagnose.simulate.flights import flights
from bench.execution.parallel import both
from registry.contracts import Dataset
from registry.dynamics import PhysicsModel
from registry.effects.waves.hidden_mode import HiddenMode
from registry.effects.waves.periodic_term import PeriodicTerm

Tick = Callable[[str], None]


def silent(what: str) -> None:
    """Say nothing of what is being done."""


def diagnose(
    source: str | Path | Dataset | Subject,
    system: str | None = None,
    model: PhysicsModel | None = None,
    tick: Tick = silent,
    catalogue: Sequence[str] | None = None,
    horizon_s: float | None = None,
    brief: bool = False,
    ignore: Sequence[str] = (),
) -> tuple[Diagnosis, PhysicsModel]:
    """Compare a model with measurements, say where it fails and what is missing, add that and fit it.

    Args:
        source: a folder with a dataset.toml, the name of a registered data set, or measurements already read.
        system: a registered physics model or "path/to/file.py:Class"; default: what the data name.
        model: to start from; default: nominal constants without effects.
        tick: called with what is being done.
        catalogue: ids of the effects to choose from; default: all that are registered.
        horizon_s: longest horizon of the comparisons [s].
        brief: whether to leave out where the error is.
        ignore: kinds of data problems that are noted and do not stop the analysis.

    Returns:
        The diagnosis and the extended model.

    Raises:
        BenchError: data or model cannot be read, or do not fit each other.
    """
    tick("read")
    subject = source if isinstance(source, Subject) else load(source, system, model)
    refuse_short(subject)
    refuse_long(subject, horizon_s)
    check_kinds(ignore)
    named_as = subject.name if isinstance(source, (Subject, Dataset)) else str(source)
    tick("check the data")
    subject, checked, damaged = _checked(subject, ignore)
    if checked.problems and not checked.only_shifts:
        return stopped(subject, named_as, checked.problems), subject.model
    tick("noise")
    source = subject = filed = in_parts(sampled(subject))
    give_back()
    subject, noise, found = read_and_discovered(filed, catalogue, tick)
    known = dict(found.uncertainty) or subject.uncertainty
    subject, filed = (
        replace(s, uncertainty=known, memory=found.memory, long_windows=found.long_windows) for s in (subject, filed)
    )
    run = Setup(subject, noise, tick, horizon_s, filed, catalogue)
    tick("extend")
    found, extension, refuted = confirmed(run, found)
    steps, terms = _concluded(run, found, extension, refuted, source=named_as, checked=checked)
    if checked.problems:
        checked = _shifts_again(replace(steps.subject, model=steps.extension.model), checked)
        if checked.problems:
            return stopped(subject, named_as, checked.problems), subject.model
        steps = replace(steps, checked=checked)
    if not brief:
        tick("locate")
        steps = _shown(steps, noise, terms, horizon_s)
    return answer(replace(steps, damaged=damaged)), steps.extension.model


def _checked(
    subject: Subject, ignore: Sequence[str], known: Known | None = None
) -> tuple[Subject, Checked, tuple[DataProblem, ...]]:
    """What is wrong with the data; how they are read comes first, since everything else follows from it.

    Args:
        subject: the model and all recordings.
        ignore: kinds of problems that are noted and do not stop the analysis.
        known: what recordings said each by itself, beside others that were left out since.

    Returns:
        The subject without few damaged recordings of many, what is wrong with the others, and what was with these.
    """
    stopping, minor = check_subject(subject)
    faults = [p for p in stopping if p.kind not in ignore]
    if faults:
        return subject, Checked(tuple(faults), tuple(minor)), ()
    known = {} if known is None else known
    found = problems(subject, known=known)
    left = tuple(p for p in found.problems if p.kind not in ignore)
    rest = None if Checked(left, ()).only_shifts else without_damaged(subject, left)
    if rest is not None:
        subject, checked, damaged = _checked(rest, ignore, known)
        return subject, checked, (*left, *damaged)
    passed = [p for p in (*stopping, *found.problems) if p.kind in ignore]
    return subject, Checked(left, (*found.suspicions, *minor, *passed)), ()


def _shifts_again(subject: Subject, checked: Checked) -> Checked:
    """What is left of time shifts once the inputs are read when they act, by the model with all that was found.

    Friction that is missing makes motion lead what drives it, named or learned, and so does a wall or a spring; what
    swings out of sight moves it at times of its own.
    """
    model, own = subject.model, {}
    if model.internal_size:
        with torch.no_grad():
            own = {log.name: own_states(model, LogBatch.of([log]))[0] for log in subject.logs}
    again = problems(subject, own)
    return checked if again.problems else Checked((), (*again.suspicions, *checked.problems[:1]))


def _verdict(found: Discovery, excess: dict[str, float], refuted: bool) -> tuple[str, Discovery]:
    """The verdict before anything is learned, and what was learnt as it bears that out.

    Args:
        found: with the effects that free runs confirm.
        excess: by group, squared error of the last model over that of the noise floor.
        refuted: whether effects were found and free runs refute all of them.
    """
    most = max(excess.values(), default=0.0)
    if not found.found and not refuted and most <= MATTERING.near**2:
        found = _remarked(found, most)
    # Where no equation could be judged by itself, what follows no signal at all shows in the free runs only.
    alone = found.verdict == "nothing" and not found.equations and most > DECIDING.high_excess
    verdict = "unknown_effect" if refuted or alone else found.verdict
    if verdict == "unknown_effect" and not found.traces:
        # Free runs show what windows hardly do, such as a slow swing: the signals that are nearest to it are said.
        found = replace(found, traces=found.faint)
    return verdict, found


def _concluded(
    run: Setup, found: Discovery, extension: Extension | None, refuted: bool, *, source: str, checked: Checked
) -> tuple[Steps, Extension | None]:
    """The verdict, and the model with terms learned from what the effects leave where something is still missing.

    Args:
        run: what most steps need.
        found: with the effects that free runs confirm.
        extension: the model with these; None: there are none.
        refuted: whether effects were found and free runs refute all of them.
        source: the data as the user named them.
        checked: what is wrong with them.

    Returns:
        The steps but for what only the page shows, and the model with learned terms; None: there are none.
    """
    if extension is None:
        extension = calibrated_only(run, found)
    excess = _excess(extension)
    verdict, found = _verdict(found, excess, refuted)
    high = _high(extension)
    excess = {group: e for group, e in excess.items() if not _rounding(extension, group)}
    unknown, worth_a_look = verdict == "unknown_effect", max(excess.values(), default=0.0) > MATTERING.near**2
    differ = told = None
    # Of a path that a controller keeps to, what free runs miss is the path and not what acts.
    if (unknown or worth_a_look) and found.inverse is None:
        quiet = not high or _only_begins_unseen(found, extension)
        search = partial(_learned, found=found, extension=extension, verdict=verdict, little=quiet)
        differ, beside, swings = _compared(run, found, extension, search if quiet and not unknown else None)
        if beside != extension.model:
            found, extension = otherwise_told(run, found)
        # What one number for all of them leaves is no term of its own.
        told = search(run) if differ is None and swings else None
        doubtful = not quiet or told is not None or strained(run.subject, extension.model)
        if differ is None and found.found and doubtful:
            told = instead(run, found, extension, told, much=_may_hide_a_mode(extension, verdict == "unknown_effect"))
    if differ is not None and not found.found:
        verdict = "unknown_effect"
    terms, subject = (None, run.subject) if told is None else (told.extension, told.subject)
    if terms is not None:
        extension, found = terms, judged(subject, run.noise, found, terms)
        # What a search for effects took for nothing repeats, and can be learned.
        verdict = found.verdict if found.found else "unknown_effect"
    if differ is None and found.equations and found.inverse is None and _high(extension):
        extension = with_forecasting(replace(run, subject=subject), extension)
    if terms is not None:
        terms = extension = likened(subject, run.noise, extension)
    steps = Steps(subject, source, checked, verdict=verdict, discovery=found, extension=extension, high=high)
    return replace(steps, differing=differ), terms


def _compared(
    run: Setup, found: Discovery, extension: Extension, search: Callable[[Setup], Learned | None] | None
) -> tuple[DifferingEffect | None, PhysicsModel, bool]:
    """What recordings differ in and beside which model, as `differing` says, and whether terms are worth a search.

    A ``search`` that mostly finds nothing is done meanwhile.
    """
    run.tick("compare recordings")
    models = (extension.model, found.calibrated) if found.found else (extension.model,)

    def compared() -> tuple[DifferingEffect | None, PhysicsModel]:
        return differing(run.subject, models, run.noise, run.catalogue)

    if search is None:
        return *compared(), True
    (differ, beside), swings = both(compared, lambda: search(replace(run, tick=silent)) is not None)
    return differ, beside, swings


def _remarked(found: Discovery, excess: float) -> Discovery:
    """What is left to say where free runs err hardly more than the noise makes them: no effect, but a remark."""
    said = (_near_the_floor(found, excess**0.5 - 1),) if found.traces and excess > 1 else ()
    return replace(found, traces=(), remarks=(*found.remarks, *said))  # rounding errors follow signals too


def _near_the_floor(found: Discovery, above: float) -> str:
    signals = " and ".join(dict.fromkeys(t.signal.replace("_", " ") for t in found.traces[:2]))
    return (
        f"A trace that follows {signals} is left, and the error of free runs is {100 * above:.1g} % above the noise "
        "floor: not worth a term."
    )


def _excess(extension: Extension) -> dict[str, float]:
    """By group, squared error of the last model over that of the noise floor; infinite where there is no floor."""
    floor = extension.comparison.error("floor")
    ratio = {g: e.rmse / max(floor[g].rmse, 1e-300) for g, e in extension.last.items()}
    return {g: r * r for g, r in ratio.items()}


def _high(extension: Extension) -> list[str]:
    """The groups in which free runs of the last model err far above the noise floor."""
    excess = _excess(extension)
    return [g for g, e in excess.items() if e > DECIDING.high_excess and not _rounding(extension, g)]


def _rounding(extension: Extension, group: str) -> bool:
    """Whether the last model leaves so little of what the nominal one errs that it follows how rates are computed."""
    nominal = extension.comparison.error("nominal")[group].rmse
    return extension.last[group].rmse ** 2 <= DECIDING.least_share * nominal**2


def _learned(run: Setup, found: Discovery, extension: Extension, verdict: str, little: bool = False) -> Learned | None:
    """The model with terms learned from what it leaves; None: held-out recordings confirm none.

    Where nothing says that something is missing and ``little`` is left, only what swings is sought.
    """
    unknown = verdict == "unknown_effect"
    much = _may_hide_a_mode(extension, unknown)
    little = little and not unknown
    subjects = [run.subject]
    if much and not little and _predictable(found) and not run.subject.long_windows:
        # In short windows a slow effect is hidden by whatever else is left of each moment.
        subjects.append(replace(run.subject, long_windows=True))
    for subject in subjects:
        told = learned(
            subject,
            extension.model,
            run.noise,
            found=found.found,
            named=extension.effects,
            tick=run.tick,
            horizon_s=run.horizon_s,
            filed=run.filed,
            doubtful=not unknown,
            much=much and subject is run.subject,  # hidden modes are sought in windows of several lengths anyway
            little=little,
        )
        if told is not None and _worth_it(extension, told.extension):
            return told
    return None


def _worth_it(before: Extension, after: Extension) -> bool:
    """Whether learned terms take enough of what free runs leave above the floor: of all that effects had to explain.

    Beside effects that explain nearly all of it, a large part of what those leave. Their share is told against a model
    without them whose numbers were not fitted to the end. What swings out of sight is exempt: free runs do not know how
    it begins.
    """
    if any(isinstance(e, (HiddenMode, PeriodicTerm)) for e in after.model.effects):
        return True
    whole, was = (before.comparison.above_floor(e) for e in (before.comparison.error("calibrated"), before.last))
    now = after.comparison.above_floor(after.last)
    return any(was[g] - now[g] > min(MATTERING.share * max(whole[g], was[g]), LEARNING.large * was[g]) for g in now)


def _only_begins_unseen(found: Discovery, extension: Extension) -> bool:
    """Whether free runs err because nobody knows how a load swings when they begin, and for all that is seen only so.

    Each equation judged by itself has nothing left then that functions of measured signals predict, but noise.
    """
    return bool(found.equations) and extension.model.internal_size > 0 and not _predictable(found)


def _predictable(found: Discovery) -> bool:
    """Whether functions of measured signals would predict an equation better than the model does."""
    return any(e.left and e.unexplained >= MATTERING.share for e in found.equations)


def _may_hide_a_mode(extension: Extension, unknown: bool) -> bool:
    """Whether a model leaves so much that it may be a hidden mode.

    A load that swings already when a free run begins leaves much that no hidden mode would say either.
    """
    begins_unseen = extension.model.internal_size > 0
    return _share_left(extension) >= MATTERING.share and (unknown or not begins_unseen)


def _share_left(extension: Extension) -> float:
    """The largest share, over groups, that the last model leaves of the squared error above the noise floor."""
    comparison = extension.comparison
    left, nominal = (comparison.above_floor(e) for e in (extension.last, comparison.error("nominal")))
    return max((left[g] / e for g, e in nominal.items() if e > 0), default=0.0)


def _shown(steps: Steps, noise: Noise, terms: Extension | None, horizon_s: float | None) -> Steps:
    """The steps with what only the page shows: where the error is, shapes of learned terms, whole recordings."""
    subject, extension = steps.subject, steps.extension
    after = extension.model if extension.effects else None
    return replace(
        steps,
        location=locate(subject, steps.discovery.calibrated, after=after, noise=noise, horizon_s=horizon_s),
        curves=() if terms is None else curves(subject, noise, terms),
        flights=flights(subject, subject.model, extension.model, noise, horizon_s),
    )
