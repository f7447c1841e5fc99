"""The section of the diagnosis page on every equation by itself. Everything that comes from data is escaped."""

from html import escape

from bench.diagnose.report import page_figures as figures
from bench.diagnose.report import words
from bench.diagnose.report.alone import Alone, alone
from bench.diagnose.result import Diagnosis
from bench.reporting import page


def equation_by_equation(d: Diagnosis) -> str:
    """The errors of every equation as bars, and what each effect saves in it; empty where none was judged."""
    every = alone(d)
    if not every:
        return ""
    panels = [
        page.panel(a.equation, f"{a.output} after {a.horizon}", _bars(d, name, a))
        for name, a in zip(d.by_equation, every, strict=True)
    ]
    return (
        "<p>With everything else as measured, each equation is judged by itself on held-out recordings, so that no "
        "error of another adds to its own. The best predictor is the model helped by a regression on every measured "
        "signal: what it leaves, these signals do not tell. The dotted line is what noise alone would leave.</p>"
        f"{page.grid(panels)}{_savings(d)}"
    )


def _bars(d: Diagnosis, name: str, a: Alone) -> str:
    e = d.by_equation[name]
    bars = [("nominal", "nominal", e.nominal), ("calibrated", "calibrated", e.calibrated)]
    bars += [("extended", "extended", e.extended)] if d.effects else []
    bars += [("best predictor", "floor", e.predictable)]
    return figures.waterfall(e.output, bars, e.floor, e.unit)


def _savings(d: Diagnosis) -> str:
    """What each named effect saves, equation by equation."""
    rows = []
    for effect in d.effects:
        for s in d.evidence.savings.get(effect.id, ()):
            share = words.percent(s.share) if s.matters else words.NOTHING
            between = f"{words.percent(s.low)} to {words.percent(s.high)}" if s.matters else "too little to explain"
            bar = figures.interval_bar(s.share, s.low, s.high, s.equation == effect.acts_on) if s.matters else ""
            rows.append(
                f"<tr><td>{escape(words.named(effect.id))}</td>"
                f'<td data-label="equation">{escape(words.named(s.equation))}</td>'
                f'<td class="number" data-label="saves">{share}</td><td data-label="">{bar}</td>'
                f'<td data-label="95 % interval">{between}</td></tr>'
            )
    if not rows:
        return ""
    intro = (
        "<h3>What each effect saves</h3><p class='quiet'>Of the squared error that can be explained in an equation: "
        "how much more is left without the effect, all else fitted anew.</p>"
    )
    return intro + page.table(["effect", "equation", "saves", "", "95 % interval"], rows, (2,))
