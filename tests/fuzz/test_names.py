"""Any text as any name: pages hold no element of it, tables print it as it is."""

import dataclasses
import io
from functools import lru_cache

from diagnose import samples
from fuzz.inputs import WORDS, cases
from hypothesis import given
from hypothesis import strategies as st
from parsed_page import Parsed
from rich.console import Console

from bench.diagnose.report import page, terminal_summary
from bench.diagnose.result import VERDICTS
from bench.fleet import page as fleet_page
from bench.fleet import summary
from bench.fleet.findings import drifts, quantities
from bench.fleet.result import Answer, FleetDiagnosis, Number

MARKUP = ["<script>x</script>", '" onload="x"', "' onload='x'", "<!--", "]]>", "</title>", "{{7*7}}", "{% x %}", "&lt;"]
MARKUP += [
    "<svg/onload=x>",
    "</style><b>",
    "javascript:x",
    "$\\frac{",
    "[/]",
    "[red",
    "[link=x]",
    "\\",
    "\x00",
    "\u202e",
]
MARKUP += ["</script>", "`", "|", "\x1b[31m"]
NAMES = st.lists(
    st.sampled_from(MARKUP + [w for w in WORDS if len(w) < 50]) | st.text(max_size=4), min_size=1, max_size=4
)
EVIL = NAMES.map("".join)


@lru_cache
def plain(verdict: str) -> tuple[list[str], set[str]]:
    """Tags, and names of attributes, of the page without such names."""
    return shape(page.render(samples.ALL[verdict]()))


def shape(source: str) -> tuple[list[str], set[str]]:
    parsed = Parsed(source)
    tags = [t for t in parsed.tags if t not in ("tspan", "text", "span", "br", "wbr")]
    once = [f"{t} {parsed.tags.count(t)} times" for t in ("script", "style", "title", "html", "link")]
    return [*sorted(set(tags)), *once], {name for name, _ in parsed.attributes}


@cases(80)
@given(verdict=st.sampled_from(VERDICTS), evil=EVIL)
def test_the_page_of_a_diagnosis(verdict: str, evil: str) -> None:
    told = samples.hostile(samples.ALL[verdict](), evil)
    tags, attributes = shape(page.render(told))
    assert set(tags) <= set(plain(verdict)[0]) and attributes <= plain(verdict)[1], (tags, attributes)
    terminal_summary.print_summary(told, Console(file=io.StringIO(), width=100))


def fleet(name: str) -> FleetDiagnosis:
    """Seven vehicles, one not diagnosed, of which everything is called this."""
    number = Number(
        effect="drag", parameter="c", value=0.3, low=0.2, high=0.4, unit="kg/m", rivals=(name,), learned=False
    )
    answers = [
        Answer(
            f"{name}{i}",
            f"{name}{i % 3}",
            f"2026-03-0{i + 1}",
            name,
            "named",
            "",
            f"{i}",
            (dataclasses.replace(number, effect=name),),
        )
        for i in range(6)
    ]
    answers.append(Answer(name, name, "", "", "failed", name, ""))
    return FleetDiagnosis(name, tuple(answers), quantities(answers), drifts(answers), (name,))


@cases(80)
@given(evil=EVIL)
def test_the_page_of_a_fleet(evil: str) -> None:
    for text in (lambda name: fleet_page.render(fleet(name), name), lambda name: fleet(name)._repr_html_()):
        (tags, attributes), (those, known) = shape(text(evil)), shape(text("plain"))
        assert set(tags) <= set(those) and attributes <= known, (tags, attributes)
    summary.print_summary(fleet(evil), Console(file=io.StringIO(), width=100))
