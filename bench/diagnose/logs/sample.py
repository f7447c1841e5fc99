"""Of many recordings a sample: what a diagnosis costs must not grow with what it does not need."""

import ctypes
from collections.abc import Iterable, Sequence, Sized
from contextlib import suppress
from dataclasses import replace
from typing import TypeVar

import numpy as np
import torch
from scipy.ndimage import convolve1d
from torch import Tensor

from bench.diagnose.logs.subject import Log, Subject
from bench.diagnose.settings import READING

T = TypeVar("T")


def sampled(subject: Subject) -> Subject:
    """A subject with no more samples than a diagnosis has use for: whole recordings, evenly spread.

    Those to fit and those that only test keep their shares. Of few long recordings the middle of each.
    """
    share = READING.enough / sum(map(len, subject.logs))
    if share >= 1:
        return subject
    parts = [
        subject.of(spread(names, max(READING.fewest, int(share * len(names)))))
        for names in (subject.training, subject.held_out)
    ]
    whole = sum(len(log) for part in parts for log in part)
    cut = min(1.0, READING.enough / whole)
    parts = [tuple(own(log) for log in shortened(part, int(cut * sum(map(len, part))))) for part in parts]
    training, held_out = (tuple(log.name for log in part) for part in parts)
    by_name = {log.name: log for part in parts for log in part}
    logs = tuple(by_name[log.name] for log in subject.logs if log.name in by_name)
    what = "of each" if len(logs) == len(subject.logs) else f"of {len(logs)} of them, evenly spread,"
    what = what if cut == 1 else f"the middle {100 * cut:.0f} % {what}"
    note = (
        f"{len(subject.logs)} recordings were read and checked, and {what.removeprefix('of ')} diagnosed: effects are "
        f"fitted to {len(training)} and tested on {len(held_out)}. More would be slower and no surer."
    )
    return replace(subject, logs=logs, training=training, held_out=held_out, notes=(*subject.notes, note))


def typical_length(series: Iterable[Sized]) -> int:
    """Length of the series that a sample lies in, on average: a short one among long ones changes it little."""
    lengths = np.array([len(x) for x in series])
    return round(float((lengths**2).sum() / max(1, lengths.sum())))


def shared(log: Log) -> Log:
    """The log with its states in the memory of the recording, where they stand there as they are.

    Of a thousand recordings a third of the memory. What is computed with takes less time on a copy: see `own`.
    """
    outputs, states = log.recording.outputs, log.states.numpy()
    for first in range(outputs.shape[1] - states.shape[1] + 1):
        part = outputs[:, first : first + states.shape[1]]
        if part.dtype == states.dtype and np.array_equal(part, states):
            return replace(log, states=torch.from_numpy(part))
    return log


def own(log: Log) -> Log:
    """The log with states of its own."""
    return replace(log, states=log.states.contiguous())


def give_back() -> None:
    """Let the system have the memory of recordings that were let go; the allocator keeps it where it can (glibc)."""
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)


def spread(some: Sequence[T], most: int) -> Sequence[T]:
    """At most so many of some, one at least, evenly spread."""
    if len(some) <= most:
        return some
    return [some[i] for i in np.linspace(0, len(some) - 1, max(1, most)).round().astype(int)]


def shortened(logs: Sequence[Log], longest: int, stride: int = 1, held: Sequence[int] = ()) -> list[Log]:
    """The middle of each log, every ``stride``-th sample; all together have no more than ``longest``.

    Where that is not valid, the stretch nearest to it that has the most valid samples.
    Of more logs than can have a stretch worth looking at, as many as can, evenly spread. Inputs are their means about
    the samples that are kept: what drives a slow motion is their integral, and picked ones would keep all their noise.

    Args:
        logs: whole recordings.
        longest: samples, of all together.
        stride: samples to one that is kept.
        held: the inputs that hold until the next sample: their means are of the samples from there on.
    """
    samples = longest * stride
    logs = spread(logs, int(samples / (READING.stretch * max(log.pace for log in logs))))
    share = min(1.0, samples / sum(map(len, logs)))
    out = []
    for log in logs:
        length = max(1, int(len(log) * share))
        first = _nearest_valid(log, length, int(len(log) * (1 - share) / 2))
        part = slice(first, first + length, stride)
        # A sample that is left out must not hide that it is not valid.
        gaps = torch.from_numpy(
            np.minimum.reduceat(log.valid[part.start : part.stop].numpy(), np.arange(0, part.stop - first, stride))
        )
        out.append(
            replace(
                log,
                rate=log.rate / stride,
                states=log.states[part],
                inputs=_averaged(log, stride, held)[part],
                valid=gaps,
                sensed=None if log.sensed is None else log.sensed[part],
                between=None if stride == 1 else _between(log, part),
                finer=None if stride == 1 or log.missed is not None else log.states[_whole(log, part)],
                missed=None if stride > 1 or log.missed is None else log.missed[part.start : part.stop - 1],
                recording=replace(
                    log.recording,
                    rate=log.rate / stride,
                    inputs=log.recording.inputs[part],
                    outputs=log.recording.outputs[part],
                    valid=gaps.numpy(),
                ),
            )
        )
    return out


def _nearest_valid(log: Log, length: int, wanted: int) -> int:
    """Where so many samples begin of which the most are valid; of several such places the one nearest to ``wanted``."""
    valid = np.concatenate([[0], np.cumsum(log.valid.numpy())])
    count = valid[length:] - valid[: len(valid) - length]
    most = np.flatnonzero(count == count.max())
    return int(most[np.abs(most - wanted).argmin()])


def _between(log: Log, part: slice) -> Tensor:
    """Means (J − 1, s) of the states from each sample that is kept to the next, of those from each to each.

    Of what swings at ω the two ends alone would tell (ω dt)²/12 too much, which is more than noise leaves where it is
    low. Inputs are averaged alike.
    """
    of = _whole(log, part)
    whole = log.means[of.start : of.stop - 1]
    return whole.unflatten(0, (len(whole) // part.step, part.step)).mean(1)


def _whole(log: Log, part: slice) -> slice:
    """From the first sample that is kept to the last, with those that are left out."""
    return slice(part.start, range(part.start, min(part.stop, len(log)), part.step)[-1] + 1)


def _averaged(log: Log, stride: int, held: Sequence[int]) -> Tensor:
    """Inputs (N, m) of which every ``stride``-th stands for all: a line between two of these has their mean.

    Of those that are ``held``, the mean from a sample on. Of others the means about each sample, sharpened: two that
    overlap tell the mean of twice the interval, and an eighth of their curvature is the difference, to fourth order in
    its length.
    """
    if stride == 1:
        return log.inputs
    u, t, good = log.inputs.numpy(), np.arange(len(log)), log.valid.numpy()
    if good.any() and not good.all():  # what is not valid must not reach the samples about it
        u = np.stack([np.interp(t, t[good], column[good]) for column in u.T], axis=1)
    sharp = np.zeros(2 * stride + 1)
    sharp[[0, stride, -1]] = -1 / 8, 5 / 4, -1 / 8
    about = np.ones(stride) if stride % 2 else np.array([0.5, *np.ones(stride - 1), 0.5])
    out, some = convolve1d(u, np.convolve(about / stride, sharp), axis=0, mode="nearest"), list(held)
    out[:, some] = convolve1d(u[:, some], np.ones(stride) / stride, axis=0, mode="nearest", origin=(stride - 1) // 2)
    return torch.from_numpy(np.where(np.isfinite(out), out, u))


def left_out(logs: Sequence[Log], looked_at: Sequence[Log]) -> tuple[str, ...]:
    """How much of the recordings that are learnt from effects were sought in, where that is not all."""
    given, seen = (sum(len(log) / log.rate for log in some) for some in (logs, looked_at))
    if seen > 0.99 * given:
        return ()
    names = {log.name for log in looked_at}
    of = sum(len(log) / log.rate for log in logs if log.name in names)
    those = "each" if len(names) == len(logs) else f"{len(names)}"
    return (
        f"Effects were sought in the middle {100 * seen / of:.0f} % of {those} of the {len(logs)} recordings that are "
        f"learnt from, {seen:.0f} s in all: more would be slower and no surer.",
    )
