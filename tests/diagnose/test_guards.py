"""What keeps noise from being named, and an effect from being dropped for a constant that imitates it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from test_compare import DT, TRUE, flights, subject_of

from bench.diagnose.regression import test_functions
from bench.diagnose.regression.generic import Term
from bench.diagnose.regression.least_squares import Normal
from bench.diagnose.regression.linearise import Candidate, Linearization
from bench.diagnose.regression.parameters import Entry
from bench.diagnose.regression.weak import mean_rates, midpoint_rates
from bench.diagnose.select import verify
from bench.diagnose.select.choose import accepted, choose, select_across_views
from bench.diagnose.select.discovery import needs_first, supported, trifle
from bench.diagnose.select.search import Search, View
from bench.diagnose.select.step import advanced
from bench.diagnose.select.subset import Subsets, _acting, t_value
from bench.diagnose.select.tie import rivals
from bench.diagnose.select.worthy import worth_naming
from bench.diagnose.settings import CHOOSING
from registry.core import EFFECTS
from registry.effects.actuation import LONGEST_DELAY
from registry.effects.air import LinearDrag
from registry.effects.mass import CogOffset
from registry.effects.torque import TorqueBias
from registry.physics.quadrotor import Quadrotor
from tests.diagnose.machines_of_any_size import cart

BLOCKS, ROWS = 40, 1000


def view_of(residual: np.ndarray, **effects: np.ndarray) -> View:
    """Four recordings (blocks, rows) of a residual, with one column an effect."""
    constant = np.random.default_rng(1).normal(size=residual.shape)
    rows = np.stack([constant, *effects.values(), residual], axis=-1)
    entry = Entry(0, "k", None, "1", 0.0, 1.0, -np.inf, np.inf)
    mass = Entry(-1, "mass", None, "kg", 1.0, 0.01, 0.97, 1.03, stated=1.0)
    starts = tuple(
        Candidate(name, None, (entry,), (i + 1,), (-np.inf,), (np.inf,))  # type: ignore[arg-type]
        for i, name in enumerate(effects)
    )
    nothing = np.empty(0)
    model = SimpleNamespace(effects=())
    linear = Linearization(model, None, (mass,), starts, nothing, nothing, (0,), (), (), ())  # type: ignore[arg-type]
    channel = np.arange(rows.shape[-1]), rows.reshape(-1, rows.shape[-1]).T
    normal = Normal((channel,), rows.shape[-1], np.arange(BLOCKS) // 10, np.full(BLOCKS, ROWS))
    return View(linear, (), Subsets(linear, normal), (), (), {}, frozenset(), ())


@pytest.mark.parametrize("drag", [0.0, 20.0])
def test_what_is_small_beside_another_equation_may_be_much_in_its_own(drag: float) -> None:
    """Two rates are damped by 1.2 and .7, in some blocks more than in others; one number for both leaves a tenth."""
    rng = np.random.default_rng(3)
    x, noise = rng.normal(size=(2, 3, BLOCKS, ROWS))
    x[1:] *= np.exp(0.7 * rng.normal(size=(BLOCKS, 1)))
    still, y = np.zeros_like(x[0]), np.array([drag, 1.2, 0.7])[:, None, None] * x + noise
    columns = [[x[0], still, still, still], [still, x[1], x[1], still], [still, x[2], still, x[2]]]
    view = view_of(y[0], drag=x[0], alike=x[0], d_p=x[0])
    entry = view.linear.starts[0].entries[0]
    of = {"drag": (1,), "alike": (2,), "damping": (3, 4)}
    starts = tuple(
        Candidate(n, None, (entry,) * len(c), c, (-np.inf,) * len(c), (np.inf,) * len(c))  # type: ignore[arg-type]
        for n, c in of.items()
    )
    linear = replace(view.linear, starts=starts, channels=(0, 1, 2))
    channels = tuple(
        (np.arange(6), np.stack([still, *own, left]).reshape(6, -1)) for own, left in zip(columns, y, strict=True)
    )
    normal = Normal(channels, 6, np.arange(BLOCKS) // 10, np.full(BLOCKS, ROWS))
    chosen, _ = choose(replace(view, linear=linear, subsets=Subsets(linear, normal)))
    assert set(chosen.ids) == ({"drag", "damping"} if drag else {"damping"})


@pytest.mark.parametrize(("gain", "recordings", "asked"), [(0.006, 4, True), (0.006, 3, False), (0.03, 4, True)])
def test_forecasts_are_asked_of_what_noise_dwarfs_if_every_recording_confirms_it(
    gain: float, recordings: int, asked: bool
) -> None:
    """A slow effect beside fast noise is little of it, and may be most of what a forecast of half a second errs."""
    x, noise = np.random.default_rng(0).normal(size=(2, BLOCKS, ROWS))
    acts = np.arange(BLOCKS)[:, None] // 10 < recordings
    view = view_of((gain * 4 / recordings) ** 0.5 * x * acts + noise, drag=x)
    smaller, larger = view.subsets.fit(), view.subsets.fit(view.subsets.starts)
    assert smaller.misfit - larger.misfit > 10 * view.subsets.penalty  # 0.6 % of 40 000 rows is significant
    assert accepted(view, smaller, larger) is asked


@pytest.mark.parametrize(("gain", "dropped"), [(0.006, (0,)), (0.03, ())])
def test_what_noise_dwarfs_is_not_named_where_no_forecast_can_be_asked(gain: float, dropped: tuple[int, ...]) -> None:
    x, noise = np.random.default_rng(0).normal(size=(2, BLOCKS, ROWS))
    bare = view_of(noise, drag=x, none=-(gain**0.5) * x)
    k = replace(bare.linear.starts[0].entries[0], owner=0, value=gain**0.5)
    model = SimpleNamespace(effects=(LinearDrag(),))
    linear = replace(
        bare.linear,
        model=model,
        own=(*bare.linear.own, k),
        starts=(),
        removals=(2,),
        dependants=(frozenset(),),
        reduced=({},),
    )
    view = replace(bare, linear=linear, subsets=Subsets(linear, bare.subsets.normal))
    search = SimpleNamespace(subject=SimpleNamespace(model=SimpleNamespace(effects=())))
    assert worth_naming(search, view, None)[0].dropped == dropped  # type: ignore[arg-type]


def test_an_effect_of_few_manoeuvres_is_sure_though_it_passes_on_noise_of_its_input() -> None:
    """Ten blocks of two recordings are manoeuvres of all sizes; in the thirty others it only adds measured noise."""
    rng = np.random.default_rng(0)
    moving = (np.arange(BLOCKS) // 10 % 3 > 0) & (np.arange(BLOCKS) % 2 > 0)
    size = np.where(moving, 10 ** rng.uniform(-0.5, 1, BLOCKS), 0.01)[:, None]
    x, noise, left = rng.normal(size=(3, BLOCKS, ROWS))
    view = view_of(size * x + left, drag=size * x + 0.3 * noise)
    smaller, larger = view.subsets.fit(), view.subsets.fit(view.subsets.starts)
    saved = (view.subsets.losses(smaller) - view.subsets.losses(larger)).sum(1)
    assert t_value(saved) < CHOOSING.sure and (saved[~moving] < 0).all()
    assert accepted(view, smaller, larger)
    still = view_of(left, drag=size * x + 0.3 * noise)
    assert not accepted(still, still.subsets.fit(), still.subsets.fit(still.subsets.starts))


def test_noise_of_the_inputs_is_no_noise_where_less_than_nothing_would_be_left() -> None:
    """Restless inputs look noisy and move the system: taken off, that makes a set of effects look perfect."""
    drag, other, noise = np.random.default_rng(0).normal(size=(3, BLOCKS, ROWS))
    plain = view_of(30 * drag + noise, drag=drag, other=other)
    false = np.zeros((1, 4, 4))
    false[0, 2, 2], false[0, 2, 3], false[0, 3, 2], false[0, 3, 3] = 0.2, -4.0, -4.0, 4.0
    less = replace(plain, subsets=Subsets(plain.linear, plain.subsets.normal.less(false)))
    assert less.subsets.fit().misfit > 0 and choose(less)[0].misfit < -less.floor
    view, fit, _ = select_across_views([less, plain])
    assert view is plain and fit.ids == ("drag",)
    assert select_across_views([plain])[1].ids == ("drag",)


@pytest.mark.parametrize(("size", "drops"), [(1.0, 0), (1.3, 20)])
def test_chance_of_a_draw_does_not_decide_whether_noise_of_the_inputs_is_taken_off(size: float, drops: int) -> None:
    """An effect passes on noise of its input, nine times what was left without it, and is exact but for that."""
    dropped = 0
    for seed in range(20):
        x, noise, drawn, left = np.random.default_rng(seed).normal(size=(4, BLOCKS, ROWS))
        view = view_of(10 * x + 0.1 * left, drag=x + 0.3 * noise)
        power = size * (0.3 * drawn.reshape(4, -1)) ** 2
        unit = np.diag([0.0, 1.0, 0.0])
        normal = view.subsets.normal.less(power.mean() * unit[None], [p.sum() * unit for p in power])
        less = replace(view, subsets=Subsets(view.linear, normal))
        dropped += less.overcorrected(less.subsets.fit(less.subsets.starts))
    assert dropped == drops


def test_an_effect_that_shows_only_beside_two_others_is_found() -> None:
    """Load explains nothing alone, and beside mass less than the many that resemble drag."""
    mass, drag, own, noise, *others = np.random.default_rng(0).normal(size=(24, BLOCKS, ROWS))
    load = own - mass - drag
    residual = 30 * mass + 30 * drag + 20 * load + noise
    like_drag = {f"rival_{i}": drag + 0.1 * x for i, x in enumerate(others)}
    view = view_of(residual, added_mass=mass, drag=drag, load=load, **like_drag)
    fit, fields = choose(view)
    assert not any("load" in f.ids for field in fields[1:3] for f in field)
    assert set(fit.ids) == {"added_mass", "drag", "load"}


def test_a_constant_of_which_a_recording_says_little_does_not_make_a_trace() -> None:
    """Left free, a fit to the first three recordings runs away with the constant, and any term that tames it gains."""
    rng = np.random.default_rng(0)
    constant, term, residual = rng.normal(size=(3, 4, ROWS))
    constant[:3] *= 1e-3
    term[:3] = constant[:3]
    rows = np.stack([constant, np.zeros_like(constant), term, residual], axis=-1)  # what takes an effect away: none
    grams = tuple(np.einsum("ri,rj->ij", x, x) for x in rows)
    said = Term("speed", "v", "force x")
    view = view_of(residual[:1].repeat(BLOCKS, 0), drag=residual[:1].repeat(BLOCKS, 0))
    linear = replace(view.linear, columns=np.empty((2, 0)))
    view = replace(
        view, linear=linear, dictionary=(said,), products=SimpleNamespace(made=lambda: grams), reach=(frozenset({0}),)
    )
    assert verify.left_over(view)[1] < 0.01 * view.floor


def test_a_number_of_an_effect_of_which_recordings_say_nothing_does_not_make_a_trace() -> None:
    """Noise that was taken off leaves little of what three recordings say of it; no prior holds it, and it ran away."""
    rng = np.random.default_rng(0)
    effect, residual = rng.normal(size=(2, 4, ROWS))
    effect[:3] *= 0.01
    residual[:3] += 20 * effect[:3]  # a chance of three standard errors
    term = np.concatenate([effect[:3], rng.normal(size=(1, ROWS))])
    rows = np.stack([effect, np.zeros_like(effect), term, residual], axis=-1)
    grams = np.einsum("fri,frj->fij", rows, rows)
    grams[np.ix_(range(3), (0, 2), (0, 2))] *= 0.1
    own = (Entry(0, "k", None, "1", 0.0, 1.0, -np.inf, np.inf),)
    model, nothing = SimpleNamespace(effects=(CogOffset(),)), np.empty(0)
    linear = Linearization(model, None, own, (), nothing, np.empty((2, 0)), (), (1,), (frozenset(),), ({},))  # type: ignore[arg-type]
    normal = Normal(((np.arange(4), rows.reshape(-1, 4).T),), 4, np.arange(BLOCKS) // 10, np.full(BLOCKS, ROWS // 10))
    view = view_of(residual[:1].repeat(BLOCKS, 0), drag=residual[:1].repeat(BLOCKS, 0))
    products = SimpleNamespace(made=lambda: tuple(grams))
    said = Term("speed", "v", "force x")
    view = replace(view, linear=linear, subsets=Subsets(linear, normal), dictionary=(said,), products=products)
    view = replace(view, reach=(frozenset({0}),))
    assert verify.left_over(view)[1] < 0.01 * view.floor


@pytest.mark.parametrize(("moves", "lets_in", "acts"), [(1.0, 0.1, True), (0.0, 0.1, False), (1.0, 2.0, False)])
def test_what_moves_the_vehicle_is_no_noise_of_the_inputs(moves: float, lets_in: float, acts: bool) -> None:
    """A controller with a noisy sensor makes inputs as lively as noise; what they do, no noise of them could explain.

    Unless the model's own numbers let so much noise of them in that it could.
    """
    x, left = np.random.default_rng(0).normal(size=(2, BLOCKS, ROWS))
    view = view_of(moves * x + left, drag=x)
    noise = np.zeros((1, 3, 3))
    noise[0, 1, 1], noise[0, 2, 2] = 0.8 * x.size, lets_in * x.size
    assert _acting(view.subsets, {1}, noise, np.ones((1, 3))) == ({1} if acts else set())


def test_noise_that_buries_a_constant_is_not_followed_in_its_place() -> None:
    """A regression takes such a constant far too small: it gives way, and is no trace of something missing."""
    rng = np.random.default_rng(0)
    constant, noise = rng.normal(size=(2, 4, ROWS))
    residual = noise - 0.3 * constant  # 30 of the constant's stated 1σ
    rows = np.stack([constant, np.zeros_like(constant), constant + 0.1 * rng.normal(size=(4, ROWS)), residual], axis=-1)
    grams = tuple(np.einsum("ri,rj->ij", x, x) for x in rows)
    view = view_of(residual[:1].repeat(BLOCKS, 0), drag=residual[:1].repeat(BLOCKS, 0))
    linear = replace(view.linear, columns=np.empty((2, 0)))
    said = Term("input", "u", "force x")
    view = replace(
        view, linear=linear, dictionary=(said,), products=SimpleNamespace(made=lambda: grams), reach=(frozenset({0}),)
    )
    normal = Normal(((np.arange(4), rows.reshape(-1, 4).T),), 4, np.arange(BLOCKS) // 10, np.full(BLOCKS, ROWS // 10))
    view = replace(view, subsets=Subsets(linear, normal))
    assert [t.signal for t in verify.left_over(view)[0]] == ["input"]
    buried = Subsets(linear, normal, {0})
    assert verify.left_over(replace(view, subsets=buried))[1] < 1e-3 * view.floor


@pytest.mark.parametrize(
    ("others", "where", "cleared", "named"),
    [(0.0, 0, True, True), (1e5, 0, True, True), (1e5, 0, False, False), (1e5, 1, False, True)],
)
def test_an_effect_is_relevant_that_clears_what_is_left_or_acts_where_others_explain_little(
    others: float, where: int, cleared: bool, named: bool
) -> None:
    x, other, noise = np.random.default_rng(0).normal(size=(3, BLOCKS, ROWS))
    rest = 0.0 if cleared else 3.0  # times the noise, which the effect does not explain
    view = replace(view_of(2**0.5 * x + rest**0.5 * other + noise, drag=x), explained={where: others * BLOCKS * ROWS})
    assert accepted(view, view.subsets.fit(), view.subsets.fit(view.subsets.starts)) is named


def test_nothing_is_cleared_where_more_was_taken_off_than_there_was_of_noise() -> None:
    x, noise = np.random.default_rng(0).normal(size=(2, BLOCKS, ROWS))
    view = replace(view_of(2**0.5 * x + noise, drag=x), explained={0: 1e5 * BLOCKS * ROWS})
    view.subsets.normal = view.subsets.normal.less(np.diag([0.0, 0.0, 4.0])[None])
    assert not accepted(view, view.subsets.fit(), view.subsets.fit(view.subsets.starts))


def test_a_coefficient_that_the_data_say_nothing_of_has_no_narrow_interval() -> None:
    """With more noise taken off its column than there is of it, a variance would be negative."""
    x, noise = np.random.default_rng(0).normal(size=(2, BLOCKS, ROWS))
    view = view_of(x + noise, drag=x)
    own = (*view.linear.own, Entry(0, "k", None, "1", 0.5, 1.0, -2.0, 2.0))
    linear = replace(view.linear, own=own, starts=())
    for taken_off, width in ((0.0, 0.02), (2.0, 4.0)):
        normal = view.subsets.normal.less(np.diag([0.0, taken_off, 0.0])[None])
        free = replace(view, linear=linear, subsets=Subsets(linear, normal))
        k = verify.estimates(free, free.subsets.fit())[1]
        assert k.high - k.low == pytest.approx(width, rel=0.2)


def test_what_is_linearised_at_a_value_is_believed_to_the_next_one_that_is_tried() -> None:
    states, force = flights(count=3, samples=500)
    search = Search(subject_of(TRUE, states, force), ["input_delay"], lambda what: None)
    starts = search.look(search.subject.model, broad=False).linear.starts
    tried = [0.0, *EFFECTS.get("input_delay").screen["delay"], LONGEST_DELAY]
    assert len(starts) == len(tried) - 2
    for before, start, after in zip(tried, starts, tried[2:], strict=False):
        ends = [start.effects_at(b)[0].delay for b in (start.low, start.high)]  # type: ignore[attr-defined]
        assert ends == pytest.approx([before, after])


def test_the_noise_of_a_delayed_input_is_accounted_for() -> None:
    """The mean of two delayed inputs has less noise than one, which must not be taken for a better model."""
    states, force = flights(count=3, samples=500)
    drawn = np.random.default_rng(2).normal(0, 0.1 * force.std(), force.shape)
    search = Search(subject_of(TRUE, states, force + drawn), ["input_delay"], lambda what: None)
    look = search.look(search.subject.model, broad=False)
    assert look.moved is not None and search.noisy is not None
    for start in look.linear.starts:
        delayed = replace(search.subject.model, effects=(start.effect,))
        expected = midpoint_rates(delayed, search.noisy) - midpoint_rates(search.subject.model, search.noisy)
        added = look.moved.columns[start.columns[0]]
        assert added == pytest.approx(expected.numpy()[..., list(look.linear.channels)], abs=1e-9)


@pytest.mark.parametrize(("share", "buried"), [(0.02, False), (1.5, False), (6.0, True)])
def test_a_constant_whose_column_is_noise_of_the_inputs_is_free_and_its_channel_doubtful(
    share: float, buried: bool
) -> None:
    states, force = flights(count=3, samples=2000)
    seen = states + np.random.default_rng(1).normal(size=states.shape) * [1e-4, 1e-3]
    drawn = np.random.default_rng(2).normal(0, share * force.std(), force.shape)
    subject = subject_of(TRUE, seen, force + drawn)
    search = Search(subject, [], lambda what: None)
    view = search.views(search.look(subject.model, broad=False))[0]
    assert bool(view.doubtful) is buried
    constants = [e.constant for e in view.linear.own]
    assert any(p == 0 for p, c in zip(view.subsets.prior, constants, strict=True) if c) is buried
    mass = next(x for x in verify.estimates(view, view.subsets.fit()) if x.entry.label == "mass")
    assert buried or 0.96 < mass.low < 1.0 < mass.high < 1.04


@pytest.mark.parametrize("acts", [False, True])
def test_what_jitters_in_the_inputs_is_no_noise_where_the_system_answers_it(acts: bool) -> None:
    """White noise on a measured force is taken off; a force that jitters itself is not."""
    states, force = flights(count=3, samples=2000)
    force = force + np.random.default_rng(2).normal(0, 0.3 * force.std(), force.shape)
    if acts:
        states = TRUE.simulate(torch.from_numpy(states[:, 0]), torch.from_numpy(force), DT).numpy()
    subject = subject_of(TRUE, states + np.random.default_rng(1).normal(size=states.shape) * [1e-4, 1e-3], force)
    search = Search(subject, [], lambda what: None)
    assert len(search.views(search.look(subject.model, broad=False))) == (1 if acts else 2)


@pytest.mark.parametrize("spread", [0.7, 0.02])
def test_an_uncertain_constant_does_not_stand_in_for_an_effect_that_is_taken_away(spread: float) -> None:
    """The column of the mass holds the friction; without the friction it must not."""
    states, force = flights(count=3, samples=2000)
    seen = states + np.random.default_rng(1).normal(size=states.shape) * [1e-4, 1e-3]
    subject = subject_of(
        replace(TRUE, damping=0.0), seen, 0.3 * force, uncertainty={"mass": spread, "stiffness": spread}
    )
    friction = EFFECTS.get("viscous_friction")(0.5)
    search = Search(subject, [], lambda what: None)
    misfits = []
    for model in (replace(subject.model, effects=(friction,)), subject.model):
        linear = search.look(model, broad=False).linear
        at_middle = midpoint_rates(model, search.stack).numpy()[..., list(linear.channels)]  # as its columns are
        rows = replace(linear, rates=at_middle).project(
            test_functions.TestFunctions.over(
                search.stack.logs, search.stride, [search.smoothing_of(subject.model.state_channels[1])]
            )
        )
        normal = rows.normal()
        misfits.append(Subsets(linear, normal).fit(drop=range(len(model.effects))).misfit)
    assert misfits[0] == pytest.approx(misfits[1], rel=1e-6)


def test_a_widely_uncertain_constant_acts_on_the_delayed_input_where_a_delay_is_tried() -> None:
    states, force = flights(count=3, samples=500)
    subject = subject_of(TRUE, states, force, uncertainty={"mass": 0.7, "stiffness": 0.1})
    linear = Search(subject, ["input_delay"], lambda what: None).look(subject.model, broad=False).linear
    mass = next(i for i, e in enumerate(linear.own) if e.name == "mass")
    others = [i for i in range(len(linear.own)) if i != mass]
    for start in linear.starts:
        now = linear.changed(range(len(linear.own)), (), [start])
        assert [now[i] for i in others] == others
        lighter, heavier = (
            mean_rates(replace(subject.model, mass=1.0 + step, effects=(start.effect,)), linear.stack).numpy()
            for step in (-1e-4, 1e-4)
        )
        expected = (heavier - lighter)[..., list(linear.channels)] / 2e-4
        assert linear.columns[now[mass]] == pytest.approx(expected, rel=1e-2, abs=1e-2 * np.abs(expected).max())


@pytest.mark.parametrize(
    ("imitates", "third", "left", "named"),
    [
        (
            True,
            900.0,
            (50.0, 50.0),
            [2],
        ),  # what the first one gained is not understood, and the second gains too little
        (True, 90.0, (50.0, 50.0), []),
        (False, 90.0, (50.0, 50.0), [0, 1, 2]),
        (False, 90.0, (300.0, 50.0), [0]),  # what is missing in one channel may act in the other
        (False, 60.0, (140.0, 50.0), [0, 1, 2]),  # a trace that is nothing missing is no rival in another channel
        (False, 60.0, (10.0, 130.0), [0, 1]),
    ],
)
def test_a_small_part_of_something_unknown_is_not_named(
    imitates: bool, third: float, left: tuple[float, float], named: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first two effects act in one channel, the third in another; noise leaves 1000, 150 is something missing."""
    saved = {0: [1000.0, 0.0], 1: [100.0, 0.0], 2: [0.0, third]}
    losses = {(): np.zeros((1, 2))} | {(i,): np.array([gain]) for i, gain in saved.items()}
    view = SimpleNamespace(
        subsets=SimpleNamespace(fit=lambda drop=(): tuple(drop), losses=losses.__getitem__),
        floor=1000.0,
        reach=(frozenset({0}), frozenset({1})),
        linear=SimpleNamespace(columns=range(3), channels=(0, 1)),
    )
    traces = [verify.ResidualTerm("", "", "", gain / 1000, 3 + i) for i, gain in enumerate(left)]
    monkeypatch.setattr(verify, "needed", lambda view, place, traces, dropped: place != 0 or not imitates)
    kept = [0, 1, 2]
    while (gone := verify.least_imitation(view, kept, traces)) is not None:  # type: ignore[arg-type]
        assert gone == min(set(kept) - set(named), key=lambda i: sum(saved[i]))
        kept.remove(gone)
    assert kept == named


@pytest.mark.parametrize("drowned_too", [False, True])
def test_a_constant_that_is_free_with_an_effect_is_known_as_stated_without_it(drowned_too: bool) -> None:
    """Columns: the constant (noise), the effect taken away, the constant without it, which can undo just that."""
    rng = np.random.default_rng(4)
    effect = rng.normal(5.0, 1.0, 4000)
    rows = np.stack([rng.normal(size=4000), -effect, effect, rng.normal(size=4000)])
    inertia = Entry(-1, "inertia", None, "kg m^2", 1.0, 0.01, 0.97, 1.03, stated=1.0)
    nothing = np.empty(0)
    linear = Linearization(None, None, (inertia,), (), nothing, nothing, (), (1,), (frozenset(),), ({0: 2},))  # type: ignore[arg-type]
    normal = Normal(((np.arange(4), rows),), 4, np.repeat(np.arange(4), 10), np.full(40, 100))
    dropped = Subsets(linear, normal, {0, 2} if drowned_too else {0}).fit(drop=[0])
    stands_in = dropped.misfit < 1.1 * 4000
    assert stands_in == drowned_too and (abs(dropped.beta[0]) < 0.05) != drowned_too


def test_what_noise_buries_decides_no_exchange_of_effects() -> None:
    """An effect and its rival do the same. With the effect the constant's column is noise, which the residual shares.

    Free beside the effect and known beside the rival, the constant would explain that noise for the effect alone.
    """
    rng = np.random.default_rng(4)
    noise, effect = rng.normal(size=4000), np.full(4000, 5.0)
    noise -= noise.mean()
    left = rng.normal(size=4000) + 0.5 * noise
    rows = np.stack([noise, -effect, noise + effect, effect, left - left.mean()])
    inertia = Entry(-1, "inertia", None, "kg m^2", 1.0, 0.01, 0.97, 1.03, stated=1.0)
    rival = Candidate("rival", TorqueBias(), (), (3,), (-9.0,), (9.0,))
    nothing = np.empty(0)
    model = SimpleNamespace(effects=(CogOffset(),))
    linear = Linearization(model, None, (inertia,), (rival,), nothing, nothing, (), (1,), (frozenset(),), ({0: 2},))  # type: ignore[arg-type]
    normal = Normal(((np.arange(5), rows),), 5, np.repeat(np.arange(4), 10), np.full(40, 100))
    free = Subsets(linear, normal, {0})
    apart = [s.fit([rival], drop=[0]).loss - free.fit().loss for s in (free, free.holding(free.fit()))]
    assert apart[0] > 500 and abs(apart[1]) < 1
    view = SimpleNamespace(subsets=free, linear=linear, floor=4000.0)
    assert list(rivals(view, 0)) == ["rival"]  # type: ignore[arg-type]


def test_a_rival_is_as_large_as_those_of_its_parameters_that_differ_from_no_effect() -> None:
    """A torque of three axes does what an offset of two does; its third axis does nothing, and makes it no larger."""
    rng = np.random.default_rng(4)
    x, y, z = rng.normal(size=(3, 4000))
    offset = 5 * x + 5 * y
    rows = np.stack([x, y, -offset, x, y, z, rng.normal(size=4000)])
    own = tuple(Entry(0, name, None, "m", 5.0, 1.0, -99.0, 99.0) for name in "xy")
    axes = tuple(Entry(1, f"t_{name}", None, "N m", 0.0, 1.0, -99.0, 99.0) for name in "xyz")
    torque = Candidate("torque_bias", TorqueBias(), axes, (3, 4, 5), (-99.0,) * 3, (99.0,) * 3)
    model = SimpleNamespace(effects=(CogOffset(x=5.0, y=5.0),))
    nothing = np.empty(0)
    linear = Linearization(model, None, own, (torque,), nothing, nothing, (), (2,), (frozenset(),), ({},))  # type: ignore[arg-type]
    normal = Normal(((np.arange(7), rows),), 7, np.repeat(np.arange(4), 10), np.full(40, 100))
    view = SimpleNamespace(subsets=Subsets(linear, normal), linear=linear, floor=4000.0)
    assert list(rivals(view, 0)) == ["torque_bias"]  # type: ignore[arg-type]


@pytest.mark.parametrize(("alike", "tie"), [(0.8, False), (0.99999, True)])
def test_a_rival_that_is_worse_in_every_block_is_none_though_few_blocks_tell_most(alike: float, tie: bool) -> None:
    """A wrong thrust scale left twice what a mass did, in every block; by Student's t the blocks did not agree."""
    rng = np.random.default_rng(6)
    size = np.repeat(np.exp(2.0 * rng.normal(size=40)), 100)
    x, other, noise = rng.normal(size=(3, 4000))
    x, other = size * x, size * (alike * x + (1 - alike**2) ** 0.5 * other)
    rows = np.stack([x, -5 * x, other, noise])
    own = (Entry(0, "delta", None, "kg", 5.0, 1.0, -99.0, 99.0),)
    scale = (Entry(1, "eps", None, "1", 0.0, 1.0, -99.0, 99.0),)
    rival = Candidate("rival", TorqueBias(), scale, (2,), (-99.0,), (99.0,))
    model, nothing = SimpleNamespace(effects=(CogOffset(),)), np.empty(0)
    linear = Linearization(model, None, own, (rival,), nothing, nothing, (), (1,), (frozenset(),), ({},))  # type: ignore[arg-type]
    subsets = Subsets(linear, Normal(((np.arange(4), rows),), 4, np.repeat(np.arange(4), 10), np.full(40, 100)))
    worse = (subsets.losses(subsets.fit([rival], drop=[0])) - subsets.losses(subsets.fit())).sum(1)
    assert t_value(worse) < CHOOSING.distinct and (tie or worse.sum() > 500)
    view = SimpleNamespace(subsets=subsets, linear=linear, floor=100.0)
    assert list(rivals(view, 0)) == (["rival"] if tie else [])  # type: ignore[arg-type]


def test_an_effect_that_is_taken_away_is_no_free_coefficient() -> None:
    """What two rotors lift more is known as well as without the common factor that they replace, which is their sum."""
    rng = np.random.default_rng(4)
    one, two = rng.normal(size=(2, 4000))
    rows = np.stack([one + two, -0.1 * (one + two), one, two, rng.normal(size=4000)])
    own = (Entry(0, "eps", None, "1", 0.1, 0.1, -0.5, 0.5),)
    each = tuple(Entry(1, f"eps_{i}", None, "1", 0.0, 0.1, -0.5, 0.5) for i in (1, 2))
    rotors = Candidate("unequal_rotors", TorqueBias(), each, (2, 3), (-0.5,) * 2, (0.5,) * 2)
    model, nothing = SimpleNamespace(effects=(CogOffset(),)), np.empty(0)
    linear = Linearization(model, None, own, (rotors,), nothing, nothing, (), (1,), (frozenset(),), ({},))  # type: ignore[arg-type]
    subsets = Subsets(linear, Normal(((np.arange(5), rows),), 5, np.repeat(np.arange(4), 10), np.full(40, 100)))
    fit = subsets.fit([rotors], drop=[0])
    spread = np.sqrt(np.diag(subsets.covariance(fit)))
    assert spread[[0, 3]] == pytest.approx(0.0)
    assert spread[[1, 2]] == pytest.approx(np.sqrt(np.diag(np.linalg.inv(rows[2:4] @ rows[2:4].T))), rel=0.3)


def test_what_acts_in_nothing_that_was_held_out_is_told_without_a_figure() -> None:
    """A motor saturates in the recordings learnt from, and those held out are too gentle for that."""
    assert "nothing held out confirms it" in trifle("saturation", ())


def test_what_needs_an_effect_goes_with_it() -> None:
    """A drag was given up as an imitation, and the wind that acts through it was left: no model is made of that."""
    assert supported(["wind", "motor_lag"], Quadrotor(drive="rotor_command")) == ["motor_lag"]
    assert supported(["wind", "rotor_drag"], Quadrotor()) == ["wind", "rotor_drag"]
    assert supported(["wind"], Quadrotor(effects=(LinearDrag(d_x=0.1),))) == ["wind"]


def test_what_needs_an_effect_comes_after_it() -> None:
    """The effect that saves most comes first, but no model has wind before it has a drag that the wind acts through."""
    names = ["wind", "motor_lag", "suspended_load", "linear_drag", "rotor_drag"]
    found = needs_first([SimpleNamespace(id=name) for name in names])  # type: ignore[misc]
    assert [f.id for f in found] == ["motor_lag", "suspended_load", "linear_drag", "rotor_drag", "wind"]
    assert [f.id for f in needs_first([SimpleNamespace(id="wind")])] == ["wind"]  # type: ignore[misc]


def test_a_step_that_no_share_of_which_is_stable_is_not_made(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a mass that MuJoCo stops hard no step had finite rates, and a search without a channel ended in an error."""
    search = Search(cart(lambda u: u), ("cubic_stiffness",), lambda what: None)
    (view, *_) = search.views(search.look(search.subject.model))
    fit = view.subsets.fit([view.linear.starts[0]])
    stable = Search.loss
    monkeypatch.setattr(Search, "loss", lambda s, v, m: np.inf if m.effects else stable(s, v, m))
    step = advanced(search, view, fit)
    assert step.model.effects == () and np.isfinite(step.loss) and not step.exchanged
