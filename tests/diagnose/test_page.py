"""The HTML page: whole, offline, and safe against names that are markup."""

import re
from dataclasses import replace
from functools import lru_cache

import pytest
import samples
from parsed_page import Parsed

from bench.diagnose.evidence import Calibration
from bench.diagnose.report import constant_words, page, phrases, sentences
from bench.diagnose.result import VERDICTS


@lru_cache
def rendered(verdict: str) -> str:
    return page.render(samples.ALL[verdict]())


@pytest.mark.parametrize("verdict", VERDICTS)
def test_page_says_the_verdict_and_needs_nothing_from_outside(verdict: str) -> None:
    diagnosis, source = samples.ALL[verdict](), rendered(verdict)
    parsed = Parsed(source)
    assert sentences.headline(diagnosis) in parsed.text and sentences.explanation(diagnosis) in parsed.text
    assert not {"link", "iframe", "object", "embed", "base"} & set(parsed.tags)
    assert parsed.tags.count("script") == (1 if diagnosis.evidence.flights else 0)
    addresses = [v for n, v in parsed.attributes if n in ("href", "src", "xlink:href", "action", "srcset", "data")]
    assert all(a.startswith("#") for a in addresses)
    assert all(u.startswith("#") for u in re.findall(r"url\(['\"]?([^)]*)", source)) and "@import" not in source
    outside = {u for u in re.findall(r"https?://[^\"'\s<>)]*", source) if not u.startswith("http://www.w3.org/")}
    assert not outside
    links = {v[1:] for n, v in parsed.attributes if n == "href"}
    anchors = [v for n, v in parsed.attributes if n == "id" and v in links]
    assert links == set(anchors) and len(anchors) == len(links)


def test_what_is_not_worth_a_term_stands_with_what_is_left() -> None:
    said, remark = samples.named(), "A trace of ground effect shows; it saves 1 % <b>of all</b>."
    pages = [page.render(replace(said, evidence=replace(said.evidence, remarks=r))) for r in ((), (remark,))]
    assert [Parsed(p).text.count("above the noise floor that would be worth a term.") for p in pages] == [0, 1]
    section = Parsed(pages[1]).text.split("What is left")[-1].partition("Constants")[0]
    assert remark in section and "<b>of all" not in pages[1]


def test_the_same_diagnosis_gives_the_same_page() -> None:
    assert page.render(samples.unknown_effect()) == rendered("unknown_effect")


@pytest.mark.parametrize("verdict", ["named", "data_problem"])
def test_markup_in_names_stays_text(verdict: str) -> None:
    diagnosis = samples.ALL[verdict]()
    evil = '<script>alert(1)</script>" onmouseover="alert(2)"$\\frac{'
    parsed = Parsed(page.render(samples.hostile(diagnosis, evil)))
    assert parsed.tags.count("script") == (1 if diagnosis.evidence.flights else 0)
    assert not [n for n, _ in parsed.attributes if n.startswith("on")]
    assert diagnosis.dataset + evil in parsed.text
    if diagnosis.evidence.windows:
        assert "alert(1)</script>" in " ".join(p for p in parsed.pieces if p.startswith("x<script>"))  # in a drawing


def test_named_page_shows_every_part_with_the_units_of_a_reader() -> None:
    parsed = Parsed(rendered("named"))
    for said in (
        "17.8 → 3.50 deg/s",  # 0.31 and 0.061 rad/s
        "81.0 → 9.40 mm",
        "RMSE [deg/s]",
        "velocity x [m/s]",
        "acceleration x [m/s²]",
        "61 % of the error",
        "Round 3: none is taken",
        "It ignores the rotor speed",
        "samples 1204 to 1206",
        "Nothing systematic is left",
        "1.2 σ",
        "flight_11",
        "bench extend flights/hummingbird --add rotor_drag --add rotor_reaction_torque",
    ):
        assert said in parsed.text, said


def test_of_the_constants_one_sentence_stands_at_the_top_and_all_of_them_in_their_section() -> None:
    d = samples.named()
    own = Calibration("torque_coefficient", 1.0, 1.04, "", 0.2, 1.02, 1.06)
    held = Calibration("damping", 700.0, 659.2, "N m s/rad", -2.9, 606.0, 712.0, stopped=True)
    d = replace(
        d, evidence=replace(d.evidence, calibration=(own, held)), error=replace(d.error, extended=d.error.nominal)
    )
    source = page.render(d)
    top, section = source.partition("</header>")[0], source.partition('<section id="constants">')[2]
    first, *rest = constant_words.miscalibrated(d)
    assert first in top and 'href="#constants">More' in top and rest and not any(said in top for said in rest)
    assert all(said in Parsed(section).text for said in (first, *rest))


def test_forces_and_torques_are_shown_apart_each_with_what_each_effect_saves_in_it() -> None:
    d = samples.named()
    source = rendered("named")
    assert source.index('id="equation-by-equation"') < source.index("With everything else as measured")
    start, middle, end = (source.index(s) for s in ("<h3>Forces", "<h3>Torques", 'id="effect-by-effect"'))
    forces, torques = Parsed(source[start:middle]).text, Parsed(source[middle:end]).text
    for said in (
        "velocity 0.320 → 0.0340 m/s",
        "Named here: rotor drag.",
        "The measured signals would predict another 6 %",
        "best predictor",
        "rotor drag 93 % 89 % to 97 %",
        "rotor reaction torque – too little to explain",
    ):
        assert said in forces, said
    for said in (
        "body rates after 0.5 s",
        "Named here: rotor reaction torque.",
        "RMSE [deg/s]",
        "2.69",  # 0.047 rad/s, best predictor of the torques
        "rotor drag 1 % −2 % to 5 %",
        "rotor reaction torque 84 % 71 % to 96 %",
        "rotor reaction torque, torque z 97 % 91 % to 100 %",
    ):
        assert said in torques, said
    without = Parsed(page.render(replace(d, by_equation={}))).text
    assert "Equation by equation" not in without
    # 0.034 of 0.320 m/s remain, 0.300 before
    assert '<i class="extended before" style="width:93.8%">' in source[start:middle]
    assert '<i class="extended" style="width:10.6%">' in source[start:middle]
    left = replace(d, verdict="nothing", effects=())
    assert "What each effect saves" not in Parsed(page.render(left)).text


def test_a_card_says_what_an_effect_saves_where_it_acts_before_its_share_of_free_runs() -> None:
    d = samples.named()
    yaw = replace(d.effects[1], share_explained=-0.0005, acts_on="torques: torque z")
    card = Parsed(page.render(replace(d, effects=(yaw,)))).text.partition("What")[0]
    assert "97 % explained in torques about z" in card
    assert card.index("torques about z 97 % 91 % to 100 %") < card.index("free runs −0.05 %")


def test_a_set_that_was_given_up_is_not_called_taken() -> None:
    d = samples.named()
    shown = Parsed(page.render(replace(d, effects=d.effects[:1]))).text
    assert "Round 1: rotor drag is taken" in shown
    assert "Round 2: rotor reaction torque is best, and dropped in a later step" in shown


@pytest.mark.parametrize(
    ("verdict", "said", "not_said"),
    [
        ("tie", ["To separate them: Fly at the same speed"], ["Nothing was"]),
        ("nothing", ["None is taken", "gentle: speeds stay below"], ["Effect by effect", "extended model"]),
        ("unknown_effect", ["A hypothesis, not a finding", "follows position x"], ["Effect by effect"]),
        ("data_problem", ["samples 1202 to 1466", "bench diagnose 'flights/tuesday 3'"], ["What is left", "runs free"]),
    ],
)  # fmt: skip
def test_each_verdict_shows_what_it_has_and_no_more(verdict: str, said: list[str], not_said: list[str]) -> None:
    text = Parsed(rendered(verdict)).text
    assert all(s in text for s in said) and not any(s in text for s in not_said)


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("k_d = -2.8e-08 kg m^2, d = 0.15 1; e = 3e+07 N", "k_d = −2.8×10⁻⁸ kg m², d = 0.15; e = 3×10⁷ N"),
        ("bench 1 of 2, v^-1", "bench 1 of 2, v⁻¹"),
    ],
)
def test_numbers_and_units_are_typeset(text: str, shown: str) -> None:
    assert phrases.typeset(text) == shown


def test_a_model_that_ran_away_is_called_diverged() -> None:
    assert "diverged → 9.40 mm" in Parsed(page.render(samples.diverged())).text
