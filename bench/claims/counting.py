"""Kinds of judgement that count: trainings that diverged, samples of a data set, its extremes."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from bench.analysis import stats
from bench.claims.estimate import Estimate, Kind
from bench.claims.evidence import Evidence
from registry.contracts import Loaded


@dataclass(frozen=True)
class Diverged(Kind):
    """Share of the trainings of a that diverged less that of b; every trained network counts once."""

    a: str
    b: str

    def measure(self, evidence: Evidence, alpha: float) -> list[Estimate]:
        """See `Kind.measure`."""
        counts = []
        for pattern in (self.a, self.b):
            runs = [r for s in evidence.specs(pattern) for r in evidence.of(s)]
            counts.append((sum(not r.sound for r in runs), len(runs)))
        a, b = counts
        if not a[1] or not b[1]:
            return []
        name = f"{a[0]} of {a[1]} trainings against {b[0]} of {b[1]}, difference of the shares"
        low, high = np.clip(stats.share_difference(a, b, 1 - alpha), -1, 1)  # rounding may leave 1 + 2e-16
        return [
            Estimate(
                name, a[0] / a[1] - b[0] / b[1], float(low), float(high), "Newcombe's interval; trainings are the unit"
            )
        ]


class Fact(ABC):
    """A way to judge a claim on the data set itself; subclasses as those of `Kind`."""

    @abstractmethod
    def count(self, loaded: Loaded) -> list[Estimate]:
        """Every number that must lie in the acceptance band; facts have no interval."""


def _fact(name: str, value: float) -> Estimate:
    return Estimate(name, value, value, value)


@dataclass(frozen=True)
class Samples(Fact):
    """Time steps of all recordings together."""

    def count(self, loaded: Loaded) -> list[Estimate]:
        """See `Fact.count`."""
        return [_fact(f"samples in {len(loaded.recordings)} recordings:", sum(map(len, loaded.recordings)))]


@dataclass(frozen=True)
class Recordings(Fact):
    """Number of recordings."""

    def count(self, loaded: Loaded) -> list[Estimate]:
        """See `Fact.count`."""
        return [_fact("recordings:", len(loaded.recordings))]


@dataclass(frozen=True)
class Hours(Fact):
    """Time recorded, in hours."""

    def count(self, loaded: Loaded) -> list[Estimate]:
        """See `Fact.count`."""
        return [_fact("hours:", sum(len(r) / r.rate for r in loaded.recordings) / 3600)]


@dataclass(frozen=True)
class Maxima(Fact):
    """Largest absolute value of channels or signals [SI], each over what is published."""

    names: tuple[str, ...]
    values: tuple[float, ...]

    def count(self, loaded: Loaded) -> list[Estimate]:
        """See `Fact.count`."""
        found = []
        for name, published in zip(self.names, self.values, strict=True):
            largest = [
                float(np.abs(r.outputs[r.valid][:, i]).max())
                for r in loaded.recordings
                for i, c in enumerate(r.output_channels)
                if name in (c.name, c.group) and r.valid.any()
            ]
            if largest:
                found.append(_fact(f"{name} {max(largest):.4f} / {published:g} =", max(largest) / published))
        return found
