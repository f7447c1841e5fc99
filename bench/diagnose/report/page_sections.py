"""What the sections of the diagnosis page show: drawings, and values in the units of a reader."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from bench.diagnose.evidence import LINES, Calibration, Candidate
from bench.diagnose.report import ceiling_words, constant_words, phrases, sentences
from bench.diagnose.report import page_figures as figures
from bench.diagnose.report.page_equations import equation_by_equation
from bench.diagnose.report.page_flights import over_time
from bench.diagnose.result import Diagnosis, NamedEffect, ParameterEstimate, Region
from bench.diagnose.settings import TELLING
from bench.reporting.page import Drawing, Section


def sections(d: Diagnosis) -> list[Section]:
    """Those of the page, in order; one that has nothing to say has no content."""
    return [Section(title, part, content(d)) for title, part, content in _SECTIONS]


@dataclass(frozen=True)
class _Drawn:
    """Drawings, and the models whose lines they hold."""

    drawings: Sequence[Drawing]
    models: Sequence[str]


@dataclass(frozen=True)
class _Curves(_Drawn):
    rows: Sequence[tuple[str, str, list[str]]]
    """Recording, output and the error of each of ``models`` at the longest horizon."""


@dataclass(frozen=True)
class _Where(_Drawn):
    regions: Sequence[Region]


@dataclass(frozen=True)
class _Left:
    sentence: str
    remarks: Sequence[str]
    hypothesis: str
    axes: Sequence[ceiling_words.Row]
    """What a network leaves of single axes."""


@dataclass(frozen=True)
class _Constant:
    name: str
    values: Sequence[str]
    """Stated, calibrated, low and high."""
    unit: str
    change: str
    sigma: str
    off: bool


@dataclass(frozen=True)
class _Constants:
    said: str
    rows: Sequence[_Constant]


@dataclass(frozen=True)
class _Round:
    title: str
    end: str
    """What became of its first candidate."""
    candidates: Sequence[Candidate]


def _ties(d: Diagnosis) -> list[NamedEffect]:
    return [e for e in d.effects if e.indistinguishable_from]


@dataclass(frozen=True)
class _Learned:
    drawings: Sequence[Drawing]
    single: Sequence[tuple[str, Sequence[str], Sequence[tuple[str, ...]]]]
    """Of terms that differ from recording to recording: what it is, heads and rows of a table."""


def _learned(d: Diagnosis) -> _Learned | None:
    drawings = [
        Drawing(f"{phrases.named(c.y_quantity)} against {phrases.named(c.x_signal)}", "", figures.learned_shape(c))
        for c in d.evidence.learned
    ]
    single = [(phrases.named(e.name), *_by_recording(e.by_recording)) for e in d.effects if e.by_recording]
    return _Learned(drawings, single) if drawings or single else None


def _by_recording(told: Mapping[str, Mapping[str, ParameterEstimate]]) -> tuple[Sequence[str], list[tuple[str, ...]]]:
    """Heads and rows of a table of each recording's numbers."""
    heads = dict.fromkeys(n for numbers in told.values() for n in numbers)
    rows = [(r, *(phrases.estimate(n, p) for n, p in numbers.items())) for r, numbers in told.items()]
    return ("recording", *heads), rows


def _differing(d: Diagnosis) -> tuple[Sequence[str], list[tuple[str, ...]]] | None:
    return None if d.differing is None else _by_recording(d.differing.by_recording)


def _waterfall(d: Diagnosis) -> list[figures.Waterfall]:
    stages = [s for s in d.evidence.waterfall if s.name != "floor"]
    floors = next((s.error for s in d.evidence.waterfall if s.name == "floor"), {})
    if len(stages) < 2:
        return []
    keys = {"nominal": "nominal", "calibrated": "calibrated"}
    labels = [phrases.named(s.name) if s.name in keys else f"+ {phrases.named(s.name)}" for s in stages]
    drawings = []
    for group in stages[0].error:
        bars = [
            (label, keys.get(s.name, "extended"), s.error.get(group, math.nan))
            for label, s in zip(labels, stages, strict=True)
        ]
        known = d.error.nominal.get(group)
        note, unit = (f"after {phrases.lasting(known.horizon_s)}", known.unit) if known else ("", "")
        drawings.append(figures.waterfall(group, note, bars, floors.get(group, math.nan), unit))
    return drawings


def _curves(d: Diagnosis) -> _Curves | None:
    curves = d.evidence.curves
    if not curves:
        return None
    present = [n for n in LINES if any(n in c.lines for c in curves.values())]
    drawings = [Drawing(phrases.named(group), "", figures.error_curves(group, c)) for group, c in curves.items()]
    rows = []
    for group, c in curves.items():
        ends = {(n, r): errors[-1] for n, line in c.lines.items() for r, errors in line.recordings.items()}
        unit, factor = phrases.shown(c.unit, group, ends.values())
        for recording in dict.fromkeys(r for _, r in ends):
            errors = [phrases.number(ends.get((n, recording), math.nan) * factor) for n in present]
            after = phrases.lasting(c.horizon_s[-1])
            rows.append((recording, f"{phrases.named(group)} after {after} [{unit}]", errors))
    return _Curves(drawings, present, rows)


def _where(d: Diagnosis) -> _Where | None:
    maps = d.evidence.residuals
    if not d.where and not maps:
        return None
    drawings = [
        Drawing(
            f"{phrases.named(m.y_quantity)} against {phrases.named(m.x_signal)}",
            f"region {m.region}" if m.region else "",
            figures.residual_map(m),
        )
        for m in maps
    ]
    return _Where(drawings, ["calibrated", *(["extended"] if any(m.after for m in maps) else [])], d.where)


def _windows(d: Diagnosis) -> _Drawn | None:
    windows = d.evidence.windows
    if not windows:
        return None
    drawings = [
        Drawing(f"{phrases.named(w.group)}, {w.recording}", f"from {w.start_s:.2f} s", figures.window(w))
        for w in windows
    ]
    return _Drawn(drawings, ["measured", "nominal", *(["extended"] if any(w.extended for w in windows) else [])])


def _left(d: Diagnosis) -> _Left | None:
    if d.verdict == "data_problem":
        return None
    worth = " that would be worth a term" if d.evidence.remarks else ""
    said = sentences.remainder(d) or f"Nothing systematic is left above the noise floor{worth}."
    said = " ".join(filter(None, (said, sentences.observed(d), *ceiling_words.sentences(d.evidence.predictable))))
    return _Left(
        said, d.evidence.remarks, d.evidence.hypothesis, [ceiling_words.row(f) for f in d.evidence.predictable_axes]
    )


def _constants(d: Diagnosis) -> _Constants | None:
    rows, hidden = [], {c.constant for c in d.evidence.obscured}
    for c in d.evidence.calibration:
        unit, factor = phrases.shown(c.unit, c.constant, [c.nominal, c.calibrated])
        rows.append(
            _Constant(
                name=phrases.named(c.constant),
                values=[phrases.number(v * factor, 4) for v in (c.nominal, c.calibrated, c.low, c.high)],
                unit=unit,
                change=_change(c, obscured=bool(hidden & c.constants)),
                sigma=phrases.number(c.sigma, 2),
                off=abs(c.sigma) > TELLING.constant_off,
            )
        )
    return _Constants(" ".join(constant_words.miscalibrated(d)), rows) if rows else None


def _change(c: Calibration, obscured: bool) -> str:
    if obscured:
        return "not to be believed"
    return phrases.changed(c.calibrated / c.nominal - 1) if c.nominal else phrases.NOTHING


def _candidates(d: Diagnosis) -> list[_Round]:
    rounds, named = [r for r in d.evidence.ranking if r], {e.id for e in d.effects}
    shown = []
    for i, candidates in enumerate(rounds, start=1):
        ahead = next((c.id for c in candidates if not c.why), None)
        end = "taken" if ahead and named.issuperset(ahead.split(" + ")) else "best, and dropped in a later step"
        what = f"{phrases.named(ahead)} is {end}" if ahead else "none is taken"
        shown.append(_Round(f"Round {i}: {what}" if len(rounds) > 1 else what.capitalize(), end, candidates))
    return shown


def _itself(d: Diagnosis) -> Diagnosis:
    return d


_SECTIONS: tuple[tuple[str, str, Callable[[Diagnosis], Any]], ...] = (
    ("What cannot be told apart", "ties", _ties),
    ("What recordings differ in", "differing", _differing),
    ("What was learned", "learned", _learned),
    ("Measured and predicted", "over_time", over_time),
    ("Equation by equation", "equation_by_equation", equation_by_equation),
    ("Effect by effect", "waterfall", _waterfall),
    ("Error against horizon", "curves", _curves),
    ("Where the error is", "where", _where),
    ("Worst moments", "windows", _windows),
    ("What is left", "left", _left),
    ("Constants", "constants", _constants),
    ("Candidates", "candidates", _candidates),
    ("The data", "data", _itself),
    ("How it was done", "method", _itself),
)
"""Title, macro of ``sections.html.j2``, and what that is given."""
