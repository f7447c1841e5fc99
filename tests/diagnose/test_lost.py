"""Free runs that lose the attitude may not take back what the weak form is sure of."""

from dataclasses import replace

import numpy as np
import pytest
from test_compare import TRUE, flights, subject_of

from bench.diagnose.fit import against, fit_parameters, lost
from bench.diagnose.regression.parameters import Entry
from bench.diagnose.select.verify import Estimate
from bench.diagnose.simulate.multiple_shooting import Shot, multiple_shooting
from registry.core import EFFECTS

LIFT = Entry(0, "lift", None, "kg", 0.2, 0.1, -10.0, 10.0, neutral=0.0)
DRAG = Entry(0, "drag", None, "kg/s", 0.2, 0.1, 0.0, 10.0, neutral=0.0)
MASS = Entry(-1, "mass", None, "kg", 1.0, 0.03, 0.9, 1.1, stated=1.0)


@pytest.mark.parametrize(
    ("entry", "interval", "after", "gone"),
    [
        (DRAG, (0.18, 0.22), 0.0, True),
        (DRAG, (0.18, 0.22), 0.03, False),  # less of it is no contradiction
        (DRAG, (0.00, 0.22), 0.0, False),  # the weak form was not sure
        (MASS, (0.99, 1.01), 0.0, False),  # a constant has no value that makes it nothing
    ],
)
def test_shooting_loses_a_sure_number_where_it_leaves_no_effect(
    entry: Entry, interval: tuple[float, float], after: float, gone: bool
) -> None:
    sure = Estimate(entry, entry.value, *interval)
    shot = Shot(None, 1.0, 0.5, (replace(entry, value=after),), np.eye(1))  # type: ignore[arg-type]
    assert lost([sure], shot) is gone
    untouched = Shot(None, 1.0, 0.5, (), np.zeros((0, 0)))  # type: ignore[arg-type]
    assert not lost([sure], untouched)


@pytest.mark.parametrize(
    ("entry", "value", "half", "interval"),
    [
        (MASS, 1.09, 0.05, (1.04, 1.14)),  # calibration stops at 1.1, what is known of the mass does not
        (MASS, 1.0, 2.0, (0.0, 3.0)),
        (replace(MASS, low=-1.0), 0.0, 2.0, (-2.0, 2.0)),
        (DRAG, 0.1, 0.2, (0.0, 0.3)),  # less than no drag there is not
    ],
)
def test_an_interval_ends_where_a_number_cannot_be_and_not_where_calibration_stops(
    entry: Entry, value: float, half: float, interval: tuple[float, float]
) -> None:
    assert entry.interval(value, half) == pytest.approx(interval)


@pytest.mark.parametrize(
    ("interval", "after", "turned"),
    [((0.18, 0.22), -0.3, True), ((0.18, 0.22), 0.9, False), ((-0.1, 0.5), -0.3, False)],
)
def test_free_runs_may_not_turn_the_sign_of_a_sure_number(
    interval: tuple[float, float], after: float, turned: bool
) -> None:
    sure = Estimate(LIFT, LIFT.value, *interval)
    shot = Shot(None, 1.0, 0.5, (replace(LIFT, value=after),), np.eye(1))  # type: ignore[arg-type]
    assert against([sure], shot) == ({(0, "lift")} if turned else set())
    held = Shot(None, 1.0, 0.5, (), np.zeros((0, 0)))  # type: ignore[arg-type]
    assert not against([sure], held)


def test_a_number_whose_sign_free_runs_turn_stays_and_the_others_are_fitted_around_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    states, force = flights(count=4, samples=800)
    states = states + np.random.default_rng(0).normal(size=states.shape) * 1e-5  # without noise no interval is one
    subject = subject_of(replace(TRUE, stiffness=90.0), states, force, uncertainty={"stiffness": 0.1})
    model = replace(subject.model, effects=(EFFECTS.get("offset_force")(0.0),))
    asked = []

    def turning(model, subject, names, tick, held=()):  # type: ignore[no-untyped-def]
        asked.append(set(held))
        shot = multiple_shooting(model, subject, names, tick, held)
        free = tuple(replace(e, value=-e.value) if e.owner == 0 else e for e in shot.free)
        return replace(shot, free=free)

    monkeypatch.setitem(fit_parameters.__globals__, "multiple_shooting", turning)
    subject = replace(subject, logs=tuple(replace(log, inputs=log.inputs - 5.0) for log in subject.logs))
    fitted, numbers = fit_parameters(subject, model)
    assert asked == [set(), {(0, "f_0")}]
    assert fitted.effects[0].f_0 == pytest.approx(5.0, rel=0.02)  # type: ignore[attr-defined]
    assert fitted.stiffness == pytest.approx(100, rel=0.01)  # type: ignore[attr-defined]
    told = {x.entry.label: x for x in numbers}
    assert told["f_0"].low <= 5.0 <= told["f_0"].high
