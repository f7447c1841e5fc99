"""All four steps in one: compare, locate, discover, extend."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from bench.diagnose.checks.checklist import check_subject
from bench.diagnose.checks.problems import Checked, problems
from bench.diagnose.compare import compare
from bench.diagnose.discover import discover
from bench.diagnose.extend import extend, fitted, pooled
from bench.diagnose.learned import curves, judged, learned
from bench.diagnose.locate import Location, locate
from bench.diagnose.logs.load import load
from bench.diagnose.logs.subject import Subject
from bench.diagnose.regression.parameters import entries
from bench.diagnose.result import (
    ByGroup,
    Calibration,
    Candidate,
    DataProblem,
    Diagnosis,
    Errors,
    Evidence,
    Stage,
    Unexplained,
)
from bench.diagnose.select.discovery import Discovery
from bench.diagnose.select.input_timing import prepared
from bench.diagnose.select.materiality import NEAR
from bench.diagnose.simulate.flights import flights
from bench.diagnose.simulate.unmeasured import hidden
from bench.diagnose.summaries import constant_estimates, effect_savings, equation_results, placed
from registry.contracts import Dataset
from registry.dynamics import PhysicsModel

HIGH = 2.0
"""Squared error over the noise floor's from which something is missing although it follows no signal."""
NOTHING = 1e-6
"""Share of the squared error that an effect must explain in free runs: what is less follows how rates are computed."""

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
    named_as = subject.name if isinstance(source, (Subject, Dataset)) else str(source)
    tick("check the data")
    checked = _checked(subject, ignore)
    shifted = bool(checked.problems) and all(p.kind == "time shift" for p in checked.problems)
    if checked.problems and not shifted:
        return _broken(subject, named_as, checked.problems), subject.model
    tick("noise")
    subject, noise = prepared(subject, tick=tick)
    found = discover(subject, catalogue, tick, noise)
    rivals = {f.id: f.rivals for f in found.found}
    names = [f.id for f in found.found]
    tick("extend")
    if names:
        known = {f.id: f.effect for f in found.found}
        extension = extend(subject, subject.model, names, tick, noise, rivals, known, horizon_s)
        if vanished := [e.id for e in extension.effects if abs(e.share_explained) < NOTHING]:
            found, names = _unnamed(found, vanished), [n for n in names if n not in vanished]
            extension = extend(subject, subject.model, names, tick, noise, rivals, known, horizon_s)
    # Where each equation was judged by itself, a free run that is lost in another one refutes nothing.
    refuted = bool(names) and not found.equations and sum(e.share_explained for e in extension.effects) < 0
    if refuted:
        found, names = _unnamed(found, names), []
    if shifted:  # unless the inputs were read anew, or friction is missing, which makes motion lead what drives it
        again = problems(replace(subject, model=extension.model) if names else subject)
        if again.problems:
            return _broken(subject, named_as, checked.problems), subject.model
        checked = Checked((), (*again.suspicions, *checked.problems[:1]))
    if names:
        model = extension.model
        comparison, stages, effects = extension.comparison, extension.stages, extension.effects
        taken, numbers = extension.calibrated, extension.constants
    else:
        model, effects, taken, numbers = found.calibrated, (), 0.0, found.constants
        if subject.model.effects:  # it was fitted so that free runs meet the measurements, and stays so
            model, estimated = fitted(subject, subject.model, noise, tick)
            numbers = tuple(estimated)
        comparison = compare(subject, {"calibrated": model}, noise=noise, horizon_s=horizon_s)
        stages = tuple(Stage(n, {g: e.rmse for g, e in comparison.error(n).items()}) for n in comparison.lines)
    nominal, after, floor = (comparison.error(n) for n in ("nominal", "extended" if names else "calibrated", "floor"))
    if not names and not refuted and max(_excess(after, floor).values(), default=0.0) <= NEAR**2:
        found = _remarked(found, max(_excess(after, floor).values(), default=0.0))
    # Where no equation could be judged by itself, what follows no signal at all shows in the free runs only.
    alone = found.verdict == "nothing" and not found.equations and max(_excess(after, floor).values(), default=0) > HIGH
    verdict = "unknown_effect" if refuted or alone else found.verdict
    if verdict == "unknown_effect" and not found.traces:
        # Free runs show what windows hardly do, such as a slow swing: the signals that are nearest to it are said.
        found = replace(found, traces=found.faint)
    axes = [g for g, ratio in _excess(after, floor).items() if ratio > HIGH]
    more = None
    if verdict == "unknown_effect" or axes:
        named = [f for f in found.found if f.id in names]
        more = learned(subject, model, noise, tick, horizon_s, named, verdict != "unknown_effect")
    if more is not None:
        extension = more
        model, comparison, numbers = extension.model, extension.comparison, extension.constants
        stages, effects, taken = extension.stages, extension.effects, extension.calibrated
        nominal, after, floor = (comparison.error(n) for n in ("nominal", "extended", "floor"))
        found = judged(subject, noise, found, extension)
        # What a search for effects took for nothing repeats, and can be learned.
        verdict = found.verdict if found.found else "unknown_effect"
    nowhere = Location((), (), (), float("nan"), {}, ())
    if not brief:
        tick("locate")
    location = nowhere if brief else locate(subject, found.calibrated, after=model if effects else None, noise=noise)
    return (
        Diagnosis(
            subject.name,
            subject.system,
            verdict,
            floor,
            Errors(nominal, comparison.error("calibrated"), after),
            placed(found, effects),
            _unexplained(subject, found, nominal, after, floor, axes),
            location.regions,
            (),
            Evidence(
                named_as,
                len(subject.logs),
                sum(len(log) / log.rate for log in subject.logs),
                subject.held_out,
                comparison.curves,
                taken,
                stages,
                _ranking(found),
                _calibration(subject, found),
                location.residuals,
                location.windows,
                "" if effects else _hypothesis(found),
                (
                    *found.remarks,
                    *dict.fromkeys((*subject.notes, *found.notes)),
                    *comparison.notes,
                    *location.notes,
                    *_warnings(subject, found, checked.suspicions),
                ),
                () if brief or more is None else curves(subject, noise, more),
                effect_savings(found, effects),
                () if brief else flights(subject, subject.model, model, noise),
            ),
            equation_results(found, subject.model, bool(effects)),
            constant_estimates(subject, model, numbers),
        ),
        model,
    )


def _checked(subject: Subject, ignore: Sequence[str]) -> Checked:
    """What is wrong with the data; how they are read comes first, since everything else follows from it."""
    stopping, minor = check_subject(subject)
    faults = [p for p in stopping if p.kind not in ignore]
    if faults:
        return Checked(tuple(faults), tuple(minor))
    found = problems(subject)
    passed = [p for p in (*stopping, *found.problems) if p.kind in ignore]
    left = tuple(p for p in found.problems if p.kind not in ignore)
    return Checked(left, (*found.suspicions, *minor, *passed))


def _unnamed(found: Discovery, names: Sequence[str]) -> Discovery:
    """What is left to say when effects found make the forecast of held-out recordings no better."""
    note = (
        f"{', '.join(names)} explained the rates of the recordings that were learnt from, but did not make the "
        "forecast of recordings better, and so is not named."
    )
    left = tuple(f for f in found.found if f.id not in names)
    return replace(found, found=left, imitators=(*found.imitators, *names), notes=(*found.notes, note))


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


def _excess(error: ByGroup, floor: ByGroup) -> dict[str, float]:
    """By group, squared error over that of the noise floor."""
    ratio = {g: e.rmse / max(floor[g].rmse, 1e-300) for g, e in error.items()}
    return {g: r * r for g, r in ratio.items()}  # infinite where there is no floor


def _broken(subject: Subject, source: str, found: Sequence[DataProblem]) -> Diagnosis:
    """What is said when the data must be mended first."""
    nothing: ByGroup = {}
    return Diagnosis(
        subject.name,
        subject.system,
        "data_problem",
        nothing,
        Errors(nothing, nothing, nothing),
        (),
        Unexplained(float("nan")),
        (),
        tuple(found),
        Evidence(source, len(subject.logs), sum(len(log) / log.rate for log in subject.logs), subject.held_out),
    )


def _unexplained(
    subject: Subject, found: Discovery, nominal: ByGroup, after: ByGroup, floor: ByGroup, high: Sequence[str]
) -> Unexplained:
    scale = {g: max(e.rmse, 1e-300) for g, e in nominal.items()}
    above = max(pooled(nominal, scale), pooled(after, scale)) - pooled(floor, scale)
    share = max(0.0, (pooled(after, scale) - pooled(floor, scale)) / above) if above > 0 else float("nan")
    # The traces that make nine tenths of what is left.
    left = sum(t.gain for t in found.traces)
    axes: list[str] = []
    signals: list[str] = []
    so_far = 0.0
    for trace in found.traces:
        if so_far > 0.9 * left:
            break
        so_far += trace.gain
        axes.append(trace.axis)
        drive = getattr(subject.model, "drive", "input")
        signals += [drive if p == "input" else p for p in trace.signal.split(" × ")]
    return Unexplained(share, tuple(dict.fromkeys(axes or high)), tuple(dict.fromkeys(signals)))


def _ranking(found: Discovery) -> tuple[tuple[Candidate, ...], ...]:
    return tuple(tuple(Candidate(c.id, c.gain, c.low, c.high, c.text, c.why) for c in one) for one in found.rounds)


def _calibration(subject: Subject, found: Discovery) -> tuple[Calibration, ...]:
    given = {e.label: e.value for e in entries(subject.model, subject.uncertainty)}
    out = []
    for x in found.constants:
        e, nominal = x.entry, given[x.entry.label]
        out.append(Calibration(e.label, nominal, x.value, e.unit, (x.value - nominal) / e.scale, x.low, x.high))
    for r in found.ratios:
        a, b = r.over, r.under
        nominal = given[a.label] / given[b.label]
        sigma = (r.value / nominal - 1) / math.hypot(a.scale / given[a.label], b.scale / given[b.label])
        name, unit = f"{a.label} / {b.label}", f"{a.unit} / ({b.unit})" if " " in b.unit else f"{a.unit} / {b.unit}"
        out.append(Calibration(name, nominal, r.value, unit, sigma, r.low, r.high))
    return tuple(out)


def _hypothesis(found: Discovery) -> str:
    """The first terms of what is left, as a formula offered for thought."""
    if not found.traces:
        return ""
    first = [t for t in found.traces if t.gain > 0.1 * found.traces[0].gain][:3]
    said = "; ".join(f"{t.axis} goes with {t.text}" for t in first)
    alike = f" The catalogue's nearest imitation is {', '.join(found.imitators)}." if found.imitators else ""
    return f"{said}.{alike}"


def _warnings(subject: Subject, found: Discovery, suspicions: Sequence[DataProblem]) -> tuple[str, ...]:
    out = [s.detail for s in suspicions]
    if unseen := [subject.model.state_channels[i].name for i in hidden(subject.logs)]:
        out.append(
            f"Not measured: {', '.join(unseen).replace('_', ' ')}. Each model's own simulation stands in for it, and "
            "sets of effects were fitted and compared by simulation, not in the weak form."
        )
    if any(f.id in ("input_delay", "transport_delay") for f in found.found) or any(
        s.kind == "time shift" for s in suspicions
    ):
        out.append(
            "A constant delay of the input and a clock of the states that runs ahead of that of the inputs look the "
            "same: check how the log was put together (data problem: time shift) before input_delay goes into a model."
        )
    return tuple(dict.fromkeys(out))
