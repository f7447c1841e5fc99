"""A source of recordings."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar

from registry.contracts.measurements import Channel, Finding, Recording, RecordingSet, Split, places
from registry.core import DATASETS
from registry.errors import BenchError
from registry.units import SIGNALS


class Dataset(ABC):
    """A source of recordings. Subclasses are frozen dataclasses; their fields are options."""

    source: ClassVar[str] = ""
    """Where the data come from: citation or address, and licence."""
    system: ClassVar[str] = ""
    """The registered physics model of the recorded system; empty: there is none, only networks predict it."""
    inputs: ClassVar[tuple[str, ...]] = ()
    """Signals that drive a predictor by default."""
    targets: ClassVar[tuple[str, ...]] = ()
    """Signals that studies and single configurations predict; empty: all that is measured beside the inputs."""
    initial_window: ClassVar[int] = 0
    """Samples at the start of a test recording that its benchmark lets a simulation look at; 0: it is none."""
    chain: ClassVar[tuple[str, ...]] = ()
    """Signals that studies of the whole motion predict together, each driven by the one after it and the last by the
    inputs, such as velocity and body rates; empty: the targets."""
    input_hold: ClassVar[str] = "linear"
    """Inputs between samples: "linear" (measured) or "previous" (commands)."""
    physics: ClassVar[dict[str, Any]] = {}
    """Nominal constants of the recorded system, SI."""
    uncertainty: ClassVar[dict[str, float]] = {}
    """Relative 1σ of these constants, where it is not the model's default."""
    described: ClassVar[str] = ""
    """Where a user states its constants; empty: what is not in ``physics`` is as in the registered system."""
    processing: ClassVar[dict[str, Any]] = {}
    """What was done to the recordings, as [processing] of a dataset.toml says it."""
    recorded: ClassVar[tuple[Channel, ...]] = ()
    """Channels of every recording, inputs first, where they are known before anything is read or simulated."""
    truth: ClassVar[Any] = None
    """The physics model that simulated the recordings, driven by the inputs as they are recorded; None: measured."""
    in_full: ClassVar[dict[str, str]] = {}
    """Options of the whole of the data, where they come in sizes; studies take it for all but smoke tests."""

    @property
    def finer_signals(self) -> dict[str, str]:
        """By signal, the option of the data set that reads it from a finer sensor, such as "gyroscope=true"."""
        return {}

    @property
    def label(self) -> str:
        """What tables and titles call the data: the registered name, unless the data have one of their own."""
        return DATASETS.name_of(type(self))

    def load(self) -> RecordingSet:
        """Read, clean and check. Duplicated recordings are dropped and named in the findings.

        Raises:
            BenchError: the data are absent or broken; the message says what to do.
        """
        loaded = self.read()
        kept: dict[str, Recording] = {}
        findings = list(loaded.findings)
        for recording in loaded.recordings:
            digest = recording.digest()
            if digest in kept:
                findings.append(
                    Finding(
                        recording.name, "duplicate", len(recording), f"dropped: the same samples as {kept[digest].name}"
                    )
                )
            else:
                kept[digest] = recording
        if not kept:
            raise BenchError(f"Dataset {type(self).__name__} holds no usable recording.")
        return RecordingSet(tuple(kept.values()), tuple(findings))

    def channels(self) -> tuple[Channel, ...]:
        """Channels of every recording, inputs first; read from the data where they are not known before."""
        return self.recorded or self.load().recordings[0].channels

    def predicted(self) -> tuple[str, ...]:
        """The signals that a run predicts where it names none: the targets."""
        return self.targets or tuple(dict.fromkeys(c.group for c in self.channels() if c.group not in self.inputs))

    def predicted_together(self) -> tuple[str, ...]:
        """The signals of the chain, or the targets where there is none."""
        return self.chain or self.predicted()

    def predicted_channels(self) -> tuple[str, ...]:
        """The channels of the targets, for studies that give each of them a model of its own."""
        axes = [SIGNALS[s].axes if s in SIGNALS else () for s in self.targets]
        if axes and all(axes) and not self.recorded:  # known without reading the data
            return tuple(f"{s}.{axis}" for s, own in zip(self.targets, axes, strict=True) for axis in own)
        known = self.channels()
        return tuple(known[i].name for i in places(known, self.predicted(), f"The data set {self.label}"))

    @abstractmethod
    def read(self) -> RecordingSet:
        """The cleaned recordings, duplicates included; called by `load`."""

    @abstractmethod
    def split(self, names: Sequence[str]) -> Split:
        """The published or default split of the recordings ``names``."""
