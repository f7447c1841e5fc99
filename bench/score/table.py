"""The answers to a suite of cases, counted against what the diagnosis must achieve."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import beta

from bench.score.case import Case
from bench.score.judge import ERROR, FAILED, LEFT, SHARE, WORTH, Judged

SETS = 300
"""Sets of logs without an effect that the false names are counted on, at least."""


@dataclass(frozen=True)
class Line:
    """One figure of the table, beside what is wanted."""

    text: str
    value: str
    wanted: str = ""
    met: bool | None = None
    """None: nothing is wanted, or there are no cases."""


@dataclass(frozen=True)
class Method:
    """One way to answer, on the cases that all ways answered."""

    name: str
    singles: float
    """Share with the exact set."""
    several: float
    """Of pairs and triples."""
    false_names: float
    """Share of the sets without an effect in which one was named."""
    parameter: float
    """Median relative error of the parameters of rightly named effects."""
    left: float
    """Median of what is left of the held-out error above the floor."""
    near: float
    """Share of cases in which little is left."""


@dataclass(frozen=True)
class Table:
    """All figures."""

    scored: int
    asked: int
    sections: tuple[tuple[str, tuple[Line, ...]], ...]
    methods: tuple[Method, ...]
    compared: tuple[int, int]
    """Cases with effects, and without, on which the methods were compared."""
    failures: tuple[tuple[str, str, str], ...]
    """Case, truth, answer."""
    leftovers: tuple[tuple[str, float, float], ...]
    """Case, share of the error above the floor that is left, and that the model with the true numbers leaves."""
    title: str = "Is the missing physics found?"
    near: float = LEFT
    """Share that counts as left."""
    raised: int = 0
    """Cases whose diagnosis raised an error; they are among the failures."""

    @property
    def unmet(self) -> int:
        """Figures that miss what is wanted."""
        return sum(line.met is False for _, lines in self.sections for line in lines)


def table(cases: Sequence[Case], found: Mapping[tuple[str, str], Mapping[str, Any]]) -> Table:
    """Count.

    Args:
        cases: those asked for.
        found: by (case id, kind), as `run.Store.read` gives it.
    """
    judged, others = [], {}
    for case in cases:
        said = found.get((case.id, "diagnosis"))
        if said is not None:
            judged.append(Judged(case, said, said["extra"].get("shares", {})))
            others[case.id] = found.get((case.id, "alternatives"))
    paired = [(j, said) for j in judged if (said := others[j.case.id]) and FAILED not in said]
    visible = [j for j in judged if j.case.condition in ("single", "pair", "triple", "tie") and j.required]
    effects = [j for j in visible if j.case.condition != "tie"]
    hidden = [j for j in judged if j.case.condition in ("single", "pair", "triple", "tie") and not j.required]
    small = sum(j.case.condition != "tie" for j in hidden)
    methods = _methods(paired)
    sections = (
        (f"Effects above {_round(SHARE)} of the error ({small} cases hold none)", _effects(effects)),
        ("No effect, and effects that the catalogue lacks", _nothing(judged)),
        ("Spoilt logs", _spoilt(judged)),
        ("Effects that hover does not tell apart", _ties([j for j in visible if j.case.condition == "tie"])),
        ("Against the alternatives", _beaten(methods)),
    )
    # Where no effect makes enough of the error to be asked for, only a wrong name is a failure.
    wrong = [j for j in judged if not (j.right or (j in hidden and not j.names_wrongly and j.verdict != ERROR))]
    failures = [(j.case.id, j.truth_line, j.answer_line) for j in wrong]
    failures += [(name, "alternatives", said[FAILED]) for name, said in others.items() if said and FAILED in said]
    without = sum(j.case.condition in ("nothing", "gusts") for j, _ in paired)
    with_effect = sum(bool(j.required) for j, _ in paired)
    filled = tuple((title, lines) for title, lines in sections if lines)
    leftovers = tuple((j.case.id, j.remaining, j.truth_leaves) for j in effects if not j.remaining <= LEFT)
    return Table(
        scored=len(judged),
        asked=len(cases),
        sections=filled,
        methods=methods,
        compared=(with_effect, without),
        failures=tuple(failures),
        leftovers=leftovers,
        raised=errors_among(judged),
    )


def errors_among(judged: Sequence[Judged]) -> int:
    """How many of the answers stand for a diagnosis that raised."""
    return sum(j.verdict == ERROR for j in judged)


# ------------------------------------------------------------------------------------------------- the sections


def _effects(judged: Sequence[Judged]) -> tuple[Line, ...]:
    single = [j for j in judged if j.case.condition == "single"]
    several = [j for j in judged if j.case.condition != "single"]
    estimates = [e for j in judged for e in j.estimates]
    errors = [e.error for e in estimates]
    median = float(np.median(errors)) if errors else math.nan
    worst = max((j.remaining for j in judged), default=math.nan)
    enough = f"nothing false, and forecasts at most {_round(WORTH - 1)} worse than the true model's in every output"
    return _some(
        judged,
        at_least("single effect: named first", 0.98, (j.first for j in single)),
        at_least("single effect: exact set", 0.95, (j.answered for j in single)),
        at_least(f"… or {enough}", 0.95, (j.answered or j.enough for j in single)),
        at_least("pairs and triples: exact set", 0.90, (j.answered for j in several)),
        at_least(f"… or {enough}", 0.90, (j.answered or j.enough for j in several)),
        rate(
            "… of all these, not named but told as a calibrated constant", (j.answered and not j.exact for j in judged)
        ),
        at_most("a tie where the truth can be told", 0.10, (j.verdict == "tie" for j in judged)),
        Line(
            "parameter error, median",
            f"{percent(median)} of {len(errors)} parameters",
            "≤ 2 %",
            median <= 0.02 if errors else None,
        ),
        _between("95 % interval holds the truth", 0.90, 0.99, [e.covered for e in estimates]),
        at_least(
            f"at most {_round(LEFT)} of the error above the floor left", 1.0, (j.remaining <= LEFT for j in judged)
        ),
        rate(
            f"… at most {_round(LEFT)} above the true model's error on the same recordings",
            (j.beyond_truth <= LEFT for j in judged if not math.isnan(j.beyond_truth)),
        ),
        at_most("worse than the nominal model", 0.0, (not j.remaining <= 1 for j in judged)),
        Line("most that is left of the error above the floor", percent(worst)),
    )


def _nothing(judged: Sequence[Judged]) -> tuple[Line, ...]:
    none = [j for j in judged if j.case.condition in ("nothing", "gusts")]
    unknown = [j for j in judged if j.case.condition == "unknown"]
    visible = [j for j in unknown if max(j.shares.values(), default=0.0) >= SHARE]
    kinds: dict[str, list[Judged]] = {}
    for j in none:
        kinds.setdefault(_kind(j.case), []).append(j)
    lines = [at_most(f"a name without an effect (≥ {SETS} sets)", 0.01, (bool(j.named) for j in none))] if none else []
    if len(none) < SETS:
        lines = [Line(x.text, x.value, x.wanted, False if x.met is False else None) for x in lines]
    lines += [rate(f"… {kind}", (bool(j.named) for j in of)) for kind, of in kinds.items()]
    lines += [rate("the answer that counts, without an effect", (j.right for j in none))] if none else []
    if unknown:
        lines += [
            at_least("not in the catalogue: said so", 0.90, (j.verdict == "unknown_effect" for j in unknown)),
            at_most("not in the catalogue: wrongly named", 0.05, (j.names_wrongly for j in unknown)),
            at_least("not in the catalogue: the signal it follows", 0.80, (j.signal for j in unknown)),
            rate(f"… said so, of those above {_round(SHARE)}", (j.verdict == "unknown_effect" for j in visible)),
        ]
    return tuple(lines)


def _spoilt(judged: Sequence[Judged]) -> tuple[Line, ...]:
    spoilt = [j for j in judged if j.case.condition == "corrupted"]
    shifted = [j for j in judged if j.case.condition == "shifted"]
    first = _some(
        spoilt,
        rate("data problem: recording", (j.recording for j in spoilt)),
        rate("data problem: recording and signal", (j.sensor for j in spoilt)),
        at_least("data problem: recording, signal and rows", 0.95, (j.rows for j in spoilt)),
        at_most("explained by an effect", 0.0, (j.names_wrongly for j in spoilt)),
    )
    words = "time shift: delay or data problem, the other mentioned"
    return (*first, *_some(shifted, at_least(words, 1.0, (j.shift for j in shifted))))


def _ties(judged: Sequence[Judged]) -> tuple[Line, ...]:
    right = (j.verdict == "tie" and j.exact for j in judged)
    return _some(judged, at_least("a tie with the truth inside, no further apart than the noise", 1.0, right))


def _methods(paired: Sequence[tuple[Judged, Mapping[str, Any] | None]]) -> tuple[Method, ...]:
    if not paired:
        return ()
    names = list(dict.fromkeys(name for _, said in paired for name in said or ()))
    out = [_method("diagnosis", [(j, j.said["error"].get("extended", {})) for j, _ in paired], paired)]
    for name in names:
        rows = []
        for j, said in paired:
            mine = (said or {})[name]
            rows.append((Judged(j.case, mine, j.shares), mine["error"]))
        out.append(_method(name, rows, paired))
    return tuple(out)


def _method(
    name: str,
    answers: Sequence[tuple[Judged, Mapping[str, float]]],
    paired: Sequence[tuple[Judged, Mapping[str, Any] | None]],
) -> Method:
    asked = [(j, error, of.said["error"]) for (j, error), (of, _) in zip(answers, paired, strict=True) if j.required]
    single = [j.exact for j, _, _ in asked if j.case.condition == "single"]
    several = [j.exact for j, _, _ in asked if j.case.condition != "single"]
    false = [bool(j.named) for j, _ in answers if j.case.condition in ("nothing", "gusts")]
    errors = [e.error for j, _, _ in asked for e in j.estimates]
    # Where the diagnosis has no floor to offer, none can be held against another.
    left = [j.left(error, reference) for j, error, reference in asked if reference.get("nominal")]
    near = [x <= LEFT for x in left]
    return Method(
        name=name,
        singles=_mean(single),
        several=_mean(several),
        false_names=_mean(false),
        parameter=_median(errors),
        left=_median(left),
        near=_mean(near),
    )


def _beaten(methods: Sequence[Method]) -> tuple[Line, ...]:
    if not methods:
        return ()
    ours, lines = methods[0], []
    figures: tuple[tuple[str, Callable[[Method], float], int], ...] = (
        ("exact set, single effects", lambda m: m.singles, 1),
        ("exact set, pairs and triples", lambda m: m.several, 1),
        ("false names", lambda m: m.false_names, -1),
        ("parameter error, median", lambda m: m.parameter, -1),
        ("held-out error above the floor, median left", lambda m: m.left, -1),
    )
    for text, figure, sign in figures:
        mine, theirs = figure(ours), [figure(m) for m in methods[1:] if not math.isnan(figure(m))]
        if theirs and not math.isnan(mine):
            best = max(theirs, key=lambda x: sign * x)
            value = f"{percent(mine)}, best alternative {percent(best)}"
            lines.append(Line(text, value, "better than each", sign * mine > sign * best))
    return tuple(lines)


# -------------------------------------------------------------------------------------------------- the figures


def bounds(count: int, total: int, confidence: float = 0.95) -> tuple[float, float]:
    """Exact (Clopper–Pearson) interval of a share."""
    tail = (1 - confidence) / 2
    low = float(beta.ppf(tail, count, total - count + 1)) if count else 0.0
    high = float(beta.ppf(1 - tail, count + 1, total - count)) if count < total else 1.0
    return low, high


def rate(text: str, flags: Iterable[bool]) -> Line:
    """How often something holds, with its interval."""
    seen = list(flags)
    if not seen:
        return Line(text, "no cases")
    low, high = bounds(sum(seen), len(seen))
    return Line(text, f"{sum(seen)}/{len(seen)} = {percent(_mean(seen))} ({percent(low)} to {percent(high)})")


def at_least(text: str, least: float, flags: Iterable[bool]) -> Line:
    """A share that must not be smaller."""
    seen = list(flags)
    wanted = "all" if least == 1 else f"≥ {_round(least)}"
    return Line(text, rate(text, seen).value, wanted, _mean(seen) >= least if seen else None)


def at_most(text: str, most: float, flags: Iterable[bool]) -> Line:
    """A share that must not be larger."""
    seen = list(flags)
    wanted = "never" if most == 0 else f"≤ {_round(most)}"
    return Line(text, rate(text, seen).value, wanted, _mean(seen) <= most if seen else None)


def _between(text: str, low: float, high: float, flags: Sequence[bool]) -> Line:
    wanted = f"{100 * low:.0f} to {100 * high:.0f} %"
    return Line(text, rate(text, flags).value, wanted, low <= _mean(flags) <= high if flags else None)


def _some(cases: Sequence[Judged], *lines: Line) -> tuple[Line, ...]:
    return lines if cases else ()


def _kind(case: Case) -> str:
    """Of a set without an effect, what is in its way: ids are seed-nothing-kind-number."""
    return case.id.split("-")[2]


def _mean(values: Sequence[float]) -> float:
    return sum(values) / len(values) if values else math.nan


def _median(values: Sequence[float]) -> float:
    return float(np.median(values)) if values else math.nan


def _round(share: float) -> str:
    return f"{100 * share:.0f} %"


def percent(share: float) -> str:
    """As a reader takes it in: three figures."""
    if math.isnan(share):
        return "–"
    return "∞" if math.isinf(share) else f"{100 * share:.3g} %"
