"""Effects that free runs ask for and no equation does by itself.

Under feedback an equation that is judged at measured states says little of what brings these states back: a controller
answers every disturbance that nobody measured, and the damping beside it hides in what the inputs cancel. A free run
lives on it. Such effects make better forecasts and are no finding: the air and the controller look the same in them.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

from bench.diagnose.logs.subject import Subject
from bench.diagnose.regression.parameters import entries
from bench.diagnose.select.catalogue import admissible
from bench.diagnose.settings import FORECASTING
from bench.diagnose.simulate.multiple_shooting import multiple_shooting, relative_error
from bench.diagnose.simulate.unmeasured import hidden
from registry.dynamics import Effect, PhysicsModel


def forecasting(
    subject: Subject,
    model: PhysicsModel,
    catalogue: Sequence[str] | None = None,
    tick: Callable[[str], None] = lambda what: None,
) -> PhysicsModel:
    """A model with the effects of the catalogue without which its free runs err far more, all numbers fitted.

    Only recordings that are learnt from choose and fit; each half of them must confirm what the other one asks for.

    Args:
        subject: measurements, read when the inputs act.
        model: with the effects that were found.
        catalogue: ids of the effects to choose from; None: all.
        tick: called with what is being done.

    Returns:
        The model with them behind its own effects; ``model`` itself where there are none, where a state was not
        measured, and where there are no two recordings to learn from.
    """
    if hidden(subject.logs) or len(subject.training) < 2:
        return model
    base = multiple_shooting(model, subject, subject.training, tick).model
    for _ in range(FORECASTING.most):
        grown = _best(subject, base, catalogue, tick)
        if grown is None or not _repeated(subject, base, grown, tick):
            break
        model = base = grown
    return model


def helps(subject: Subject, model: PhysicsModel, grown: PhysicsModel, names: Sequence[str] = ()) -> bool:
    """Whether free runs of ``grown`` err far less than those of ``model``, on ``names`` or on what is learnt from."""
    return relative_error(model, grown, subject, names or subject.training) < FORECASTING.gain


def _best(
    subject: Subject, model: PhysicsModel, catalogue: Sequence[str] | None, tick: Callable[[str], None]
) -> PhysicsModel | None:
    """The model with the one effect more that helps its free runs most; None: none helps by enough.

    Every effect is fitted beside the numbers as they are, the best one then together with them.
    """
    tried: list[tuple[float, Effect]] = []
    for name, kind in admissible(subject, model, catalogue):
        tick(name)
        grown = _with(model, kind.neutral_for(model, {}))
        others = {
            (e.owner, e.label)
            for e in entries(grown, subject.uncertainty, subject.model)
            if e.owner != len(model.effects)
        }
        shot = multiple_shooting(grown, subject, subject.training, held=others)
        tried.append((shot.after, shot.model.effects[-1]))
    if not tried:
        return None
    _, effect = min(tried, key=lambda t: t[0])
    shot = multiple_shooting(_with(model, effect), subject, subject.training, tick)
    return shot.model if helps(subject, model, shot.model) else None


def _repeated(subject: Subject, model: PhysicsModel, grown: PhysicsModel, tick: Callable[[str], None]) -> bool:
    """Whether the last effect, fitted on either half of the recordings, helps the free runs of the other half."""
    halves = subject.training[::2], subject.training[1::2]
    for fitted, judged in (halves, halves[::-1]):
        own, more = (multiple_shooting(m, subject, fitted, tick).model for m in (model, grown))
        if not helps(subject, own, more, judged):
            return False
    return True


def _with(model: PhysicsModel, effect: Effect) -> PhysicsModel:
    return replace(model, effects=(*model.effects, effect))
