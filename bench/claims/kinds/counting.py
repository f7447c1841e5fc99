"""Kinds of judgement that count: trainings that diverged, samples of a data set, its extremes."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from typing_extensions import override

from bench.analysis import stats
from bench.claims.estimate import Estimate, Kind, fact
from bench.claims.evidence import Evidence

if TYPE_CHECKING:  # it loads torch
    from registry.contracts import RecordingSet


@dataclass(frozen=True)
class Diverged(Kind):
    """Share of the trainings of a that diverged less that of b; every trained network counts once."""

    a: str
    b: str

    relative: ClassVar[bool] = False

    @override
    def measure(self, evidence: Evidence) -> list[Estimate]:
        counts = []
        for pattern in (self.a, self.b):
            runs = [r for s in evidence.specs(pattern) for r in evidence.of(s)]
            counts.append((sum(not r.sound for r in runs), len(runs)))
        a, b = counts
        if not a[1] or not b[1]:
            return []
        name = f"{a[0]} of {a[1]} trainings against {b[0]} of {b[1]}, difference of the shares"

        def limits(alpha: float, seeds: float, recordings: float) -> tuple[float, float]:
            more = [(seeds * count, seeds * of) for count, of in (a, b)]
            low, high = stats.share_difference(more[0], more[1], 1 - alpha)
            return max(low, -1.0), min(high, 1.0)  # rounding may leave 1 + 2e-16

        seeds = min(evidence.seeds_of((self.a, self.b)).values(), default=0)
        difference = a[0] / a[1] - b[0] / b[1]
        return [Estimate(name, difference, limits, "Newcombe's interval; trainings are the unit", seeds=seeds)]


class Fact(ABC):
    """A way to judge a claim on the data set itself; subclasses as those of `Kind`."""

    @abstractmethod
    def count(self, loaded: "RecordingSet") -> list[Estimate]:
        """Every number that must lie in the acceptance band; facts have no interval."""


@dataclass(frozen=True)
class Samples(Fact):
    """Time steps of all recordings together."""

    @override
    def count(self, loaded: "RecordingSet") -> list[Estimate]:
        return [fact(f"samples in {len(loaded.recordings)} recordings:", sum(map(len, loaded.recordings)))]


@dataclass(frozen=True)
class Hours(Fact):
    """Time recorded, in hours."""

    @override
    def count(self, loaded: "RecordingSet") -> list[Estimate]:
        return [fact("hours:", sum(len(r) / r.rate for r in loaded.recordings) / 3600)]


@dataclass(frozen=True)
class Maxima(Fact):
    """Largest absolute value of channels or signals [SI], each over what is published."""

    names: tuple[str, ...]
    values: tuple[float, ...]

    @override
    def count(self, loaded: "RecordingSet") -> list[Estimate]:
        found = []
        for name, published in zip(self.names, self.values, strict=True):
            largest = [
                float(np.abs(r.outputs[r.valid][:, i]).max())
                for r in loaded.recordings
                for i, c in enumerate(r.output_channels)
                if name in (c.name, c.group) and r.valid.any()
            ]
            if largest:
                found.append(fact(f"{name} {max(largest):.4f} / {published:g} =", max(largest) / published))
        return found
