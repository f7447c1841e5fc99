"""The answers to the suite of the unknown, counted against what is asked of learned terms."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bench.score.case import Case
from bench.score.table import Line, Table, at_least, at_most, errors_among, percent, rate
from bench.score.unknown.condition import KINDS, UnknownCase
from bench.score.unknown.judge import LEFT, MOST, NEAR, OFF, JudgedUnknown

SETS = 300
"""Sets in which nothing is hidden, at least."""
TITLE = "Is an effect described that no catalogue has?"


def table(cases: Sequence[Case], found: Mapping[tuple[str, str], Mapping[str, Any]]) -> Table:
    """Count.

    Args:
        cases: those asked for.
        found: by (case id, kind), as `run.Store.read` gives it.
    """
    judged = []
    for case in cases:
        said = found.get((case.id, "diagnosis"))
        if said is not None and isinstance(case, UnknownCase):
            judged.append(JudgedUnknown(case, said, {}))
    hidden, none = [j for j in judged if j.hidden], [j for j in judged if not j.hidden]
    sections = (
        ("What is left once terms are added", _left(hidden)),
        ("Functions of measured signals", _static([j for j in hidden if j.static])),
        ("What swings", _swings([j for j in hidden if j.swings])),
        ("By what is hidden: the whole answer", _kinds(hidden)),
        ("Nothing hidden", _nothing(none)),
    )
    return Table(
        scored=len(judged),
        asked=len(cases),
        sections=tuple((title, lines) for title, lines in sections if lines),
        methods=(),
        compared=(0, 0),
        failures=tuple((j.case.id, j.truth_line, j.answer_line) for j in judged if not j.right),
        leftovers=tuple((j.case.id, j.remaining, math.nan) for j in hidden if not j.remaining <= MOST),
        title=TITLE,
        near=MOST,
        raised=errors_among(judged),
    )


def _left(judged: Sequence[JudgedUnknown]) -> tuple[Line, ...]:
    if not judged:
        return ()
    left = [j.remaining for j in judged]
    middle, high = (float(np.quantile(left, q, method="higher")) for q in (0.5, 0.9))
    return (
        Line("error above the floor left, median", percent(middle), f"≤ {100 * LEFT:.0f} %", middle <= LEFT),
        Line("… in nine cases of ten, at most", percent(high), f"≤ {100 * MOST:.0f} %", high <= MOST),
        rate(f"… at most {100 * MOST:.0f} % left", (j.remaining <= MOST for j in judged)),
        at_most("forecasts worse than without", 0.0, (j.worse for j in judged)),
        rate("an effect of the catalogue named", (bool(j.named) for j in judged)),
    )


def _static(judged: Sequence[JudgedUnknown]) -> tuple[Line, ...]:
    if not judged:
        return ()
    inside, total = map(sum, zip(*(j.band for j in judged), strict=True))
    share = inside / total if total else math.nan
    return (
        at_least("axes and signals", 0.90, (j.place for j in judged)),
        at_least("the true form", 0.70, (j.form for j in judged)),
        Line(
            "points of true curves inside the 95 % band",
            f"{inside}/{total} = {percent(share)}",
            "90 to 99 %",
            0.90 <= share <= 0.99 if total else None,
        ),
    )


def _swings(judged: Sequence[JudgedUnknown]) -> tuple[Line, ...]:
    if not judged:
        return ()
    called = [j for j in judged if j.called]
    return (
        at_least("said to swing", 0.85, (j.called for j in judged)),
        at_least(
            f"its frequency within {100 * OFF:.0f} %, where it is said", 1.0, (j.frequency <= OFF for j in called)
        ),
    )


def _kinds(judged: Sequence[JudgedUnknown]) -> tuple[Line, ...]:
    by = {k: [j for j in judged if j.case.condition == k] for k in KINDS}
    return tuple(rate(k.replace("_", " "), (j.right for j in of)) for k, of in by.items() if of)


def _nothing(judged: Sequence[JudgedUnknown]) -> tuple[Line, ...]:
    if not judged:
        return ()
    near = [j for j in judged if j.above_floor <= NEAR]
    lines = [
        at_most(f"a learned term (≥ {SETS} sets)", 0.01, (bool(j.learned) for j in judged)),
        at_most(
            f"called unknown, of those within {100 * (NEAR - 1):.0f} % of the floor",
            0.02,
            (j.verdict == "unknown_effect" for j in near),
        ),
        rate("an effect named", (bool(j.named) for j in judged)),
        rate("called a data problem", (j.verdict == "data_problem" for j in judged)),
    ]
    if len(judged) < SETS:  # too few to say that it is met; enough to say that it is not
        lines = [Line(x.text, x.value, x.wanted, False if x.met is False else None) for x in lines]
    return tuple(lines)
