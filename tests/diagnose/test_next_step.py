"""From a linearised model to the next one: what stays and what is exchanged are compared alike."""

from types import SimpleNamespace

import pytest

from bench.diagnose.select import step
from bench.diagnose.select.step import Step, next_step

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
