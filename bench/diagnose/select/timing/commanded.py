"""A measured drive beside the commands that it follows: what both say of it together.

Speeds of rotors are measured with noise, and what goes with their rate drowns in it; the commands have none. A channel
x of the drive follows its commands c, as filed and up to `COMMANDING.latest` samples before, by a first-order lag,

    x[k] = a x[k − 1] + Σ_j (b_j c[k − j] + d_j c²[k − j]) + e + w[k],    y[k] = x[k] + v[k],

so that what is measured, y, is an ARMAX process: maximum likelihood gives the lag, and how much of what it leaves is
noise v of the sensor and how much, w, the drive does of its own accord. Given these, x is what a Rauch–Tung–Striebel
smoother makes of all samples. Its error does not go with what it says (it is Berkson's kind), so that a regression on
it has no bias, which one on y has. Where the drive does not follow, w is large and what was measured stays as it is.

L. Ljung, System Identification (1999), section 4.2; H. E. Rauch, F. Tung and C. T. Striebel, AIAA Journal 3 (1965).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from bench.diagnose.logs.subject import Log, Subject, drives_of
from bench.diagnose.settings import COMMANDING
from registry.datasets.reading.cleaning import runs

Series = tuple[np.ndarray, np.ndarray]
"""What was measured of a channel (n,), and its commands (n,), one after the other."""
Way = tuple[np.ndarray, np.ndarray]
"""What is known (p,) of a and the commanded part, and how they go (p, f) with what is fitted."""


@dataclass(frozen=True)
class Follower:
    """How a channel of the drive follows its commands."""

    decay: float
    """a: what is left of a deviation a sample later."""
    commanded: np.ndarray
    """(2 (latest + 1) + 1,): b_0, b_1, …, d_0, d_1, … and e, of scaled commands."""
    scale: float
    """Of the commands."""
    sensor: float
    """Variance of v."""
    own: float
    """Variance of w."""

    @property
    def gains(self) -> tuple[float, float, float]:
        """Of the Kalman filter and of the smoother, once settled, and the variance of what the smoother leaves."""
        a, q, r = self.decay, self.own, self.sensor
        b = r * (1 - a * a) - q
        before = (-b + (b * b + 4 * q * r) ** 0.5) / 2  # of x before its sample is seen
        gain = before / (before + r) if before > 0 else 0.0
        after = (1 - gain) * before
        back = after * a / before if before > 0 else 0.0
        left = (after - back * back * before) / (1 - back * back)
        return gain, back, left

    def smoothed(self, series: Series) -> np.ndarray:
        """What all samples say of a channel (n,)."""
        from scipy.signal import lfilter

        y, drive = series[0], _regressors(series[1] / self.scale) @ self.commanded
        a, (gain, back, _) = self.decay, self.gains
        kept = (1 - gain) * a

        def filtered(first: float) -> np.ndarray:
            """The filter's estimates (n,), from a first one."""
            seen = (1 - gain) * drive[1:] + gain * y[1:]
            return np.concatenate([[first], lfilter([1.0], [1.0, -kept], seen, zi=[kept * first])[0]])

        # Where it began is told by all that follows: an error of the first estimate shows in the innovations after it.
        x = filtered(y[0])
        shown = np.concatenate([[1.0], a * kept ** np.arange(len(y) - 1)])
        innovations = np.concatenate([[0.0], y[1:] - a * x[:-1] - drive[1:]])
        x = filtered(y[0] + float(shown @ innovations) / float(shown @ shown))
        step = x[:-1] - back * (a * x[:-1] + drive[1:])
        late = lfilter([1.0], [1.0, -back], step[::-1], zi=[back * x[-1]])[0][::-1]
        return np.concatenate([late, x[-1:]])


def follower(series: Sequence[Series]) -> Follower | None:
    """How the channel of some stretches follows its commands; None: it does not, as far as can be told.

    As commanded, by a gain and an offset, or along a parabola: of these what Schwarz's criterion (BIC) prefers, since
    numbers that need not be fitted have no error that would look like an effect.
    """
    from scipy.optimize import minimize_scalar

    scale = max(float(np.abs(c).max()) for _, c in series)
    if not scale > 0:
        return None
    parts = [(y, _regressors(c / scale)) for y, c in series]
    samples, least = sum(len(y) for y, _ in parts), COMMANDING.rounding * max(float((y * y).max()) for y, _ in parts)

    def best(way: Way) -> tuple[float, np.ndarray, float, float]:
        """BIC, a and the commanded part, the moving-average part, and the variance of the innovations."""
        bounds = (0.0, COMMANDING.slowest)
        moving = float(minimize_scalar(lambda m: _fitted(parts, way, m)[1], bounds=bounds, method="bounded").x)
        found, innovation = _fitted(parts, way, moving)
        criterion = samples * np.log(max(innovation, least)) + way[1].shape[1] * np.log(samples)
        return criterion, found, moving, innovation

    _, found, moving, innovation = min(map(best, _ways(scale)), key=lambda told: told[0])
    decay = float(found[0])
    if not 0 < decay < 1 or innovation <= least:
        return None
    moving = min(moving, decay)
    sensor = moving * innovation / decay
    own = max(0.0, (1 + moving**2) * innovation - (1 + decay**2) * sensor)
    return Follower(decay, found[1:], scale, sensor, own)


def _ways(scale: float) -> tuple[Way, ...]:
    """The drive becomes what is commanded, or that by a gain and an offset, or along a parabola."""
    count = COMMANDING.latest + 1
    free, known = np.eye(2 * count + 2), np.zeros(2 * count + 2)
    known[1] = scale
    exact = free[:, [0, *range(2, count + 1)]]
    exact[1] = [-scale, *[-1.0] * (count - 1)]
    return (known, exact), (0 * known, free[:, [*range(count + 1), -1]]), (0 * known, free)


def _fitted(parts: Sequence[Series], way: Way, moving: float) -> tuple[np.ndarray, float]:
    """a, then the commanded part; and the variance of the innovations (1 − moving/z)⁻¹ of what these leave."""
    from scipy.signal import lfilter

    settled = min(round(COMMANDING.settled / (1 - moving)), min(len(y) for y, _ in parts) // 2)
    rows, told = [], []
    for y, known in parts:
        both = lfilter([1.0], [1.0, -moving], np.column_stack([y, np.roll(y, 1), known])[1:], axis=0)
        told.append(both[settled:, 0] - both[settled:, 1:] @ way[0])
        rows.append(both[settled:, 1:] @ way[1])
    a, b = np.concatenate(rows), np.concatenate(told)
    found = np.linalg.lstsq(a, b, rcond=None)[0]
    return way[0] + way[1] @ found, float(((b - a @ found) ** 2).mean())


def as_commanded(subject: Subject) -> Subject:
    """The subject with its measured drive as commands and measurements say together, with a note; else as it is.

    Only where the description says which recorded signal asked for it.
    """
    commands, drives = subject.commands, drives_of(subject.model, subject.logs[0])
    if not commands or subject.model.input_hold == "previous":
        return subject
    paths = [log.inputs[:, :drives].numpy().copy() for log in subject.logs]
    # An autopilot logs every output that it has; the motors come first.
    asked = [log.recording.pick([commands])[0][:, :drives].astype(np.float64) for log in subject.logs]
    if any(c.shape != y.shape for y, c in zip(paths, asked, strict=True)):
        return subject
    stretches = [_stretches(log, c) for log, c in zip(subject.logs, asked, strict=True)]
    found = []
    for channel in range(drives):
        at = [(i, slice(*ends)) for i, of in enumerate(stretches) for ends in of]
        series = [(paths[i][part, channel], asked[i][part, channel]) for i, part in at]
        follows = follower(series) if series else None
        if follows is None:
            return subject
        found.append(follows)
        for (i, part), one in zip(at, series, strict=True):
            paths[i][part, channel] = follows.smoothed(one)
    logs = tuple(
        replace(log, inputs=torch.cat([torch.from_numpy(path), log.inputs[:, drives:]], dim=1))
        for log, path in zip(subject.logs, paths, strict=True)
    )
    noise, left = (float(np.mean(of)) ** 0.5 for of in ([f.sensor for f in found], [f.gains[2] for f in found]))
    if not left < COMMANDING.least_gained * noise:
        return subject
    signal = subject.logs[0].recording.input_channels[0].group
    said = _said(subject, found, noise, left)
    return replace(subject, logs=logs, noise={**subject.noise, signal: left}, notes=(*subject.notes, said))


def _stretches(log: Log, asked: np.ndarray) -> list[tuple[int, int]]:
    """Where a log is valid and its commands (N, m) are numbers, for long enough."""
    good = log.valid.numpy() & np.isfinite(asked).all(axis=1)
    return [(a, b) for a, b in runs(good) if b - a >= COMMANDING.shortest]


def _regressors(commands: np.ndarray) -> np.ndarray:
    """The commands (n,) and their squares, now and before, and a one (n, 2 (latest + 1) + 1)."""
    late = [
        np.concatenate([commands[:1].repeat(j), commands[: len(commands) - j]]) for j in range(COMMANDING.latest + 1)
    ]
    return np.column_stack([*late, *(c * c for c in late), np.ones_like(commands)])


def _said(subject: Subject, found: Sequence[Follower], noise: float, left: float) -> str:
    """What was read, how much noise was in it, and how much is left."""
    channel = subject.logs[0].recording.input_channels[0]
    lag = -subject.logs[0].dt / np.log(np.mean([f.decay for f in found]))
    return (
        f"The {channel.group.replace('_', ' ')} is read as what was measured and the commands say together: it follows "
        f"them with a lag of {1e3 * lag:.3g} ms, and of noise of {noise:.2g} {channel.unit} that leaves {left:.2g}."
    )
