"""A finished study as one HTML file that needs no network: what was asked, what came out, and how to make it again."""

from collections.abc import Sequence
from html import escape
from pathlib import Path

from bench.experiment.study import Study
from bench.records.record import RunRecord
from bench.reporting.page import document
from bench.reporting.study_page_content import Content
from bench.reporting.study_page_sections import SECTIONS
from bench.reporting.study_page_training import provenance, training
from registry.errors import BenchError


def write(path: Path, records: Sequence[RunRecord], title: str, study: Study | None, command: str) -> None:
    """Write the page.

    Args:
        path: of the HTML file.
        records: all runs of the study, baselines included.
        title: heading.
        study: for the question, and what is compared; None for a single configuration.
        command: the command that makes the study again.

    Raises:
        BenchError: the file cannot be written, or a record is damaged.
    """
    page = render(records, title, study, command)
    try:
        path.write_text(page, encoding="utf-8")
    except OSError as error:
        raise BenchError(f"The report {path} cannot be written: {error.strerror or error}.") from error


def render(records: Sequence[RunRecord], title: str, study: Study | None, command: str) -> str:
    """The page as text; arguments as for `write`."""
    content = Content(records, title, study, command)
    sections = SECTIONS | {"Training": training, "Provenance": provenance}
    made = {name: body for name, section in sections.items() if (body := section(content))}
    return document(
        title,
        _head(content),
        made,
        "Intervals are 95 %. Errors are those of free runs on test recordings, unless said otherwise.",
        Path(__file__).with_name("study_page.css"),
    )


def _head(c: Content) -> str:
    lost = len(c.lost())
    facts = [
        f"{len(c.specs)} configurations",
        f"{len(c.records)} runs",
        f"{lost} diverged" if lost else "none diverged",
        " and ".join(c.duration(h) for h in c.horizons),
    ]
    over = "".join(f"<span>{escape(f)}</span>" for f in facts)
    # Without words on the figure, the question stands where they would.
    asked = f'<p class="lead">{escape(c.study.question)}</p>' if c.study and c.study.paper_says else ""
    what = c.study.title if c.study else c.title
    badge = f'<span class="badge">{escape(c.title)}</span>' if c.study else ""
    return f'<header><p class="over">{badge}{over}</p><h1>{escape(what[:1].upper() + what[1:])}</h1>{asked}</header>'
