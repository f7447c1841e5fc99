"""From recordings to windows: choose signals, split by recording, fit scalers, list window starts."""

import fnmatch
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

from bench.experiment.config import RunConfig
from registry.contracts import Channel, Dataset, Recording, RecordingSet, Split
from registry.errors import BenchError, near

GRID = 10
"""Prediction starts lie on one grid whatever the history, so that runs of different τ are judged on the same ones."""
HELD_BACK = 0.2
"""Share of each training recording, at its end, that validates where no recording does."""
OVERLAP = 50
"""Consecutive samples that two recordings must share to be called overlapping."""


@lru_cache(maxsize=4)
def load(dataset: Dataset) -> RecordingSet:
    """The recordings of a data set, read once in a process."""
    return dataset.load()


@lru_cache(maxsize=4)
def digest(dataset: Dataset) -> str:
    """SHA-256 over the recordings of a data set."""
    return load(dataset).digest()


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
    of = _of_parts(recordings, valid, split)
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
    )


def _scale(values: Tensor, trained: np.ndarray) -> tuple[Tensor, Tensor]:
    """Mean and standard deviation (c,) of the samples (N, c) that train (N,)."""
    part = values.numpy()[trained].astype(np.float64)
    return torch.from_numpy(part.mean(0)).float(), torch.from_numpy(part.std(0)).float()


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


def _of_parts(
    recordings: Sequence[Recording], valid: Sequence[np.ndarray], split: Split
) -> tuple[tuple[np.ndarray, ...], ...]:
    """Valid samples (N,) of each recording that train, that validate and that test."""
    parts = split.train, split.validation or split.train, split.test
    masks = [[v & (r.name in names) for v, r in zip(valid, recordings, strict=True)] for names in parts]
    if not split.validation:
        for training, held in zip(*masks[:2], strict=True):
            cut = round((1 - HELD_BACK) * len(held))
            training[cut:] = held[:cut] = False
    return tuple(tuple(part) for part in masks)


def remarks(config: RunConfig) -> tuple[str, ...]:
    """What is said of the data before a run: samples that are not as they were logged, no recording to validate."""
    made, split = load(config.dataset).made, choose_split(config)
    if split.validation:
        return made
    return (
        *made,
        f"No recording of {config.dataset.label} is for validation: the last {HELD_BACK:.0%} of "
        f"{', '.join(split.train)} {'is' if len(split.train) == 1 else 'are'}.",
    )


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


def choose_split(config: RunConfig) -> Split:
    """The data set's split, or the one that the configuration names by patterns.

    Raises:
        BenchError: a pattern without a match, a recording on two sides, or overlapping recordings on two sides.
    """
    return _split(config.dataset, config.train, config.validation, config.test)


@lru_cache(maxsize=64)
def _split(
    dataset: Dataset, ask_train: tuple[str, ...], ask_validation: tuple[str, ...], ask_test: tuple[str, ...]
) -> Split:
    loaded = load(dataset)
    default = dataset.split(loaded.names)

    def match(patterns: Sequence[str], otherwise: Sequence[str]) -> tuple[str, ...]:
        if not patterns:
            return tuple(otherwise)
        for p in patterns:
            if not fnmatch.filter(loaded.names, p):
                raise BenchError(f"No recording is called {p!r}: {near(p, loaded.names)}")
        return tuple(n for n in loaded.names if any(fnmatch.fnmatch(n, p) for p in patterns))

    test = match(ask_test, default.test)
    validation = match(ask_validation, [n for n in default.validation if n not in test])
    train = match(ask_train, [n for n in default.train if n not in (*test, *validation)])
    parts = {"train": train, "validation": validation, "test": test}
    for a, b in (("train", "validation"), ("train", "test"), ("validation", "test")):
        twice = sorted(set(parts[a]) & set(parts[b]))
        if twice:
            raise BenchError(f"Recording {twice[0]} is asked for in both {a} and {b}: give it one side.")
    refuse_overlap(loaded.recordings, parts)
    return Split(train, validation, test)


def _row_hashes(recording: Recording) -> np.ndarray:
    """(N,) uint64: equal samples have equal hashes."""
    columns = np.ascontiguousarray(np.concatenate([recording.inputs, recording.outputs], axis=1), dtype=np.float64)
    hashes = np.zeros(len(columns), np.uint64)
    for column in columns.T:  # FNV-1a over the bits of each channel, all samples at once
        hashes = (hashes ^ np.ascontiguousarray(column).view(np.uint64)) * np.uint64(0x100000001B3)
        hashes ^= hashes >> np.uint64(29)
    return hashes


def _among(values: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Which of the values (N,) are among the known ones, sorted; `np.isin` would sort these again."""
    if not len(known):
        return np.zeros(len(values), bool)
    return known[np.minimum(np.searchsorted(known, values), len(known) - 1)] == values


def refuse_overlap(recordings: Sequence[Recording], parts: dict[str, tuple[str, ...]]) -> None:
    """Raise `BenchError` when recordings of two parts share a stretch of `OVERLAP` samples, shifted or not."""
    hashes = {r.name: _row_hashes(r) for r in recordings}
    sides = list(parts)
    for a, first in enumerate(sides):
        known = np.unique(np.concatenate([hashes[n] for n in parts[first]] or [np.empty(0, np.uint64)]))
        for second in sides[a + 1 :]:
            for name in parts[second]:
                shared = _among(hashes[name], known)
                shared[1:] &= hashes[name][1:] != hashes[name][:-1]  # a vehicle at rest resembles any other at rest
                run = np.convolve(shared, np.ones(OVERLAP), "valid") if len(shared) >= OVERLAP else np.zeros(0)
                if not (run > OVERLAP - 0.5).any():
                    continue
                counts = {n: int(np.isin(hashes[name], hashes[n]).sum()) for n in parts[first]}
                other = max(counts, key=counts.__getitem__)
                raise BenchError(
                    f"Recordings {other} ({first}) and {name} ({second}) share {OVERLAP} or more samples: "
                    "put both on one side of the split."
                )
