"""From a linearised model to the next one: what stays and what is exchanged are compared alike."""

from types import SimpleNamespace

import pytest

from bench.diagnose.select import step
from bench.diagnose.select.step import Step, next_step
from registry.effects.actuation import InputDelay, MotorLag

FLOOR = 1000.0


@pytest.mark.parametrize(("settles_at", "taken"), [(1080.0, "lag"), (1200.0, "delay")])
def test_what_stays_is_fitted_as_well_as_what_is_exchanged(
    monkeypatch: pytest.MonkeyPatch, settles_at: float, taken: str
) -> None:
    """One step of the present effects goes too far. The rival is fitted until it moves no more, and so are they."""
    here, changed = SimpleNamespace(loss=1080.0), SimpleNamespace(loss=1084.0)
    first = {id(here): Step("lag, one step", 1122.0, False), id(changed): Step("delay", 1101.0, True)}  # type: ignore[arg-type]
    end = {"lag, one step": ("lag", settles_at), "delay": ("delay", 1101.0)}
    losses = dict(end.values())
    monkeypatch.setattr(step, "advanced", lambda search, view, fit: first[id(fit)])
    monkeypatch.setattr(step, "neighbours", lambda view, known: [changed])
    monkeypatch.setattr(step, "settled", lambda search, model, view: (view, end[model][0]))
    linear = SimpleNamespace(model=SimpleNamespace(effects=()))
    view = SimpleNamespace(subsets=SimpleNamespace(fit=lambda: here), floor=FLOOR, linear=linear)
    search = SimpleNamespace(loss=lambda view, model: losses[model], stack=SimpleNamespace(dt=0.01))
    assert next_step(search, view, 0).model == taken  # type: ignore[arg-type, comparison-overlap]


def test_a_delay_gives_way_to_a_lag_that_leaves_less_though_no_linearisation_promises_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """They act one after the other: what the one leaves beside the other tells nothing of an exchange."""
    here, other = SimpleNamespace(loss=1400.0, parameters=1), SimpleNamespace(loss=5000.0, parameters=2)
    steps = {id(here): Step("delay", 1400.0, False), id(other): Step("lag, far off", 3000.0, True)}  # type: ignore[arg-type]
    losses = {"delay": 1400.0, "lag": 1050.0}
    monkeypatch.setattr(step, "advanced", lambda search, view, fit: steps[id(fit)])
    monkeypatch.setattr(step, "neighbours", lambda view, known: [])
    monkeypatch.setattr(step, "settled", lambda search, model, view: (view, "lag"))
    start = SimpleNamespace(id="motor_lag", effect=MotorLag(), through=None)
    subsets = SimpleNamespace(fit=lambda starts=(), drop=(): other if starts else here, starts=[start], penalty=7.0)
    linear = SimpleNamespace(model=SimpleNamespace(effects=(InputDelay(),)))
    view = SimpleNamespace(subsets=subsets, floor=FLOOR, linear=linear)
    search = SimpleNamespace(loss=lambda view, model: losses[model], stack=SimpleNamespace(dt=0.01))
    assert next_step(search, view, 0).model == "lag"  # type: ignore[arg-type, comparison-overlap]
    assert next_step(search, view, 1).model == "delay"  # type: ignore[arg-type, comparison-overlap]


def test_an_exchange_that_was_taken_back_is_not_made_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """A drag came with a wind, which went, and then the drag went: from where they came another way is taken."""
    bare, both = SimpleNamespace(effects=(InputDelay(),)), SimpleNamespace(effects=(InputDelay(), MotorLag()))
    here, more = SimpleNamespace(loss=5000.0), SimpleNamespace(loss=2000.0, dropped=(), ids=("motor_lag",))
    steps = {id(here): Step(bare, 5000.0, False), id(more): Step(both, 2000.0, True)}  # type: ignore[arg-type]
    monkeypatch.setattr(step, "advanced", lambda search, view, fit: steps[id(fit)])
    monkeypatch.setattr(step, "neighbours", lambda view, known: [more])
    monkeypatch.setattr(step, "without", lambda model, dropped: model)
    linear = SimpleNamespace(model=bare)
    view = SimpleNamespace(subsets=SimpleNamespace(fit=lambda: here, starts=()), floor=FLOOR, linear=linear)
    search = SimpleNamespace(stack=SimpleNamespace(dt=0.01))
    assert next_step(search, view, 0, [both]).model is both  # type: ignore[arg-type, list-item]
    assert next_step(search, view, 0, [bare, both]).model is bare  # type: ignore[arg-type, list-item]
