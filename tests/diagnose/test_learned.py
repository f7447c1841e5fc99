"""Terms that no catalogue has, on measurements whose truth is written down here and shares no code with the effects."""

import importlib
import json
import re
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import jsonschema
import numpy as np
import pytest
import torch

from bench.diagnose import compare, diagnose, extend, learned
from bench.diagnose.compare import Comparison
from bench.diagnose.confirm import Setup
from bench.diagnose.fit import fit_parameters
from bench.diagnose.learn.candidates import Pair
from bench.diagnose.learn.curve import nearest
from bench.diagnose.learn.formulas import Option, fitted, option_columns, options
from bench.diagnose.learn.held_out import HeldOut
from bench.diagnose.learn.learn import _Seen, _worth, learn, worthy
from bench.diagnose.learn.request import parsed
from bench.diagnose.learned import _doubted
from bench.diagnose.learned_shape import LearnedShape
from bench.diagnose.logs.subject import Subject, log_of
from bench.diagnose.report import model_file, page, sentences
from bench.diagnose.report.learned_words import known_as
from bench.diagnose.result import Diagnosis, schema
from bench.diagnose.select.catalogue import admissible, check_catalogue
from bench.diagnose.select.search import Search
from bench.diagnose.select.timing.reading import prepared
from bench.diagnose.settings import LEARNING
from bench.diagnose.simulate.equation_error import EquationError, Saving
from registry.contracts import Channel, Recording
from registry.core import EFFECTS
from registry.effects.air import LinearDrag
from registry.effects.learned_term import LearnedTerm
from registry.effects.waves.hidden_mode import HiddenMode
from registry.errors import BenchError
from registry.physics.oscillator import Oscillator
from registry.physics.quadrotor import Quadrotor
from registry.terms.shapes import SHAPES

Force = Callable[[float, float], float]
FREQUENCIES = (0.3, 0.8, 1.4, 1.9, 2.6)
CONFUSABLE = ["coulomb_friction", "offset_force"]
"""A catalogue that has not what is hidden."""


def run(
    force: Force, seed: int, gust: float = 0.0, seconds: float = 10.0, dt: float = 0.01
) -> tuple[np.ndarray, np.ndarray]:
    """Drive (N,) and motion (N, 2) of a mass of 1 kg, 0.5 N s/m and 100 N/m, with a force of its own: RK4, 400 Hz.

    With ``gust`` [N] a random force pushes too, which the drive pushes against a moment later.
    """
    rng, count = np.random.default_rng(seed), round(seconds / dt)
    t = np.arange(4 * count + 1) * dt / 4
    u = sum(20 * rng.uniform(0.3, 1) * np.sin(2 * np.pi * f * t + rng.uniform(0, 6.28)) for f in FREQUENCIES)
    x, out = rng.normal(size=2) * [0.2, 1.0], []
    blown = np.zeros(len(t))
    if gust:
        kicks = rng.normal(0, gust * np.sqrt(dt / 2), len(t))
        answer = 0.0
        for k in range(1, len(t)):
            blown[k] = blown[k - 1] * (1 - dt / 4) + kicks[k]
            answer += dt / 4 / 0.1 * (blown[k] - answer)
            u[k] = 0.05 * u[k] - answer

    def rate(at: np.ndarray, push: float) -> np.ndarray:
        q, v = at
        return np.array([v, push - 0.5 * v - 100 * q + force(q, v)])

    pushed = u + blown

    for k in range(4 * count):
        if k % 4 == 0:
            out.append(x)
        middle, h = (pushed[k] + pushed[k + 1]) / 2, dt / 4
        a = rate(x, pushed[k])
        b = rate(x + h / 2 * a, middle)
        c = rate(x + h / 2 * b, middle)
        x = x + h / 6 * (a + 2 * b + 2 * c + rate(x + h * c, pushed[k + 1]))
    return u[: 4 * count : 4], np.array(out)


def subject(force: Force, noise: float = 1e-3, gust: float = 0.0) -> Subject:
    """Six recordings, two of them held out, with white noise relative to each state's spread."""
    model, logs = Oscillator(), []
    for seed in range(6):
        u, x = run(force, seed, gust)
        x = x + np.random.default_rng(100 + seed).normal(size=x.shape) * noise * x.std(0)
        made = Recording(
            f"run_{seed}", 100.0, u[:, None], x, (Channel("force", "N"),), model.state_channels, np.ones(len(x), bool)
        )
        logs.append(log_of(made, model, "force"))
    names, signals = [log.name for log in logs], ("displacement", "speed", "force")
    return Subject("hidden", model, tuple(logs), tuple(names[:4]), tuple(names[4:]), None, {}, {}, signals)


def terms_of(of: Subject) -> list[tuple[str, tuple[str, ...], str, tuple[float, ...]]]:
    """The terms that are learned, before they are fitted by simulation."""
    return [(t.axis, t.signals, t.shape, t.values) for t in learned_by(of)]


def learned_by(of: Subject) -> tuple[LearnedTerm, ...]:
    """These, as effects."""
    of, noise = prepared(of)
    calibrated, _ = fit_parameters(of, of.model, noise, through_simulator=False)
    return learn(of, calibrated, noise)


HIDDEN: dict[str, tuple[Force, tuple[str, ...], tuple[float, ...]]] = {
    "signed_square": (lambda q, v: -0.4 * abs(v) * v, ("speed.q",), (-0.4,)),
    "above": (lambda q, v: -300 * max(q - 0.25, 0.0), ("displacement.q",), (-300, 0.25)),
    "dead_zone": (lambda q, v: -120 * (q - np.clip(q, -0.2, 0.2)), ("displacement.q",), (-120, 0.2)),
    "linear": (lambda q, v: -3 * q * v, ("speed.q", "displacement.q"), (-3.0,)),
    "constant": (lambda q, v: 3.0, (), (3.0,)),
}


@pytest.mark.parametrize("shape", HIDDEN)
def test_the_formula_of_what_is_hidden_is_found(shape: str) -> None:
    force, follows, true = HIDDEN[shape]
    ((axis, signals, found, values),) = terms_of(subject(force))
    assert (axis, set(signals), found) == ("speed.q", set(follows), shape)
    np.testing.assert_allclose(values, true, rtol=0.1)  # a start: simulation fits it


def test_a_known_stiffness_leaves_the_straight_part_to_the_formula() -> None:
    """It took a pull of 30 N/m, 30 of its standard deviations, and left a cubic that no fit could be."""
    of = replace(subject(lambda q, v: 30 * q - 150 * q**3), uncertainty=dict.fromkeys(("mass", "stiffness"), 0.01))
    ((axis, signals, shape, values),) = terms_of(of)
    assert (axis, signals, shape) == ("speed.q", ("displacement.q",), "linear_cubic")
    np.testing.assert_allclose(values, (30, -150), rtol=0.1)


def test_what_is_narrow_has_the_knots_that_it_needs(monkeypatch: pytest.MonkeyPatch) -> None:
    """A magnet that the mass passes pulls within some 20 cm of 2.8 m, and between 15 knots half of that is lost."""

    def pull(q: float, v: float) -> float:
        s = (q - 0.1) / 0.1
        return -40 * s / (1 + s * s) ** 2

    of, at = subject(pull, noise=2e-4), torch.linspace(-0.3, 0.5, 81, dtype=torch.float64)
    true = np.array([pull(float(q), 0.0) for q in at])
    left = []
    for finer in (True, False):
        if not finer:
            monkeypatch.setattr(_Seen, "finer", lambda self, splines: splines)
        (term,) = learned_by(of)
        assert (term.signals, term.shape) == (("displacement.q",), "spline")
        left.append(float(np.std(term.function(at).numpy() - true) / np.std(true)))
    assert left[0] < 0.1 < 0.4 < left[1]


def test_of_a_drag_one_way_only_the_other_way_has_none() -> None:
    """A wave of the speed was fitted to it, which no recording confirmed."""
    ((axis, signals, shape, values),) = terms_of(subject(lambda q, v: -0.4 * v * abs(v) * (v > 0)))
    assert (axis, signals, shape) == ("speed.q", ("speed.q",), "square_sides")
    np.testing.assert_allclose(values, (-0.4, 0.0), atol=0.02)


@pytest.mark.parametrize(("hidden", "waves"), [("signed_square", False), ("above", True)])
def test_what_repeats_along_the_way_follows_places_alone(
    hidden: str, waves: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A wave of the speed was the one formula as good as the spline of a drag one way."""
    asked: list[set[str]] = []

    def seen(x: np.ndarray, of_a_place: bool) -> list[Option]:
        found = options(x, of_a_place)
        asked.append({o.shape.name for o in found})
        return found

    monkeypatch.setattr("bench.diagnose.learn.learn.options", seen)
    terms_of(subject(HIDDEN[hidden][0]))
    assert asked and all(({"sine", "wave"} <= names) is waves for names in asked)


@pytest.mark.parametrize(("middle", "names"), [(2.0, {"above"}), (0.0, {"above", "dead_zone"})])
def test_a_dead_zone_has_two_edges(middle: float, names: set[str]) -> None:
    """Of a height or a thrust, which are never negative, it was told in place of what begins above an edge."""
    x = np.linspace(-2.0, 2.0, 400).reshape(4, 100, order="F") + middle
    y = -0.4 * (np.maximum(x - 1.5 - middle, 0) - (middle == 0) * np.maximum(-x - 1.5, 0))
    some = [o for o in options(x) if o.shape.name in ("above", "dead_zone")]
    columns = option_columns(Pair("force_z", ("height",)), some, [{"height": x}]).values[0]
    rows = [np.column_stack([columns[:, i].T, y[i]]) for i in range(4)]
    nothing = np.zeros(len(columns) + 1)
    view = SimpleNamespace(
        grams=[r.T @ r for r in rows],
        floor=400.0,
        subsets=SimpleNamespace(anchor=nothing, prior=nothing, centre=nothing, low=nothing, high=nothing),
    )
    fits = HeldOut(view, [])  # type: ignore[arg-type]
    assert set(fitted(fits, some, np.arange(len(columns)), (), x)) == names


def test_two_functions_of_one_signal_become_one() -> None:
    """Of a stiff stop a product with a constant factor stood beside the function of the place: 4738 and −4739."""
    place, product = (("displacement.q",), ("speed.q", "displacement.q"))
    splines = [SimpleNamespace(pair=SimpleNamespace(signals=s)) for s in (place, product)]

    def as_formulas(some: list[SimpleNamespace], plain: bool) -> tuple[SimpleNamespace, ...]:
        return tuple(SimpleNamespace(axis="speed.q", signals=place, alone=len(some) == 1) for _ in some)

    seen = SimpleNamespace(as_formulas=as_formulas)
    kept, terms = _Seen.as_distinct_formulas(seen, splines)  # type: ignore[arg-type]
    assert kept == splines[:1] and [t.alone for t in terms] == [True]  # type: ignore[attr-defined]


def test_a_product_is_found_where_neither_signal_matters_by_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "bench.diagnose.learn.learn.LEARNING", replace(LEARNING, few=0)
    )  # as of a vehicle's many signals
    crossed = subject(HIDDEN["linear"][0])
    ((axis, signals, found, _),) = terms_of(crossed)
    assert (axis, set(signals), found) == ("speed.q", {"speed.q", "displacement.q"}, "linear")
    monkeypatch.setattr("bench.diagnose.learn.learn.crosses", lambda offered: [])
    assert terms_of(crossed) == []


def test_where_nothing_repeats_nothing_is_learned() -> None:
    assert terms_of(subject(lambda q, v: 0.0)) == []


def test_what_only_answers_a_disturbance_is_no_cause(monkeypatch: pytest.MonkeyPatch) -> None:
    blown = subject(lambda q, v: 0.0, gust=5.0)
    assert terms_of(blown) == []
    monkeypatch.setattr("bench.diagnose.learn.learn.consequences", lambda *given: [])
    assert ("force",) in [signals for _, signals, _, _ in terms_of(blown)]


@pytest.fixture(scope="module")
def said() -> tuple[Subject, Diagnosis, Oscillator]:
    """The diagnosis of a drag that the catalogue at hand lacks."""
    of = subject(HIDDEN["signed_square"][0])
    found, model = diagnose(of, catalogue=CONFUSABLE)
    return of, found, model  # type: ignore[return-value]


def test_a_diagnosis_adds_it_and_the_error_falls_to_the_floor(said: tuple[Subject, Diagnosis, Oscillator]) -> None:
    _, found, model = said
    (effect,) = found.effects
    assert found.verdict == "unknown_effect" and effect.learned and effect.term is not None
    assert (effect.term.axis, effect.term.signals, effect.term.shape) == ("speed.q", ("speed.q",), "signed_square")
    k = effect.parameters["k"]
    assert k.low <= -0.4 <= k.high and k.high - k.low < 0.02 and k.unit == "1/m"
    for group, error in found.error.extended.items():
        assert error.rmse < 1.15 * found.noise_floor[group].rmse < 0.1 * found.error.nominal[group].rmse
    shape = r"learned instead: rate of change of speed q = f\(speed q\), signed square, −([\d.]+) 1/m"
    assert float(re.search(shape, sentences.headline(found))[1]) == pytest.approx(0.4, rel=0.01)
    assert len(model.effects) == 1
    values = found.to_json()
    jsonschema.Draft202012Validator(schema()).validate(values)
    assert values["effects"][0]["learned"] is True and values["effects"][0]["term"]["signals"] == ["speed.q"]
    assert found.unexplained.axes == ("d speed.q/dt",)


def test_it_says_what_it_looks_like(said: tuple[Subject, Diagnosis, Oscillator]) -> None:
    """The catalogue at hand lacked the drag; the whole one has it, and nothing else does as much of it."""
    of, found, model = said
    (term,) = (e.term for e in found.effects)
    assert term is not None and (term.nearest, term.known_as) == (("quadratic_drag",), "drag at high speed")
    assert term.likeness == pytest.approx(1, abs=1e-6)
    text = sentences.explanation(found)
    assert "term looks like drag at high speed; nearest in the catalogue: quadratic drag, which would do 100 %" in text
    assert "To tell it from quadratic drag: " in text
    odd = replace(model, effects=(LearnedTerm("speed.q", ("speed.q",), "sine", (1.0, 20.0)),))
    driven = replace(model, effects=(LearnedTerm("speed.q", ("speed.q",), "signed_square", (0.4,)),))
    for unlike in (odd, driven):  # a force along the motion is no drag, whatever its shape
        assert nearest(Search(of, None, lambda what: None).look(unlike, broad=False).linear, 0) is None


@pytest.mark.parametrize(
    ("axis", "signal", "shape", "slope", "said"),
    [
        ("world_force_x", "position.x", "linear", -1.0, "a spring"),
        ("world_force_z", "height", "above", -1.0, "a wall or an end stop"),
        ("world_force_x", "position.y", "linear", -1.0, ""),
        ("force_x", "body_velocity.x", "linear", 1.0, "less friction or drag than the model has"),
        ("torque_x", "body_rates.p", "linear", -1.0, "viscous friction or slow drag"),
        ("force_z", "rotor_speed.1", "linear", -1.0, ""),
        ("force_z", "airspeed", "square", -1.0, ""),
    ],
)
def test_a_shape_is_known_where_it_acts_along_what_it_follows(
    axis: str, signal: str, shape: str, slope: float, said: str
) -> None:
    values = (slope,) * len(SHAPES[shape].parameters)
    assert known_as(LearnedTerm(axis, (signal,), shape, values), Quadrotor()) == said


def test_what_a_constant_would_say_as_well_is_not_learned() -> None:
    """A single term was weighed against the model as it was given, all of whose numbers may gain by being fitted."""
    of = replace(subject(lambda q, v: 0.0), uncertainty={"stiffness": 0.1})
    off, spring = replace(of.model, stiffness=97.0), LearnedTerm("speed.q", ("displacement.q",), "linear", (-3.0,))
    of, noise = prepared(replace(of, model=off))
    search = Search(of, (), lambda what: None, noise)
    with torch.no_grad():
        assert worthy(of, noise, search, off, [spring], doubtful=False) == ()
        # Where it is known it is the term that says so.
        known = replace(of, uncertainty={"stiffness": 1e-4})
        search = Search(known, (), lambda what: None, noise)
        assert worthy(known, noise, search, off, [spring], doubtful=False) == (spring,)


def test_where_nothing_says_that_something_is_missing_a_term_must_be_large_and_sure() -> None:
    """Gusts go with the time of a few recordings by chance: most of what can be explained, and not for sure."""
    saving = Saving("forces", 0.5, share=0.88, low=-1.2, high=2.9, matters=True, ratio=0.94)
    sure = [replace(saving, share=share, low=0.04, high=2 * share) for share in (0.1, 0.88)]
    assert [_worth(s, doubtful) for s in (saving, *sure) for doubtful in (True, False)] == [0, 0, 0, 1, 1, 1]


@pytest.mark.parametrize(
    ("explained", "kept"),
    [
        ({"ab": (0.0, 0.3), "b": (0.4,)}, "b"),  # the forecast is better without a
        ({"ab": (-0.1, 0.5), "b": (0.3,)}, "ab"),  # b needs a
        ({"ab": (0.1, 0.2)}, "ab"),
        ({"ab": (0.3, -0.1), "a": (0.3,)}, "a"),
        ({"ab": (0.0, 0.0), "b": (0.0,)}, None),
    ],
)
def test_a_term_that_free_runs_do_not_need_is_not_added(
    monkeypatch: pytest.MonkeyPatch, explained: dict[str, tuple[float, ...]], kept: str | None
) -> None:
    """By the terms that are added: the share of the error of held-out free runs that each explains."""
    model = Oscillator()
    a, b = (LearnedTerm("speed.q", (signal,), "linear", (1.0,)) for signal in ("displacement.q", "speed.q"))
    letters = {a: "a", b: "b"}

    def extended(subject: object, base: object, asked: list[LearnedTerm], *_: object, **__: object) -> object:
        terms = "".join(letters[t] for t in asked)
        effects = [
            SimpleNamespace(learned=True, share_explained=share, parameters={}, term=None) for share in explained[terms]
        ]
        return SimpleNamespace(terms=terms, effects=effects)

    monkeypatch.setattr(learned, "learn_all_terms", lambda *_, **__: (a, b))
    monkeypatch.setattr(learned, "extend", extended)
    monkeypatch.setattr(learned, "idle_effects", lambda *_: set())
    given = SimpleNamespace(model=model, logs=())
    done = learned.learned(
        given,
        model,
        None,
        found=(),
        named=(),
        tick=print,
        horizon_s=None,
        doubtful=False,  # type: ignore[arg-type]
        much=True,
        filed=given,
    )
    assert (done and done.extension.terms) == kept  # type: ignore[attr-defined]


@pytest.mark.parametrize("read_again", [False, True])
def test_a_named_effect_goes_for_a_mode_only_where_inputs_were_read_again(
    monkeypatch: pytest.MonkeyPatch, read_again: bool
) -> None:
    """A delay may stand for a mode that shifted the inputs; a load that swings is named beside one."""
    named, term = SimpleNamespace(id="load", learned=False), SimpleNamespace(id="hidden_mode", learned=True)
    given, filed = (SimpleNamespace(model=Oscillator(), logs=(name,)) for name in "ab")
    mode = HiddenMode(axes=("speed.q",), drivers=("speed.q",))

    def extended(subject: object, base: object, asked: list[object], *_: object, **__: object) -> object:
        return SimpleNamespace(effects=[named] * ("load" in asked) + [term])

    for name, value in {
        "learn_all_terms": lambda *_, **__: (mode,),
        "extend": extended,
        "ordered": lambda *_: Oscillator(),
        "retimed": lambda *_: SimpleNamespace(**vars(given)),
        "idle_effects": lambda *_: {"load"},
        "_outdoes": lambda done: False,
        "_outdoes_given_the_past": lambda *_: True,
        "_pruned": lambda done, *_: done,
    }.items():
        monkeypatch.setattr(learned, name, value)
    done = learned.learned(
        given,  # type: ignore[arg-type]
        Oscillator(),
        None,  # type: ignore[arg-type]
        found=[SimpleNamespace(id="load", rivals=())],  # type: ignore[list-item]
        named=(),
        tick=print,
        horizon_s=None,
        filed=filed if read_again else given,  # type: ignore[arg-type]
        doubtful=False,
        much=True,
    )
    assert (None if done is None else done.extension.effects) == ([term] if read_again else None)


def test_an_effect_with_states_of_its_own_is_no_imitation_of_a_mode() -> None:
    """A load of the catalogue had given way to "something swings": free runs know the beginning of neither."""
    both = [SimpleNamespace(id=name, effect=EFFECTS.get(name).typical()) for name in ("suspended_load", "linear_drag")]
    assert learned._doubted(SimpleNamespace(found=both, equations=()), None) == ["linear_drag"]  # type: ignore[arg-type]


def test_where_a_constant_stands_for_something_else_every_effect_is_doubted() -> None:
    error = EquationError("speed", 0.1, "m/s", {"calibrated": 0.2, "extended": 0.01}, 0.01, 0.01, own_floor=0.01)
    found = SimpleNamespace(found=[SimpleNamespace(id="coulomb_friction", effect=None, savings=())], equations=[error])
    assert learned._doubted(found, None) == []  # type: ignore[arg-type]
    assert learned._doubted(found, None, strained=True) == ["coulomb_friction"]  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("load", "error", "alone"),
    [
        (True, {"extended": 0.06, "predictable": 0.06}, True),
        (True, {"extended": 0.06, "predictable": 0.03}, False),  # signals would predict half of what is left
        (True, {"calibrated": 0.0105, "extended": 0.0104, "predictable": 0.009}, True),  # what is left is noise
        (False, {"extended": 0.06, "predictable": 0.06}, False),
        (True, None, False),
    ],
)
def test_a_load_that_swings_when_free_runs_begin_is_no_reason_to_learn_what_no_signal_tells(
    load: bool, error: dict[str, float] | None, alone: bool
) -> None:
    """A load and a drag were named in 30 s of CPU, and then terms of other signals sought for ten minutes."""
    effects = (EFFECTS.get("suspended_load").typical(),) if load else ()
    extension = SimpleNamespace(model=Quadrotor(effects=effects))
    errors = [
        EquationError(
            "forces",
            0.1,
            "m/s",
            {"calibrated": of.get("calibrated", 0.2), "extended": of["extended"]},
            predictable=of["predictable"],
            floor=0.01,
            own_floor=0.01,
        )
        for of in ([] if error is None else [error])
    ]
    found = SimpleNamespace(equations=errors)
    begins = importlib.import_module("bench.diagnose.diagnose")._only_begins_unseen
    assert begins(found, extension) is alone


@pytest.mark.parametrize(("named", "kept"), [("coulomb_friction", []), ("quadratic_drag", ["quadratic_drag"])])
def test_what_only_imitates_a_term_gives_way_to_it_and_what_is_there_does_not(named: str, kept: list[str]) -> None:
    """A drag is hidden; Coulomb friction makes much of it, and beside that what is left would be learned or not."""
    of, noise = prepared(subject(HIDDEN["signed_square"][0]))
    before = extend(of, of.model, [named], noise=noise)
    found = SimpleNamespace(found=(SimpleNamespace(id=named, rivals=(), effect=None),), equations=())
    done = learned.instead(Setup(of, noise, lambda what: None, None, of), found, before, None, much=True)  # type: ignore[arg-type]
    if kept:
        assert done is None
        return
    assert done is not None
    (effect,) = done.extension.effects
    assert effect.term is not None and effect.term.shape == "signed_square"
    assert effect.parameters["k"].low <= -0.4 <= effect.parameters["k"].high


def test_where_effects_leave_little_they_imitate_no_hidden_mode(monkeypatch: pytest.MonkeyPatch) -> None:
    of, noise = prepared(subject(HIDDEN["signed_square"][0]))
    before, asked = extend(of, of.model, ["coulomb_friction"], noise=noise), []
    found = SimpleNamespace(found=(SimpleNamespace(id="coulomb_friction", rivals=(), effect=None),), equations=())
    monkeypatch.setattr(learned, "learn_all_terms", lambda *given, much, **rest: asked.append(much) or ())
    run = Setup(of, noise, lambda what: None, None, of)
    for much in (True, False):
        assert learned.instead(run, found, before, None, much) is None  # type: ignore[arg-type]
    assert asked == [True, False]


@pytest.mark.parametrize(
    ("now", "alone", "numbers", "taken"),
    [
        ((1.0, 1.0), True, [1], True),
        ((1.0, 2.5), True, [1], False),  # held-out recordings do not confirm it
        ((2.5, 1.0), True, [1], False),
        ((3.0, 3.0), True, [3, 1], False),  # what is known stands alone
        ((3.0, 3.0), False, [3, 1], True),
        ((3.0, 3.0), False, [3], False),
        ((3.0, 3.0), False, [1, 1], False),  # two effects in one formula are no fewer numbers
        ((3.0, 4.0), False, [3, 1], False),
    ],
)
def test_terms_without_what_is_named_forecast_clearly_better_or_as_well_with_fewer(
    monkeypatch: pytest.MonkeyPatch, now: tuple[float, float], alone: bool, numbers: list[int], taken: bool
) -> None:
    """What is named, of effects with these numbers, leaves 3 above the floor; beside it stands a term with two."""

    def told(numbers: list[int]) -> SimpleNamespace:
        last = SimpleNamespace(horizon_s=(0.5,))
        effects = [SimpleNamespace(parameters=dict.fromkeys(range(n))) for n in numbers]
        return SimpleNamespace(
            subject=None, extension=SimpleNamespace(model=Oscillator(), effects=effects, comparison=last)
        )

    def left(models: object, noise: object, names: str, horizon_s: float) -> tuple[np.ndarray, np.ndarray]:
        mean = np.array([3.0, now[names == "held out"]])
        return mean, np.tile(mean, (10, 1))

    monkeypatch.setattr(learned, "above_floor", left)
    run = SimpleNamespace(subject=SimpleNamespace(training="training", held_out="held out"), noise=None)
    assert learned._better(run, told([2]), told(numbers), alone) is taken  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("shape", "intervals", "kept"),
    [
        ("linear", {"k": (-0.43, 0.34)}, False),
        ("linear", {"k": (-0.43, -0.34)}, True),
        ("above", {"k": (-1.0, 1.0), "w": (0.2, 0.3)}, False),
        ("affine", {"k": (-1.0, 1.0), "c": (0.2, 0.3)}, True),
        ("swing", {"frequency": (2.0, 2.1), "damping": (0.1, 0.2), "p": (-1.0, 1.0), "q": (-0.1, 0.2)}, False),
    ],
)
def test_a_term_that_may_as_well_be_none_is_not_told(
    shape: str, intervals: dict[str, tuple[float, float]], kept: bool
) -> None:
    numbers = {n: SimpleNamespace(value=sum(i) / 2, low=i[0], high=i[1]) for n, i in intervals.items()}
    term = SimpleNamespace(shape=shape, signals=("speed.q",))
    effect = SimpleNamespace(learned=True, share_explained=0.9, parameters=numbers, term=term)
    done = SimpleNamespace(effects=[effect])
    found = learned._pruned(done, (LearnedTerm(signals=("speed.q",)),), (), lambda fewer: done)  # type: ignore[arg-type]
    assert (found is not None) is kept


@pytest.mark.parametrize(("share", "now", "kept"), [(0.01, 1.3, False), (0.01, 1.05, True), (0.2, 1.3, True)])
def test_a_trace_that_moves_what_is_named_is_not_added(share: float, now: float, kept: bool) -> None:
    def effect(name: str, learned: bool, share: float, value: float) -> SimpleNamespace:
        numbers = {"k": SimpleNamespace(value=value, low=0.9, high=1.1)}
        return SimpleNamespace(id=name, learned=learned, share_explained=share, parameters=numbers, term=None)

    done = SimpleNamespace(effects=[effect("drag", False, 0.9, now), effect("learned_term", True, share, 1.0)])
    terms, named = (LearnedTerm(signals=("speed.q",)),), [effect("drag", False, 0.9, 1.0)]
    found = learned._pruned(done, terms, named, lambda fewer: done)  # type: ignore[arg-type]
    assert (found is done) is kept and (found is None) is not kept


def test_the_page_draws_its_shape_with_a_band_that_holds_the_truth(said: tuple[Subject, Diagnosis, Oscillator]) -> None:
    _, found, _ = said
    (curve,) = found.evidence.learned
    x, low, high = (np.array(v) for v in (curve.x, curve.low, curve.high))
    true = -0.4 * np.abs(x) * x
    assert (low <= true + 1e-9).all() and (true <= high + 1e-9).all()
    dots = np.array(curve.dots_y) + 0.4 * np.abs(curve.dots_x) * np.array(curve.dots_x)
    assert np.median(np.abs(dots)) < 0.05 * np.abs(true).max()
    text = page.render(found)
    assert "What was learned" in text and "rate of change of speed q [m/s²]" in text and "speed q [m/s]" in text


def test_a_file_keeps_it_for_every_later_step(said: tuple[Subject, Diagnosis, Oscillator], tmp_path: Path) -> None:
    of, found, model = said
    model_file.write(tmp_path / "model.toml", model, found.effects)
    read = model_file.read(tmp_path / "model.toml", "oscillator")
    a, b = (compare(of, {"extended": m}).error("extended") for m in (model, read))
    assert all(abs(a[g].rmse - b[g].rmse) <= 1e-9 for g in a)
    again, _ = diagnose(replace(of, model=read), catalogue=CONFUSABLE, brief=True)
    assert (again.verdict, again.effects) == ("nothing", ())
    with pytest.raises(BenchError, match="Nothing is left"):
        extend(of, read, ["learned"])


def test_one_is_added_on_request() -> None:
    of = subject(HIDDEN["signed_square"][0])
    asked = extend(of, of.model, ["speed ~ speed"])
    assert asked.effects[0].name == "speed.q ~ speed.q"
    assert asked.effects[0].parameters["k"].value == pytest.approx(-0.4, rel=0.01)
    assert [s.name for s in asked.stages] == ["nominal", "calibrated", "speed.q ~ speed.q", "floor"]


def test_of_a_term_that_acts_nowhere_nothing_is_told() -> None:
    idle = LearnedTerm("speed.q", ("displacement.q",), "above", (-300.0, 9.0), span=(-0.5, 0.5))
    of = subject(lambda q, v: 0.0)
    told = extend(of, of.model, [idle])
    k = told.effects[0].parameters["k"]
    assert k.value == -300 and not np.isfinite([k.low, k.high]).any()


@pytest.mark.parametrize(
    ("text", "axis", "signals"),
    [
        ("force_z ~ height", "force_z", ("height",)),
        ("world force x ~ position x", "world_force_x", ("position.x",)),
        ("force_x ~ speed * body_velocity.x", "force_x", ("airspeed", "body_velocity.x")),
        ("torque_y~q", "torque_y", ("body_rates.q",)),
        ("world_force_z ~ position.z", "world_force_z", ("height",)),
    ],
)
def test_a_request_is_read_as_people_write_it(text: str, axis: str, signals: tuple[str, ...]) -> None:
    pair = parsed(text, Quadrotor())
    assert pair is not None and (pair.axis, pair.signals) == (axis, signals)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("force_z ~ heigth", "there is no signal 'heigth': did you mean height"),
        ("up ~ height", "quadrotor has no axis 'up'"),
        ("force_z ~", "there is no signal ''"),
        ("force_z ~ height * height * thrust", "one signal, or is a function of one times another"),
    ],
)
def test_what_cannot_be_asked_for_is_one_sentence(text: str, says: str) -> None:
    with pytest.raises(BenchError, match=says):
        parsed(text, Quadrotor())


def test_it_is_no_member_of_the_catalogue() -> None:
    of = subject(lambda q, v: 0.0)
    with pytest.raises(BenchError, match=r"--catalogue learned_term: it is learned .* --add learned"):
        check_catalogue(of, of.model, ["learned_term"])
    assert "learned_term" not in [name for name, _ in admissible(of, of.model, None)]


# ------------------------------------------------------------------------------ flights of another simulator

hidden = pytest.importorskip("bench.score.multirotor.hidden", reason="needs RotorPy: pip install .[score]")


def flights(monkeypatch: pytest.MonkeyPatch, method: str, extra: Callable[[np.ndarray, np.ndarray], object]) -> Subject:
    """Six flights of 15 s, simulated by RotorPy, with more in its wrench or in its forces of the world."""
    from bench.score import case, logs

    before = getattr(hidden.HiddenMultirotor, method)

    def changed(self: object, now: object) -> object:
        own, more = before(self, now), extra(now.state, now.air)  # type: ignore[attr-defined]
        return (own[0] + more[0], own[1] + more[1]) if isinstance(own, tuple) else own + more  # type: ignore[index]

    monkeypatch.setattr(hidden.HiddenMultirotor, method, changed)
    flown = case.Case("hidden", recordings=6, seconds=15.0, flight_seed=3)
    columns = case.clean(flown, case._fly(flown))
    return logs.subject("hidden", columns, case.nominal(flown), case.UNCERTAINTY, {})


@pytest.mark.slow
def test_a_spring_in_the_room_is_found_in_flights(monkeypatch: pytest.MonkeyPatch) -> None:
    def spring(state: np.ndarray, air: np.ndarray) -> np.ndarray:
        return np.concatenate([-0.31 * state[:2], 0 * state[:1]])

    found, _ = diagnose(flights(monkeypatch, "world_force", spring))
    assert found.verdict == "unknown_effect"
    terms = {e.term.axis: e for e in found.effects if e.term is not None}
    assert {a: (e.term.signals, e.term.shape) for a, e in terms.items()} == {  # type: ignore[union-attr]
        f"world_force_{a}": ((f"position.{a}",), "linear") for a in "xy"
    }
    for effect in terms.values():
        k = effect.parameters["k"]
        assert k.low <= -0.31 <= k.high and k.unit == "N/m"
    after, floor = found.error.extended["velocity"].rmse, found.noise_floor["velocity"].rmse
    assert after < 1.05 * floor < 0.15 * found.error.nominal["velocity"].rmse
    json.dumps(found.to_json(), allow_nan=False)


@pytest.mark.slow
def test_a_moment_that_goes_with_the_square_of_the_speed_is_found_in_flights(monkeypatch: pytest.MonkeyPatch) -> None:
    def moment(state: np.ndarray, air: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.zeros_like(air), np.stack([0 * air[0], 0.004 * np.abs(air[0]) * air[0], 0 * air[0]])

    found, _ = diagnose(flights(monkeypatch, "wrench", moment), brief=True)
    (effect,) = found.effects
    assert effect.term is not None and effect.acts_on == "torques"
    assert (effect.term.axis, effect.term.signals) == ("torque_y", ("body_velocity.x",))
    assert effect.term.shape == "signed_square"
    assert effect.parameters["k"].low <= 0.004 <= effect.parameters["k"].high


@pytest.mark.slow
def test_a_drag_of_each_axis_by_itself_is_not_taken_for_one_of_the_airspeed(monkeypatch: pytest.MonkeyPatch) -> None:
    true = np.array([0.12, 0.20, 0.06])

    def drag(state: np.ndarray, air: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return -true[:, None] * np.abs(air) * air if air.ndim > 1 else -true * np.abs(air) * air, np.zeros_like(air)

    found, _ = diagnose(flights(monkeypatch, "wrench", drag), brief=True)
    assert found.verdict == "unknown_effect"
    for effect in found.effects:
        assert effect.term is not None and effect.term.shape == "signed_square"
        k = effect.parameters["k"]
        assert k.low <= -true["xyz".index(effect.term.axis[-1])] <= k.high


@pytest.mark.parametrize(
    ("signals", "shape", "name"),
    [
        (("voltage",), "wave", "speed.q ~ voltage"),
        (("voltage", "speed.q"), "linear", "speed.q ~ voltage * speed.q"),
        ((), "wave", "speed.q ~ wave"),
        ((), "constant", "speed.q ~ 1"),
    ],
)
def test_a_term_is_named_as_one_asks_for_it(signals: tuple[str, ...], shape: str, name: str) -> None:
    assert LearnedShape("speed.q", signals, shape, "", "").name == name


@pytest.mark.parametrize(
    ("calibrated", "now", "worth"),
    [(2.0, 2.0, False), (2.0, 1.99, False), (2.0, 1.9, True), (2.0, 1.0, True), (20.0, 1.9, False), (20.0, 1.6, True)],
)
def test_terms_that_leave_free_runs_as_they_were_are_not_told(
    monkeypatch: pytest.MonkeyPatch, calibrated: float, now: float, worth: bool
) -> None:
    """Error 2 above a floor of 1 without terms; their own shares are told of a model that was not fitted to the end.

    Beside effects that took nearly all that the calibrated model left, terms take a large part of the rest or are none.
    """

    def extension(error: float) -> SimpleNamespace:
        errors = {"floor": 1.0, "nominal": 1.0, "calibrated": calibrated}
        comparison = SimpleNamespace(error=lambda name: {"speed": SimpleNamespace(rmse=errors[name])})
        comparison.above_floor = partial(Comparison.above_floor, comparison)
        return SimpleNamespace(
            last={"speed": SimpleNamespace(rmse=error)}, comparison=comparison, model=Oscillator(effects=()), effects=()
        )

    step = importlib.import_module("bench.diagnose.diagnose")
    assert step._worth_it(extension(2.0), extension(now)) is worth
    told = SimpleNamespace(extension=extension(now))
    monkeypatch.setattr(step, "learned", lambda *_, **__: told)
    run = SimpleNamespace(subject=None, noise=None, tick=print, horizon_s=None, filed=None)
    given = step._learned(run, SimpleNamespace(found=(), equations=()), extension(2.0), "unknown_effect")
    assert (given is told) is worth and (given is None) is not worth


def test_an_effect_that_leaves_hardly_more_than_its_numbers_may_be_off_is_not_doubted():
    """Though its error is far above the noise floor still."""
    found = SimpleNamespace(
        id="linear_drag", effect=LinearDrag(), savings=[SimpleNamespace(equation="forces", worth=True)]
    )

    def doubted(left: float) -> list[str]:
        models = {"nominal": 2.0, "calibrated": 1.0, "extended": left}
        error = EquationError("forces", 0.5, "m/s", models, predictable=left, floor=0.001)
        return _doubted(SimpleNamespace(found=[found], equations=[error]), None)

    assert [doubted(0.01), doubted(0.15)] == [[], ["linear_drag"]]
