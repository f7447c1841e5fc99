"""One recording from end to end beside what the models make of it: what the page draws over time and from above."""

from dataclasses import dataclass

import numpy as np

AFTER = "after"
"""The model that the diagnosis ends with."""
RUNS = ("measured", "nominal", AFTER)
"""The lines of a trace, in the order of drawing."""


@dataclass(frozen=True, eq=False)
class Trace:
    """One channel over time. The pieces of a line follow one another; between two of them it is broken."""

    channel: str
    """Such as "velocity.x"."""
    lines: dict[str, tuple[tuple[np.ndarray, np.ndarray], ...]]
    """By one of `RUNS`: pieces of sample numbers (n,), counted from 0, and values (n,), SI."""
    rms: dict[str, float]
    """By model: root mean square of its error over all samples, SI; NaN: it ran nowhere, or diverged."""


@dataclass(frozen=True, eq=False)
class Signal:
    """The channels of one group."""

    name: str
    unit: str
    traces: tuple[Trace, ...]
    sensed: bool = False
    """Whether a sensor shows the rates themselves: then a model is asked at every measured state and runs nowhere."""


@dataclass(frozen=True, eq=False)
class Path:
    """A flight seen from above, in stretches of one free run each."""

    stretches: tuple[np.ndarray, ...]
    """(n, 2) measured x and y [m]."""
    group: str
    """Whose error colours the stretches, such as "velocity"."""
    unit: str
    errors: dict[str, np.ndarray]
    """By model: root mean square error (stretches,) of the free run, SI; not finite where it diverged."""


@dataclass(frozen=True, eq=False)
class Flight:
    """A recording and the free runs of the models through it, begun anew from the measured state at an interval."""

    recording: str
    held_out: bool
    dt: float
    """Sampling period [s]."""
    samples: int
    """Shown, from the first on."""
    whole: int
    """Of the recording."""
    restart_s: float
    signals: tuple[Signal, ...]
    path: Path | None = None
    """None: there is no position."""

    @property
    def points(self) -> int:
        """Of all lines together."""
        return sum(len(at) for s in self.signals for t in s.traces for line in t.lines.values() for at, _ in line)
