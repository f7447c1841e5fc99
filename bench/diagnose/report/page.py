"""The diagnosis as one HTML file that needs no network: what is missing, how much it explains, how sure that is."""

import math
from html import escape
from pathlib import Path

from bench.diagnose.report import page_parts as parts
from bench.diagnose.report import phrases, sentences
from bench.diagnose.report.page_flights import script
from bench.diagnose.report.page_sections import SECTIONS
from bench.diagnose.result import Diagnosis, NamedEffect, write_text
from bench.reporting.page import document

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
    order = list(SECTIONS)
    if diagnosis.verdict == "data_problem":
        order.sort(key=lambda title: title != "The data")
    made = {title: body for title in order if (body := SECTIONS[title](diagnosis))}
    return document(
        f"Diagnosis of {diagnosis.dataset}",
        _head(diagnosis),
        made,
        "Intervals are 95 % and RMSE is the root mean square error of free runs on held-out recordings, unless said "
        "otherwise.",
        Path(__file__).with_name("page.css"),
        script() if diagnosis.evidence.flights else "",
    )


def _head(d: Diagnosis) -> str:
    e = d.evidence
    facts = [f"{e.recordings} recordings" if e.recordings else "", f"{e.seconds:.0f} s in all" if e.seconds else ""]
    facts.append(f"{len(e.held_out)} held out" if e.held_out else "")
    over = "".join(f"<span>{f}</span>" for f in facts if f)
    cards, falls = "".join(map(_effect_card, d.effects)), "".join(map(_fall, sentences.falls(d)))
    return (
        f'<header class="{d.verdict}"><p class="over"><span class="badge">{_BADGES[d.verdict]}</span>'
        f"<span><b>{escape(d.dataset)}</b></span><span>{escape(phrases.named(d.system))}</span>{over}</p>"
        f"<h1>{escape(sentences.headline(d))}</h1>"
        f"{_sentences(d)}"
        + (f'<div class="falls">{falls}</div>' if falls else "")
        + (f'<div class="cards">{cards}</div>' if cards else "")
        + "</header>"
    )


def _sentences(d: Diagnosis) -> str:
    """What was found stands first and large, what is left of it and of the constants below."""
    kinds = ["lead", "quiet", "quiet"]
    return "".join(
        f'<p class="{kind}">{escape(said)}</p>' for kind, said in zip(kinds, sentences.paragraphs(d), strict=False)
    )


def _fall(fall: sentences.Fall) -> str:
    """Before → after of one output group, with a bar on which the floor is a mark."""
    after = fall.after
    top = max((e for e in fall.errors.values() if math.isfinite(e)), default=0.0)

    def at(model: str) -> str:
        error = fall.errors[model]
        return f"{100 * (min(error, top) / top if top and not math.isnan(error) else 0):.1f}%"

    others = [f"calibrated {fall.text('calibrated')}"] if after == "extended" else []
    others += [f"floor {fall.text('floor')}"]
    return (
        f'<div class="fall"><h3>{escape(phrases.named(fall.group))} <small>after {fall.horizon}</small></h3>'
        f'<p class="big"><span class="nominal">{fall.text("nominal")}</span> → '
        f'<span class="{after}">{fall.text(after)}</span> <small>{escape(fall.unit)}</small></p>'
        f'<div class="track"><i class="nominal" style="width:{at("nominal")}"></i>'
        f'<i class="{after}" style="width:{at(after)}"></i><b style="left:{at("floor")}"></b></div>'
        f'<p class="quiet">{", ".join(others)}</p></div>'
    )


def _effect_card(effect: NamedEffect) -> str:
    about, equation = phrases.about(effect.id) if effect.term is None else (effect.term.described, effect.term.formula)
    tied = effect.indistinguishable_from
    values = []
    for name, p in effect.parameters.items():
        value, low, high, unit = phrases.estimate_parts(name, p)
        between = f" <small>{low} to {high}</small>" if low != phrases.NOTHING else ""
        values.append(f"<p><code>{escape(name)}</code> = <b>{escape(phrases.united(value, unit))}</b>{between}</p>")
    main = effect.main
    if main is None:
        share, of, more = effect.share_explained, "of the error of free runs", ""
    else:
        share, of = main.share, f"of the explainable error of {sentences.acts(main)}"
        more = "".join(f"<p class='quiet'>{escape(said)}</p>" for said in sentences.beside(effect))
    return (
        f'<div class="card"><div class="share">{phrases.percent(share)}<small>{escape(of)}</small></div>'
        f"<h3>{escape(phrases.named(effect.name))}</h3>"
        + (f"<p class='quiet'>{escape(about)}</p>" if about else "")
        + parts.equation(equation)
        + (f"<p class='quiet'>Or {escape(phrases.listed(map(phrases.named, tied), 'or'))}.</p>" if tied else "")
        + f'<div class="values">{"".join(values)}</div>{more}</div>'
    )
