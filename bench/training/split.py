"""Which recordings train, validate and test; data that overlap are never on two sides."""

import fnmatch
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from bench.experiment.config import RunConfig
from registry.contracts import Dataset, Recording, RecordingSet, Split
from registry.errors import BenchError, near

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


def of_parts(
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
            raise BenchError(f"Recording {twice[0]} is named in both {a} and {b}: name it in one of them.")
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
                    "put both into the same part of the split."
                )
