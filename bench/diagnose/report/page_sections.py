"""The sections of the diagnosis page. Everything that comes from data is escaped."""

import math
from collections.abc import Callable
from html import escape

from bench.diagnose.report import learned_page, phrases, sentences
from bench.diagnose.report import page_figures as figures
from bench.diagnose.report import page_parts as parts
from bench.diagnose.report.page_equations import equation_by_equation
from bench.diagnose.report.page_flights import over_time
from bench.diagnose.result import LINES, Candidate, Diagnosis
from bench.reporting import page

_METHOD = (
    "Every model runs free from many starts on recordings that it was not fitted to, and its error is compared with "
    "the noise floor: what measurement noise and smoothing alone would give.",
    "Base constants are calibrated within their stated uncertainty first, so that a wrong constant is not taken for a "
    "missing effect.",
    "Sets of effects of the catalogue are then fitted to changes of the state over short windows, smoothed as the data "
    "were, and compared by what they leave of the whitened residual and by their number of parameters; a larger set "
    "must gain on recordings left out of the fit.",
    "A dictionary of signals is tried on what is left: what it still explains is reported as unknown, and effects that "
    "it explains better are not named.",
    "What is taken is fitted again together with the constants, by simulating forward and comparing with the "
    "measurement, and effects that explain the data equally well are reported as a tie.",
)


def _waterfall(d: Diagnosis) -> str:
    stages = [s for s in d.evidence.waterfall if s.name != "floor"]
    floors = next((s.error for s in d.evidence.waterfall if s.name == "floor"), {})
    if len(stages) < 2:
        return ""
    keys = {"nominal": "nominal", "calibrated": "calibrated"}
    panels = []
    for group in stages[0].error:
        labels = [phrases.named(s.name) if s.name in keys else f"+ {phrases.named(s.name)}" for s in stages]
        bars = [
            (label, keys.get(s.name, "extended"), s.error.get(group, math.nan))
            for label, s in zip(labels, stages, strict=True)
        ]
        known = d.error.nominal.get(group)
        drawn = figures.waterfall(group, bars, floors.get(group, math.nan), known.unit if known else "")
        panels.append(page.panel(phrases.named(group), f"after {known.horizon_s:g} s" if known else "", drawn))
    return (
        "<p>The bar is the error that remains; its pale part is what the stage took away. The dotted line is the noise "
        f"floor: what noise alone would leave, as estimated.</p>{page.grid(panels)}"
    )


def _curves(d: Diagnosis) -> str:
    curves = d.evidence.curves
    if not curves:
        return ""
    present = [n for n in LINES if any(n in c.lines for c in curves.values())]
    panels = [page.panel(phrases.named(group), "", figures.error_curves(group, c)) for group, c in curves.items()]
    return (
        "<p>Free runs from many starts of the held-out recordings; bands are 95 % intervals over recordings.</p>"
        f"{parts.legend(present)}{page.grid(panels)}{_by_recording(d)}"
    )


def _by_recording(d: Diagnosis) -> str:
    """Every recording's error at the longest horizon, folded away."""
    rows = []
    for group, c in d.evidence.curves.items():
        ends = {(n, r): errors[-1] for n, line in c.lines.items() for r, errors in line.recordings.items()}
        unit, factor = phrases.shown(c.unit, group, ends.values())
        for recording in dict.fromkeys(r for _, r in ends):
            errors = [phrases.number(ends.get((n, recording), math.nan) * factor) for n in LINES]
            cells = "".join(f'<td class="number" data-label="{n}">{e}</td>' for n, e in zip(LINES, errors, strict=True))
            what = f"{escape(phrases.named(group))} after {c.horizon_s[-1]:g} s [{escape(unit)}]"
            rows.append(f'<tr><td>{escape(recording)}</td><td data-label="">{what}</td>{cells}</tr>')
    if not rows:
        return ""
    table = page.table(["recording", "output", "nominal", "calibrated", "extended", "noise floor"], rows, range(2, 6))
    return f"<details><summary>Recording by recording</summary>{table}</details>"


def _where(d: Diagnosis) -> str:
    rows = []
    for r in d.where:
        error = f"{parts.bar(r.share_of_error, '')}<span>{phrases.percent(r.share_of_error)} of the error</span>"
        time = f"{parts.bar(r.share_of_time, 'time')}<span>{phrases.percent(r.share_of_time)} of the time</span>"
        bars = f'<div class="bars">{error}{time}</div>'
        seen = f'<span title="{escape(", ".join(r.recordings))}">{len(r.recordings)} recordings</span>'
        rows.append(f"<tr><td>{escape(r.region)}</td><td>{bars}</td><td>{seen}</td></tr>")
    panels = [
        page.panel(
            f"{phrases.named(m.y_quantity)} against {phrases.named(m.x_signal)}",
            f"region {m.region}" if m.region else "",
            figures.residual_map(m),
        )
        for m in d.evidence.residuals
    ]
    if not rows and not panels:
        return ""
    intro = "<p>A region matters where its share of the squared error is far larger than its share of the time.</p>"
    maps = ""
    if panels:
        after = any(m.after for m in d.evidence.residuals)
        maps = (
            '<h3>Residual against what it follows</h3><p class="quiet">What the model lacks at every sample '
            "of the training recordings (dots), and its mean in bins of the signal. A model that lacks "
            "nothing stays at zero.</p>"
            f"{parts.legend(['calibrated', 'extended'] if after else ['calibrated'])}{page.grid(panels)}"
        )
    return (intro + page.table(["region", "", "met in"], rows) if rows else "") + maps


def _ranking(d: Diagnosis) -> str:
    rounds = [r for r in d.evidence.ranking if r]
    if not rounds:
        return ""
    body = (
        "<p>The share of the squared error above the floor that each effect would explain beside those already taken, "
        "with its 95 % interval.</p>"
    )
    named = {e.id for e in d.effects}
    for i, candidates in enumerate(rounds, start=1):
        ahead = next((c.id for c in candidates if not c.why), None)
        end = "taken" if ahead and named.issuperset(ahead.split(" + ")) else "ahead, and given up later"
        title = f"Round {i}: {phrases.named(ahead)} is {end}" if ahead else f"Round {i}: none is taken"
        title = title.partition(": ")[2].capitalize() if len(rounds) == 1 else title
        rows = [_candidate(c, end) for c in candidates]
        table = page.table(["effect", "explains", "", "fitted", "why not"], rows, (1,), "rank")
        body += f"<details{' open' if i == 1 else ''}><summary>{escape(title)}</summary>{table}</details>"
    return body


def _candidate(c: Candidate, end: str) -> str:
    bar = figures.interval_bar(c.gain, c.low, c.high, taken=not c.why)
    why = escape(phrases.typeset(c.why or end))
    return (
        f"<tr{'' if c.why else ' class=taken'}><td>{escape(phrases.named(c.id))}</td>"
        f'<td class="number" data-label="explains">{phrases.percent(c.gain)}</td><td data-label="">{bar}</td>'
        f'<td data-label="fitted">{escape(phrases.typeset(c.parameters))}</td><td data-label="">{why}</td></tr>'
    )


def _ties(d: Diagnosis) -> str:
    cards = []
    for effect in d.effects:
        if effect.indistinguishable_from:
            names = "".join(
                f"<h3>{escape(phrases.named(i))}</h3><p class='quiet'>{escape(phrases.about(i)[0])}</p>"
                f"{parts.equation(phrases.about(i)[1])}"
                for i in (effect.id, *effect.indistinguishable_from)
            )
            advice = f"<p><b>To separate them:</b> {escape(effect.separate_by)}</p>" if effect.separate_by else ""
            cards.append(f'<div class="card">{names}{advice}</div>')
    if not cards:
        return ""
    intro = (
        "<p>These explain the recordings equally well; more of the same recordings will not decide between them.</p>"
    )
    return f'{intro}<div class="cards">{"".join(cards)}</div>'


def _data_problems(d: Diagnosis) -> str:
    if not d.data_problems:
        return "<p>No spikes, frozen sensors, time shifts, swapped signs or clock errors were found.</p>"
    rows = [
        f"<tr><td>{escape(p.recording)}</td><td data-label='signal'>{escape(phrases.named(p.signal))}</td>"
        f"<td data-label='problem'>{escape(p.kind)}</td><td data-label='where'>{phrases.rows(p)}</td>"
        f"<td data-label=''>{escape(p.detail)}</td></tr>"
        for p in d.data_problems
    ]
    what = (
        "Mend or remove these and run the diagnosis again."
        if d.verdict == "data_problem"
        else "These did not stop the diagnosis."
    )
    return f"<p>{what}</p>{page.table(['recording', 'signal', 'problem', 'where', 'detail'], rows)}"


def _left(d: Diagnosis) -> str:
    if d.verdict == "data_problem":
        return ""
    sentence = sentences.remainder(d) or "Nothing systematic is left above the noise floor."
    hypothesis = ""
    if d.evidence.hypothesis:
        hypothesis = (
            f'<div class="card"><h3>A hypothesis, not a finding</h3>{parts.equation(d.evidence.hypothesis)}'
            "<p class='quiet'>The simplest formula found that has the shape of what is left. It was not tested as an "
            "effect is.</p></div>"
        )
    return f"<p>{escape(sentence)}</p>{hypothesis}"


def _windows(d: Diagnosis) -> str:
    if not d.evidence.windows:
        return ""
    panels = [
        page.panel(f"{phrases.named(w.group)}, {w.recording}", f"from {w.start_s:.2f} s", figures.window(w))
        for w in d.evidence.windows
    ]
    extended = any(w.extended for w in d.evidence.windows)
    shown = ["measured", "nominal", *(["extended"] if extended else [])]
    intro = "<p>The stretches in which the nominal model fails most, all started from the measured state.</p>"
    return f"{intro}{parts.legend(shown)}{page.grid(panels)}"


def _calibration(d: Diagnosis) -> str:
    rows = []
    for c in d.evidence.calibration:
        unit, factor = phrases.shown(c.unit, c.constant, [c.nominal, c.calibrated])
        off = ' class="off"' if abs(c.sigma) > sentences.OFF else ""
        change = phrases.percent(c.calibrated / c.nominal - 1) if c.nominal else phrases.NOTHING
        rows.append(
            f"<tr><td>{escape(phrases.named(c.constant))}</td>"
            f'<td class="number" data-label="stated">{phrases.number(c.nominal * factor, 4)}</td>'
            f'<td class="number" data-label="calibrated">{phrases.number(c.calibrated * factor, 4)}</td>'
            f'<td class="number" data-label="low">{phrases.number(c.low * factor, 4)}</td>'
            f'<td class="number" data-label="high">{phrases.number(c.high * factor, 4)}</td>'
            f'<td data-label="unit">{escape(unit)}</td><td class="number" data-label="change">{change}</td>'
            f'<td class="number" data-label="moved by"><span{off}>{phrases.number(c.sigma, 2)} σ</span></td></tr>'
        )
    if not rows:
        return ""
    intro = (
        "<p>Base constants fitted together with the effects that were found, each held near its stated value by its "
        "uncertainty σ; intervals are 95 %. Where motion tells the ratio of two constants better than either, so does "
        "the table: which of the two is off rests on what was stated of them.</p>"
    )
    return intro + page.table(
        ["constant", "stated", "calibrated", "low", "high", "unit", "change", "moved by"],
        rows,
        numbers=(1, 2, 3, 4, 6, 7),
    )


def _method(d: Diagnosis) -> str:
    notes = "".join(f"<li>{escape(n)}</li>" for n in d.evidence.notes)
    if d.verdict == "data_problem":
        steps = "<p>Every recording is checked by itself and against the model before any effect is looked for.</p>"
    else:
        steps = f"<ol class='notes'>{''.join(f'<li>{s}</li>' for s in _METHOD)}</ol>"
    held = f"<p class='quiet'>Held out: {escape(', '.join(d.evidence.held_out))}.</p>" if d.evidence.held_out else ""
    return (
        f"{steps}{held}"
        + (f"<h3>Noted on the way</h3><ul class='notes'>{notes}</ul>" if notes else "")
        + f"<h3>To repeat it</h3><pre>{escape(chr(10).join(sentences.commands(d)))}</pre>"
    )


SECTIONS: dict[str, Callable[[Diagnosis], str]] = {
    "What cannot be told apart": _ties,
    "What was learned": learned_page.section,
    "Measured and predicted": over_time,
    "Equation by equation": equation_by_equation,
    "Effect by effect": _waterfall,
    "Error against horizon": _curves,
    "Where the error is": _where,
    "Worst moments": _windows,
    "What is left": _left,
    "Constants": _calibration,
    "Candidates": _ranking,
    "The data": _data_problems,
    "How it was done": _method,
}
"""By title, in the order of the page; a section that has nothing to say is empty."""
