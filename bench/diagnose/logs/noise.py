"""Noise of measured states and inputs, as stated or from their spectra, and the filter that both went through."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from bench.diagnose.logs.filters import savitzky_golay
from bench.diagnose.logs.smoothing import Slope, Smoothing
from bench.diagnose.logs.subject import Log, Subject
from bench.diagnose.settings import HEARING
from registry.contracts import Channel
from registry.datasets.reading.cleaning import runs
from registry.dynamics.model import RATE_OF

DERIVED_FROM = {rate: pose for pose, rate in RATE_OF.items()}
"""Signals that are often read from the pose."""
_BLACKMAN_HARRIS = (0.35875, 0.48829, 0.14128, 0.01168)
"""Of the window with four terms: Harris, "On the use of windows for harmonic analysis", Proc. IEEE 66 (1978)."""
QUIET = slice(HEARING.segment // 4, HEARING.segment // 2)
"""Frequencies of a spectrum, from a quarter to half the sampling rate, at which motion is small against noise."""


@dataclass(frozen=True, eq=False)
class Noise:
    """White noise of sensors, and the filter that measured states went through after it. SI."""

    smoothing: Smoothing
    derived: tuple[bool, ...]
    """(s,): whether a state channel is the derivative of its smoothed pose."""
    raw: tuple[float, ...]
    """(s,) 1σ before smoothing (attitude: about each body axis [rad]); 0 where derived or not measured."""
    processed: tuple[float, ...]
    """(s,) 1σ of the states as they are given to a model (attitude: about each body axis [rad])."""
    inputs: tuple[float, ...]
    """(m,) 1σ of the inputs, before what they went through."""
    input_smoothing: Smoothing
    """What the inputs went through: nothing, or what the states did."""
    notes: tuple[str, ...]
    """What was stated, what was estimated."""
    sensed: tuple[float, ...] = ()
    """(f,) 1σ of what sensors show of the rates."""
    slopes: dict[int, Slope] = field(default_factory=dict)
    """State channels that are slopes of others; see `logs.slopes`."""
    inputs_stated: bool = False
    """Whether somebody stated the noise of the inputs."""
    input_reading: tuple[float, ...] = (1.0,)
    """Weights of the samples between which inputs are read: fast noise of theirs is less there, slow noise is not."""

    @property
    def input_weights(self) -> np.ndarray:
        """Weights (w,) on white noise of the inputs that give it as a model sees it."""
        return np.convolve(impulse_response(self.input_smoothing, False), self.input_reading)

    @property
    def half_width(self) -> int:
        """Samples on either side that a state depends on."""
        own = (impulse_response(self.smoothing, d) for d in (False, self.smoothing.derived))
        return max(len(w) // 2 for w in (*own, *(impulse_response(s.smoothing, True) for s in self.slopes.values())))

    def smoothing_of(self, channel: int) -> Smoothing:
        """What a state channel went through, as the weak form takes it."""
        if channel in self.slopes:
            return self.slopes[channel].smoothing
        s = self.smoothing
        return replace(s, derived=self.derived[channel])


def noise_of(subject: Subject) -> Noise:
    """Noise of the subject's recordings, as stated where it is stated, else from their spectra.

    Above `QUIET` times the sampling rate a measured state is noise that went through the filter: its spectrum has the
    filter's shape, by which the filter is known (Whittle's likelihood), and its height gives 1σ. Steps of an input set
    off corners, which are no noise: what follows them linearly is taken off first.
    """
    logs, channels = subject.logs, subject.model.state_channels
    measured = tuple(i not in subject.slopes and all(log.measured[i] for log in logs) for i in range(len(channels)))
    places, length = channel_indices(channels, measured), _segment([log.valid.numpy() for log in logs])
    steps = _steps(subject)
    height = {g: _height(logs, at, length, steps) for g, at in places.items()}
    own = {g for g in subject.noise if g in DERIVED_FROM}  # a sensor of its own has noise of its own
    notes = []
    if subject.smoothing is None:
        smoothing, fits = _filter(height, length)
        what = f"{smoothing}" if fits else "no filter that is known here: none is assumed"
        notes.append(f"The filter that the measured states went through was estimated from their spectra: {what}.")
    else:
        smoothing = subject.smoothing
    derived = tuple(
        m and smoothing.derived and c.group not in own and DERIVED_FROM.get(c.group) in height
        for c, m in zip(channels, measured, strict=True)
    )
    followers = {DERIVED_FROM[c.group]: c.group for c, d in zip(channels, derived, strict=True) if d}
    sigma = {}
    for group, spectrum in height.items():
        if group in followers.values():
            continue
        shapes, found = [_gain(smoothing, False, length)], [spectrum]
        if group in followers:
            shapes.append(_gain(smoothing, True, length) * logs[0].rate ** 2)
            found.append(height[followers[group]])
        least = HEARING.digits * max(float(log.states[:, list(places[group])].abs().max()) for log in logs)
        sigma[group] = max(least, subject.noise.get(group, _level(found, shapes) ** 0.5))
    if estimated := sorted(set(sigma) - set(subject.noise)):
        notes.append(f"The noise of {', '.join(estimated).replace('_', ' ')} was estimated from the spectra.")
    raw, processed = [], []
    for channel, is_derived, m in zip(channels, derived, measured, strict=True):
        of = sigma.get(DERIVED_FROM[channel.group] if is_derived else channel.group, 0.0) if m else 0.0
        weights = impulse_response(smoothing, is_derived)
        raw.append(0.0 if is_derived else of)
        processed.append(of * float(np.linalg.norm(weights)) * (logs[0].rate if is_derived else 1.0))
    for i, slope in subject.slopes.items():
        processed[i] = raw[slope.of] * float(np.linalg.norm(impulse_response(slope.smoothing, True))) * logs[0].rate
    inputs, through = _input_noise(subject, replace(smoothing, derived=False), length)
    if through.kind != "none":
        notes.append(f"The inputs show {through} as well.")
    return Noise(
        smoothing=smoothing,
        derived=derived,
        raw=tuple(raw),
        processed=tuple(processed),
        inputs=inputs,
        input_smoothing=through,
        notes=tuple(notes),
        sensed=_sensed_noise(subject, length),
        slopes=subject.slopes,
        inputs_stated=any(c.group in subject.noise for c in logs[0].recording.input_channels[:1]),
    )


def white_level(series: Sequence[np.ndarray], valid: Sequence[np.ndarray]) -> np.ndarray:
    """1σ (c,) of the noise of signals (N, c), each with its mask (N,), if it is white: as quiet frequencies have it."""
    power = _spectrum(series, valid, _segment(valid))[QUIET]
    return np.asarray(np.sqrt(np.median(power, axis=0)))


# ---------------------------------------------------------------------------------------------------- the filter


@lru_cache(maxsize=256)
def impulse_response(s: Smoothing, derived: bool) -> np.ndarray:
    """Weights (w,) on the noisy signal that give the smoothed one or, over dt, its derivative; later samples last."""
    if s.kind == "savgol" and not (derived and s.differenced):
        return savitzky_golay(s.window, s.order, derived)
    own = savitzky_golay(s.window, s.order) if s.kind == "savgol" else np.full(s.window, 1 / s.window)
    return np.convolve(own, [-0.5, 0.0, 0.5]) if derived else own


@lru_cache(maxsize=256)
def _gain(s: Smoothing, derived: bool, length: int) -> np.ndarray:
    """Power (F,) that white noise of 1σ = 1 has after the filter, as `_spectrum` sees it through its taper."""
    weights, taper = impulse_response(s, derived), _taper(length)
    n, lags = len(weights), np.arange(len(weights))
    own = np.correlate(weights, weights, "full")[n - 1 :]
    seen = own * np.array([taper[: HEARING.segment - k] @ taper[k:] for k in lags]) / (taper @ taper)
    frequency = np.arange(HEARING.segment // 2 + 1)[:, None] / HEARING.segment
    power = seen[0] + 2 * (seen[1:] * np.cos(2 * np.pi * frequency * lags[1:])).sum(1)
    return np.asarray(np.maximum(power, HEARING.faint * power.max())[QUIET])


@lru_cache(maxsize=3)
def _taper(length: int) -> np.ndarray:
    """Of ``length`` samples, with zeros up to `HEARING.segment`."""
    # Its side lobes lie at -92 dB: slow motion does not leak into the quiet frequencies.
    at = np.linspace(-np.pi, np.pi, length + 1)[:-1]
    window = sum(a * np.cos(k * at) for k, a in enumerate(_BLACKMAN_HARRIS))
    return np.pad(window, (0, HEARING.segment - length))


def _filter(height: dict[str, np.ndarray], length: int) -> tuple[Smoothing, bool]:
    """The filter whose gain is most like the heights found, and whether it is like them at all."""
    best, least, unlike = Smoothing(), np.inf, np.inf
    height = {group: found for group, found in height.items() if found.min() > 0}
    for smoothing in _candidates():
        loss, distance = 0.0, []
        for group, found in height.items():
            shape = _gain(smoothing, smoothing.derived and DERIVED_FROM.get(group) in height, length)
            shape = shape * _level([found], [shape])
            loss += float((np.log(shape) + found / shape).sum())
            distance.append(float(np.abs(np.log(found / shape)).mean()))
        if distance and loss < least:
            best, least, unlike = smoothing, loss, float(np.mean(distance))
    return (best, True) if unlike < HEARING.unlike else (Smoothing(), False)


def _candidates() -> list[Smoothing]:
    kinds = [("none", 1, 0)]
    kinds += [("mean", w, 0) for w in range(3, 16, 2)]
    kinds += [("savgol", w, o) for w in range(5, 26, 2) for o in (2, 3, 4) if o + 1 < w]
    found = [Smoothing(*k, derived=d) for d in (False, True) for k in kinds]
    return found + [Smoothing(*k, derived=True, differenced=True) for k in kinds if k[0] == "savgol"]


# --------------------------------------------------------------------------------------------------- the spectra


def channel_indices(channels: Sequence[Channel], measured: Sequence[bool]) -> dict[str, tuple[int, ...]]:
    """Of each signal that was measured, its places among the channels."""
    found: dict[str, tuple[int, ...]] = {}
    for i, (channel, m) in enumerate(zip(channels, measured, strict=True)):
        if m:
            found[channel.group] = (*found.get(channel.group, ()), i)
    return found


def _segment(valid: Sequence[np.ndarray]) -> int:
    """Samples of a spectrum: `HEARING.segment`, or less where no recording is as long without a gap."""
    longest = max((b - a for good in valid for a, b in runs(good)), default=0)
    return next((n for n in (HEARING.segment, HEARING.segment // 2) if n <= longest), HEARING.segment // 4)


def _height(logs: Sequence[Log], at: Sequence[int], length: int, steps: Sequence[np.ndarray]) -> np.ndarray:
    """Mean power (F,) of a channel at quiet frequencies; white noise has its variance everywhere."""
    states, valid = [log.states[:, list(at)].numpy() for log in logs], [log.valid.numpy() for log in logs]
    out = _spectrum(_unanswered(states, valid, steps) if len(steps) else states, valid, length)
    # About each axis: half the angle goes into a quaternion, three axes into its four numbers.
    return np.asarray((out.sum(-1) * 4 / 3 if len(at) == 4 else out.mean(-1))[QUIET])


def _steps(subject: Subject) -> list[np.ndarray]:
    """Of each recording the inputs (N, d) that stay as they are from most samples to the next; empty: none does.

    Nobody's noise is in them, as it is in what a controller answers at every sample.
    """
    drives = [log.inputs[:, : log.inputs.shape[1] - len(subject.model.extras)].numpy() for log in subject.logs]
    moves = np.mean(np.concatenate([np.diff(u, axis=0) != 0 for u in drives]), axis=0)
    stepped = (moves > 0) & (moves < HEARING.stepped)
    return [u[:, stepped] for u in drives] if stepped.any() else []


def _unanswered(
    states: Sequence[np.ndarray], valid: Sequence[np.ndarray], steps: Sequence[np.ndarray]
) -> list[np.ndarray]:
    """The states (N, c) of each recording less what follows its steps (N, d) linearly, as their changes of slope tell.

    A finite impulse response; second differences weigh the frequencies that are quiet otherwise.
    """
    bent = [np.convolve(good, np.ones(3), "valid") > 2.5 for good in valid]
    lags = min(HEARING.answered, int(sum(map(np.sum, bent)) / (HEARING.rows * steps[0].shape[1])))
    past = [_lagged(np.nan_to_num(u), lags) for u in steps]
    width = past[0].shape[1]
    gram, cross = np.zeros((width, width)), np.zeros((width, states[0].shape[1]))
    for u, x, good in zip(past, states, bent, strict=True):
        du, dx = (np.diff(of, 2, axis=0)[good] for of in (u, x))
        gram += du.T @ du
        cross += du.T @ dx
    answer = np.linalg.lstsq(gram, cross, rcond=HEARING.digits)[0]
    return [x - u @ answer for x, u in zip(states, past, strict=True)]


def _lagged(u: np.ndarray, lags: int) -> np.ndarray:
    """Inputs (N, d) now and at as many samples before (N, (lags + 1) · d)."""
    before = np.concatenate([np.repeat(u[:1], lags, axis=0), u])
    return np.concatenate([before[lags - k : len(before) - k] for k in range(lags + 1)], axis=1)


def _spectrum(series: Sequence[np.ndarray], valid: Sequence[np.ndarray], length: int) -> np.ndarray:
    """Typical power (F, c) of ``length`` samples; a median, so that bursts and spikes do not count."""
    taper, parts = _taper(length)[:length], []
    line = np.linspace(-1, 1, length)[:, None]
    for x, good in zip(series, valid, strict=True):
        for k in range(0, len(x) - length + 1, length // 2):
            if good[k : k + length].all():
                piece = x[k : k + length] - x[k : k + length].mean(0)
                piece = piece - line * (line * piece).sum(0) / (line**2).sum()
                parts.append(
                    np.abs(np.fft.rfft(piece * taper[:, None], HEARING.segment, axis=0)) ** 2 / (taper**2).sum()
                )
    if not parts:  # too short to be heard
        return np.zeros((HEARING.segment // 2 + 1, series[0].shape[1]))
    return np.asarray(np.median(parts, axis=0) / np.log(2))


def _level(found: Sequence[np.ndarray], shapes: Sequence[np.ndarray]) -> float:
    """σ² that brings the shapes to the heights found: where the shape is faint, so is what it says."""
    ratios = np.concatenate([f / s for f, s in zip(found, shapes, strict=True)])
    return float(np.median(ratios))


def _sensed_noise(subject: Subject, length: int) -> tuple[float, ...]:
    """1σ (f,) of what sensors show of the rates, vibration included: as stated, or from their spectra."""
    logs, groups = subject.logs, [c.group for c in subject.model.sensed_channels]
    if any(log.sensed is None for log in logs):
        return ()
    shown = [log.recording.pick(list(dict.fromkeys(groups)))[0].astype(np.float64) for log in logs]
    power = _spectrum(shown, [log.valid.numpy() for log in logs], length)[QUIET]
    return tuple(subject.noise.get(g, float(np.median(p)) ** 0.5) for g, p in zip(groups, power.T, strict=True))


def _input_noise(subject: Subject, smoothing: Smoothing, length: int) -> tuple[tuple[float, ...], Smoothing]:
    """1σ (m,) of the inputs' noise, and the filter it went through: ``smoothing``, that of the states, or none."""
    model, logs = subject.model, subject.logs
    drives = logs[0].inputs.shape[1] - len(model.extras)
    still = (0.0,) * len(model.extras)
    if model.input_hold == "previous" or not drives:
        return (0.0,) * drives + still, Smoothing()  # commands are known
    power = _spectrum([log.inputs[:, :drives].numpy() for log in logs], [log.valid.numpy() for log in logs], length)
    white, shape = (_gain(s, False, length) for s in (Smoothing(), smoothing))
    mean = power[QUIET].mean(1)
    unlike, alike = (
        (float(np.abs(np.log(mean / (s * _level([mean], [s])))).mean()) for s in (white, shape))
        if mean.min() > 0
        else (0.0, 1.0)
    )
    filtered = alike < HEARING.unlike < unlike
    signal = logs[0].recording.input_channels[0].group if logs[0].recording.input_channels else ""
    if signal in subject.noise:
        sigma = (subject.noise[signal],) * drives
    elif filtered:
        sigma = tuple(_level([p], [shape]) ** 0.5 for p in power[QUIET].T)
    else:
        top = power[round(0.4 * HEARING.segment) : HEARING.segment // 2]
        sigma = tuple(float(v) for v in np.sqrt(np.median(top, axis=0)))
    return (*sigma, *still), smoothing if filtered else Smoothing()
