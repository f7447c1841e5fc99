"""The section of the diagnosis page on every equation by itself. Everything that comes from data is escaped."""

import math
from html import escape

from bench.diagnose.flight import AFTER, Signal
from bench.diagnose.report import page_figures as figures
from bench.diagnose.report import phrases, sentences
from bench.diagnose.report.alone import Alone, alone
from bench.diagnose.result import Diagnosis
from bench.reporting import page


def equation_by_equation(d: Diagnosis) -> str:
    """Each equation apart: its errors as bars, what each effect saves in it; empty where none was judged."""
    every = alone(d)
    if not every:
        return ""
    sensed = {s.name for f in d.evidence.flights for s in f.signals if s.sensed}
    judged = list(zip(d.by_equation, every, strict=True))
    first = judged[0][0]  # what a sensor feels of it stands beside it
    judged.sort(key=lambda pair: (pair[0] != first, d.by_equation[pair[0]].output not in sensed))
    parts = [_equation(d, name, a) for name, a in judged]
    return (
        "<p>With everything else as measured, each equation is judged by itself on held-out recordings, so that no "
        "error of another adds to its own. The best predictor is the model helped by a regression on every measured "
        "signal: what it leaves, these signals do not tell. The dotted line is what noise alone would leave.</p>"
        f"{''.join(parts)}"
    )


def _equation(d: Diagnosis, name: str, a: Alone) -> str:
    panel = page.panel(a.output, f"after {a.horizon}", _bars(d, name, a))
    fall = f"{a.output} {phrases.number(a.nominal)} → {phrases.united(phrases.number(a.extended), a.unit)}"
    beside = _savings(d, name) + _axes(d, d.by_equation[name].output)
    return (
        f'<div class="equation-alone"><h3>{escape(a.equation.capitalize())} <small>{escape(fall)}</small>'
        f'</h3><p class="quiet">{escape(_said(d, name, a))}</p>'
        f'<div class="sides">{panel}<div>{beside}</div></div></div>'
    )


def _said(d: Diagnosis, name: str, a: Alone) -> str:
    """What acts in the equation, and how much of its error can still be explained."""
    here = [phrases.named(e.id) for e in d.effects if e.acts_on == name or (e.main and e.main.equation == name)]
    acts = f"Named here: {phrases.listed(here)}." if here else "No effect was named here."
    left, best = a.extended**2, a.predictable**2
    if not all(map(math.isfinite, (left, best))) or not left:
        return acts
    more = 1 - best / left
    if more < sentences.LITTLE:
        return f"{acts} What is left, the measured signals do not predict."
    return f"{acts} Of the squared error that is left, the measured signals would predict {phrases.percent(more)} more."


def _bars(d: Diagnosis, name: str, a: Alone) -> str:
    e = d.by_equation[name]
    bars = [("nominal", "nominal", e.nominal), ("calibrated", "calibrated", e.calibrated)]
    bars += [("extended", "extended", e.extended)] if d.effects else []
    bars += [("best predictor", "floor", e.predictable)]
    return figures.waterfall(e.output, bars, e.floor, e.unit)


def _savings(d: Diagnosis, name: str) -> str:
    """What each named effect saves in this equation."""
    rows = []
    for effect in d.effects:
        for s in effect.saves:
            if s.equation != name:
                continue
            share = phrases.percent(s.share) if s.matters else phrases.NOTHING
            between = f"{phrases.percent(s.low)} to {phrases.percent(s.high)}" if s.matters else "too little to explain"
            bar = figures.interval_bar(s.share, s.low, s.high, s.where == effect.acts_on) if s.matters else ""
            rows.append(
                f"<tr><td>{escape(phrases.named(effect.id))}{f', {escape(sentences.acts(s))}' if s.axis else ''}</td>"
                f'<td class="number" data-label="saves">{share}</td><td data-label="">{bar}</td>'
                f'<td data-label="95 % interval">{between}</td></tr>'
            )
    if not rows:
        return ""
    intro = (
        "<h4>What each effect saves</h4><p class='quiet'>Of the squared error that can be explained here: how much "
        "more is left without the effect, all else fitted anew.</p>"
    )
    return intro + page.table(["effect", "saves", "", "95 % interval"], rows, (1,))


def _axes(d: Diagnosis, output: str) -> str:
    """What a sensor of rates shows, axis by axis, sample by sample; empty where there is no such sensor."""
    found = [s for f in d.evidence.flights for s in f.signals if s.sensed and s.name == output and f.held_out]
    if not found:
        return ""
    unit, factor = phrases.shown(found[0].unit, output)
    rows = [
        f"<tr><td>{escape(trace.channel.rpartition('.')[2])}</td>"
        f'<td class="number" data-label="before">{phrases.number(_mean(found, c, "nominal") * factor)}</td>'
        f'<td class="number" data-label="after">{phrases.number(_mean(found, c, AFTER) * factor)}</td></tr>'
        for c, trace in enumerate(found[0].traces)
    ]
    heads = ["axis", f"before [{escape(unit)}]", f"after [{escape(unit)}]"]
    intro = (
        "<h4>Axis by axis, every sample</h4><p class='quiet'>Root mean square of measured less modelled, in the "
        "held-out recordings that are shown above.</p>"
    )
    return intro + page.table(heads, rows, (1, 2))


def _mean(signals: list[Signal], c: int, model: str) -> float:
    """Root mean square over recordings."""
    errors = [s.traces[c].rms.get(model, math.nan) for s in signals]
    return math.sqrt(sum(e * e for e in errors) / len(errors))
