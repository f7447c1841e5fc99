"""The parts that the diagnosis page is put together from. Titles and cells come escaped unless said otherwise."""

import math
import re
from collections.abc import Sequence
from html import escape

_MODELS = {
    "nominal": "nominal model (before)",
    "calibrated": "calibrated constants",
    "extended": "extended model (after)",
    "floor": "noise floor",
    "measured": "measured",
}


def equation(text: str) -> str:
    """A formula with its indices set low; empty for none."""
    if not text:
        return ""
    low = re.sub(r"_([0-9A-Za-z⊥]+(?:,[a-z])?)", r"<sub>\1</sub>", escape(text))
    return f'<p class="equation">{low}</p>'


def legend(names: Sequence[str]) -> str:
    """What the lines of all drawings of a section mean."""
    items = []
    for name in names:
        dashes = {"nominal": "7 3", "calibrated": "7 2 2 2", "floor": "2 2"}.get(name, "none")
        colour = "ink" if name == "measured" else name
        width = '6" stroke-opacity=".28' if name == "measured" else "2.4"
        stroke = f'stroke="var(--{colour})" stroke-width="{width}" stroke-dasharray="{dashes}"'
        line = f'<svg viewBox="0 0 30 10" aria-hidden="true"><line x1="0" x2="30" y1="5" y2="5" {stroke}/></svg>'
        items.append(f"<li>{line}{_MODELS[name]}</li>")
    return f'<ul class="legend">{"".join(items)}</ul>'


def bar(share: float, kind: str) -> str:
    """A share from 0 to 1 as a bar."""
    width = 100 * min(1.0, max(0.0, share)) if math.isfinite(share) else 0.0
    return f'<div class="bar {kind}"><i style="width:{width:.1f}%"></i></div>'
