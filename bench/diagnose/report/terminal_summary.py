"""The diagnosis in a few lines on the terminal."""

import re
import textwrap
from typing import Any

from bench.diagnose.report import constant_words, equation_errors, phrases, sentences
from bench.diagnose.result import Diagnosis, NamedEffect
from bench.diagnose.settings import TELLING

_STYLES = {"named": "cyan", "tie": "yellow", "nothing": "green", "unknown_effect": "yellow", "data_problem": "red"}


def print_summary(diagnosis: Diagnosis, console: Any) -> None:
    """Print the verdict, the falling error, the effects and where the error is, in at most `TELLING.lines` lines.

    Sentences give way to figures: what is left out of them stands on the page.

    Args:
        diagnosis: what was found.
        console: a rich console.
    """
    from rich.text import Text

    verdict = Text(sentences.headline(diagnosis), style=f"bold {_STYLES[diagnosis.verdict]}")
    if diagnosis.verdict == "data_problem":
        first, last = _problems(diagnosis), _regions(diagnosis)
    else:
        first = [*_effects(diagnosis), *_far_constants(diagnosis), *_errors(diagnosis)]
        last = [*equation_errors.lines(diagnosis), *_regions(diagnosis), *_problems(diagnosis)]
    figures = [
        Text(line)
        for item in [*first, *last]
        for line in textwrap.wrap(item, console.width, subsequent_indent=" " * 6, break_on_hyphens=False)
    ]
    told = list(verdict.wrap(console, console.width))
    said = _fitting(sentences.explanation(diagnosis), console, TELLING.lines - len(told) - len(figures))
    for line in [*told, *said, *figures][: TELLING.lines]:
        line.rstrip()
        console.print(line, highlight=False, no_wrap=True)


def _fitting(text: str, console: Any, most: int) -> list[Any]:
    """Lines of the first sentences of a text that fit in so many."""
    from rich.text import Text

    said = re.split(r"(?<=\.) (?=[A-Z])", text)
    some = [" ".join([*said[:count], "The page says more."]) for count in range(len(said) - 1, 0, -1)]
    wrapped = (list(Text(x).wrap(console, console.width)) for x in (text, *some))
    return next((lines for lines in wrapped if len(lines) <= most), [])


def _effects(diagnosis: Diagnosis) -> list[str]:
    shown = diagnosis.effects[:5]
    width = max((len(e.name) for e in shown), default=0)
    return [f"  + {e.name:<{width}}  {sentences.explains(e)}: {_how(e)}" for e in shown]


def _far_constants(diagnosis: Diagnosis) -> list[str]:
    """What calibration moved far beside the effects; without effects the headline says it."""
    return [f"  {line}" for line in constant_words.far(diagnosis)] if diagnosis.effects else []


def _how(effect: NamedEffect) -> str:
    """Its fitted numbers, or the description of a spline."""
    if not effect.learned:
        return phrases.parameters(effect)
    formula = effect.term is not None and effect.term.shape != "spline"
    return f"{effect.term.formula}, {phrases.parameters(effect)}" if effect.term and formula else effect.described


def _errors(diagnosis: Diagnosis) -> list[str]:
    found = [
        (
            f"{phrases.named(f.group)} after {f.horizon}",
            f"{f.text('nominal')} → {f.text(f.after)} {f.unit}",
            (f"with observer {f.text('disturbance')}, " if f.observed else "")
            + (f"network {f.text('network')}, " if f.networked else "")
            + f"floor {f.text('floor')}",
        )
        for f in sentences.falls(diagnosis)[:4]
    ]
    widths = [max((len(row[i]) for row in found), default=0) for i in range(2)]
    return [f"  {what:<{widths[0]}}  {fall:<{widths[1]}}  {floor}" for what, fall, floor in found]


def _regions(diagnosis: Diagnosis) -> list[str]:
    return [
        f"  where the calibrated model errs: {r.region}: {phrases.percent(r.share_of_error)} of its error in "
        f"{phrases.percent(r.share_of_time)} of the time"
        for r in diagnosis.where[:2]
    ]


def _problems(diagnosis: Diagnosis) -> list[str]:
    found = phrases.gathered(diagnosis.data_problems)
    more = [f"  and {len(found) - 4} more in the report"] if len(found) > 4 else []
    what = "" if diagnosis.verdict == "data_problem" else "left out: "
    return [*(f"  {what}{line}" for line in found[:4]), *more]
