"""The thresholds of `bench.diagnose.manoeuvre`."""

from dataclasses import dataclass

from bench.diagnose.settings.threshold import Basis, threshold


@dataclass(frozen=True)
class Designing:
    """What is asked of a manoeuvre, and how it is told."""

    seconds: tuple[float, ...] = threshold((10.0, 30.0, 60.0), "lengths of flight that are spoken of", Basis.SHOWN, "s")
    fewest: int = threshold(
        200,
        "samples of a manoeuvre: of slow processes these lengths are stretched until the shortest holds so many",
        Basis.JUDGED,
        "samples",
    )
    wide: float = threshold(
        0.1,
        "half of a 95 % interval, relative to the value, from which a parameter is known so badly that a manoeuvre is "
        "sought for it",
        Basis.JUDGED,
    )
    drawn: int = threshold(1200, "samples of a curve that are drawn at most", Basis.SHOWN, "count")


@dataclass(frozen=True)
class Limiting:
    """How far and how fast a manoeuvre may go, as the recordings show."""

    fastest: float = threshold(
        99.0,
        "percentile of the changes between samples that is taken for the fastest: above it measurement noise decides",
        Basis.JUDGED,
        "%",
    )
    power: float = threshold(
        0.98, "share of the recorded inputs' power below the upper end of the band that they excite", Basis.JUDGED
    )
    room: float = threshold(
        0.05,
        "how far beyond what was recorded of a state a manoeuvre may take it, as a share of its span",
        Basis.JUDGED,
    )
    slowest: float = threshold(0.05, "rate at which a set-point may always change, in its unit", Basis.JUDGED, "1/s")


@dataclass(frozen=True)
class Composing:
    """Manoeuvres that are tried."""

    levels: int = threshold(6, "levels of a staircase, which are sought", Basis.EFFORT, "count")
    tempi: tuple[int, ...] = threshold((1, 2, 4), "how often a staircase may be gone through", Basis.EFFORT, "count")
    releases: int = threshold(4, "runs of an undriven system that make one manoeuvre", Basis.JUDGED, "count")
    pace: float = threshold(
        3.0,
        "periods of a sine of a stock manoeuvre; it has a small and a large amplitude as often",
        Basis.JUDGED,
        "count",
    )
    population: int = threshold(40, "manoeuvres of a generation of the search", Basis.EFFORT, "count")
    generations: int = threshold(8, "generations of the search after the first one", Basis.EFFORT, "count")


@dataclass(frozen=True)
class Separating:
    """How far apart two candidates' free runs are."""

    points: int = threshold(4, "samples of a window that are compared", Basis.EFFORT, "count")
    shrink: float = threshold(
        0.1,
        "share of the covariance of a window's errors that is taken from its diagonal alone: few windows tell it badly",
        Basis.JUDGED,
    )
    refits: int = threshold(
        3, "Gauss–Newton steps of a rival's parameters to imitate another candidate", Basis.EFFORT, "count"
    )


@dataclass(frozen=True)
class Assuring:
    """How sure a diagnosis would be after a manoeuvre."""

    sure: float = threshold(0.95, "chance from which one is said to be sure", Basis.CONVENTION)
    worst: float = threshold(-20.0, "score below which nothing more is lost in a search", Basis.JUDGED)
    best: float = threshold(10.0, "score above which nothing more is won in a search", Basis.JUDGED)
    inside: float = threshold(1e-9, "excess of a state over its limits, as a share of its span", Basis.ROUNDING)
    tried: tuple[int, ...] = threshold(
        (1, 2, 3, 6, 12, 24),
        "repetitions of a manoeuvre that are tried when it is asked how many suffice",
        Basis.SHOWN,
        "count",
    )
