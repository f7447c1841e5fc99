"""The JSON of a diagnosis against its schema, and the summary on the terminal."""

import io
import json
import math
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jsonschema
import numpy as np
import pytest
import samples
from rich.console import Console

from bench.cli.diagnosing import show_extension
from bench.diagnose.by_equation import ConstantEstimate, GivenPast, InverseDynamics, ObscuredConstant
from bench.diagnose.evidence import Calibration, Stage
from bench.diagnose.extend import shares_of
from bench.diagnose.learned_shape import LearnedShape
from bench.diagnose.regression.parameters import entries
from bench.diagnose.report import constant_words, page, page_sections, phrases, sentences, terminal_summary
from bench.diagnose.report.page import render
from bench.diagnose.report.phrases import gathered, lasting
from bench.diagnose.result import DataProblem, Diagnosis, NamedEffect, ParameterEstimate, schema
from bench.diagnose.select.discovery import Discovery, Found
from bench.diagnose.select.verify import Estimate
from bench.diagnose.settings import TELLING
from bench.diagnose.simulate.equation_error import EquationError, Saving
from bench.diagnose.simulate.free_run import Group
from bench.diagnose.summaries import constant_estimates, equation_results, placed
from registry.errors import BenchError
from registry.physics.quadrotor import Quadrotor

VALIDATOR = jsonschema.Draft202012Validator(schema())


def told(diagnosis: Diagnosis, width: int = 100) -> str:
    out = io.StringIO()
    terminal_summary.print_summary(diagnosis, Console(file=out, width=width, highlight=False))
    return out.getvalue()


@pytest.mark.parametrize(
    ("seconds", "said"), [(0.5, "0.5 s"), (1024, "1024 s"), (36000, "10 h"), (7200, "2 h"), (1.728e5, "2 days")]
)
def test_a_time_is_said_as_one_would(seconds: float, said: str) -> None:
    assert lasting(seconds) == said


@pytest.mark.parametrize("verdict", samples.ALL)
def test_every_verdict_is_valid_json_of_the_schema(verdict: str, tmp_path: Path) -> None:
    path = tmp_path / "new" / "diagnosis.json"
    samples.ALL[verdict]().write(path)
    read = json.loads(path.read_text(encoding="utf-8"), parse_constant=lambda c: pytest.fail(f"{c} is no JSON"))
    VALIDATOR.check_schema(VALIDATOR.schema)
    VALIDATOR.validate(read)
    assert read["verdict"] == verdict and "evidence" not in read
    assert [p.name for p in path.parent.iterdir()] == ["diagnosis.json"]


def test_what_does_not_fit_a_line_of_the_terminal_goes_on_indented() -> None:
    lines = told(samples.named(), width=60).splitlines()
    at = next(i for i, line in enumerate(lines) if line.startswith("  + "))
    assert all(len(line) <= 60 for line in lines)
    assert lines[at + 1].startswith(" " * 6) and not lines[at + 1].startswith(" " * 7)


def test_numbers_that_do_not_exist_are_null() -> None:
    read = samples.diverged().to_json()
    VALIDATOR.validate(read)
    assert read["error"]["nominal"]["position"] == {"horizon_s": 0.5, "rmse": None, "unit": "m"}
    assert read["effects"][0]["parameters"]["k_d"] == {"value": 1.187e-4, "low": None, "high": None, "unit": "kg/rad"}


def test_equations_and_constants_are_part_of_the_contract() -> None:
    read = samples.named().to_json()
    assert [e["acts_on"] for e in read["effects"]] == ["forces", "torques"]
    assert read["by_equation"]["torques"] == {
        "output": "body_rates",
        "horizon_s": 0.5,
        "unit": "rad/s",
        "nominal": 0.28,
        "calibrated": 0.26,
        "extended": 0.052,
        "predictable": 0.047,
        "floor": 0.011,
    }
    assert read["constants"]["thrust_coefficient"]["determined"] is True
    assert read["constants"]["torque_coefficient"]["low"] is None


def _error(equation: str, horizon_s: float, size: float) -> EquationError:
    models = {"nominal": 4 * size, "calibrated": 3 * size, "extended": 2 * size}
    return EquationError(equation, horizon_s, "m/s", models, 1.5 * size, 0.1 * size)


def test_each_equation_is_summed_up_at_its_longest_horizon_and_an_effect_acts_where_it_saves_most() -> None:
    model = Quadrotor()
    errors = tuple(_error(e, h, h) for e in ("forces", "torques") for h in (0.5, 0.1))
    savings = (
        Saving("forces", 0.1, 1.1, 0.9, 1.3, True),  # both are all of it: the first
        Saving("forces", 0.5, 0.2, 0.1, 0.3, True),
        Saving("torques", 0.1, 1.4, 1.1, 1.7, True),
        Saving("torques", 0.5, 9.0, 8.0, 10.0, False),  # of next to nothing
        Saving("forces", 0.5, 0.9, 0.8, 1.0, True, axis="force x"),  # the whole tells it
        Saving("torques", 0.1, 0.6, 0.5, 0.7, True, axis="torque z"),
    )
    drag = Found("rotor_drag", samples.DRAG, (), 1.0, (), savings)  # type: ignore[arg-type]
    found = Discovery(model, model, (drag,), (), (), (), equations=errors)
    summed = equation_results(found, model, extended=True)
    assert {n: (e.output, e.horizon_s, e.extended) for n, e in summed.items()} == {
        "forces": ("velocity", 0.5, 1.0),
        "torques": ("body_rates", 0.5, 1.0),
    }
    assert equation_results(found, model, extended=False)["forces"].extended == 1.5  # the effects were given up
    (effect,) = placed(found, [replace(samples.DRAG, acts_on="", saves=())])
    assert effect.acts_on == "forces" and effect.main == effect.saves[0]
    assert [(s.equation, s.axis, s.horizon_s, s.share, s.worth) for s in effect.saves] == [
        ("forces", "", 0.5, 0.2, True),
        ("torques", "", 0.1, 1.0, True),  # at its longest horizon there is next to nothing to save
        ("forces", "force x", 0.5, 0.9, True),
        ("torques", "torque z", 0.1, 0.6, True),
    ]


def test_an_effect_of_one_axis_is_told_by_what_it_saves_there() -> None:
    """Yaw makes little of the error of all torques, and less of a free run that tumbles."""
    savings = (
        Saving("torques", 0.5, -0.01, -0.02, -0.005, True),
        Saving("torques", 0.5, 0.98, 0.9, 1.05, True, axis="torque z"),
    )
    reaction = Found("rotor_reaction_torque", samples.REACTION, (), 1.0, (), savings)  # type: ignore[arg-type]
    model = Quadrotor()
    found = Discovery(model, model, (reaction,), (), (), ())
    d = samples.named()
    (yaw,) = placed(found, [replace(samples.REACTION, share_explained=-0.0005)])
    assert yaw.acts_on == "torques: torque z" and yaw.main is not None and yaw.main.share == 0.98
    assert "rotor_reaction_torque  explains 98 % in torques about z, −0.05 % in free runs: rotor_inertia" in told(
        replace(d, effects=(yaw,))
    )
    read = replace(d, effects=(yaw,)).to_json()
    VALIDATOR.validate(read)
    whole, axis = read["effects"][0]["saves"]
    assert (whole["axis"], whole["worth"], axis["axis"], axis["worth"]) == ("", False, "torque z", True)


def test_a_constant_is_determined_where_its_interval_is_under_half_of_the_stated_one() -> None:
    stated = Quadrotor()
    subject: Any = SimpleNamespace(model=stated, uncertainty={"mass": 0.02})
    entry = next(e for e in entries(stated, subject.uncertainty) if e.label == "mass")
    half = 1.96 * 0.02 * stated.mass
    moved = replace(stated, mass=1.01 * stated.mass)

    def estimated(share: float, off: float = 0.0) -> ConstantEstimate:
        low, high = (np.float64(moved.mass + off + side * share * half) for side in (-1, 1))  # as the fits give them
        x = Estimate(entry, moved.mass + off, low, high)
        return constant_estimates(subject, moved, [x])["mass"]

    sharp = estimated(0.49)
    assert (sharp.stated, sharp.value, sharp.unit) == (stated.mass, moved.mass, "kg")
    assert sharp.determined is True and not estimated(0.51).determined
    # The model that is written has another value than the fit of the interval: it is worth no more than that.
    wide = estimated(0.1, off=0.6 * half)
    assert wide.value == moved.mass and wide.high - wide.low == pytest.approx(1.2 * half) and not wide.determined


def _without(*path: Any) -> Any:
    def change(d: Any) -> None:
        for key in path[:-1]:
            d = d[key]
        del d[path[-1]]

    return change


@pytest.mark.parametrize(
    "change",
    [
        _without("unexplained"),
        _without("effects", 0, "parameters", "k_d", "low"),
        _without("error", "extended"),
        lambda d: d.update(verdict="maybe"),
        _without("by_equation"),
        _without("constants", "mass", "determined"),
        _without("effects", 0, "acts_on"),
        lambda d: d["by_equation"]["forces"].update(best=1.0),
        lambda d: d.update(evidence={}),
        lambda d: d["data_problems"][0].update(rows=[3]),
        lambda d: d["effects"].clear(),
        lambda d: [e.update(indistinguishable_from=["wind"]) for e in d["effects"]],
        lambda d: d.update(verdict="nothing"),
    ],
)
def test_schema_refuses_what_is_no_diagnosis(change: Any) -> None:
    read = samples.named().to_json()
    change(read)
    with pytest.raises(jsonschema.ValidationError):
        VALIDATOR.validate(read)


def test_a_file_that_cannot_be_written_is_one_sentence_and_leaves_nothing(tmp_path: Path) -> None:
    (tmp_path / "diagnosis.json").mkdir()
    with pytest.raises(BenchError, match=r"diagnosis\.json cannot be written"):
        samples.named().write(tmp_path / "diagnosis.json")
    assert [p.name for p in tmp_path.iterdir()] == ["diagnosis.json"]


@pytest.mark.parametrize("verdict", samples.ALL)
def test_the_story_is_short_and_says_the_verdict(verdict: str) -> None:
    diagnosis = samples.ALL[verdict]()
    text = told(diagnosis)
    assert len(text.splitlines()) <= TELLING.lines and all(len(line) <= 100 for line in text.splitlines())
    flat = " ".join(text.split())
    for said in {
        "named": ["rotor drag and rotor reaction torque", "1.152×10⁻⁴ to 1.224×10⁻⁴", "81.0 → 9.40 mm", "96 %"],
        "tie": ["rotor drag or linear drag", "heavier payload"],
        "nothing": ["No effect", "moved stated constants: mass by 12.4 % (11.9 % to 12.9 %; 12.4 σ)."],
        "unknown_effect": ["not in the catalogue", "acts on velocity z", "follows position x", "93 %"],
        "data_problem": ["frozen", "flight_03", "body rates r", "samples 1202 to 1466", "velocity x, all samples"],
    }[verdict]:
        assert said in flat


def test_the_story_has_a_line_for_each_of_several_equations() -> None:
    d = samples.named()
    text = told(replace(d, where=()))
    assert "  forces, all else measured: velocity after 0.5 s  0.320 → 0.0340 m/s (best 0.0330, noise 0.0012)" in text
    assert "  torques, all else measured: body rates after 0.5 s  16.0 → 2.98 deg/s (best 2.69, noise 0.63)" in text
    assert "all else measured" not in told(replace(d, by_equation={"forces": samples.EQUATIONS["forces"]}))


def test_nothing_is_not_said_to_be_noise_where_much_is_left() -> None:
    d = samples.nothing()
    assert "is at the noise floor." in sentences.explanation(d)
    worse = {g: replace(e, rmse=2.5 * e.rmse) for g, e in d.noise_floor.items()}
    said = sentences.explanation(replace(d, error=replace(d.error, calibrated=worse)))
    assert "is up to 2.5 times the noise floor; what is left is more than noise, but no" in said
    worse = {g: replace(e, rmse=1.5 * e.rmse) for g, e in d.noise_floor.items()}
    said = sentences.explanation(replace(d, error=replace(d.error, calibrated=worse)))
    assert "is up to 1.5 times the noise floor; what is left is not worth a term." in said
    left = replace(d.unexplained, share=0.9, axes=("velocity.x",), follows=())
    d = replace(d, unexplained=left, disturbance_floor={}, by_equation={})
    said = sentences.explanation(d)
    assert "wind, something" in said and "noise floor." not in said.partition("A syst")[0]
    (group, error), *_ = d.error.calibrated.items()
    slow = replace(d, disturbance_floor={group: replace(error, rmse=error.rmse / 2)})
    assert "wind, something that swings" in sentences.explanation(slow)
    fast = sentences.explanation(replace(d, disturbance_floor={group: error}))
    assert "`[processing] noise` states it" in fast and "wind, something" not in fast
    forces = replace(samples.EQUATIONS["forces"], extended=0.05, predictable=0.03)
    said = sentences.explanation(replace(d, by_equation={"forces": forces}))
    assert "A regression on all measured signals errs 40 % less in forces" in said and "wind, something" not in said
    assert sentences.explanation(replace(d, by_equation={"forces": replace(forces, predictable=0.049)})) == (
        sentences.explanation(d)
    )


def test_rotors_are_told_against_each_other_for_what_all_have_in_common_is_the_coefficients() -> None:
    """One that lost a tenth, beside a coefficient 10 % off: four intervals that hold zero, and one rotor that is it."""
    factors = {f"eps_{i}": 1.1 * (1 + own) - 1 for i, own in enumerate((0.0, 0.0, -0.1, 0.0), 1)}
    numbers = {name: ParameterEstimate(v, v - 0.3, v + 0.3, "1") for name, v in factors.items()}
    worn = replace(samples.DRAG, id="worn_rotors", parameters=numbers)
    expected = "beside the mean of all rotors +2.6 %, +2.6 %, −7.7 %, +2.6 %"  # 1 / .975 and .9 / .975
    assert phrases.parameters(worn).endswith(f"; {expected}")
    assert f'<p class="quiet">{expected}</p>' in page.render(replace(samples.named(), effects=(worn,)))
    assert phrases.together(samples.DRAG) == ""


def test_what_nobody_measured_of_a_load_when_a_free_run_begins_is_said() -> None:
    d = samples.named()
    left = replace(d.unexplained, share=0.08, axes=("position.x",), follows=())
    load, said = replace(samples.DRAG, id="suspended_load"), []
    for effects in ((load,), (samples.DRAG,), (replace(load, forecast_only=True),)):
        said.append(sentences.remainder(replace(d, unexplained=left, effects=effects)))
    assert all("A systematic error is left in position" in text for text in said)
    assert ["suspended load begins a free run" in text for text in said] == [True, False, False]


def test_every_tie_is_said_by_itself() -> None:
    d = samples.tie()
    (drag,) = d.effects
    torque = replace(samples.REACTION, share_explained=0.05, indistinguishable_from=("motor_lag",))
    both = "rotor drag or linear drag; rotor reaction torque or motor lag."
    two = replace(d, effects=(drag, torque))
    assert sentences.headline(two) == f"The model lacks two effects that these recordings cannot name: {both}"
    assert "Together, one of each explains about 97 %" in sentences.explanation(two)
    sure = replace(two, verdict="named", effects=(samples.DRAG, drag, torque))
    assert sentences.headline(sure) == "The model lacks rotor drag."
    assert f"Two more effects act that these recordings cannot name: {both}" in sentences.explanation(sure)


def test_the_headline_has_a_learned_formula_of_several_numbers_without_them() -> None:
    term = LearnedShape("speed.q", ("displacement.q",), "wave", "a sin n x + b cos n x", "all of it in a line")
    effect = replace(samples.DRAG, learned=True, term=term)
    pair = dict.fromkeys("ab", ParameterEstimate(1.0, 0.9, 1.1, "m"))
    d = replace(samples.unknown_effect(), effects=(replace(effect, parameters=pair),))
    assert sentences.headline(d).endswith("instead: speed q ~ displacement q, a sin n x + b cos n x.")
    one = replace(effect, parameters={"k": pair["a"]})
    assert sentences.headline(replace(d, effects=(one,))).endswith("instead: all of it in a line.")
    known = replace(one, term=replace(one.term, nearest=("offset_force",), likeness=1.0))
    for effects, lead in (((known,), "No effect of the catalogue was found"), ((known, one), "The catalogue does not")):
        assert sentences.headline(replace(d, effects=effects)).startswith(lead)


def test_the_headline_has_a_learned_term_that_explains_more_than_what_is_named() -> None:
    shape = LearnedShape("speed.q", ("displacement.q",), "linear", "k x", "rate of speed = f(displacement)")
    term = replace(samples.DRAG, learned=True, term=shape, share_explained=0.9)
    small = replace(samples.DRAG, share_explained=0.05)
    d = replace(samples.named(), effects=(small, term))
    told = "worth more: rate of speed = f(displacement)."
    assert sentences.headline(d) == f"The model lacks rotor drag; learned beside it, and {told}"
    less = replace(d, effects=(small, replace(term, share_explained=0.01)))
    assert sentences.headline(less) == "The model lacks rotor drag."


def test_a_constant_far_off_is_told_as_a_multiple() -> None:
    near = Calibration("thrust_coefficient", 1e-5, 1.056e-5, "N s^2", 2.8, 1.043e-5, 1.069e-5)
    assert constant_words.change(near) == "thrust coefficient by 5.6 % (4.3 % to 6.9 %; 2.8 σ)"
    far = replace(near, constant="mass", calibrated=8.3e-4, low=3.44e-4, high=1.31e-3)
    assert constant_words.change(far) == "mass to 83 times what was stated (34 to 130)"
    d = samples.named()
    d = replace(d, evidence=replace(d.evidence, calibration=(far, replace(near, calibrated=4e-6), near)))
    assert constant_words.far(d)[0] == "mass: 83 times what was stated (34 to 130)" and len(constant_words.far(d)) == 2
    assert "\n  mass: 83 times what was stated" in told(d)


def test_the_story_stays_short_when_there_is_much_to_say() -> None:
    d = samples.named()
    many = replace(d, effects=d.effects * 5, where=d.where * 5, data_problems=d.data_problems * 9)
    assert len(told(many, width=60).splitlines()) <= TELLING.lines


def test_sentences_give_way_to_figures() -> None:
    """However much there is to say of constants, the effects and the falling errors are told."""
    d = samples.named()
    long = Calibration("_".join(["mass", *["of", "what"] * 99]), 1.0, 1.2, "kg", 9.0, 1.1, 1.3)
    text = told(replace(d, evidence=replace(d.evidence, calibration=(long,))))
    assert "The page says more." in " ".join(text.split()) and len(text.splitlines()) <= TELLING.lines
    assert all(f"+ {e.name} " in text for e in d.effects) and "81.0 → 9.40 mm" in text


def test_a_constant_that_calibration_held_back_is_told_where_free_runs_still_err_far_above_the_floor() -> None:
    d = samples.named()
    held = Calibration("damping", 700.0, 659.2, "N m s/rad", -2.9, 606.0, 712.0, stopped=True)
    d = replace(d, evidence=replace(d.evidence, calibration=(held,)))
    near = replace(d, error=replace(d.error, extended=d.noise_floor))
    far = replace(d, error=replace(d.error, extended=d.error.nominal))
    assert constant_words.miscalibrated(near) == []
    stopped = "Calibration stopped at 3 stated standard deviations of damping."
    assert constant_words.miscalibrated(far)[0] == stopped
    # The end of what is stated is no result, of the constant or of a ratio with it.
    moved = replace(held, high=690.0)
    ratio = replace(moved, constant="damping / mass", stopped=False)
    ends = replace(near, evidence=replace(d.evidence, calibration=(moved, ratio)))
    assert constant_words.miscalibrated(ends) == [stopped]


@pytest.mark.parametrize("value", [0.0, 1.0, 9.995, 0.00099951, 99999.0, -2.5e-7, 1.234e-4, 123456.0, 0.1, -0.0314])
def test_a_shown_number_is_the_number(value: float) -> None:
    text = phrases.number(value)
    plain = text.translate(str.maketrans("−⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "--0123456789"))
    mantissa, _, exponent = plain.partition("×10")
    assert float(mantissa) * 10.0 ** int(exponent or 0) == pytest.approx(value, rel=0.0051)
    assert len(re.sub(r"^0+", "", mantissa.lstrip("-").replace(".", ""))) <= 6
    assert phrases.number(math.nan) == phrases.NOTHING


@pytest.mark.parametrize(
    ("by", "said"),
    [(0.004, "+0.4 %"), (-0.0002, "−0.02 %"), (0.124, "+12 %"), (8.8, "+880 %"), (0.0, "0 %"), (math.nan, "–")],
)
def test_a_change_has_a_sign(by: float, said: str) -> None:
    assert phrases.changed(by) == said


@pytest.mark.parametrize(
    ("name", "estimate", "said"),
    [
        ("a_x", ParameterEstimate(0.026180, 0.024435, 0.027925, "rad"), "1.50 deg (1.40 to 1.60)"),
        ("delay", ParameterEstimate(0.0123, 0.0119, 0.0127, "s"), "12.30 ms (11.90 to 12.70)"),
        ("c", ParameterEstimate(1.0, math.nan, math.nan, "1"), "1.00"),
        ("k", ParameterEstimate(1.187e-4, 1.15e-4, 1.22e-4, "kg/m"), "1.187×10⁻⁴ kg/m (1.150×10⁻⁴ to 1.220×10⁻⁴)"),
    ],
)  # fmt: skip
def test_an_estimate_has_the_digits_and_the_unit_that_a_reader_wants(
    name: str, estimate: ParameterEstimate, said: str
) -> None:
    assert phrases.estimate(name, estimate) == said


def test_constants_are_said_to_have_moved_where_their_interval_leaves_the_stated_value_out() -> None:
    d = samples.named()

    def said(*constants: Calibration) -> str:
        found = replace(d, evidence=replace(d.evidence, calibration=constants))
        return " ".join(constant_words.miscalibrated(found))

    held = Calibration("mass", 0.5, 0.506, "kg", 1.2, 0.499, 0.513)
    unknown = Calibration("mass", 0.5, 0.506, "kg", 1.2)
    moved = Calibration("inertia[1]", 2e-3, 1.9e-3, "kg m^2", -0.5, 1.88e-3, 1.92e-3)
    ratio = Calibration("torque_coefficient / inertia[2]", 2.0, 2.1, "", 0.5, 2.08, 2.12)
    assert said(held, unknown) == ""
    assert said(held, moved) == (
        "Calibration moved stated constants: inertia about y by −5.0 % (−6.0 % to −4.0 %; 0.5 σ)."
    )
    own = Calibration("torque_coefficient", 1.0, 1.04, "", 0.2, 1.02, 1.06)
    text = said(own, ratio, moved)
    assert "inertia about y" in text.partition(" Calibration also moved ratios of stated constants: ")[0]
    either = "To these recordings torque coefficient 5.0 % higher or inertia about z 4.8 % lower is the same. "
    assert either + "What is stated of the constants makes of these ratios: torque coefficient by 4.0 %" in text


def test_a_constant_that_went_where_it_cannot_be_is_no_finding() -> None:
    far = Calibration("inertia[1]", 1.4e-5, 1.2e-3, "kg m^2", 280.0, 5.8e-4, 1.9e-3)
    d = replace(samples.named(), effects=())
    hidden = ObscuredConstant("inertia", 88.0, "torques", "body_rates", finer="gyroscope=true")
    told = GivenPast({"inertia[1]": (1.37e-5, "kg m^2")}, 0.16, 0.05, 0.28, 0.1)

    def said(c: ObscuredConstant) -> str:
        found = replace(d, evidence=replace(d.evidence, calibration=(far,), obscured=(c,)))
        return " ".join(constant_words.miscalibrated(found))

    plain = said(hidden)
    assert plain.startswith(
        "Torques are not understood: the inertia would go to 88 times what was stated, which is not"
    )
    assert said(replace(hidden, equation="speed")).startswith("The equation of speed is not understood: the inertia")
    assert "With --set gyroscope=true the body rates" in plain and "Calibration moved" not in plain
    text = said(replace(hidden, repeats=0.96, told=told))
    assert "slow (96 % of it follows from its own past)" in text and "--set" not in text
    assert "inertia about y: about 1.37×10⁻⁵ kg m²" in text and "falls by 16 %" in text
    lost = replace(d, verdict="nothing", evidence=replace(d.evidence, calibration=(far,), obscured=(hidden,)))
    assert sentences.headline(lost) == "No effect of the catalogue was found, and torques cannot be explained."
    assert "not worth a term" not in sentences.explanation(lost)
    assert '<span class="badge">not understood</span>' in render(lost)
    known = replace(lost, evidence=replace(lost.evidence, obscured=(replace(hidden, told=told),)))
    assert "is missing as far as" in sentences.headline(known)
    assert '<span class="badge">nothing missing</span>' in render(known)
    friction = InverseDynamics(
        "coulomb_friction", "torque", (0.326, 0.301, 0.35), "N m", (1.47, 0.95, 1.98), 0.9, 0.86, 0.93
    )
    seen = replace(lost, evidence=replace(lost.evidence, inverse=friction))
    assert sentences.headline(seen) == "The torque works against Coulomb friction; forecasts by it gain nothing."
    first, *_ = sentences.paragraphs(seen)
    assert "works against Coulomb friction of 0.326 N m (0.301 to 0.350), which explains 90 % (86 % to 93 %)" in first
    assert '<span class="badge">missing effect seen</span>' in render(seen)
    page = page_sections._constants(lost)
    assert page is not None and [row.change for row in page.rows] == ["not to be believed"]


@pytest.mark.parametrize(("taken", "told"), [(0.9, True), (0.1, False), (math.nan, False)])
def test_the_headline_of_a_model_that_lacks_nothing_says_if_its_constants_were_far_off(
    taken: float, told: bool
) -> None:
    ratio = Calibration("thrust_coefficient / mass", 2.0, 1.84, "", -0.4, 1.83, 1.85)
    d = replace(samples.named(), verdict="nothing", effects=())
    d = replace(d, evidence=replace(d.evidence, calibration=(ratio,), calibrated=taken))
    off = "but stated constants are off: thrust coefficient / mass by −8.0 % (−8.5 % to −7.5 %; 0.4 σ)."
    assert sentences.headline(d).endswith(off) is told
    assert sentences.headline(replace(d, evidence=replace(d.evidence, calibration=()))).endswith("can show.")


def test_what_effects_take_is_never_more_than_all() -> None:
    # Calibration made it worse, and two effects end below the floor by chance.
    taken, *shares = shares_of([1.0, 1.2, 0.5, 0.08], 0.1)
    assert taken == pytest.approx(-0.2 / 1.1) and shares == pytest.approx([0.7 / 1.1, 0.4 / 1.1])
    assert shares_of([1.0, 0.9, 0.6], 0.5) == pytest.approx([0.2, 0.6])
    assert all(map(math.isnan, shares_of([0.1, 0.1, 0.1], 0.1)))


def test_a_problem_that_many_recordings_have_is_one_line() -> None:
    def found(name: str, kind: str, detail: str) -> DataProblem:
        return DataProblem(name, "body_rates.p", kind, (3, 9), detail)

    swapped = [found(f"flight_{i}", "swapped sign", "It is −p.") for i in range(5)]
    spikes = [found("flight_7", "spike", "9 rad/s."), found("flight_8", "spike", "8 rad/s.")]
    once = [found("flight_2", "frozen", "Held.")]
    assert gathered([*swapped, *spikes, *once]) == [
        "flight_0, flight_1 and 3 more, body rates p: swapped sign; It is −p.",
        "flight_7 and flight_8, body rates p: spike; in flight_7: 9 rad/s.",
        "flight_2, body rates p, samples 3 to 9: frozen; Held.",
    ]


def test_extending_prints_the_units_of_the_page() -> None:
    console = Console(width=120, record=True, file=io.StringIO())
    lag = NamedEffect("motor_lag", {"tau": ParameterEstimate(0.0412, 0.040, 0.0424, "s")}, 0.9, {}, {})
    groups = (Group("attitude", "rad", (6, 7, 8, 9)), Group("body_rates", "rad/s", (10, 11, 12)))
    stages = (
        Stage("nominal", {"attitude": 0.1, "body_rates": 1.0}),
        Stage("motor_lag", {"attitude": 0.01, "body_rates": 0.2}),
    )
    done = SimpleNamespace(comparison=SimpleNamespace(groups=groups), stages=stages, effects=(lag,), notes=())
    show_extension(console, done)
    shown = console.export_text()
    for part in (
        "attitude [deg]",
        "body rates [deg/s]",
        "5.73",
        "57.3",
        "+ motor_lag",
        "0.573",
        "11.5",
        "41.2 ms (40.0 to",
    ):
        assert part in shown
    assert "rad" not in shown and "final fit" not in shown
    done.effects = (replace(lag, id="rotor_drag"), lag)
    show_extension(console, done)
    assert "Only the row of motor_lag is of the final fit by simulation" in console.export_text()


@pytest.mark.parametrize(
    ("unit", "shown"),
    [
        ("m/s^2", "m/s²"),
        ("N s^2 / kg", "N s² / kg"),
        ("N / (kg m^2)", "N/(kg m²)"),
        ("kg/rad s", "kg/(rad s)"),
    ],
)
def test_a_unit_that_is_divided_by_several_has_these_in_brackets(unit: str, shown: str) -> None:
    assert phrases.shown(unit)[0] == shown


@pytest.mark.parametrize(
    ("identifier", "said"),
    [
        ("bouc_wen", "Bouc-Wen hysteresis"),
        ("coulomb_friction", "Coulomb friction"),
        ("munk_moment", "Munk moment"),
        ("inertia[2]", "inertia about z"),
        ("rotor_drag", "rotor drag"),
    ],
)
def test_effects_are_called_after_people_by_their_names(identifier: str, said: str) -> None:
    assert phrases.named(identifier) == said
