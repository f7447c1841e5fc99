"""A learned term, a wave or a hidden mode in words, its numbers by name, and what has such a shape elsewhere."""

import math
from collections.abc import Mapping
from dataclasses import replace

from bench.diagnose.learn.spectral_line import Line, Swing
from bench.diagnose.learned_shape import RELAXATION, SWING, WAVE, LearnedShape
from bench.diagnose.report import phrases
from bench.diagnose.result import Diagnosis, ParameterEstimate
from registry.dynamics import PhysicsModel
from registry.dynamics.model import RATE_OF
from registry.effects.learned_term import LearnedTerm
from registry.effects.waves.hidden_mode import HiddenMode
from registry.terms import signals
from registry.terms.shapes import SHAPES, SPLINE

Estimates = dict[str, ParameterEstimate]

_PLACE, _PACE, _DRIVE, _TIME = "place", "pace", "drive", "time"
_UNITS = {"m": _PLACE, "rad": _PLACE, "m/s": _PACE, "rad/s": _PACE, "s": _TIME}
_KNOWN = {
    _PLACE: {
        "linear": "a spring",
        "affine": "a spring that is pressed",
        "sides": "a spring that is stiffer one way",
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
        "sides": "friction or drag that differs with the direction",
        "square_sides": "drag that differs with the direction",
        "above": "a resistance one way only",
        "below": "a resistance one way only",
    },
    _DRIVE: {
        "linear": "a drive that is stronger or weaker than stated",
        "saturation": "a drive at its limit",
        "dead_zone": "a drive with a dead zone",
        "sign": "a drive with a dead zone or dry friction",
        "square": "a drive that is not linear",
        "signed_square": "a drive that is not linear",
        "cubic": "a drive that is not linear",
    },
    _TIME: {"linear": "a drift", "affine": "a drift", "exponential": "something that warms up or settles"},
}

_STRAIGHT = ("linear", "affine", "sign", "saturation", "signed_square")
"""Shapes whose first number is the slope."""
_FORWARD = {
    _PLACE: "a force away from a place, as at the top of a pendulum, or a spring that is weaker than stated",
    _PACE: "less friction or drag than the model has",
}
"""What they are where they act along what they follow, not against it."""


def axis_named(axis: str, model: PhysicsModel) -> str:
    """An axis as a reader says it."""
    kind = type(model)
    if not signals.flies(kind):
        return phrases.named(signals.quantity_of(kind, axis))
    return phrases.named(axis if axis.startswith(("world", "torque")) else f"body_{axis}")


def described(
    term: LearnedTerm, model: PhysicsModel, estimates: list[ParameterEstimate]
) -> tuple[LearnedShape, dict[str, ParameterEstimate]]:
    """A term with what is known of its parameters.

    Args:
        term: fitted.
        model: that it acts in.
        estimates: of its parameters, in order; their units are not looked at.
    """
    named = term.named_parameters(model)
    parameters = {
        name: ParameterEstimate(e.value, e.low, e.high, unit) for (name, unit), e in zip(named, estimates, strict=True)
    }
    of = f"f({phrases.named(term.signals[0])})" if term.signals else "c"
    times = f" × {phrases.named(term.signals[1])}" if len(term.signals) > 1 else ""
    if term.shape == SPLINE:
        unit = signals.available(model)[term.signals[0]]
        over, factor = phrases.shown(unit, term.signals[0])
        low, high = (phrases.number(factor * k) for k in term.span)
        formula, how = "f(x)", f"a spline through {len(term.knots)} values from {low} to {phrases.united(high, over)}"
    else:
        shape = SHAPES[term.shape]
        formula = shape.text
        values = [phrases.estimate(n, p) for n, p in parameters.items()]
        if len(values) > 1:
            values = [f"{n} = {v}" for n, v in zip(parameters, values, strict=True)]
        said = shape.said if len(parameters) == 1 else f"{shape.said} {formula}"
        how = ", ".join([said, *values])
    text = f"{axis_named(term.axis, model)} = {of}{times}, {how}"
    return LearnedShape(term.axis, term.signals, term.shape, formula, text), parameters


def known_as(term: LearnedTerm, model: PhysicsModel) -> str:
    """What has such a shape in mechanics, in words; empty: nothing that is well known."""
    if len(term.signals) != 1 or not _along(term.axis, term.signals[0], model):
        return ""
    (signal,) = term.signals
    driven = signal in signals.input_names(type(model), *signals.drive_of(model))
    kind = _DRIVE if driven else _UNITS.get(signals.available(model).get(signal, ""), "")
    own = term.axis.partition(".")[2] == signal.partition(".")[2] or signals.flies(type(model))
    if own and kind in _FORWARD and term.shape in _STRAIGHT and float(term.values[0]) > 0:
        return _FORWARD[kind]
    return _KNOWN.get(kind, {}).get(term.shape, "")


def _along(axis: str, signal: str, model: PhysicsModel) -> bool:
    """Whether a signal is of the direction in which a term acts; a system that is given by its rates has but one."""
    if not signals.flies(type(model)):
        return True
    of = "z" if signal == "height" else signal[-1].translate(str.maketrans("pqr", "xyz"))
    return "." not in signal[:-2] and axis[-1] == of


def described_wave(line: Line, model: PhysicsModel) -> tuple[LearnedShape, Estimates, dict[str, Estimates]]:
    """What it is, its frequency and mean amplitude, and amplitude and phase of each recording."""
    swings = list(line.swings.values())
    mean = sum(s.amplitude for s in swings) / len(swings)
    half = math.sqrt(sum(((s.high - s.low) / 2) ** 2 for s in swings)) / len(swings)
    numbers = {
        "frequency": ParameterEstimate(line.frequency, line.low, line.high, "Hz"),
        "amplitude": ParameterEstimate(mean, max(0.0, mean - half), mean + half, line.unit),
    }
    often, much = (phrases.estimate(name, p) for name, p in numbers.items())
    where = axis_named(line.axis, model)
    text = f"a periodic {where} of {often}, amplitude {much}, which follows no measured signal"
    shape = LearnedShape(line.axis, (), WAVE, "A cos(2π f t + φ)", text)
    return shape, numbers, {name: _swing(s, line.unit) for name, s in line.swings.items()}


def _swing(swing: Swing, unit: str) -> Estimates:
    # The phase is that of the recording's first sample.
    return {
        "amplitude": ParameterEstimate(swing.amplitude, swing.low, swing.high, unit),
        "phase": ParameterEstimate(swing.phase, swing.phase - swing.turn, swing.phase + swing.turn, "rad"),
    }


def described_mode(
    mode: HiddenMode, model: PhysicsModel, estimates: Mapping[str, ParameterEstimate]
) -> tuple[LearnedShape, Estimates]:
    """A hidden mode with what is known of its numbers.

    Args:
        mode: fitted.
        model: that it acts in.
        estimates: of its parameters, by label; the units of the gains are not looked at.
    """
    often = estimates["frequency"]
    if mode.order == 2:
        numbers = {"frequency": often, "damping": estimates["damping"]}
        moves = f"swings at {phrases.estimate('', often)}, damping {phrases.estimate('', numbers['damping'])}"
    else:
        value, shortest = (1 / (2 * math.pi * f) if f else math.inf for f in (often.value, often.high))
        longest = 1 / (2 * math.pi * often.low) if often.low else math.nan  # nobody knows
        numbers = {"time constant": ParameterEstimate(value, shortest, longest, "s")}
        moves = f"relaxes with a time constant of {phrases.estimate('', numbers['time constant'])}"
    names = [
        f"{letter} {axis}" if len(mode.axes) > 1 else letter for axis in mode.axes for letter in "pq"[: mode.order]
    ]
    for i, (name, unit) in enumerate(zip(names, mode.units(model), strict=True)):
        numbers[name] = replace(estimates[f"gains[{i}]"], unit=unit)
    acts = phrases.listed(axis_named(a, model) for a in mode.axes)
    text = f"something {moves}, driven by {_drivers(mode, model)}; acts as {acts}"
    formula = "F = ω (p (z − d) + q ż/ω)" if mode.order == 2 else "F = ω p (z − d)"
    shape = SWING if mode.order == 2 else RELAXATION
    return LearnedShape(",".join(mode.axes), mode.drivers, shape, formula, text), numbers


def _drivers(mode: HiddenMode, model: PhysicsModel) -> str:
    """What drives a mode, which answers changes only."""
    group = mode.drivers[0].partition(".")[0]
    letters = phrases.listed(d.rpartition(".")[2] for d in mode.drivers)
    if not signals.flies(type(model)):
        named = phrases.listed(phrases.named(d) for d in mode.drivers)
        return f"the rate of change of {named}" if group in RATE_OF.values() else f"changes of {named}"
    if group in ("velocity", "body_velocity"):
        return f"the acceleration along {'world' if group == 'velocity' else 'body'} {letters}"
    return f"changes of {group.replace('_', ' ')} {letters}"


def alike(diagnosis: Diagnosis) -> str:
    """What the learned terms are like, and what would tell them from it; empty: nothing that is known."""
    out = []
    alone = sum(e.learned for e in diagnosis.effects) == 1
    for e in diagnosis.effects:
        if e.term is None or not (e.term.nearest or e.term.known_as):
            continue
        names = phrases.listed(map(phrases.named, e.term.nearest), "or")
        near = f"{names}, which would do {phrases.percent(e.term.likeness)} of it" if names else ""
        like = "; nearest in the catalogue: ".join(filter(None, (e.term.known_as, near)))
        which = "The learned term" if alone else phrases.named(e.term.name)
        out.append(f"{which} looks like {like}. {e.separate_by}".strip())
    return " ".join(out)
