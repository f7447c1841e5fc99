"""An HTML page that needs no network: its frame and the parts that all pages have. Titles and cells come escaped."""

import base64
import hashlib
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from importlib.metadata import version
from pathlib import Path


def document(title: str, head: str, sections: Mapping[str, str], footer: str, style: Path, script: str = "") -> str:
    """The page as text, without external addresses; the browser is told to load nothing and to run one script at most.

    Args:
        title: plain text.
        head: HTML of the header element.
        sections: title → HTML, in order.
        footer: HTML, after the name of this package.
        style: rules beyond those of every page.
        script: the only one that runs, at the end of the page; it may hold nothing that comes from data.
    """
    links = "".join(f'<a href="#{anchor(name)}">{name}</a>' for name in sections)
    nav = f"<nav>{links}</nav>" if len(sections) > 1 else ""
    body = "".join(f'<section id="{anchor(name)}"><h2>{name}</h2>{made}</section>' for name, made in sections.items())
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    allowed = f"; script-src 'sha256-{digest}'" if script else ""
    css = "".join(path.read_text(encoding="utf-8") for path in (Path(__file__).with_name("page.css"), style))
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        '<meta http-equiv="Content-Security-Policy" content="default-src \'none\'; img-src data:; '
        f"style-src 'unsafe-inline'{allowed}\">"
        f"<title>{escape(title)}</title><style>\n{css}</style></head><body>"
        f"{head}<main>{nav}{body}</main>"
        f"<footer>multistep-bench {escape(version('multistep-bench'))}. {footer}</footer>"
        f"{f'<script>{script}</script>' if script else ''}</body></html>\n"
    )


def table(heads: Sequence[str], rows: Iterable[str], numbers: Iterable[int] = (), kind: str = "") -> str:
    """A table of ready rows; ``numbers`` are the columns that are right-aligned. Narrow pages stack its cells."""
    right = set(numbers)
    cells = "".join(f'<th class="number">{h}</th>' if i in right else f"<th>{h}</th>" for i, h in enumerate(heads))
    head, body = f"<thead><tr>{cells}</tr></thead>", f"<tbody>{''.join(rows)}</tbody>"
    return f'<div class="scroll"><table class="{kind}">{head}{body}</table></div>'


def panel(title: str, note: str, svg: str) -> str:
    """A drawing with its title."""
    small = f" <small>{escape(note)}</small>" if note else ""
    return f"<figure><figcaption>{escape(title)}{small}</figcaption>{svg}</figure>"


def grid(panels: Sequence[str], kind: str = "") -> str:
    """Drawings side by side, as many as the page is wide."""
    return f'<div class="{f"grid {kind}".strip()}">{"".join(panels)}</div>'


def anchor(title: str) -> str:
    """The address of a section within the page."""
    return title.lower().replace(" ", "-")
