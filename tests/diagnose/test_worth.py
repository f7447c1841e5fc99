"""What is worth a term on held-out recordings: where few moments tell, where signals are far from zero."""

import sys
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from simulated_fleet import CUBIC, DRAG, vehicle
from test_compare import TRUE, flights, subject_of

from bench.diagnose import diagnose, discover, load
from bench.diagnose.logs.subject import Subject
from bench.diagnose.select import worthy
from bench.diagnose.select.discovery import Discovery, Found, trifle
from bench.diagnose.select.materiality import Weighing
from bench.diagnose.select.search import Search
from bench.diagnose.select.tie import spanned
from bench.diagnose.select.verify import by_chance, estimates
from bench.diagnose.select.worthy import Choice, rival_that_saves, saved
from bench.diagnose.settings import SEARCHING
from bench.diagnose.simulate.equation_error import EquationError, Saving
from bench.execution import parallel
from registry.dynamics import Effect
from registry.effects.mass import Mass
from registry.effects.mechanics.friction import CoulombFriction, OffsetForce, StribeckFriction
from registry.effects.mechanics.hysteresis import BoucWen
from registry.effects.torque import RotationalDamping, TorqueScale
from registry.physics.oscillator import Oscillator


def test_two_effects_that_act_in_few_moments_are_named(tmp_path):
    """By Student's interval the cubic stiffness saves 62 % (−15 to 138) of the held-out error, which was not sure."""
    size = 0.9794753841052475
    found, _ = diagnose(vehicle(tmp_path / "cart", "two", 1009, size))
    numbers = {e.id: e.parameters for e in found.effects}
    assert found.verdict == "named"
    assert set(numbers) == {"cubic_stiffness", "quadratic_drag"}
    for told, true in ((numbers["cubic_stiffness"]["k_3"], CUBIC), (numbers["quadratic_drag"]["c"], DRAG)):
        assert told.value == pytest.approx(size * true, rel=0.01)


def test_savings_are_told_beside_constants_as_stated_and_where_an_effect_acts():
    """Squared errors by model, of an equation that the effect acts in and of one in which only constants moved."""
    left = {"stated": (1.0, 9.0), "calibrated": (9.0, 1.0), "without": (9.0, 9.0), "full": (4.0, 4.0)}

    def saved(channels, **others):
        found = left | others
        errors = [
            EquationError(name, 0.1, "m/s", {"calibrated": 3.0, "extended": 2.0}, predictable=1.0, floor=0.1)
            for name in ("forces", "torques")
        ]
        weighing = SimpleNamespace(
            equations=[SimpleNamespace(name=e.equation, group=SimpleNamespace(at=(i,))) for i, e in enumerate(errors)],
            by_axis=lambda extended: errors,
            increments=lambda model: model,
            _at=lambda error, model: (
                np.full(40, found[model][error.equation == "torques"]) + 0.01 * np.arange(40),
                np.repeat(np.arange(8), 5),
            ),
            calibrated="calibrated",
            subject=SimpleNamespace(model="stated"),
        )
        return {s.equation: s.share for s in Weighing.savings(weighing, "without", "full", "full", channels)}

    assert saved(None)["forces"] < 0 and saved(None)["torques"] < 0  # what is stated errs less, and what is calibrated
    assert "torques" not in saved({0}) and saved({0})["forces"] < 0  # no harm where it does not act
    bent = saved({0}, stated=(9.0, 9.0), calibrated=(4.0, 9.0))  # constants that are bent without it speak for it
    assert bent["torques"] > 0 and bent["forces"] == pytest.approx(0)
    told = saved({0}, stated=(9.0, 9.0), calibrated=(9.0, 9.0))
    assert set(told) == {"forces"} and told["forces"] > 0


@pytest.mark.parametrize(
    ("roll", "channels", "paid"),
    [(7.0, {0}, False), (7.0, None, False), (3.05, None, True), (5.2, {0}, True), (5.2, {0, 1}, False)],
)
def test_what_one_axis_gains_counts_where_the_others_do_not_pay_for_it(
    roll: float, channels: set[int] | None, paid: bool
) -> None:
    """A gyroscope that is turned: unequal rotors saved 97 % about x, and cost more than that about y.

    What acts about one axis alone may cost the others a little, where constants moved. Gusts had a wind, which acts
    along all axes, that saved along z and cost more than that.
    """
    squares = {"without": {"torque x": 2.0, "torque y": 3.0}, "full": {"torque x": 0.1, "torque y": roll}}
    whole = {model: sum(of.values()) for model, of in squares.items()}
    errors = [
        EquationError("torques", 0.5, "rad/s", {"calibrated": 2.0, "extended": 1.0}, 0.5, 0.1, axis)
        for axis in ("", "torque x", "torque y")
    ]
    weighing = SimpleNamespace(
        equations=[SimpleNamespace(name="torques", group=SimpleNamespace(at=(0, 1)))],
        by_axis=lambda extended: errors,
        increments=lambda model: model,
        _at=lambda error, model: (
            np.full(40, squares[model].get(error.axis, whole[model])) + 0.01 * np.arange(40),
            np.repeat(np.arange(8), 5),
        ),
        calibrated="without",
        subject=SimpleNamespace(model="without"),
    )
    told = Weighing.savings(weighing, "without", "full", "full", channels)
    assert [s.axis for s in told] == (["", "torque x"] if paid else [""])
    assert any(s.worth for s in told) is paid


def test_no_rescue_is_missed_where_it_is_first_asked_whether_there_could_be_one() -> None:
    """Levels by model, three errors each: what `Weighing.savings` calls a rescue is one that could be."""
    random = np.random.default_rng(3)
    errors = [
        EquationError("torques", horizon, "rad/s", {"calibrated": 2.0, "extended": 1.0}, 0.5, 0.1)
        for horizon in (0.1, 0.5, 2.0)
    ]
    told = []
    for _ in range(200):
        levels = {model: np.exp(random.normal(size=3)) for model in ("stated", "calibrated", "without", "full")}
        weighing = SimpleNamespace(
            equations=[SimpleNamespace(name="torques", group=SimpleNamespace(at=(0,)))],
            by_axis=lambda extended: errors,
            increments=lambda model, levels=levels: levels[model],
            _at=lambda error, left: (left[errors.index(error)] + 0.01 * np.arange(40), np.repeat(np.arange(8), 5)),
            calibrated="calibrated",
            subject=SimpleNamespace(model="stated"),
        )
        rescued = any(s.rescues for s in Weighing.savings(weighing, "without", "full", "full"))
        told.append((rescued, Weighing.could_rescue(weighing, "without", "full")))
    assert all(could for rescued, could in told if rescued)
    assert {rescued for rescued, _ in told} == {could for _, could in told} == {True, False}


@pytest.mark.parametrize(("rare", "sure"), [(0.5, True), (-np.inf, False)])
def test_what_one_block_of_eight_saves_is_sure_by_its_course_or_not_at_all(rare: float, sure: bool) -> None:
    """See `stats.rare_gain`: a vortex ring that a flight meets once."""
    squares = {"without": np.repeat([10.0, *[1.0] * 7], 5), "full": np.ones(40)}
    error = EquationError("torques", 0.5, "rad/s", {"calibrated": 2.0, "extended": 1.0}, 1.0, 0.1)
    weighing = SimpleNamespace(
        equations=[SimpleNamespace(name="torques", group=SimpleNamespace(at=(0,)))],
        by_axis=lambda extended: [error],
        increments=lambda model: model,
        _at=lambda error, model: (squares[model], np.repeat(np.arange(8), 5)),
        _rare=lambda error, without, full: rare,
        calibrated="without",
        subject=SimpleNamespace(model="without"),
    )
    (saving,) = Weighing.savings(weighing, "without", "full", "full")
    assert saving.worth is sure and (not sure or saving.low == rare / error.scale)


@pytest.mark.parametrize(("ratio", "low", "refuted"), [(0.55, 5e-4, True), (0.9, 5e-4, False), (0.55, -1e-4, False)])
def test_a_rival_that_loses_an_equation_is_none_however_little_that_is_of_everything(
    ratio: float, low: float, refuted: bool
) -> None:
    """Beside unequal rotors a shifted centre of gravity explained 99.9 % of the torques, and left twice the error."""
    saving = Saving("torques", 0.5, 0.001, low, 0.0015, matters=True, ratio=ratio)
    weighing = SimpleNamespace(
        savings=lambda other, full, extended: [saving],
        increments=lambda model: model,
        noise_alone=lambda model: "noise",
        _at=lambda place, left: (np.full(8, 1.0 if left == "noise" else 4.0), None),
    )
    assert Weighing.refutes(weighing, "other", "full", "full") is refuted


@pytest.mark.parametrize(
    ("full", "noisy", "told"), [(0.2, True, 0.2), (-0.3, True, 0.1), (-0.3, False, -0.3)], ids=["full", "half", "worse"]
)
def test_what_lets_noise_of_the_inputs_in_is_judged_by_half_of_it_too(full: float, noisy: bool, told: float) -> None:
    """The rotors' reaction was found with the noise of their speeds taken off; forecasts have this noise, and erred."""

    def savings(less: str, model: str, extended: str, channels: object, calibrated: bool = True) -> tuple[Saving, ...]:
        assert less == "less" and calibrated
        share = {"full": full, "half": 0.1}[model]
        return (Saving("torques", 0.5, share, share - 0.02, share + 0.02, matters=True),)

    weighing = SimpleNamespace(
        savings=savings, channels_moved=lambda before, after: None, noisier=lambda less, model: noisy
    )
    chosen = SimpleNamespace(
        model="full", less=lambda place: "less", faded=lambda place: "half", relieves=lambda place: False
    )
    assert [s.share for s in saved(weighing, chosen, 0, "full")] == [told]


def test_constants_that_nobody_believes_do_not_take_an_effects_place() -> None:
    """A payload of 10 %: a mass 3 % off beside a thrust coefficient 6 % off, both stated within 2 %, does the same."""

    def savings(less: str, model: str, extended: str, channels: object, calibrated: bool = True) -> tuple[Saving, ...]:
        share = 0.0 if less == "bent" or calibrated else 0.99
        return (Saving("forces", 0.5, share, share - 0.01, share + 0.01, matters=True),)

    weighing = SimpleNamespace(
        savings=savings, channels_moved=lambda before, after: None, noisier=lambda less, model: False
    )
    for relieves in (False, True):
        chosen = SimpleNamespace(
            model="full",
            less=lambda place: "bent",
            taken_out=lambda place: "as beside it",
            faded=lambda place: "half",
            relieves=lambda place, told=relieves: told,
        )
        assert [s.worth for s in saved(weighing, chosen, 0, "full")] == [relieves]


def test_a_rival_without_which_an_equation_is_lost_takes_the_place_of_an_effect(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Asked of the effects that are kept. Rotors that wear saved 7 % about one axis, beside a torque: too little.

    A friction of Stribeck that is larger at speed than at rest, which none is, took the place of Coulomb's.
    """
    friction = {False: StribeckFriction(f_c=0.4, f_s=0.3), True: StribeckFriction(f_c=0.3, f_s=0.4)}
    monkeypatch.setattr(worthy, "rivals", lambda view, place: {n: f"{n} {place}" for n in ("alike", "better")})
    monkeypatch.setattr(worthy, "friction_that_saves", lambda *given: None)
    view = SimpleNamespace(linear=SimpleNamespace(model=SimpleNamespace(effects=("known", "dropped", "kept"))))
    for possible, could, ratio, taken in (
        (True, True, 0.5, "better 2"),
        (False, True, 0.5, None),
        (True, True, 0.94, None),
        (True, False, 0.5, None),
    ):
        chosen = SimpleNamespace(
            search=None,
            model="model",
            dropped=(1,),
            exchanged=lambda place, start, e=friction[possible]: SimpleNamespace(name=start, effects=(e,)),
        )
        weighing = SimpleNamespace(
            subject=SimpleNamespace(model=SimpleNamespace(effects=("known",))),
            could_rescue=lambda less, full, could=could: could,
            savings=lambda less, full, extended, ratio=ratio: (Saving("torques", 0.5, 0.07, 0.02, 0.1, True, ratio),),
            refutes=lambda other, full, extended: other == "model" and full.name.startswith("better"),
        )
        assert getattr(rival_that_saves(view, weighing, chosen), "name", None) == taken


@pytest.mark.parametrize(
    ("errors", "believed"),
    [((0.05, 1.07), True), ((0.6, 0.99), True), ((0.7, 0.9), False), ((0.5, 1.6), False), ((0.6, 1.4), False)],
)
def test_a_second_answer_is_believed_that_saves_an_equation_and_loses_none(
    errors: tuple[float, ...], believed: bool
) -> None:
    """Drag took forces from .066 to .005 m/s and was not believed: torques that nobody understood erred 7 % more."""

    lost = answer("effect", 1.0, 1.0, predictable=0.6)
    second = answer("effect", *errors, predictable=0.6)
    assert Discovery.clearer(second, lost) is believed


@pytest.mark.parametrize(
    ("let_go", "before", "believed"), [("torques", False, False), ("torques", True, True), ("forces", False, True)]
)
def test_a_second_answer_is_not_believed_for_a_constant_that_only_it_let_go(
    let_go: str, before: bool, believed: bool
) -> None:
    """An inertia of nine times what was stated halved what a Crazyflie's torques err, whose reaction it hid."""
    lost, second = answer("effect", 1.0, 1.0, predictable=0.6), answer("effect", 0.5, 0.5, predictable=0.6)
    second.let_go = {"inertia": let_go}  # type: ignore[misc]
    lost.let_go = second.let_go if before else {}  # type: ignore[misc]
    assert Discovery.clearer(second, lost) is believed


@pytest.mark.parametrize(
    ("short", "own_floor", "believed"), [(1.02, 0.6, True), (1.3, 0.9, True), (1.3, 0.6, False), (0.99, 0.6, True)]
)
def test_an_answer_that_saves_what_matters_is_believed_where_nothing_is_worse_but_for_the_noise_that_it_lets_in(
    short: float, own_floor: float, believed: bool
) -> None:
    """The rotors' reaction passes on noise of their speeds: over .1 s it erred more, over .5 s by a third less."""
    first, more = answer("", 1.0, 1.0), answer("effect", 0.7, short, floors=(0.6, own_floor))
    assert Discovery.clearer(more, first) is believed
    assert Discovery.clearer(more, answer("another", 1.0, 1.0)) is believed
    assert Discovery.clearer(answer("effect", 0.96, 0.9), first) and not Discovery.clearer(
        answer("e", 0.96, 0.99), first
    )
    asks = answer("", 1.0, 1.0, traces=("a signal",)), answer("", 1.0, 1.0, predictable=0.6)
    assert not any(Discovery.clearer(more, other) for other in asks)  # that is to be explained first
    constants = answer("effect", 0.7, short, floors=(0.6, own_floor), acts_on="forces")
    assert not Discovery.clearer(constants, first)  # other constants save in torques, and it acts in forces
    uneven = answer("effect", 0.7, 0.7, floors=(0.6, own_floor), one=1.6)  # an offset of one flight's attitude
    assert not Discovery.clearer(uneven, first)


@pytest.mark.parametrize(("speaks", "along", "believed"), [("z", 0.9, True), ("z", 0.97, False), ("x", 0.9, False)])
def test_an_answer_that_saves_what_matters_along_one_axis_is_believed(
    speaks: str, along: float, believed: bool
) -> None:
    """Ground effect of a nano near the ground: .90 of what z had erred, and .96 of all three axes."""
    first, more = answer("", 1.0, 1.0), answer("effect", 0.96, 0.99, axis=speaks)
    axes = [
        (replace(a.equations[0], axis="z", models={"extended": e}, by_recording=(e, e)),)
        for a, e in ((first, 1.0), (more, along))
    ]
    first.along_axes, more.along_axes = axes  # type: ignore[misc]
    assert Discovery.clearer(more, first) is believed


@pytest.mark.parametrize(("number", "believed"), [((0.95, 0.7, 1.2), False), ((0.8, 0.6, 1.0), True)])
def test_an_answer_that_knows_the_same_less_well_is_not_taken(
    number: tuple[float, float, float], believed: bool
) -> None:
    """EMPS with a speed of twice the window: viscous friction 188 (152 to 225) in place of 204 (182 to 226)."""
    first, long = answer("effect", 1.0, 1.0), answer("effect", 0.7, 0.7, number=number)
    assert Discovery.clearer(long, first) is believed


def answer(
    name: str,
    *errors: float,
    floors: tuple[float, ...] = (0.6, 0.6),
    traces: tuple[str, ...] = (),
    predictable: float = 0.8,
    one: float = 1.0,
    acts_on: str = "torques",
    number: tuple[float, float, float] = (1.0, 0.9, 1.1),
    axis: str = "",
) -> Discovery:
    """Held-out errors of a model with an effect of this name, or none; of ``one`` recording so many times as large."""
    equations = tuple(
        EquationError(
            "torques",
            0.5,
            "rad/s",
            {"calibrated": 1.0, "extended": e},
            predictable,
            0.6,
            own_floor=floor,
            by_recording=(e, e * one),
        )
        for e, floor in zip(errors, floors, strict=True)
    )
    saving = Saving(acts_on, 0.5, 0.9, 0.8, 1.0, matters=True, axis=axis)
    told = SimpleNamespace(entry=SimpleNamespace(label="k"), **dict(zip(("value", "low", "high"), number, strict=True)))
    found = (SimpleNamespace(id=name, savings=(saving,), estimates=(told,)),) if name else ()
    return SimpleNamespace(  # type: ignore[return-value]
        equations=equations, along_axes=(), found=found, confounders=(), traces=traces, let_go={}
    )


@pytest.mark.parametrize(
    ("effect", "saves", "cancels"),
    [(TorqueScale(), -0.03, True), (TorqueScale(), 0.26, False), (RotationalDamping(), -0.03, False)],
)
def test_what_scales_all_torques_must_save_given_the_moments_before_too(
    effect: Effect, saves: float, cancels: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A survey craft in turbulence that its controller cancelled had lost 40 % of its yaw torque."""
    asked: list[tuple[str, str, str]] = []

    def foretold(weighing: object, less: str, model: str, group: str) -> SimpleNamespace:
        asked.append((less, model, group))
        return SimpleNamespace(saves=saves)

    monkeypatch.setattr(worthy, "foretold", foretold)
    view = SimpleNamespace(linear=SimpleNamespace(model=SimpleNamespace(effects=(effect,))))
    chosen = SimpleNamespace(view=view, model="full", less=lambda place: "without")
    groups = {"torques": "body_rates", "forces": "velocity"}
    equations = [SimpleNamespace(name=n, group=SimpleNamespace(name=g)) for n, g in groups.items()]
    savings = [Saving(n, 0.5, s, s - 0.2, s + 0.2, matters=True) for n, s in (("torques", 0.5), ("forces", 0.0))]
    assert worthy._cancels(SimpleNamespace(equations=equations), chosen, 0, savings) is cancels
    assert asked in ([], [("without", "full", "body_rates")])


@pytest.mark.parametrize(
    ("forces", "chance"),
    [
        ((0.26, 0.53, 1.42, 0.20), True),  # 2.2 standard errors, where white noise alone would have a tenth of them
        ((1.26, 1.53, 2.42, 1.20), False),
        ((0.6, 0.6, 0.6, 0.6), False),
    ],
)
def test_what_recordings_disagree_about_is_as_sure_as_their_mean(forces: tuple[float, ...], chance: bool) -> None:
    states, pushed = flights(count=4)
    seen = states + np.random.default_rng(1).normal(size=states.shape) * [1e-4, 1e-3]
    subject = subject_of(TRUE, seen, pushed - np.array(forces)[:, None, None])
    search = Search(subject, ["offset_force"], lambda what: None)
    view = search.views(search.own(replace(TRUE, effects=(OffsetForce(0.5),))))[-1]
    fit = view.subsets.fit()
    (found,) = (x for x in estimates(view, fit) if not x.entry.constant)
    assert found.value == pytest.approx(np.mean(forces), rel=0.05) and found.low > 0
    assert by_chance(view, fit, 0) is chance


def test_what_made_good_for_an_effect_is_fitted_anew_before_the_others_are_judged_without_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """One step from where 250 of 1000 g are an effect's makes of the mass 938 g, and what it moves errs by 6 %."""
    monkeypatch.setattr(Mass, "systems", ("oscillator",))
    states, pushed = flights(count=3)
    off = replace(TRUE, mass=0.75, effects=(Mass(0.25),))
    search = Search(subject_of(replace(TRUE, mass=0.75), states, pushed, uncertainty={"mass": 0.3}), [], print)
    chosen = Choice(search, search.views(search.own(off))[-1], (0,))
    assert not chosen.model.effects
    assert chosen.model.mass == pytest.approx(1.0, rel=0.01)


def test_a_trifle_is_told_of_the_equation_in_which_it_is_sure():
    """A moment does nothing to forces, whose small errors make of chance a share that is large and unsure."""
    forces = Saving("forces", 0.5, 0.58, -1.77, 3.15, matters=True)
    torques = Saving("torques", 0.1, 0.034, 0.024, 0.044, matters=True)
    assert "3 % (2 to 4) of what can be explained in torques" in trifle("munk_moment", [forces, torques])


OVEN = """
from dataclasses import dataclass
from typing import Any

from registry.contracts import Channel
from registry.dynamics import constant, tensor
from registry.physics.state_space import StateSpace
from registry.units import Signal


@dataclass(frozen=True)
class Oven(StateSpace):
    capacity: Any = constant(100.0, "C", "J/K", low=1.0)
    state_channels = (Channel("temperature.oven", "K"),)
    input_signals = ("power",)
    signals = {"power": Signal("W", ("",))}
    alike = ()
    equation = "C dT/dt = P - 2 (T - 290)"

    def own_rate(self, state, inputs):
        return (inputs[..., :1] - 2 * (state - 290)) / tensor(self.capacity, state).unsqueeze(-1)
"""
DESCRIBED = """
name = "ovens"
rate_hz = 1
files = "*.csv"
time = "t"
input = "power"
[signals]
temperature = {columns = ["T"], unit = "K"}
power = {columns = ["P"], unit = "W"}
[physics]
capacity = 100.0
"""


def test_something_is_missing_in_temperatures_that_are_far_from_zero(tmp_path: Path) -> None:
    """Held out are recordings that are cooler and vary less: what was learnt has the same units there."""
    (tmp_path / "mine.py").write_text(OVEN)
    (tmp_path / "dataset.toml").write_text(DESCRIBED)
    random, fine = np.random.default_rng(0), 20
    for run in range(6):
        size = 1.0 if run % 3 != 1 else 0.7
        at = np.arange(400 * fine) / fine
        tones = random.uniform(0.01, 0.1, 3), random.uniform(0, 6, 3)
        power = size * (120 + 30 * sum(np.sin(w * at + p) for w, p in zip(*tones, strict=True)))
        warm = np.full(len(at), 325.0)
        for k in range(1, len(at)):
            lost = 2 * (warm[k - 1] - 290) + 0.4 * max(warm[k - 1] - 310, 0.0) ** 1.5
            warm[k] = warm[k - 1] + (power[k - 1] - lost) / 100 / fine
        table = np.column_stack([at, warm, power])[::fine]
        table[:, 1] += random.normal(0, 0.02, len(table))
        np.savetxt(tmp_path / f"run_{run}.csv", table, delimiter=",", header="t,T,P", comments="", fmt="%.6f")
    found = discover(load(tmp_path, f"{tmp_path}/mine.py:Oven"))
    assert found.verdict == "unknown_effect"
    assert all(e.predictable < 0.5 * e.models["extended"] for e in found.equations)
    assert not found.found


@pytest.mark.parametrize(
    ("effect", "verdict", "sought"),
    [(BoucWen(), "named", False), (BoucWen(), "unknown_effect", True), (CoulombFriction(), "named", True)],
)
def test_no_hidden_mode_is_sought_where_free_runs_begin_unseen(
    monkeypatch: pytest.MonkeyPatch, effect: object, verdict: str, sought: bool
) -> None:
    """A load that swings already when a log begins left 9 %, and 536 s went into modes beside it."""
    asked = {}
    diagnosing = sys.modules["bench.diagnose.diagnose"]
    monkeypatch.setattr(diagnosing, "learned", lambda *_, much, **__: asked.update(much=much))
    monkeypatch.setattr(diagnosing, "_share_left", lambda extension: 0.09)
    run = SimpleNamespace(subject=None, noise=None, tick=None, horizon_s=None, filed=None)
    extension = SimpleNamespace(model=Oscillator(effects=(effect,)), effects=())
    assert diagnosing._learned(run, SimpleNamespace(found=(), equations=()), extension, verdict) is None
    assert asked == {"much": sought}


@pytest.mark.parametrize(
    ("best", "long", "tried"), [(0.5, False, [False, True]), (1.0, False, [False]), (0.5, True, [True])]
)
def test_what_short_windows_do_not_confirm_is_sought_in_long_ones_where_signals_tell_more(
    monkeypatch: pytest.MonkeyPatch, best: float, long: bool, tried: list[bool]
) -> None:
    diagnosing, asked = sys.modules["bench.diagnose.diagnose"], []
    monkeypatch.setattr(
        diagnosing, "learned", lambda subject, *_, much, **__: asked.append((subject.long_windows, much))
    )
    monkeypatch.setattr(diagnosing, "_share_left", lambda extension: 0.5)
    subject = Subject("", Oscillator(), (), (), (), None, {}, {}, (), long_windows=long)
    run = SimpleNamespace(subject=subject, noise=None, tick=None, horizon_s=None, filed=None)
    left = EquationError("speed", 0.5, "m/s", {"calibrated": 1.0, "extended": 1.0}, best, 0.1, own_floor=0.1)
    found = SimpleNamespace(found=(), equations=(left,))
    extension = SimpleNamespace(model=Oscillator(), effects=())
    assert diagnosing._learned(run, found, extension, "unknown_effect") is None
    assert asked == [(windows, i == 0) for i, windows in enumerate(tried)]  # hidden modes only the first time


def test_what_can_do_the_same_with_more_numbers_is_no_other_explanation() -> None:
    """Four rotors that all lift too much are a scale; an offset and a scale are two things, however alike they look."""
    rotors = np.random.default_rng(5).normal(size=(4, 300)) + 3.0
    columns = np.stack([rotors.sum(0), *rotors, rotors.sum(0) + 1e-2 * rotors[0] ** 2])
    gram = columns @ columns.T
    assert spanned(gram, [0], [1, 2, 3, 4])
    assert not spanned(gram, [5], [1, 2, 3, 4]) and not spanned(gram, [0], [1, 2, 3])


def test_a_rival_is_one_in_long_windows_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a racer's centre of gravity, 4 mm off in much noise, short windows said that unequal rotors were as likely."""
    module = import_module("bench.diagnose.discover")

    def answer(rivals: tuple[str, ...], name: str = "cog_offset") -> Discovery:
        found = Found(name, SimpleNamespace(), (), 1.0, rivals)  # type: ignore[arg-type]
        left = SimpleNamespace(missed=False, lost=False, left=True, models={"extended": 1.0})
        model = SimpleNamespace()
        return Discovery(model, model, (found,), (), (), (), equations=(left,))  # type: ignore[arg-type]

    def rivals_where_long_windows_say(again: Discovery) -> tuple[str, ...]:
        searches = {False: answer(("unequal_rotors", "torque_bias")), True: again}
        few = SimpleNamespace(logs=())
        monkeypatch.setattr(
            module, "Search", lambda *given, long_windows=False, **rest: SimpleNamespace(long=long_windows, stack=few)
        )
        monkeypatch.setattr(module, "_discovered", lambda search, noise: searches[search.long])
        monkeypatch.setattr(Discovery, "clearer", lambda self, other: False)
        return module._searched(SimpleNamespace(held_out=()), None, print, None).found[0].rivals

    assert rivals_where_long_windows_say(answer(("torque_bias", "mass"))) == ("torque_bias",)
    assert rivals_where_long_windows_say(answer((), "torque_bias")) == ("unequal_rotors", "torque_bias")


def test_a_part_of_many_samples_tells_whether_another_view_of_them_is_worth_a_search(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    module = import_module("bench.diagnose.discover")
    lost = SimpleNamespace(missed=False, lost=True, left=True)
    logs = SimpleNamespace(logs=(range(SEARCHING.glance), range(1)))

    def answer(name: str, *rivals: str) -> Discovery:
        found = Found(name, SimpleNamespace(), (), 1.0, rivals)  # type: ignore[arg-type]
        return Discovery(SimpleNamespace(), SimpleNamespace(), (found,), (), (), (), equations=(lost,))  # type: ignore[arg-type]

    def searches(part: Discovery, whole: Discovery) -> tuple[Discovery, list[int | None]]:
        asked: list[int | None] = []

        def discovered(search: SimpleNamespace, noise: object) -> Discovery:
            if search.memory is None:
                return first
            asked.append(search.longest)
            return whole if search.longest is None else part

        monkeypatch.setattr(
            module,
            "Search",
            lambda *given, memory=None, long_windows=False, longest=None: SimpleNamespace(
                memory=memory, longest=longest, stack=logs
            ),
        )
        monkeypatch.setattr(module, "_discovered", discovered)
        monkeypatch.setattr(parallel, "_processors", lambda: 1)  # what copies ask is not seen here
        monkeypatch.setattr(Discovery, "clearer", lambda self, other: self is not nothing)
        return module._searched(SimpleNamespace(held_out=()), None, print, None), asked  # type: ignore[arg-type]

    first, nothing, other = (answer(name) for name in ("first", "nothing", "other"))
    parts = [SEARCHING.glance] * 2  # in short windows, and in long ones
    assert searches(part=other, whole=other) == (other, [*parts, None])
    assert searches(part=nothing, whole=other) == (first, parts)
    assert searches(part=other, whole=nothing) == (first, [*parts, None, None])
    first = answer("first", "a rival")  # ties are told apart by all samples
    assert searches(part=nothing, whole=nothing) == (first, [SEARCHING.glance, None])


@pytest.mark.parametrize("rivals", [(), ("torque_bias",)])
def test_where_inputs_are_read_anew_only_ties_are_looked_at_again(
    rivals: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    module = import_module("bench.diagnose.discover")
    lost = SimpleNamespace(missed=False, lost=True, left=True)
    found = Found("cog_offset", SimpleNamespace(), (), 1.0, rivals)  # type: ignore[arg-type]
    before = Discovery(SimpleNamespace(), SimpleNamespace(), (found,), (), (), (), equations=(lost,), memory=3)  # type: ignore[arg-type]
    asked: list[tuple[object, ...]] = []

    def search(*given: object, **how: object) -> SimpleNamespace:
        asked.append(tuple(how.items()))
        return SimpleNamespace(stack=SimpleNamespace(logs=()))

    monkeypatch.setattr(module, "Search", search)
    monkeypatch.setattr(module, "_discovered", lambda search, noise: before)
    monkeypatch.setattr(Discovery, "clearer", lambda self, other: False)
    module._searched(SimpleNamespace(held_out=()), None, print, None, before=before)  # type: ignore[arg-type]
    as_there, long = (("memory", 3), ("long_windows", False)), (("memory", 0), ("long_windows", True))
    assert asked == [as_there, *[long] * len(rivals)]
