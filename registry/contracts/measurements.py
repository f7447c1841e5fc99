"""What was measured: channels, recordings, what cleaning found in them, and how they are split."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from registry.errors import BenchError, near


@dataclass(frozen=True)
class Channel:
    """One column of a recording, named ``group.axis`` ("body_rates.p"), in an SI unit."""

    name: str
    unit: str

    @property
    def group(self) -> str:
        """The signal this channel belongs to."""
        return self.name.partition(".")[0]

    @property
    def axis(self) -> str:
        """Its axis within the signal."""
        return self.name.partition(".")[2]


@dataclass(frozen=True, eq=False)
class Recording:
    """One continuous measurement at a constant rate.

    Args:
        name: unique within its data set.
        rate: samples per second [Hz].
        inputs: (N, m) what drives the system, SI; m = 0 for an undriven one.
        outputs: (N, n) everything else that was measured, SI.
        input_channels: the m columns of ``inputs``.
        output_channels: the n columns of ``outputs``.
        valid: (N,) bool; a window never touches a sample that is not valid.
        begins: time of the first sample after the start of what it was cut from [s].
    """

    name: str
    rate: float
    inputs: np.ndarray
    outputs: np.ndarray
    input_channels: tuple[Channel, ...]
    output_channels: tuple[Channel, ...]
    valid: np.ndarray
    begins: float = 0.0

    def __post_init__(self) -> None:
        n = len(self.outputs)
        if self.inputs.shape != (n, len(self.input_channels)):
            raise ValueError(f"{self.name}: inputs {self.inputs.shape} do not fit {len(self.input_channels)} channels")
        if self.outputs.shape != (n, len(self.output_channels)) or self.valid.shape != (n,):
            raise ValueError(f"{self.name}: outputs {self.outputs.shape} or mask {self.valid.shape} do not fit")
        names = [c.name for c in (*self.input_channels, *self.output_channels)]
        if len(set(names)) != len(names):
            raise ValueError(f"{self.name}: two channels of one name")

    def __len__(self) -> int:
        return len(self.outputs)

    @property
    def seconds(self) -> float:
        """Duration [s]."""
        return len(self) / self.rate

    def part(self, at: slice, name: str) -> Recording:
        """Some of the samples, as a recording of this name."""
        begins, inputs = self.begins + at.indices(len(self))[0] / self.rate, self.inputs[at]
        return replace(self, name=name, inputs=inputs, outputs=self.outputs[at], valid=self.valid[at], begins=begins)

    @property
    def channels(self) -> tuple[Channel, ...]:
        """Input and output channels."""
        return (*self.input_channels, *self.output_channels)

    def pick(self, selectors: Sequence[str]) -> tuple[np.ndarray, tuple[Channel, ...]]:
        """The columns (N, len) of the named groups ("body_rates") or channels ("body_rates.p"), in that order.

        Raises:
            BenchError: nothing of that name was measured.
        """
        picked = places(self.channels, selectors, f"Recording {self.name}")
        columns = np.concatenate([self.inputs, self.outputs], axis=1)
        return columns[:, picked], tuple(self.channels[i] for i in picked)

    def digest(self) -> str:
        """SHA-256 over samples, mask, rate and channel names (not the recording's own name)."""
        h = hashlib.sha256(repr((self.rate, [(c.name, c.unit) for c in self.channels])).encode())
        for a in (self.inputs, self.outputs, self.valid):
            h.update(np.ascontiguousarray(a).tobytes())
        return h.hexdigest()


def places(channels: Sequence[Channel], selectors: Sequence[str], owner: str) -> list[int]:
    """Where the named groups or channels are among an owner's channels, in the order of the names.

    Raises:
        BenchError: it has none of that name.
    """
    picked: list[int] = []
    for selector in selectors:
        found = [i for i, c in enumerate(channels) if selector in (c.name, c.group)]
        if not found:
            known = {c.group for c in channels} | {c.name for c in channels}
            raise BenchError(f"{owner} has no signal {selector!r}: {near(selector, known)}")
        picked += [i for i in found if i not in picked]
    return picked


@dataclass(frozen=True)
class Finding:
    """One thing that cleaning found in a recording and what was done about it."""

    recording: str
    kind: str
    """Such as "spike", "held", "dropped", "gap", "trimmed", "lag", "duplicate", "short"."""
    count: float
    """Samples concerned (for a lag: samples of shift)."""
    detail: str
    """One sentence with figures and units."""


@dataclass(frozen=True)
class RecordingSet:
    """What `Dataset.load` returns: the recordings that are left, and everything that was found in them."""

    recordings: tuple[Recording, ...]
    findings: tuple[Finding, ...]

    def digest(self) -> str:
        """SHA-256 over all recordings, in order, with their names."""
        h = hashlib.sha256()
        for r in self.recordings:
            h.update(f"{r.name}:{r.digest()};".encode())
        return h.hexdigest()

    @property
    def names(self) -> list[str]:
        """Names of the recordings."""
        return [r.name for r in self.recordings]

    @property
    def made(self) -> tuple[str, ...]:
        """What was made of samples that are not as they were to be, a sentence a kind."""
        sentences = []
        for kind in ("resampled", "jitter", "missing", "cut"):
            found = sorted((f for f in self.findings if f.kind == kind), key=lambda f: -f.count)
            recordings = dict.fromkeys(f.recording for f in found)
            if found:
                others = f"{len(recordings)} recordings, most of all " if len(recordings) > 1 else ""
                sentences.append(f"{others}{found[0].recording}: {found[0].detail}.")
        return tuple(sentences)


@dataclass(frozen=True)
class Split:
    """Which recordings train, which validate (early stopping, tuning) and which test."""

    train: tuple[str, ...]
    validation: tuple[str, ...]
    test: tuple[str, ...]
