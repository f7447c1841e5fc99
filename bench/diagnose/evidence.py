"""The evidence behind a diagnosis: what its page shows beyond the contract."""

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from bench.analysis.display import draw_curves, new_axes
from bench.diagnose.by_equation import InverseDynamics, ObscuredConstant
from bench.diagnose.learned_shape import LearnedCurve
from bench.experiment.asked import Asked
from registry.units import display

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LINES = ("nominal", "calibrated", "extended", "disturbance", "network", "floor")
"""The lines of every comparison, in the order of drawing; "disturbance" and "network" may be missing."""
AFTER = "after"
"""The model that the diagnosis ends with."""
RUNS = ("measured", "nominal", AFTER)
"""The lines of a trace, in the order of drawing."""


@dataclass(frozen=True)
class Line:
    """Error of one model at every horizon, SI: over all held-out recordings, its 95 % interval, and one by one."""

    rmse: tuple[float, ...]
    low: tuple[float, ...] = ()
    high: tuple[float, ...] = ()
    recordings: dict[str, tuple[float, ...]] = field(default_factory=dict)


@dataclass(frozen=True)
class Curves:
    """Error of one output group against the horizon; the keys of ``lines`` are among `LINES`."""

    unit: str
    horizon_s: tuple[float, ...]
    lines: dict[str, Line]

    def plot(self, axes: "Axes", name: str) -> None:
        """Draw the error of the group called ``name`` against the horizon, with 95 % intervals."""
        unit, factor = display(self.unit, name)
        drawn = {
            n: [[factor * v for v in values] for values in (of.rmse, of.low, of.high)] for n, of in self.lines.items()
        }
        draw_curves(axes, self.horizon_s, drawn, ("horizon [s]", f"rms error of {name} [{unit}]"))


def plot_curves(curves: dict[str, Curves]) -> "list[Axes]":
    """One matplotlib axes a group."""
    axes = new_axes(max(1, len(curves)))
    for ax, (name, of) in zip(axes, curves.items(), strict=False):
        of.plot(ax, name)
    return axes


@dataclass(frozen=True)
class Stage:
    """One step of the waterfall: "nominal", "calibrated", the id of the effect added, or "floor"."""

    name: str
    error: dict[str, float]
    """By output group, SI, at the horizon of `Diagnosis.error`."""


@dataclass(frozen=True)
class Candidate:
    """One effect that was tried in a round."""

    id: str
    gain: float
    """Share of the error above the floor that it explains, with its 95 % interval."""
    low: float
    high: float
    parameters: str = ""
    """Its fitted values as text."""
    why: str = ""
    """A sentence: why it lost; empty for the one taken."""


@dataclass(frozen=True)
class Calibration:
    """A base constant, or the ratio of two, before and after calibration."""

    constant: str
    """A ratio: "thrust_coefficient / mass"."""
    nominal: float
    calibrated: float
    unit: str
    sigma: float
    """By how many of its stated uncertainties it moved."""
    low: float = math.nan
    high: float = math.nan
    """95 % interval; NaN: there is none."""
    stopped: bool = False
    """Whether it went as far as what is stated of it lets calibration go."""

    @property
    def constants(self) -> set[str]:
        """Names, without their components, of what it is about."""
        return {label.partition("[")[0] for label in self.constant.split(" / ")}

    @property
    def moved(self) -> bool:
        """Whether the interval excludes the nominal value."""
        return self.low > self.nominal or self.high < self.nominal


@dataclass(frozen=True)
class ResidualMap:
    """A residual against a signal, SI: all samples (thinned as you like) and means in bins of the signal."""

    x_signal: str
    x_unit: str
    y_quantity: str
    y_unit: str
    x: tuple[float, ...]
    y: tuple[float, ...]
    """Of the calibrated model, before any effect."""
    centres: tuple[float, ...]
    before: tuple[float, ...]
    after: tuple[float, ...] = ()
    region: str = ""
    """The region of `Diagnosis.where` that it belongs to."""


@dataclass(frozen=True)
class Window:
    """A stretch of a recording and what the models make of it: N samples of c channels, SI."""

    recording: str
    start_s: float
    group: str
    unit: str
    channels: tuple[str, ...]
    t: tuple[float, ...]
    """(N,) [s] from the start of the window."""
    measured: tuple[tuple[float, ...], ...]
    """(c, N), as the other two."""
    nominal: tuple[tuple[float, ...], ...]
    extended: tuple[tuple[float, ...], ...] = ()


@dataclass(frozen=True)
class Predictable:
    """What a network predicts of what the last model leaves of outputs: rms errors at the last horizon, SI."""

    group: str
    """A group of outputs, or one channel."""
    horizon_s: float
    unit: str
    model: float
    observer: float
    """Of the model with a disturbance observer; NaN: nothing is known of it."""
    autoregression: float
    """Of a linear regression on the state in which a run starts: it sees neither inputs nor a model."""
    network: float
    floor: float
    finding: str
    """"missing": something that these signals tell; "slow": as much as an observer tells; "autoregression": as much
    as that tells without inputs; "little" is left to learn; "worse": nothing follows; "open": the recordings do not
    tell."""
    own: bool = True
    """Whether it has an equation of its own: a pose is wrong because its rates are."""
    axes: tuple[str, ...] = ()
    """Where something is missing, the channels of the group in which it is; empty: in all of it, or none by itself."""

    lines: ClassVar[tuple[str, ...]] = ("model", "observer", "autoregression", "network", "floor")

    @property
    def errors(self) -> tuple[float, ...]:
        """Of each of the ``lines``."""
        return tuple(getattr(self, line) for line in self.lines)


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


@dataclass(frozen=True)
class Evidence:
    """What the page shows beyond the contract. Every part may be missing."""

    source: str = ""
    """The data as the user named them: what follows `bench diagnose`."""
    recordings: int = 0
    seconds: float = 0.0
    """Of all recordings together."""
    held_out: tuple[str, ...] = ()
    curves: dict[str, Curves] = field(default_factory=dict)
    calibrated: float = 0.0
    """Share of the squared error above the floor that the calibration of constants takes before any effect."""
    waterfall: tuple[Stage, ...] = ()
    ranking: tuple[tuple[Candidate, ...], ...] = ()
    """One tuple a round, best first."""
    calibration: tuple[Calibration, ...] = ()
    residuals: tuple[ResidualMap, ...] = ()
    windows: tuple[Window, ...] = ()
    hypothesis: str = ""
    """A symbolic form of what is left, offered as a hypothesis."""
    remarks: tuple[str, ...] = ()
    """Sentences: what shows and is not worth a term."""
    notes: tuple[str, ...] = ()
    """Sentences: what was estimated, what was assumed, what the data cannot show."""
    learned: tuple[LearnedCurve, ...] = ()
    """The shapes of learned terms."""
    predictable: tuple[Predictable, ...] = ()
    """What a network predicts, group by group; empty: none was asked for."""
    predictable_axes: tuple[Predictable, ...] = ()
    """The same of single channels of those that have an equation of their own."""
    obscured: tuple[ObscuredConstant, ...] = ()
    inverse: InverseDynamics | None = None
    """What the input works against where it seems to do nothing."""
    """Constants of which the recordings say nothing that could be believed."""
    contradicted_effects: tuple[str, ...] = ()
    """Effects that the training recordings are sure of and held-out ones contradict; not named."""
    flights: tuple[Flight, ...] = ()
    """Whole recordings, held-out ones first."""
    part: tuple[str, ...] = ()
    """Words of a command that choose what of the data this is about, such as --vehicle N7; empty: all of them."""
    parted: bool = False
    """Whether `bench diagnose DATA --each-recording` takes the recordings one by one."""
    asked: Asked = field(default_factory=Asked)

    def command(self, name: str, *more: str) -> str:
        """What to type next on the same data; see `Asked.command`."""
        return self.asked.command(name, self.source or "DATA", *more)
