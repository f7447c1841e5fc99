"""A wave or a hidden mode in words, and its numbers by name."""

import math
from collections.abc import Mapping
from dataclasses import replace

from bench.diagnose.learn.spectral_line import Line, Swing
from bench.diagnose.learned_shape import RELAXATION, SWING, WAVE, LearnedShape
from bench.diagnose.report import phrases
from bench.diagnose.report.learned_words import axis_named
from bench.diagnose.result import ParameterEstimate
from registry.dynamics import PhysicsModel
from registry.dynamics.model import RATE_OF
from registry.effects.waves.hidden_mode import HiddenMode
from registry.terms import signals

Estimates = dict[str, ParameterEstimate]


def described(line: Line, model: PhysicsModel) -> tuple[LearnedShape, Estimates, dict[str, Estimates]]:
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
    return shape, numbers, {name: _of(s, line.unit) for name, s in line.swings.items()}


def _of(swing: Swing, unit: str) -> Estimates:
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
        longest, value, shortest = (1 / (2 * math.pi * f) for f in (often.low or math.nan, often.value, often.high))
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
