"""Effects that hide behind one another: behind a constant that was let go."""

from dataclasses import replace
from importlib import import_module
from types import SimpleNamespace

import pytest
from test_one_heading import LEAN_IN_WIND, flight
from test_problems import INERTIA, flights, made

from bench.diagnose import discover, extend

module = import_module("bench.diagnose.discover")

WIND, DRAG, MUNK = (4.0, -2.0), 0.06, 0.006
CATALOGUE = ["parasitic_drag", "linear_drag", "wind", "munk_moment", "rotor_reaction_torque", "rotational_damping"]


def test_what_a_wind_does_to_torques_is_found_once_the_wind_is() -> None:
    """Before it is, only a huge inertia makes these torques small, and no step leads back from there."""
    subject = made(flights(5, drag=DRAG, wind=WIND, munk=MUNK))
    found = discover(replace(subject, uncertainty={"inertia": 0.3}), CATALOGUE)
    numbers = {e.entry.name: e.value for f in found.found for e in f.estimates}
    assert {f.id for f in found.found} == {"parasitic_drag", "wind", "munk_moment"}
    assert (numbers["w_x"], numbers["w_y"]) == (pytest.approx(WIND[0], rel=0.05), pytest.approx(WIND[1], rel=0.05))
    assert (numbers["m_x"], numbers["m_y"]) == (pytest.approx(MUNK, rel=0.1), pytest.approx(MUNK, rel=0.1))
    assert not any("let go" in n for n in found.notes)


@pytest.mark.slow
def test_effects_asked_for_together_end_where_they_are_found() -> None:
    """Beside an inertia as wrongly stated, and one after the other, a step had ended at .93 m/s where this has .09."""
    subject = made([flight(500 + i, 10.0, linear=0.2) for i in range(4)], inertia=(INERTIA / 8).tolist())
    found, told = discover(subject), extend(subject, subject.model, ["linear_drag", "wind"])
    assert {f.id for f in found.found} == {"linear_drag", "wind"}
    ours = {name: p for e in told.effects for name, p in e.parameters.items()}
    for e in (e for f in found.found for e in f.estimates):
        assert e.low <= ours[e.entry.name].value <= e.high
    assert ours["w_x"].value == pytest.approx(10 + LEAN_IN_WIND, rel=0.02)
    assert told.model.inertia == pytest.approx(INERTIA, rel=0.05)
    assert all(error.rmse < 1.1 * told.comparison.error("floor")[group].rmse for group, error in told.last.items())
    assert any("The stated inertia" in note and "let go" in note for note in told.notes)


def test_effects_are_judged_once_numbers_move_no_more_beside_a_constant_that_was_let_go(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """On `nanobench` a motor lag of 60 ms seemed to be one of 2 ms in the step with which the inertia went.

    Effects are exchanged until the last time allowed: the view of that one is asked for what is left. Each step knows
    the models before it.
    """
    judged, wrong = [], ["inertia"]

    class Looked(SimpleNamespace):
        subsets, whole = SimpleNamespace(fit=lambda: None), True

        def light(self) -> "Looked":
            return Looked(linear=self.linear, whole=False)

    def looked(search: object, model: str, *rest: object) -> Looked:
        return Looked(linear=SimpleNamespace(model=model))

    def next_step(search: object, view: Looked, known: int, past: list[str]) -> SimpleNamespace:
        assert past == judged
        judged.append(view.linear.model)
        return SimpleNamespace(loss=1.0, exchanged=True, model="exchanged")

    search = SimpleNamespace(
        subject=SimpleNamespace(model=SimpleNamespace(effects=())),
        tick=lambda what: None,
        let_go=lambda name: name is not None,
        as_known=lambda view: view,
    )
    monkeypatch.setattr(module, "_viewed", looked)
    monkeypatch.setattr(module, "contradicted", lambda view, fit: wrong.pop() if wrong else None)
    monkeypatch.setattr(module, "settled", lambda search, model, view: (view, f"{model}, settled"))
    monkeypatch.setattr(module, "next_step", next_step)
    last = module._one_by_one(search, looked(None, ""), "drag and lag", set(), 0.0)
    assert judged[:2] == ["drag and lag, settled, settled", "exchanged, settled"]
    assert last.whole


@pytest.mark.parametrize(("again", "taken"), [({"inertia", "gain"}, "first"), ({"inertia"}, "again"), (set(), "again")])
def test_what_begins_again_counts_where_it_lets_no_more_constants_go(
    monkeypatch: pytest.MonkeyPatch, again: set[str], taken: str
) -> None:
    """Beside the stated inertia a delay was chosen, the inertia let go all the same, and lag and sag dropped."""
    stated = made(flights(1, count=2, seconds=1.0))
    free = replace(stated, uncertainty={"inertia": 3.0})
    effects = (SimpleNamespace(),)
    view = SimpleNamespace(linear=SimpleNamespace(model=SimpleNamespace(effects=effects)), light=lambda: None)
    search, other = SimpleNamespace(subject=free), SimpleNamespace(subject=stated)
    search.of = lambda subject: other

    def exchanged(search: SimpleNamespace, *rest: object) -> SimpleNamespace:
        search.subject = replace(stated, uncertainty=dict.fromkeys(again, 3.0)) if again else stated
        return view

    monkeypatch.setattr(module, "_first", lambda search, model: (view, None, []))
    monkeypatch.setattr(module, "_exchanged", exchanged)
    monkeypatch.setattr(module, "replace", lambda model, effects: model)
    assert module._begun_again(search, stated, view)[0] is (search if taken == "first" else other)
