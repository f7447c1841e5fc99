"""From recordings to windows: choose signals, fit scalers, list window starts."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

from bench.experiment.config import RunConfig
from bench.training.split import choose_split, load, of_parts
from registry.contracts import Channel, Dataset, Split
from registry.errors import BenchError

GRID = 10
"""Prediction starts lie on one grid whatever the history, so that runs of different τ are judged on the same ones."""


@dataclass(frozen=True)
class Windows:
    """Starts of the windows of one part: indices of the first history sample into the joined recordings."""

    starts: Tensor
    """(W,) int64."""
    recording: np.ndarray
    """(W,) index of each window's recording."""

    def __len__(self) -> int:
        return len(self.starts)

    def every(self, count: int) -> "Windows":
        """At most ``count`` windows, evenly spread."""
        if len(self) <= count:
            return self
        pick = np.linspace(0, len(self) - 1, count).round().astype(int)
        return Windows(self.starts[torch.from_numpy(pick)], self.recording[pick])


@dataclass(frozen=True, eq=False)
class WindowedData:
    """Everything a run needs of its data. SI inside; the scalers belong to the model."""

    inputs: Tensor
    """(N, m) all recordings joined."""
    outputs: Tensor
    """(N, n)."""
    context: Tensor
    """(N, c) what is measured during the history only."""
    input_channels: tuple[Channel, ...]
    output_channels: tuple[Channel, ...]
    context_channels: tuple[Channel, ...]
    rate: float
    """Samples per second [Hz]."""
    tau: int
    horizon: int
    train: Windows
    validation: Windows
    test: Windows
    names: tuple[str, ...]
    """Recordings, in the order joined."""
    split: Split
    input_scale: tuple[Tensor, Tensor]
    """Mean and standard deviation of the training part, (m,) each."""
    output_scale: tuple[Tensor, Tensor]
    context_scale: tuple[Tensor, Tensor]
    increment_scale: Tensor | None = None
    """Root mean square (n,) of the outputs' change in a step over the training part, for what predicts changes."""
    held_back: tuple[tuple[int, int], ...] = ()
    """Start and length of the longest stretch of valid samples that validate, of each recording that has one."""

    def gather(self, starts: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """History inputs (B, τ, m) and outputs (B, τ, n + c), horizon inputs (B, T, m) and outputs (B, T, n), SI."""
        length = self.tau + self.horizon
        u, y = _at(self.inputs, starts, length), _at(self.outputs, starts, length)
        history = y[:, : self.tau]
        if self.context_channels:
            history = torch.cat([history, _at(self.context, starts, self.tau)], -1)
        return u[:, : self.tau], history, u[:, self.tau :], y[:, self.tau :]


def _at(signals: Tensor, starts: Tensor, length: int) -> Tensor:
    """Windows (B, length, c) of signals (N, c), each copied in one piece."""
    samples, width = signals.shape
    row, column = signals.stride()
    windows = signals.as_strided((samples - length + 1, length, width), (row, row, column))
    return windows[starts]


def prepare(config: RunConfig) -> WindowedData:
    """Windows and scalers of a run; runs that differ in model, training or seed share them.

    Raises:
        BenchError: a signal that was not measured, a split that overlaps, or a part without a single window.
    """
    c = config.resolved()
    strides = {"training": c.train_stride, "validation": c.test_stride, "test": c.test_stride}
    signals = c.inputs, c.outputs, c.context
    return _prepare(c.dataset, signals, choose_split(c), c.tau, c.horizon, tuple(strides.items()))


@lru_cache(maxsize=32)
def _prepare(
    dataset: Dataset,
    signals: tuple[tuple[str, ...], ...],
    split: Split,
    tau: int,
    horizon: int,
    strides: tuple[tuple[str, int], ...],
) -> WindowedData:
    recordings = load(dataset).recordings
    rate = recordings[0].rate
    odd = [r.name for r in recordings if r.rate != rate]
    if odd:
        raise BenchError(f"Recording {odd[0]} is not at {rate:g} Hz like {recordings[0].name}: resample one of them.")
    inputs, outputs, context = (_signals(dataset, selectors) for selectors in signals)
    both = {c.name for c in (*inputs.channels, *context.channels)} & {c.name for c in outputs.channels}
    if both:
        raise BenchError(f"{', '.join(sorted(both))} cannot be an input and an output at once.")
    joined = np.concatenate([r.valid for r in recordings]) & inputs.finite & outputs.finite & context.finite
    valid = np.split(joined, np.cumsum([len(r) for r in recordings])[:-1])
    of = of_parts(recordings, valid, split)
    made = {}
    for (part, stride), own in zip(strides, of, strict=True):
        starts, which = _starts(own, tau + horizon, stride, first=(GRID - tau) % stride)
        if not len(starts):
            raise BenchError(
                f"The {part} part of {dataset.label} has no window of {tau} + "
                f"{horizon} valid samples: shorten the horizon or give it other recordings."
            )
        made[part] = Windows(torch.from_numpy(starts), which)
    trained = np.concatenate(of[0])
    return WindowedData(
        inputs=inputs.values,
        outputs=outputs.values,
        context=context.values,
        input_channels=inputs.channels,
        output_channels=outputs.channels,
        context_channels=context.channels,
        rate=rate,
        tau=tau,
        horizon=horizon,
        train=made["training"],
        validation=made["validation"],
        test=made["test"],
        names=tuple(r.name for r in recordings),
        split=split,
        input_scale=_scale(inputs.values, trained),
        output_scale=_scale(outputs.values, trained),
        context_scale=_scale(context.values, trained),
        increment_scale=_change(outputs.values, of[0]),
        held_back=_stretches(of[1], tau),
    )


def _stretches(valid: Sequence[np.ndarray], tau: int) -> tuple[tuple[int, int], ...]:
    """Start among the samples of all recordings, joined, and length of each one's longest valid stretch beyond τ."""
    found, before = [], 0
    for own in valid:
        edges = np.flatnonzero(np.diff(np.concatenate([[False], own, [False]])))
        starts, lengths = edges[::2], edges[1::2] - edges[::2]
        if lengths.max(initial=0) > tau:
            found.append((before + int(starts[lengths.argmax()]), int(lengths.max())))
        before += len(own)
    return tuple(found)


def _scale(values: Tensor, trained: np.ndarray) -> tuple[Tensor, Tensor]:
    """Mean and standard deviation (c,) of the samples (N, c) that train (N,)."""
    part = values.numpy()[trained].astype(np.float64)
    return torch.from_numpy(part.mean(0)).float(), torch.from_numpy(part.std(0)).float()


def _change(values: Tensor, trained: Sequence[np.ndarray]) -> Tensor:
    """Root mean square change (c,) of (N, c) from sample to sample, where both train and are of one recording."""
    follows = np.concatenate([own & np.append(False, own[:-1]) for own in trained])
    part = np.diff(values.numpy().astype(np.float64), axis=0)[follows[1:]]
    return torch.from_numpy(np.sqrt(np.mean(part**2, axis=0))).float()


def _starts(valid: Sequence[np.ndarray], length: int, stride: int, first: int) -> tuple[np.ndarray, np.ndarray]:
    """Starts of windows (W,) among the samples of all recordings, joined, and the recording of each (W,).

    Args:
        valid: samples of each recording that a window may hold, (N,) each.
        length: samples of a window.
        stride: samples between the starts of two.
        first: start of the first in a recording without invalid samples.
    """
    starts, which, before = [np.empty(0, int)], [np.empty(0, int)], 0
    for i, own in enumerate(valid):
        if own.any():
            found = window_starts(own, length, stride, first)
            starts.append(found + before)
            which.append(np.full(len(found), i))
        before += len(own)
    return np.concatenate(starts), np.concatenate(which)


@dataclass(frozen=True, eq=False)
class _Signals:
    """Some signals of all recordings, joined."""

    values: Tensor
    """(N, c) float32, zero where it is not finite."""
    channels: tuple[Channel, ...]
    finite: np.ndarray
    """(N,) whether all of a sample are."""


@lru_cache(maxsize=16)
def _signals(dataset: Dataset, selectors: tuple[str, ...]) -> _Signals:
    recordings = load(dataset).recordings
    picked = [r.pick(selectors) for r in recordings]
    values = np.ascontiguousarray(np.concatenate([v for v, _ in picked]), np.float32)  # a sample in one piece
    finite = np.asarray(np.isfinite(values).all(axis=1))
    values[~finite] = np.nan_to_num(values[~finite])
    return _Signals(torch.from_numpy(values), picked[0][1], finite)


def window_starts(valid: np.ndarray, length: int, stride: int, first: int = 0) -> np.ndarray:
    """Starts, ``stride`` apart from ``first``, of windows of ``length`` samples that touch no invalid one; (W,) int."""
    if len(valid) < length:
        return np.empty(0, dtype=int)
    bad = np.concatenate([[0], np.cumsum(~valid)])
    starts = np.arange(first, len(valid) - length + 1, stride)
    return starts[bad[starts + length] == bad[starts]]
