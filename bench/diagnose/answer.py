"""The answer of a diagnosis, put together from what its steps have found."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from bench.diagnose.by_equation import ConstantEstimate
from bench.diagnose.checks.problems import Checked
from bench.diagnose.evidence import Calibration, Candidate, Evidence, Flight
from bench.diagnose.extend import Extension, pooled
from bench.diagnose.learned_shape import LearnedCurve
from bench.diagnose.locate import Location
from bench.diagnose.logs.subject import Subject
from bench.diagnose.regression.parameters import entries
from bench.diagnose.report.phrases import listed, named
from bench.diagnose.result import ByGroup, DataProblem, Diagnosis, DifferingEffect, Errors, Unexplained
from bench.diagnose.select.discovery import Discovery
from bench.diagnose.settings import DECIDING, MATTERING
from bench.diagnose.simulate.unmeasured import hidden
from bench.diagnose.summaries import constant_estimates, equation_results, placed


@dataclass(frozen=True, eq=False)
class Steps:
    """What every step of a diagnosis that was not stopped by its data has found."""

    subject: Subject
    source: str
    """The data as the user named them."""
    checked: Checked
    verdict: str
    discovery: Discovery
    extension: Extension
    """Without effects: the calibrated model."""
    high: Sequence[str]
    """Output groups whose free runs err far above the floor."""
    differing: DifferingEffect | None = None
    """What recordings differ in so much that no one number holds for all."""
    location: Location = field(default_factory=Location)
    curves: tuple[LearnedCurve, ...] = ()
    """The shapes of learned terms."""
    flights: tuple[Flight, ...] = ()
    damaged: tuple[DataProblem, ...] = ()
    """What is wrong with recordings that were left out."""


def stopped(subject: Subject, source: str, found: Sequence[DataProblem]) -> Diagnosis:
    """What is said when the data must be mended first."""
    nothing: ByGroup = {}
    return Diagnosis(
        dataset=subject.name,
        system=subject.system,
        verdict="data_problem",
        noise_floor=nothing,
        error=Errors(nothing, nothing, nothing),
        effects=(),
        unexplained=Unexplained(float("nan")),
        where=(),
        data_problems=tuple(found),
        evidence=Evidence(source, len(subject.logs), _seconds(subject), subject.held_out),
    )


def answer(steps: Steps) -> Diagnosis:
    """The contract, and the evidence for it."""
    subject, discovery, extension = steps.subject, steps.discovery, steps.extension
    error, effects = extension.comparison.error, extension.effects
    constants = constant_estimates(subject, extension.model, extension.constants)
    return Diagnosis(
        dataset=subject.name,
        system=subject.system,
        verdict=steps.verdict,
        noise_floor=error("floor"),
        disturbance_floor=error("disturbance"),
        error=Errors(error("nominal"), error("calibrated"), extension.last),
        effects=placed(discovery, effects),
        unexplained=_unexplained(steps),
        where=steps.location.regions,
        data_problems=steps.damaged,
        evidence=_evidence(steps, constants),
        by_equation=equation_results(discovery, subject.model, bool(effects)),
        constants=constants,
        differing=steps.differing,
    )


def _evidence(steps: Steps, constants: Mapping[str, ConstantEstimate]) -> Evidence:
    subject, discovery, extension = steps.subject, steps.discovery, steps.extension
    return Evidence(
        source=steps.source,
        recordings=len(subject.logs),
        seconds=_seconds(subject),
        held_out=subject.held_out,
        curves=extension.comparison.curves,
        calibrated=extension.calibrated,
        waterfall=extension.stages,
        ranking=_ranking(discovery),
        calibration=_calibration(subject, discovery, constants),
        residuals=steps.location.residuals,
        windows=steps.location.windows,
        hypothesis="" if extension.effects else _hypothesis(discovery),
        remarks=discovery.remarks,
        notes=_notes(steps),
        learned=steps.curves,
        flights=steps.flights,
        obscured=discovery.obscured,
        inverse=discovery.inverse,
        contradicted_effects=discovery.contradicted_effects,
        parted=subject.folder is not None and not subject.folder.only and len(subject.folder.names) > 1,
    )


def _seconds(subject: Subject) -> float:
    return sum(len(log) / log.rate for log in subject.logs)


def _notes(steps: Steps) -> tuple[str, ...]:
    discovery = steps.discovery
    return (
        *dict.fromkeys((*steps.subject.notes, *discovery.notes)),
        *steps.extension.comparison.notes,
        *steps.location.notes,
        *_high_floor(steps),
        *_warnings(steps.subject, discovery, steps.checked.suspicions),
    )


def _high_floor(steps: Steps) -> list[str]:
    """A sentence where the model errs less than noise alone is said to."""
    floor, left = steps.extension.comparison.error("floor"), steps.extension.last
    groups = [g for g, e in floor.items() if g in left and e.rmse > MATTERING.near * left[g].rmse]
    if not groups:
        return []
    return [
        f"The estimated noise floor of {listed(named(g) for g in groups)} is too high: the extended model errs less "
        "than that. Inputs that move as fast as they are sampled look noisier than they are; what is known of their "
        "noise can be stated under [processing] in dataset.toml."
    ]


def _unexplained(steps: Steps) -> Unexplained:
    comparison, after = steps.extension.comparison, steps.extension.last
    nominal, floor = comparison.error("nominal"), comparison.error("floor")
    scale = {g: max(e.rmse, 1e-300) for g, e in nominal.items()}
    above = max(pooled(nominal, scale), pooled(after, scale)) - pooled(floor, scale)
    share = max(0.0, (pooled(after, scale) - pooled(floor, scale)) / above) if above > 0 else float("nan")
    left = sum(t.gain for t in steps.discovery.traces)
    axes: list[str] = []
    signals: list[str] = []
    so_far = 0.0
    for trace in steps.discovery.traces:
        if so_far > DECIDING.traces_shown * left:
            break
        so_far += trace.gain
        axes.append(trace.axis)
        drive = getattr(steps.subject.model, "drive", "input")
        signals += [drive if p == "input" else p for p in trace.signal.split(" × ")]
    return Unexplained(share, tuple(dict.fromkeys(axes or steps.high)), tuple(dict.fromkeys(signals)))


def _ranking(found: Discovery) -> tuple[tuple[Candidate, ...], ...]:
    return tuple(tuple(Candidate(c.id, c.gain, c.low, c.high, c.text, c.why) for c in one) for one in found.rounds)


def _calibration(subject: Subject, found: Discovery, last: Mapping[str, ConstantEstimate]) -> tuple[Calibration, ...]:
    """What became of the constants: of each what the model that is returned has, and of their ratios.

    Args:
        subject: with the stated constants.
        found: says which ratios the equations tell, and how well.
        last: the constants of that model.
    """
    known = subject.uncertainty if found.stated is None else dict(found.stated)
    given = {e.label: e for e in entries(subject.model, known)}
    out = []
    for x in found.constants:
        e, nominal, end = x.entry, given[x.entry.label].value, last.get(x.entry.label)
        value, low, high = (x.value, x.low, x.high) if end is None else (end.value, end.low, end.high)
        moved = Calibration(
            constant=e.label,
            nominal=nominal,
            calibrated=value,
            unit=e.unit,
            sigma=(value - nominal) / given[e.label].scale,
            low=low,
            high=high,
            stopped=e.stopped(value),
        )
        out.append(moved)
    for r in found.ratios:
        a, b = given[r.over.label], given[r.under.label]
        nominal, stated = a.value / b.value, math.hypot(a.scale / a.value, b.scale / b.value)
        ends = [last[e.label].value for e in (a, b) if e.label in last]
        value = ends[0] / ends[1] if len(ends) == 2 else r.value
        half = max(r.high - r.value, r.value - r.low, abs(value - r.value))  # two that differ are worth no more
        moved = Calibration(
            constant=f"{a.label} / {b.label}",
            nominal=nominal,
            calibrated=value,
            unit=f"{a.unit} / ({b.unit})" if " " in b.unit else f"{a.unit} / {b.unit}",
            sigma=(value / nominal - 1) / stated,
            low=value - half,
            high=value + half,
        )
        out.append(moved)
    return tuple(out)


def _hypothesis(found: Discovery) -> str:
    """The first terms of what is left, as a formula offered for thought."""
    if not found.traces:
        return ""
    first = [t for t in found.traces if t.gain > DECIDING.hypothesis_term * found.traces[0].gain][:3]
    said = "; ".join(f"{t.axis} goes with {t.text}" for t in first)
    alike = f" The catalogue's nearest imitation is {', '.join(found.confounders)}." if found.confounders else ""
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
