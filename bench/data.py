"""From recordings to windows: choose signals, split by recording, fit scalers, list window starts."""

import fnmatch
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

from bench.config import RunConfig
from registry.contracts import Channel, Dataset, Loaded, Recording, Split
from registry.errors import BenchError, near

GRID = 10
"""Prediction starts lie on one grid whatever the history, so that runs of different τ are judged on the same ones."""
OVERLAP = 50
"""Consecutive samples that two recordings must share to be called overlapping."""


@lru_cache(maxsize=4)
def load(dataset: Dataset) -> Loaded:
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
class Prepared:
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
        index = starts.unsqueeze(-1) + torch.arange(self.tau + self.horizon)
        u, y = self.inputs[index], self.outputs[index]
        history = y[:, : self.tau]
        if self.context_channels:
            history = torch.cat([history, self.context[index[:, : self.tau]]], -1)
        return u[:, : self.tau], history, u[:, self.tau :], y[:, self.tau :]


def prepare(config: RunConfig) -> Prepared:
    """Windows and scalers of a run.

    Raises:
        BenchError: a signal that was not measured, a split that overlaps, or a part without a single window.
    """
    config = config.resolved()
    recordings = load(config.dataset).recordings
    rate = recordings[0].rate
    odd = [r.name for r in recordings if r.rate != rate]
    if odd:
        raise BenchError(f"Recording {odd[0]} is not at {rate:g} Hz like {recordings[0].name}: resample one of them.")
    split = choose_split(config)
    (inputs, u_channels), (outputs, y_channels), (context, c_channels) = (
        _pick(recordings, selectors) for selectors in (config.inputs, config.outputs, config.context)
    )
    both = {c.name for c in (*u_channels, *c_channels)} & {c.name for c in y_channels}
    if both:
        raise BenchError(f"{', '.join(sorted(both))} cannot be an input and an output at once.")
    joined = np.concatenate([r.valid for r in recordings])
    joined &= np.isfinite(inputs).all(1) & np.isfinite(outputs).all(1) & np.isfinite(context).all(1)
    valid = np.split(joined, np.cumsum([len(r) for r in recordings])[:-1])
    offsets = np.cumsum([0, *(len(r) for r in recordings)])
    length = config.tau + config.horizon

    def windows(names: Sequence[str], stride: int, part: str) -> Windows:
        starts, which = [], []
        for i, r in enumerate(recordings):
            if r.name in names:
                found = window_starts(valid[i], length, stride, (GRID - config.tau) % stride)
                starts.append(found + offsets[i])
                which.append(np.full(len(found), i))
        joined = np.concatenate(starts) if starts else np.empty(0, int)
        if not len(joined):
            raise BenchError(
                f"The {part} part of {config.dataset.label} has no window of {config.tau} + "
                f"{config.horizon} valid samples: shorten the horizon or give it other recordings."
            )
        return Windows(torch.from_numpy(joined), np.concatenate(which))

    train = np.concatenate([v & (r.name in split.train) for v, r in zip(valid, recordings, strict=True)])

    def scale(x: np.ndarray) -> tuple[Tensor, Tensor]:
        part = x[train].astype(np.float64)
        return torch.from_numpy(part.mean(0)).float(), torch.from_numpy(part.std(0)).float()

    return Prepared(
        inputs=torch.from_numpy(np.nan_to_num(inputs)),
        outputs=torch.from_numpy(np.nan_to_num(outputs)),
        context=torch.from_numpy(np.nan_to_num(context)),
        input_channels=u_channels,
        output_channels=y_channels,
        context_channels=c_channels,
        rate=rate,
        tau=config.tau,
        horizon=config.horizon,
        train=windows(split.train, config.train_stride, "training"),
        validation=windows(split.validation, config.test_stride, "validation"),
        test=windows(split.test, config.test_stride, "test"),
        names=tuple(r.name for r in recordings),
        split=split,
        input_scale=scale(inputs),
        output_scale=scale(outputs),
        context_scale=scale(context),
    )


def _pick(recordings: Sequence[Recording], selectors: Sequence[str]) -> tuple[np.ndarray, tuple[Channel, ...]]:
    """The named signals of all recordings, joined (N, c) float32, and their channels."""
    if not selectors:
        return np.empty((sum(map(len, recordings)), 0), np.float32), ()
    picked = [r.pick(selectors) for r in recordings]
    return np.concatenate([values for values, _ in picked]).astype(np.float32), picked[0][1]


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


def refuse_overlap(recordings: Sequence[Recording], parts: dict[str, tuple[str, ...]]) -> None:
    """Raise `BenchError` when recordings of two parts share a stretch of `OVERLAP` samples, shifted or not."""
    hashes = {r.name: _row_hashes(r) for r in recordings}
    sides = list(parts)
    for a, first in enumerate(sides):
        known = np.unique(np.concatenate([hashes[n] for n in parts[first]] or [np.empty(0, np.uint64)]))
        for second in sides[a + 1 :]:
            for name in parts[second]:
                shared = np.isin(hashes[name], known)
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
