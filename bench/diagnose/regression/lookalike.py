"""What a learned term is most like: the nearest effect of the catalogue, or what has such a shape in other systems."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bench.diagnose.regression.linearise import Candidate, Linearization
from bench.diagnose.settings import TELLING
from registry.dynamics import PhysicsModel
from registry.effects.learned_term import LearnedTerm
from registry.terms import signals

_PLACE, _PACE, _DRIVE, _TIME = "place", "pace", "drive", "time"
_UNITS = {"m": _PLACE, "rad": _PLACE, "m/s": _PACE, "rad/s": _PACE, "s": _TIME}
_KNOWN = {
    _PLACE: {
        "linear": "a spring",
        "affine": "a spring that is pressed",
        "cubic": "a spring that hardens or softens",
        "linear_cubic": "a spring that hardens or softens",
        "above": "a wall or an end stop",
        "below": "a wall or an end stop",
        "dead_zone": "play, or stops at both ends",
        "sine": "cogging, or another force that repeats along the way",
        "wave": "cogging, or another force that repeats along the way",
        "inverse": "a field or an air cushion that fades with distance",
        "inverse_square": "a field or an air cushion that fades with distance",
        "exponential": "a field or an air cushion that fades with distance",
    },
    _PACE: {
        "linear": "viscous friction or slow drag",
        "sign": "dry friction",
        "sign_linear": "dry and viscous friction",
        "saturation": "dry friction with a soft beginning",
        "signed_square": "drag at high speed",
        "linear_signed_square": "viscous friction and drag at high speed",
        "square": "a force that is the same in both directions, such as a loss of lift",
        "above": "a resistance one way only",
        "below": "a resistance one way only",
    },
    _DRIVE: {
        "linear": "a drive that is stronger or weaker than stated",
        "constant": "an offset of the drive",
        "saturation": "a drive at its limit",
        "dead_zone": "a drive with a dead zone",
        "sign": "a drive with a dead zone or dry friction",
        "square": "a drive that is not linear",
        "signed_square": "a drive that is not linear",
        "cubic": "a drive that is not linear",
    },
    _TIME: {"linear": "a drift", "affine": "a drift", "exponential": "something that warms up or settles"},
}


@dataclass(frozen=True)
class Likeness:
    """What a term is like."""

    effects: tuple[str, ...]
    """Ids of the effects of the catalogue that come nearest to it."""
    share: float
    """Of the squared rates that the term makes of the recordings, what the first of them would make too, 0 to 1."""


def nearest(linear: Linearization, place: int) -> Likeness | None:
    """The candidates that tell most of what the effect in a place of the model does; None: none tells much.

    Rates of all groups of channels on which the term acts count alike, over all recordings that ``linear`` is of.
    """
    gone = linear.columns.responses[linear.removals[place]]
    group = {c: linear.model.measured_channels[c].group for c in gone}
    power = dict.fromkeys(group.values(), 0.0)
    for c, x in gone.items():
        power[group[c]] += float(np.mean(x**2))
    scale = {c: power[g] ** 0.5 for c, g in group.items()}
    y = np.concatenate([x.ravel() / scale[c] for c, x in gone.items()])
    shares: dict[str, float] = {}
    for s in linear.starts:
        shares[s.id] = max(shares.get(s.id, 0.0), _told(linear, s, gone, scale, y))
    best = max(shares.values(), default=0.0)
    near = sorted((i for i in shares if shares[i] >= best - TELLING.as_near), key=lambda i: -shares[i])
    return Likeness(tuple(near[: TELLING.nearest]), best) if best >= TELLING.alike else None


def _told(
    linear: Linearization, start: Candidate, gone: Mapping[int, np.ndarray], scale: Mapping[int, float], y: np.ndarray
) -> float:
    """R² of a candidate's columns on what the term does."""
    zeros = np.zeros(linear.columns.shape)
    columns = [
        np.concatenate([linear.columns.responses[j].get(c, zeros).ravel() / scale[c] for c in gone])
        for j in start.columns
    ]
    x = np.stack(columns, axis=1)
    x = x[:, np.isfinite(x).all(0) & (np.abs(x).max(0) > 0)]
    if not x.shape[1]:
        return 0.0
    rest = y - x @ np.linalg.lstsq(x, y, rcond=None)[0]
    return float(1 - rest @ rest / (y @ y))


def known_as(term: LearnedTerm, model: PhysicsModel) -> str:
    """What has such a shape in mechanics, in words; empty: nothing that is well known."""
    if len(term.signals) != 1 or not _along(term.axis, term.signals[0], model):
        return ""
    (signal,) = term.signals
    driven = signal in signals.input_names(type(model), *signals.drive_of(model))
    kind = _DRIVE if driven else _UNITS.get(signals.available(model).get(signal, ""), "")
    return _KNOWN.get(kind, {}).get(term.shape, "")


def _along(axis: str, signal: str, model: PhysicsModel) -> bool:
    """Whether a signal is of the direction in which a term acts; a system that is given by its rates has but one."""
    if not signals.flies(type(model)):
        return True
    of = "z" if signal == "height" else signal[-1].translate(str.maketrans("pqr", "xyz"))
    return "." not in signal[:-2] and axis[-1] == of
