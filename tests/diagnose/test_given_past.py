"""Inputs that cancel what disturbs a system seem to do nothing; beside a slow disturbance they do not."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter
from test_compare import DT, subject_of
from test_problems import flights, made

from bench.diagnose.by_equation import GivenPast, ObscuredConstant
from bench.diagnose.logs.noise import noise_of
from bench.diagnose.logs.subject import Subject
from bench.diagnose.select.closed_loop import given_past
from bench.diagnose.select.closed_loop.given_past import memory, revealed
from bench.diagnose.select.materiality import Weighing
from bench.diagnose.select.search import Search
from bench.diagnose.select.verify import estimates
from registry.dynamics import PhysicsModel
from registry.effects.actuation import InputDelay
from registry.effects.air import ParasiticDrag, Wind
from registry.physics.oscillator import Oscillator

STATED = Oscillator(mass=1.0, damping=0.05, stiffness=0.01)


def held_in_place(
    count: int = 8, samples: int = 3000, wind: float = 8.0, shaken: float = 1.5
) -> tuple[np.ndarray, np.ndarray]:
    """States (R, N, 2) and forces (R, N, 1) of a mass that a controller holds against a force that nobody measured.

    The force wanders over seconds; the controller knows it .15 s late, and shakes the mass a little beside.
    """
    rng = np.random.default_rng(0)
    fine, h = 10, DT / 10
    kicks = rng.normal(0, np.sqrt(2 * h / 4.0), (count, samples * fine))
    pushed = wind * lfilter([1.0], [1.0, -np.exp(-h / 4.0)], kicks)
    late = lfilter([h / 0.15], [1.0, h / 0.15 - 1.0], pushed)
    shakes = np.repeat(rng.normal(0, shaken, (count, samples // 10)), 10 * fine, axis=1)
    states, force = np.zeros((count, samples, 2)), np.zeros((count, samples, 1))
    x, v, u = np.zeros(count), np.zeros(count), np.zeros(count)
    for k in range(samples * fine):
        if k % fine == 0:
            states[:, k // fine] = np.column_stack([x, v])
            u = shakes[:, k] - late[:, k] - 4.0 * x - 3.0 * v
            force[:, k // fine, 0] = u
        v = v + h * (u + pushed[:, k] - STATED.damping * v - STATED.stiffness * x)
        x = x + h * v
    return states, force


def of(states: np.ndarray, force: np.ndarray) -> Subject:
    seen = states + np.random.default_rng(1).normal(size=states.shape) * [1e-5, 1e-4]
    known = {"mass": 0.3, "damping": 0.01, "stiffness": 0.01}
    whole = subject_of(replace(STATED, input_hold="previous"), seen, force, uncertainty=known)
    return replace(whole, training=whole.training[:5], held_out=whole.held_out[5:], finer={"speed": "laser=true"})


def told_of(subject: Subject, mass: float, judged: bool = True, memory: int = 8) -> tuple[ObscuredConstant, ...]:
    """What is told where a fit has let the mass go there."""
    search = Search(subject, [], lambda what: None, memory=memory)
    other = replace(subject.model, mass=mass)
    assert search.let_go("mass")
    view = search.views(search.own(other))[-1]
    stays = replace(view.subsets.fit(), beta=np.zeros(len(view.linear.own)))
    weighing = Weighing(search.subject, noise_of(subject), other) if judged else None
    return revealed(search, view, stays, other, subject, weighing)


@pytest.mark.parametrize(("shaken", "off"), [(1.5, 0.25), (4.0, 0.05)])
def test_a_mass_that_a_controller_hides_is_told_given_the_past(shaken: float, off: float) -> None:
    """The better, the more the mass is shaken against the 8 N that nobody measured; its prior alone says 30 %."""
    (found,) = told_of(of(*held_in_place(shaken=shaken)), 20.0)
    assert (found.constant, found.group, found.finer) == ("mass", "speed", "laser=true")
    assert found.times == pytest.approx(20.0) and found.repeats > 0.5
    assert found.told is not None and found.told.low > 0
    value, unit = found.told.numbers["mass"]
    assert value == pytest.approx(1.0, abs=off) and unit == "kg"


def test_a_hidden_constant_is_told_where_all_rows_counted_alike() -> None:
    (found,) = told_of(of(*held_in_place(shaken=4.0)), 20.0, memory=0)
    assert found.constant == "mass" and found.times == pytest.approx(20.0)


def test_a_hidden_inertia_is_told_beside_forces_where_all_rows_counted_alike() -> None:
    """Rows of torques are told by the one before; those of forces, which have no past, count as many."""
    subject = made(flights(4, drag=0.06))
    search = Search(subject, [], lambda what: None, memory=0)
    model = replace(subject.model, effects=(ParasiticDrag(0.06, 0.06, 0.06),))
    view = search.views(search.own(model))[-1]
    _, last = given_past.given_past(search, view, model, subject, {"inertia"}, "body_rates")
    assert len(last.linear.channels) == 6
    assert [len(f) for f in last.filters] == [2] * len(last.linear.channels)
    numbers = {x.entry.label: x for x in estimates(last, last.subsets.fit())}
    assert numbers["inertia[0]"].low < subject.model.inertia[0] < numbers["inertia[0]"].high


def test_nothing_is_told_given_the_past_without_recordings_that_confirm_it() -> None:
    (found,) = told_of(of(*held_in_place()), 20.0, judged=False)
    assert found.told is None and found.repeats > 0.5


def test_a_constant_within_an_order_of_magnitude_is_told_as_it_is() -> None:
    assert told_of(of(*held_in_place()), 8.0) == ()


def test_what_is_not_slow_hides_nothing() -> None:
    states, force = held_in_place(wind=0.0)
    (found,) = told_of(of(states, force), 20.0)
    assert found.repeats == 0.0 and found.told is None


def test_what_an_input_effect_is_worth_is_asked_beside_a_wind_that_needs_its_drag(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A model without the drag and with the wind cannot be; real flights in a fan's wind had ended there."""
    subject = made(flights(4, drag=0.06, wind=(4.0, -2.0)))
    model = replace(subject.model, effects=(ParasiticDrag(0.06, 0.06, 0.06), Wind(4.0, -2.0), InputDelay(0.02)))
    search = Search(replace(subject, model=model), [], lambda what: None)
    view = search.views(search.own(model))[-1]
    asked: list[tuple[str, ...]] = []

    def foretold(weighing: object, less: PhysicsModel, more: PhysicsModel, group: str) -> GivenPast:
        asked.append(tuple(type(e).__name__ for e in less.effects))
        return GivenPast({}, 0.5, 0.4, 0.6, 0.1)

    monkeypatch.setattr(given_past, "foretold", foretold)
    given_past._told(None, view, model, model, "body_rates")  # type: ignore[arg-type]
    assert asked[1:] == [("ParasiticDrag", "Wind")]


def test_the_memory_of_an_autoregression_is_the_closed_form() -> None:
    past = 0.9
    repeats, rise = memory(np.array([1.0, -past]) / 3.0)
    assert repeats == pytest.approx(past**2)  # variance 1 / (1 − a²) of an innovation of one
    assert rise == pytest.approx((1 - past**2) / (1 - past) ** 2)  # density at rest 1 / (1 − a)²
