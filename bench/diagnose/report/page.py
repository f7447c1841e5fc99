"""The diagnosis as one HTML file that needs no network: what is missing, how much it explains, how sure that is."""

import math
import re
from functools import lru_cache
from pathlib import Path

from jinja2 import Environment
from markupsafe import Markup, escape

from bench.diagnose.evidence import Candidate
from bench.diagnose.report import constant_words, page_figures, phrases, sentences
from bench.diagnose.report.page_flights import script
from bench.diagnose.report.page_sections import sections
from bench.diagnose.result import Diagnosis, NamedEffect, ParameterEstimate, write_text
from bench.reporting import page

_BADGES = {
    "named": "missing effect found",
    "tie": "tie",
    "nothing": "nothing missing",
    "unknown_effect": "unknown effect",
    "data_problem": "data problem",
}


def write(path: Path, diagnosis: Diagnosis) -> None:
    """Write the page, whole or not at all.

    Raises:
        BenchError: the file cannot be written.
    """
    write_text(path, render(diagnosis))


def render(diagnosis: Diagnosis) -> str:
    """The page as text. All that comes from data is escaped; there is no external address and one script of our own."""
    made = sections(diagnosis)
    if diagnosis.verdict == "data_problem":
        made.sort(key=lambda section: section.title != "The data")
    return page.render(
        _templates(),
        "diagnosis.html.j2",
        f"Diagnosis of {diagnosis.dataset}",
        made,
        script() if diagnosis.evidence.flights else "",
        d=diagnosis,
        look=_look(diagnosis),
        facts=_facts(diagnosis),
        headline=sentences.headline(diagnosis),
        paragraphs=sentences.paragraphs(diagnosis),
        constants=constant_words.miscalibrated(diagnosis),
        falls=sentences.falls(diagnosis),
    )


def _look(d: Diagnosis) -> tuple[str, str]:
    """The style of the heading and its badge; where an equation is not understood, or friction only seen, in amber."""
    if d.evidence.inverse is not None and d.verdict in ("nothing", "unknown_effect"):
        return "tie", "missing effect seen"
    if d.verdict == "nothing" and sentences.not_understood(d.evidence.obscured):
        return "tie", "not understood"
    return d.verdict, _BADGES[d.verdict]


@lru_cache(maxsize=1)
def _templates() -> Environment:
    return page.templates(
        Path(__file__).with_name("templates"),
        about=_about,
        acts=sentences.acts,
        catalogue=phrases.about,
        commands=sentences.commands,
        estimated=_estimated,
        formula=_formula,
        gain_bar=_gain_bar,
        legend=page_figures.legend,
        listed=phrases.listed,
        named=phrases.named,
        percent=phrases.percent,
        rows=phrases.rows,
        savings=sentences.savings,
        together=phrases.together,
        typeset=phrases.typeset,
        width=_width,
    )


def _facts(d: Diagnosis) -> list[str]:
    e = d.evidence
    long = f"{e.seconds:.0f}" if e.seconds >= 10 else f"{e.seconds:.2g}"
    facts = [f"{e.recordings} recordings" if e.recordings else "", f"{long} s in all" if e.seconds else ""]
    return [*filter(None, (*facts, f"{len(e.held_out)} held out" if e.held_out else ""))]


def _about(effect: NamedEffect) -> tuple[str, str]:
    """What an effect is, in a line, and its equation."""
    return phrases.about(effect.id) if effect.term is None else (effect.term.described, effect.term.formula)


def _estimated(p: ParameterEstimate, name: str) -> tuple[str, str]:
    """A parameter's value with its unit, and its interval; empty where there is none."""
    value, low, high, unit = phrases.estimate_parts(name, p)
    return phrases.united(value, unit), f"{low} to {high}" if low != phrases.NOTHING else ""


def _formula(text: str) -> Markup:
    """An equation with its indices set low."""
    return Markup(re.sub(r"_([0-9A-Za-z⊥]+(?:,[a-z])?)", r"<sub>\1</sub>", str(escape(text))))


def _gain_bar(c: Candidate) -> Markup:
    return page_figures.interval_bar(c.gain, c.low, c.high, taken=not c.why)


def _width(share: float) -> str:
    """The length of a bar."""
    return f"{100 * min(1.0, max(0.0, share)) if math.isfinite(share) else 0.0:.1f}%"
