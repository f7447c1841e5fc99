"""HTML pages that need no network, from templates that escape whatever comes from data."""

import base64
import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from bench.reporting.drawing import swatch

SHARED = Path(__file__).with_name("templates")
"""The layout, its style, and the parts that all pages have."""


@dataclass(frozen=True)
class Drawing:
    """A drawing with its title."""

    title: str
    note: str
    """Small, beside the title."""
    svg: Markup


@dataclass(frozen=True)
class Section:
    """A part of a page with a heading and an address."""

    title: str
    part: str
    """The macro that shows it."""
    content: Any
    """What that is given; a section without any is not shown."""

    @property
    def anchor(self) -> str:
        """Its address within the page."""
        return self.title.lower().replace(" ", "-")


@lru_cache
def templates(folder: Path, **filters: Callable[..., Any]) -> Environment:
    """The templates in a folder beside the shared ones; everything is escaped but `Markup`.

    Args:
        folder: of ``*.html.j2`` files.
        filters: functions that templates may call, by name.
    """
    found = Environment(
        loader=FileSystemLoader([folder, SHARED]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    found.filters |= {"swatch": swatch, **filters}
    return found


def shared() -> Environment:
    """The templates of this room."""
    return templates(SHARED)


def render(
    pages: Environment, name: str, title: str, sections: Sequence[Section], script: str = "", **content: Any
) -> str:
    """A page as text, without external addresses.

    Args:
        pages: templates, of which ``name`` extends the shared layout.
        name: of the template.
        title: of the browser's window.
        sections: in order; those without content are left out.
        script: the only one that runs, at the end of the page; it may hold nothing that comes from data.
        content: what the template shows beside its sections.
    """
    return pages.get_template(name).render(
        title=title,
        sections=[s for s in sections if s.content],
        script=Markup(script),
        script_digest=base64.b64encode(hashlib.sha256(script.encode()).digest()).decode(),
        version=version("multistep-bench"),
        **content,
    )
