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

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from bench.diagnose.logs.subject import Log, Subject, drives_of
from bench.diagnose.select.timing.acting_noise import acts, share_acting
from bench.diagnose.settings import COMMANDING
from bench.execution.parallel import side_by_side
from registry.contracts import Channel
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
    told_by: float = math.inf
    """Samples for each number that was fitted."""

    @property
    def left(self) -> float:
        """Variance of the error of what is read: what the smoother leaves, and what errors of the numbers make."""
        return self.gains[2] + self.sensor / self.told_by

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


def followers(channels: Sequence[Sequence[Series]]) -> list[Follower] | None:
    """How each channel, given as its stretches, follows its commands; None: one does not, as far as can be told.

    Each in its own way or all alike, as motors of one kind do: of these what Schwarz's criterion (BIC) prefers. Where
    little moves, as in a hover, one alone does not tell noise of its sensor from what it does of its own accord.
    """
    parts = [_enough(channel) for channel in channels]
    together = [[series for part in parts for series in part]] if len(parts) > 1 else []
    (alike, shared), *each = side_by_side(_best, [*together, *parts])
    each = each or [(alike, shared)]
    found = [shared] * len(channels) if alike <= sum(told for told, _ in each) else [f for _, f in each]
    return None if None in found else [f for f in found if f is not None]


def _enough(series: Sequence[Series]) -> list[Series]:
    """The beginning of every stretch, which together tell how a channel follows its commands."""
    share = min(1.0, COMMANDING.enough / max(1, sum(len(y) for y, _ in series)))
    ends = [max(COMMANDING.shortest, round(share * len(y))) for y, _ in series]
    return [(y[:end], commands[:end]) for (y, commands), end in zip(series, ends, strict=True)]


def _best(series: Sequence[Series]) -> tuple[float, Follower | None]:
    """BIC, and how the channel of some stretches follows its commands; None: it does not, as far as can be told.

    Its commands act between two samples or over all of the latest; it becomes what is commanded, or that by a gain and
    an offset, or along a parabola. Numbers that need not be fitted have no error that would look like an effect.
    """
    from scipy.optimize import minimize_scalar

    scale = max((float(np.abs(c).max()) for _, c in series), default=0.0)
    if not scale > 0:
        return math.inf, None
    parts = [(y, _regressors(c / scale)) for y, c in series]
    samples, least = sum(len(y) for y, _ in parts), COMMANDING.rounding * max(float((y * y).max()) for y, _ in parts)

    def fitted(way: Way, own: bool = True) -> tuple[float, np.ndarray, float, float]:
        """BIC, a and the commanded part, the moving-average part, and the variance of the innovations.

        Without noise of its ``own`` the drive is what commands make of it, and the two parts are one (output error).
        """
        bounds = (0.0, COMMANDING.slowest)

        def at(moving: float) -> tuple[np.ndarray, float]:
            return _fitted(parts, way if own else _decaying(way, moving), moving)

        moving = float(minimize_scalar(lambda m: at(m)[1], bounds=bounds, method="bounded").x)
        found, innovation = at(moving)
        numbers = way[1].shape[1] + own + 1
        return samples * math.log(max(innovation, least)) + numbers * math.log(samples), found, moving, innovation

    delays = [(j, j + 1) for j in range(COMMANDING.latest)] + [tuple(range(COMMANDING.latest + 1))]
    linear = {when: fitted(_linear(when)) for when in delays}
    when = min(delays, key=lambda when: linear[when][0])
    ways = _linear(when), _exact(when, scale), _parabola(when)
    told = [linear[when], *map(fitted, ways[1:])]
    chosen = min(range(len(ways)), key=lambda i: told[i][0])
    still = fitted(ways[chosen], own=False)
    criterion, found, moving, innovation = min(told[chosen], still, key=lambda t: t[0])
    decay = float(found[0])
    if not 0 < decay < 1 or innovation <= least:
        return criterion, None
    moving = min(moving, decay)
    sensor = moving * innovation / decay
    own = max(0.0, (1 + moving**2) * innovation - (1 + decay**2) * sensor)
    numbers = ways[chosen][1].shape[1]
    return criterion, Follower(decay, found[1:], scale, sensor, own, samples / numbers)


def _exact(when: Sequence[int], scale: float) -> Way:
    """The drive becomes what was commanded these samples before."""
    known, free = _nothing(), _free([0, *(1 + j for j in when[1:])])
    known[1 + when[0]] = scale
    free[1 + when[0]] = [-scale, *[-1.0] * (len(when) - 1)]
    return known, free


def _linear(when: Sequence[int]) -> Way:
    """It becomes a gain of that, and an offset."""
    return _nothing(), _free([0, *(1 + j for j in when), -1])


def _parabola(when: Sequence[int]) -> Way:
    """It becomes a polynomial of second order of that."""
    squares = COMMANDING.latest + 2
    return _nothing(), _free([0, *(1 + j for j in when), *(squares + j for j in when), -1])


def _nothing() -> np.ndarray:
    return np.zeros(2 * COMMANDING.latest + 4)


def _free(numbers: Sequence[int]) -> np.ndarray:
    """These of a and the commanded part are fitted."""
    return np.eye(2 * COMMANDING.latest + 4)[:, list(numbers)]


def _decaying(way: Way, decay: float) -> Way:
    """The same with a known, which is the first that is fitted."""
    known, free = way
    return known + decay * free[:, 0], free[:, 1:]


def _fitted(parts: Sequence[Series], way: Way, moving: float) -> tuple[np.ndarray, float]:
    """a, then the commanded part; and the variance of the innovations (1 − moving/z)⁻¹ of what these leave."""
    from scipy.signal import lfilter

    settled = min(round(COMMANDING.settled / (1 - moving)), min(len(y) for y, _ in parts) // 2)
    rows = []
    for y, commanded in parts:
        known = np.column_stack([y[:-1], commanded[1:]])
        both = np.column_stack([known @ way[1], y[1:] - known @ way[0]])
        rows.append(lfilter([1.0], [1.0, -moving], both, axis=0)[settled:])
    every = np.concatenate(rows)
    a, b = every[:, :-1], every[:, -1]
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
    at = [(i, slice(*ends)) for i, of in enumerate(stretches) for ends in of]
    series = [[(paths[i][part, c], asked[i][part, c]) for i, part in at] for c in range(drives)]
    found = followers(series) if at else None
    if found is None:
        return subject
    for channel, follows in enumerate(found):
        for (i, part), one in zip(at, series[channel], strict=True):
            paths[i][part, channel] = follows.smoothed(one)
    logs = tuple(
        replace(log, inputs=torch.cat([torch.from_numpy(path), log.inputs[:, drives:]], dim=1))
        for log, path in zip(subject.logs, paths, strict=True)
    )
    noise, left = (float(np.mean(of)) ** 0.5 for of in ([f.sensor for f in found], [f.left for f in found]))
    if not left < COMMANDING.least_gained * noise:
        return subject
    drive, read = subject.logs[0].recording.input_channels[0], replace(subject, logs=logs)
    share, error = share_acting(subject, read)
    if acts(share, error):
        return replace(subject, notes=(*subject.notes, _kept(drive, noise, share, error)))
    said = _said(drive, subject.logs[0].dt, found, noise, left)
    return replace(read, noise={**subject.noise, drive.group: left}, notes=(*subject.notes, said))


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


def _kept(drive: Channel, noise: float, share: float, error: float) -> str:
    """Why the drive stays as it was measured."""
    return (
        f"The {drive.group.replace('_', ' ')} stays as it was measured: what its commands do not say of it "
        f"({noise:.2g} {drive.unit}) is no noise of a sensor, the states answer {share:.2g} ± {2 * error:.1g} of it. "
        "Commands were given more often than they were logged, or the drive does not follow them."
    )


def _said(drive: Channel, dt: float, found: Sequence[Follower], noise: float, left: float) -> str:
    """What was read, how much noise was in it, and how much is left."""
    lag = -dt / np.log(np.mean([f.decay for f in found]))
    return (
        f"The {drive.group.replace('_', ' ')} is read as what was measured and the commands say together: it follows "
        f"them with a lag of {1e3 * lag:.3g} ms, and of noise of {noise:.2g} {drive.unit} that leaves {left:.2g}."
    )
