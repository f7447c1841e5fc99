"""Rates that nobody measured, read from what they are the rate of: slopes of a local polynomial through an encoder.

In the weak form nothing is differentiated by that: the polynomial's weights, summed by parts, act on both sides of an
equation (`Smoothing.kernel`), as test functions that are twice differentiable would.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import torch
from scipy.ndimage import binary_erosion, correlate1d

from bench.diagnose.logs.consistency import Pair, modelled, pairs
from bench.diagnose.logs.noise import impulse_response, white_level
from bench.diagnose.logs.smoothing import Slope, Smoothing
from bench.diagnose.logs.subject import Log, self_contained
from bench.diagnose.settings import READING, SLOPING
from registry.contracts import Recording
from registry.datasets.reading.cleaning import runs
from registry.dynamics import PhysicsModel

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class Sloped:
    """Recordings with rates that were not measured."""

    recordings: tuple[Recording, ...]
    slopes: dict[int, Slope] = field(default_factory=dict)
    """By place among the model's states, where a rate comes from."""
    noise: dict[str, float] = field(default_factory=dict)
    """1σ of the signals whose slopes they are, SI, where no filter is stated."""
    notes: tuple[str, ...] = ()


def with_slopes(recordings: Sequence[Recording], model: PhysicsModel, processing: Smoothing | None) -> Sloped:
    """Recordings with the rates that are slopes of measured signals and that run free once they are known.

    Args:
        recordings: with the signals of ``model``.
        model: tells which states are rates of others; those of an attitude are left out.
        processing: the filter that the measured states went through, as stated; None: nobody says.
    """
    made = Sloped(tuple(recordings))
    names = [c.name for c in model.state_channels]
    measured = [all(n in {c.name for c in r.channels} for r in recordings) for n in names]
    missing = [
        p
        for whole in pairs(model, (True,) * len(names))
        if not whole.turns and (p := _unmeasured(whole, measured)).rates
    ]
    known = self_contained(model, [m or any(i in p.rates for p in missing) for i, m in enumerate(measured)])
    for pair in missing:
        if all(known[j] for j in pair.rates):
            made = _with(made, pair, model, processing)
    return made


def _unmeasured(pair: Pair, measured: Sequence[bool]) -> Pair:
    """What of a pair has a signal and no rate: of two joints one may have an encoder alone."""
    lacking = [
        k for k, (i, j) in enumerate(zip(pair.channels, pair.rates, strict=True)) if measured[i] and not measured[j]
    ]

    def of(some: Sequence[Any]) -> tuple[Any, ...]:
        return tuple(some[k] for k in lacking)

    return replace(pair, channels=of(pair.channels), rates=of(pair.rates), axes=of(pair.axes))


def with_missed(log: Log, model: PhysicsModel, slopes: Mapping[int, Slope]) -> Log:
    """The log with what slopes lack as the rates in between that they stand for (`Log.missed`).

    A slope is a rate seen through the kernel K, so that the model's own rate v, integrated from what is measured, tells
    what that takes off: the integral drifts, and in a difference of two averages no drift is left. With a model that is
    a tenth off, a tenth of it is left. The mean over an interval is that of the two ends less a twelfth of the second
    difference, whether v bends or has a kink at each sample.

    Where inputs hold, what stands for a mean is sharper than one: for the rate of change at a sample `Smoothing.kernel`
    takes the mean of two intervals, which is right of an input that steps there and (ω dt)²/12 too little of what
    swings. Of v with its kinks that comes to the same twelfth; of its signal, which has none, to a sixth of the rise.
    """
    if not slopes or len(log) < 3:
        return log
    before, after = log.inputs[:-1], log.inputs[1:]
    given = before if model.input_hold == "previous" else (before + after) / 2
    middle = replace(log, states=(log.states[:-1] + log.states[1:]) / 2, inputs=given)
    changes = modelled(replace(model, effects=()), middle) * log.dt
    good, missed = log.valid.numpy(), np.zeros(changes.shape)
    for rate, slope in slopes.items():
        steps = log.states[:, rate].diff().numpy()
        missed[:, slope.of] = -log.dt * steps / (12 if slope.smoothing.straight else 6)
        v, kernel = np.append(0.0, np.cumsum(changes[:, rate])), slope.smoothing.kernel()
        bend = correlate1d(v, [-1 / 12, 1 / 6, -1 / 12], mode="nearest")
        lacking = v + bend - correlate1d(v, kernel, mode="nearest")
        known = binary_erosion(good, np.ones(len(kernel) + 2, dtype=bool))
        lacking = np.where(known, lacking, 0.0)
        missed[:, rate] = (lacking[:-1] + lacking[1:]) / 2
    return replace(log, missed=torch.from_numpy(missed))


def _with(made: Sloped, pair: Pair, model: PhysicsModel, processing: Smoothing | None) -> Sloped:
    """The recordings with the rates of one more pair."""
    signal, rates = ([model.state_channels[i] for i in at] for at in (pair.channels, pair.rates))
    paths = [r.pick([c.name for c in signal])[0].astype(np.float64) for r in made.recordings]
    noise = made.noise
    if processing is None or processing.kind == "none":
        masks = [r.valid for r in made.recordings]
        stretches = [x[a:b] for x, good in zip(paths, masks, strict=True) for a, b in runs(good)]
        if not stretches:
            return made
        stretches = stretches[:: -(-sum(map(len, stretches)) // READING.enough)]
        sigma = np.maximum(white_level(paths, masks), _count(stretches) / 12**0.5)
        smoothing, level = _best(stretches, sigma)
        noise = noise | {pair.signal: level}
    else:  # a rate that is read from a smoothed signal needs no filter of its own
        smoothing = replace(processing, derived=True, differenced=True)
    weights = impulse_response(smoothing, True) if not smoothing.differenced else np.array([-0.5, 0.0, 0.5])
    recordings = tuple(
        replace(
            r,
            outputs=np.concatenate([r.outputs, correlate1d(x, weights, axis=0, mode="nearest") * r.rate], axis=1),
            output_channels=(*r.output_channels, *rates),
            valid=binary_erosion(r.valid, np.ones(len(weights), dtype=bool)),
        )
        for r, x in zip(made.recordings, paths, strict=True)
    )
    smoothing = replace(smoothing, straight=model.input_hold != "previous")
    slopes = {j: Slope(i, smoothing) for i, j in zip(pair.channels, pair.rates, strict=True)}
    ms = 1e3 * (len(weights) - 1) / made.recordings[0].rate
    how = f"of a local cubic over {len(weights)} samples ({ms:.3g} ms)"
    all_of_it = len(rates) == sum(c.group == pair.rate for c in model.state_channels)
    some = "" if all_of_it else f" of {' and '.join(pair.axes)}"
    rate, signal_name = (name.replace("_", " ") for name in (pair.rate, pair.signal))
    note = (
        f"The {rate}{some} was not measured: it is the slope of the {signal_name}, "
        f"{'over its neighbours' if smoothing.differenced else how}, and what is said of it is said of that."
    )
    return Sloped(recordings, made.slopes | slopes, noise, (*made.notes, note))


def _count(stretches: Sequence[Array]) -> Array:
    """The least step (c,) of a signal from one sample to the next: one count of an encoder, or a rounding error."""
    steps = np.concatenate([np.abs(np.diff(x, axis=0)) for x in stretches])
    rounding = 1e-9 * max(float(np.abs(x).max()) for x in stretches)
    least = np.where(steps > rounding, steps, np.inf).min(axis=0)
    return np.where(np.isfinite(least), least, 0.0)


def _best(stretches: Sequence[Array], sigma: Array) -> tuple[Smoothing, float]:
    """The window of a local cubic whose slope errs least, of signals (N, c) with white noise of 1σ (c,).

    Counts of an encoder that turns slowly are more than white noise. So what is said with the window is the noise that
    differs so over half of it, where a cubic follows all that moves.

    The mean square of the error is what noise makes, σ² Σ w², and what the polynomial does not follow. The latter is
    the difference to the slope over half the window, which follows far better (its error goes with the fourth power of
    the window), less what noise makes of that.
    """
    window, least, best, heard = SLOPING.shortest, np.inf, Smoothing(derived=True), {0: sigma**2}
    longest = min(SLOPING.longest, max(map(len, stretches)) // SLOPING.windows)
    while window <= longest:
        tried = Smoothing("savgol", window, 3, derived=True)
        weights = impulse_response(tried, True)
        half = max(SLOPING.shortest, 2 * (window // 4) + 1)
        more = weights - np.pad(impulse_response(replace(tried, window=half), True), (window - half) // 2)
        edge = window // 2
        apart = [correlate1d(x, more, axis=0)[edge:-edge] ** 2 for x in stretches if len(x) > window]
        power = np.concatenate(apart).mean(0)
        missed = power - sigma**2 * (more @ more)
        error = float((np.maximum(missed, 0) + sigma**2 * (weights @ weights)).sum())
        if error < least:
            least, best = error, tried
        if error > SLOPING.hopeless * least:
            break
        if half < window:
            heard[window] = power / (more @ more)
        window = max(window + 2, 2 * round(SLOPING.step * window / 2) + 1)
    return best, float(np.sqrt(heard[max(w for w in heard if 2 * w <= best.window)].mean()))
