"""A finished study as one HTML file that needs no network: what was asked, what came out, and how to make it again."""

from collections.abc import Sequence
from pathlib import Path

from bench.experiment.study import Study
from bench.records.record import RunRecord
from bench.reporting import page
from bench.reporting.page import Section
from bench.reporting.study_page_content import Content
from bench.reporting.study_page_sections import SECTIONS
from bench.reporting.study_page_training import LAST_SECTIONS
from registry.atomic_io import writing


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
    text = render(records, title, study, command)
    with writing(f"The report {path}"):
        path.write_text(text, encoding="utf-8")


def render(records: Sequence[RunRecord], title: str, study: Study | None, command: str) -> str:
    """The page as text; arguments as for `write`."""
    content = Content(records, title, study, command)
    what = study.title if study else title
    return page.render(
        page.shared(),
        "study.html.j2",
        title,
        [Section(name, part, of(content)) for name, part, of in (*SECTIONS, *LAST_SECTIONS)],
        badge=title if study else "",
        facts=_facts(content),
        heading=what[:1].upper() + what[1:],
        # Without words on the figure, the question stands where they would.
        asked=study.question if study and study.paper_says else "",
    )


def _facts(c: Content) -> list[str]:
    lost = len(c.lost())
    return [
        f"{len(c.specs)} configurations",
        f"{len(c.records)} runs",
        f"{lost} diverged" if lost else "none diverged",
        " and ".join(c.duration(h) for h in c.horizons),
    ]
