"""Effects that free runs ask for and no equation does by itself.

Under feedback an equation that is judged at measured states says little of what brings these states back: a controller
answers every disturbance that nobody measured, and the damping beside it hides in what the inputs cancel. A free run
lives on it. Such effects make better forecasts and are no finding: the air and the controller look the same in them.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from bench.diagnose.logs.subject import Subject
from bench.diagnose.regression.parameters import entries
from bench.diagnose.select.catalogue import admissible
from bench.diagnose.select.verify import Estimate
from bench.diagnose.settings import EXTENDING, FORECASTING
from bench.diagnose.simulate.multiple_shooting import Shot, multiple_shooting, relative_error
from bench.diagnose.simulate.unmeasured import hidden
from registry.dynamics import Effect, PhysicsModel


def forecasting(
    subject: Subject,
    model: PhysicsModel,
    catalogue: Sequence[str] | None = None,
    tick: Callable[[str], None] = lambda what: None,
) -> tuple[PhysicsModel, tuple[Estimate, ...]]:
    """A model with the effects of the catalogue without which its free runs err far more; all its own numbers stay.

    Only recordings that are learnt from choose and fit; what is fitted to one half of them must help the other half.

    Args:
        subject: measurements, read when the inputs act.
        model: with the effects that were found.
        catalogue: ids of the effects to choose from; None: all.
        tick: called with what is being done.

    Returns:
        The model with such effects behind its own, and their numbers; ``model`` itself where there are none, where a
        state was not measured, and where there are no two recordings to learn from.
    """
    found: tuple[Estimate, ...] = ()
    if hidden(subject.logs) or len(subject.training) < 2:
        return model, found
    for _ in range(FORECASTING.most):
        shots = []
        for name, kind in admissible(subject, model, catalogue):
            tick(name)
            shots.append(_fitted(subject, model, kind.neutral_for(model, {}), subject.training))
        best = min(shots, key=lambda s: s.after, default=None)
        if best is None or best.after >= FORECASTING.gain:
            break
        halves = subject.training[::2], subject.training[1::2]
        parts = [_fitted(subject, model, best.model.effects[-1], names) for names in halves]
        if any(relative_error(model, s.model, subject, n) >= 1 for s, n in zip(parts, halves[::-1], strict=True)):
            break
        found += tuple(_estimates(best, parts))
        model = best.model
    return model, found


def _fitted(subject: Subject, model: PhysicsModel, effect: Effect, names: Sequence[str]) -> Shot:
    """A model with one effect more, whose numbers alone are fitted to free runs of some recordings."""
    grown = replace(model, effects=(*model.effects, effect))
    numbers = entries(grown, subject.uncertainty, subject.model)
    held = {(e.owner, e.label) for e in numbers if e.owner != len(model.effects)}
    return multiple_shooting(grown, subject, names, held=held)


def _estimates(whole: Shot, parts: Sequence[Shot]) -> list[Estimate]:
    """Numbers with 95 % intervals, not narrower than what halves of the recordings differ by."""
    half = EXTENDING.interval * np.sqrt(np.maximum(np.diag(whole.covariance), 0.0))
    apart = [[abs(p.value - e.value) for p, e in zip(s.free, whole.free, strict=True)] for s in parts]
    widths: list[float] = np.max(np.array([half, *apart]), axis=0).tolist()
    return [Estimate(e, e.value, *e.interval(e.value, w)) for e, w in zip(whole.free, widths, strict=True)]
