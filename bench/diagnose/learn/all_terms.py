"""All that can be learned of what a model leaves: waves, hidden modes, and functions of measured signals."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import torch

from bench.diagnose.learn.learn import E, learn, refitted, worthy
from bench.diagnose.learn.modes.modes import modes
from bench.diagnose.learn.waves import periodic, waves
from bench.diagnose.logs.noise import Noise
from bench.diagnose.logs.subject import Subject
from bench.diagnose.select.materiality import Weighing
from bench.diagnose.select.search import Search
from bench.diagnose.select.timing.reading import prepared
from bench.diagnose.settings import MATTERING
from registry.dynamics import Effect, PhysicsModel
from registry.effects.waves.hidden_mode import HiddenMode
from registry.effects.waves.periodic_term import PeriodicTerm


def learn_all_terms(
    subject: Subject,
    model: PhysicsModel,
    noise: Noise | None = None,
    tick: Callable[[str], None] = lambda what: None,
    doubtful: bool = False,
    much: bool = True,
    little: bool = False,
) -> tuple[Effect, ...]:
    """The terms that ``model`` lacks: waves, functions of signals and, where these leave much, hidden modes.

    What answers a wave would be taken for its cause: waves come first. What follows signals in a way that was not seen
    before they were learned may look like one: it must be there beside them too. A hidden mode has states that nobody
    measured; it is sought where measured signals do not say as much, and kept where it leaves less.

    Args:
        subject: measurements.
        model: with the effects it has, its constants calibrated.
        noise: default `noise.noise_of`.
        tick: called with what is being done.
        doubtful: see `learn`.
        much: whether so much is left that it may be a hidden mode.
        little: whether so little is left that only waves, which stand out of noise as nothing else does, are sought.
    """
    subject, noise = prepared(subject, noise, tick)
    tick("what swings")
    found = _waves(subject, model, noise, tick)
    if little and not found:
        return ()
    terms = _beside(found, _waves, subject, model, noise, tick=tick, doubtful=doubtful)
    if not much or not subject.held_out:
        return terms
    left = left_by(subject, model, noise, terms, tick)
    if left.most < MATTERING.share:
        return terms
    tick("hidden modes")
    swinging = _swinging(subject, model, noise, tick, found)
    if not any(isinstance(t, HiddenMode) for t in swinging):
        return terms
    beside = _beside(swinging, _swinging, subject, model, noise, tick=tick, doubtful=doubtful)
    if not any(isinstance(t, HiddenMode) for t in beside):
        return terms
    # Of an equation in which a mode does nothing it leaves all.
    return beside if left_by(subject, model, noise, beside, tick).whole < left.whole else terms


def _beside(
    found: tuple[Effect, ...],
    swinging: Callable[..., tuple[Effect, ...]],
    subject: Subject,
    model: PhysicsModel,
    noise: Noise,
    *,
    tick: Callable[[str], None],
    doubtful: bool,
) -> tuple[Effect, ...]:
    """What swings, as ``swinging`` has ``found`` it, and functions of signals beside it."""
    terms = learn(subject, _with(model, *found), noise, tick, doubtful=doubtful)
    if not (found and terms):
        return (*found, *terms)
    again = swinging(subject, _with(model, *terms), noise, tick)
    if len(again) < len(found):
        terms = learn(subject, _with(model, *again), noise, tick, doubtful=doubtful)
    return (*again, *terms)


@dataclass(frozen=True)
class Left:
    """What terms leave of the held-out squared error above the noise, of equations in which it matters."""

    most: float
    """The largest share, over equations."""
    whole: float
    """Share of all of them together, each in units of its noise."""


def left_by(
    subject: Subject, model: PhysicsModel, noise: Noise, terms: Sequence[Effect], tick: Callable[[str], None]
) -> Left:
    """What terms leave beside ``model``; nothing where nothing matters."""
    with torch.no_grad():
        full = refitted(Search(subject, (), tick, noise), _with(model, *terms)) if terms else model
        errors = Weighing(subject, noise, model).errors(full)
    matters = MATTERING.near**2 - 1
    pairs = [[(e.models[n] / max(e.floor, 1e-300)) ** 2 - 1 for n in ("calibrated", "extended")] for e in errors]
    above = [(was, now) for was, now in pairs if was > matters]
    whole = sum(now for _, now in above) / max(sum(was for was, _ in above), 1e-300)
    return Left(max((now / was for was, now in above), default=0.0), whole)


def _swinging(
    subject: Subject,
    model: PhysicsModel,
    noise: Noise,
    tick: Callable[[str], None],
    found: tuple[PeriodicTerm, ...] | None = None,
) -> tuple[PeriodicTerm | HiddenMode, ...]:
    """The waves and the hidden modes that ``model`` lacks; what rings for long may look like a wave without a mode.

    ``found`` are its waves where they are known.
    """
    found = _waves(subject, model, noise, tick) if found is None else found
    driven = _modes(subject, _with(model, *found), noise, tick)
    if not driven and found:
        driven = _modes(subject, model, noise, tick)
        beside = _waves(subject, _with(model, *driven), noise, tick) if driven else found
        return (*beside, *driven) if len(beside) < len(found) else found
    return (*(_waves(subject, _with(model, *driven), noise, tick) if found else ()), *driven)


def _modes(subject: Subject, model: PhysicsModel, noise: Noise, tick: Callable[[str], None]) -> tuple[HiddenMode, ...]:
    """The hidden modes that ``model`` lacks and that save enough on held-out recordings."""
    return _worthy(subject, model, noise, tick, modes(subject, model, noise))


def _waves(
    subject: Subject, model: PhysicsModel, noise: Noise, tick: Callable[[str], None]
) -> tuple[PeriodicTerm, ...]:
    """The waves that ``model`` lacks and that save enough on held-out recordings."""
    return _worthy(subject, model, noise, tick, [periodic(line) for line in waves(subject, model, noise)])


def _worthy(
    subject: Subject, model: PhysicsModel, noise: Noise, tick: Callable[[str], None], found: Sequence[E]
) -> tuple[E, ...]:
    """Those of ``found`` that save enough on held-out recordings."""
    if not found:
        return ()
    with torch.no_grad():
        return worthy(subject, noise, Search(subject, (), tick, noise), model, found, doubtful=False)


def _with(model: PhysicsModel, *effects: Effect) -> PhysicsModel:
    return replace(model, effects=(*model.effects, *effects))
