"""A wave in words, and its numbers by name."""

import math

from bench.diagnose.learn.spectral_line import Line, Swing
from bench.diagnose.learned_shape import WAVE, LearnedShape
from bench.diagnose.report import phrases
from bench.diagnose.report.learned_words import axis_named
from bench.diagnose.result import ParameterEstimate
from registry.dynamics import PhysicsModel

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
