"""The thresholds of the checks of how a file is read, in `bench.diagnose.checks.description`."""

from dataclasses import dataclass

from bench.diagnose.settings.threshold import Basis, threshold


@dataclass(frozen=True)
class Offsetting:
    """Clocks of two signals that show the same motion."""

    widest: float = threshold(0.3, "offset that is looked for, at most", Basis.JUDGED, "s")
    least_correlation: float = threshold(
        0.9, "correlation of two signals from which their offset is told", Basis.JUDGED
    )
    least_disagreement: float = threshold(
        1.5, "times as much of two motions that must disagree without an offset as with it", Basis.JUDGED
    )
    steady: float = threshold(
        0.25,
        "spread of the offset over recordings, relative and in samples ×3, from which no one number mends it",
        Basis.JUDGED,
    )
    recordings: float = threshold(0.75, "share of the recordings that must say so", Basis.JUDGED)


@dataclass(frozen=True)
class Mounting:
    """Axes of sensors, turned against those of the body."""

    least: float = threshold(
        1.0, "turn from which it is told: less makes less than a fiftieth of a torque act across", Basis.JUDGED, "deg"
    )
    significant: float = threshold(4.0, "times its standard error over stretches of flight", Basis.JUDGED)
    stretch: float = threshold(3.0, "time of a stretch of flight that tells the turn by itself", Basis.JUDGED, "s")
    parts: int = threshold(4, "stretches at least, so that their spread is known", Basis.JUDGED, "count")
    few: int = threshold(50, "samples of a stretch that are too few", Basis.JUDGED, "count")
    near: float = threshold(
        0.5,
        "distance, over the turn, of what rotors say from all of it or none, up to which they tell whose it is",
        Basis.JUDGED,
    )
    moves: float = threshold(
        0.1, "body rates, about the second most lively axis, that are enough", Basis.JUDGED, "rad/s"
    )
    ends: float = threshold(0.1, "time at the ends of a stretch that differences spoil", Basis.JUDGED, "s")
    burst: float = threshold(0.1, "time over which rotors are held against rates; see `Turning`", Basis.JUDGED, "s")


@dataclass(frozen=True)
class Mending:
    """How a file says that its columns are to be read, against what other columns say."""

    wrong: float = threshold(0.6, "misfit from which an axis is said not to agree", Basis.JUDGED)
    fall: float = threshold(0.4, "by how much that misfit must fall for a change to be named", Basis.JUDGED)
    agreeing: float = threshold(
        0.4, "misfit below which a change mends a relation that nothing but reading spoils", Basis.JUDGED
    )
    agreeing_loosely: float = threshold(
        0.72, "misfit below which a change mends a relation that missing physics spoils too", Basis.JUDGED
    )
    recordings: float = threshold(0.75, "share of the recordings that must say so", Basis.JUDGED)
    worse: float = threshold(0.25, "how much worse another axis may become that agreed", Basis.JUDGED)
    alike: float = threshold(
        0.15, "total misfit between two changes up to which both are told: either may be right", Basis.JUDGED
    )
    sure: float = threshold(
        0.08,
        "misfit below which two signals agree beyond doubt, of which one is the integral of the other",
        Basis.JUDGED,
    )
    cleared: float = threshold(
        0.15, "share of a larger misfit that a change may leave to be named for it", Basis.JUDGED
    )
    same: float = threshold(1e-06, "total misfit between changes that are the same by another name", Basis.ROUNDING)
    passes: int = threshold(4, "mistakes of one folder that are looked for, one after the other", Basis.EFFORT, "count")
    uncommon: float = threshold(
        0.06, "total misfit by which an uncommon change must be better than a common one", Basis.JUDGED
    )
    less_common: float = threshold(
        0.03, "total misfit by which a less common change must be better than a common one", Basis.JUDGED
    )


@dataclass(frozen=True)
class Trying:
    """A part of the recordings on which hundreds of changes are tried, before the best are tried on everything."""

    seconds: float = threshold(6.0, "time of each of these recordings, from its middle", Basis.EFFORT, "s")
    recordings: int = threshold(4, "recordings at most, spread over all", Basis.EFFORT, "count")
    kept: int = threshold(10, "changes that are then tried on everything", Basis.EFFORT, "count")


@dataclass(frozen=True)
class Sampling:
    """What of the recordings is looked at, and how motions are compared."""

    recordings: int = threshold(8, "recordings that are looked at, spread over all", Basis.EFFORT, "count")
    longest: float = threshold(30.0, "time of each recording that is looked at, from its middle", Basis.EFFORT, "s")
    fewest: int = threshold(
        3000, "samples of it, where these take longer: a slow process does little in 30 s", Basis.EFFORT, "samples"
    )
    window: float = threshold(0.3, "time over which changes are compared", Basis.JUDGED, "s")
    half_width: float = threshold(
        0.06, "half of the time over which an acceleration is the change of the velocity", Basis.JUDGED, "s"
    )
    few: int = threshold(60, "samples that are too few to judge", Basis.JUDGED, "count")
    stride: int = threshold(3, "samples from one that is compared to the next: windows overlap", Basis.EFFORT, "count")
    tail: float = threshold(
        0.01, "share of the samples at either end that are brought in to their neighbours' size", Basis.JUDGED
    )


@dataclass(frozen=True)
class Turning:
    """Order and direction of rotors."""

    bursts: tuple[float, ...] = threshold(
        (0.05, 0.1, 0.2),
        "times over which the change of the change of the body rates is looked at: the shortest that noise "
        "allows, since what moves slowly with the speed of flight, such as drag and flapping, then falls "
        "out",
        Basis.JUDGED,
        "s",
    )
    lags: tuple[float, ...] = threshold(
        (0.0, 0.02, 0.04, 0.08, 0.15),
        "lags of first order with which rotors may follow what is logged of them",
        Basis.JUDGED,
        "s",
    )
    late: float = threshold(
        0.02, "by how much a log may be late without the answer of yaw changing its sign", Basis.JUDGED, "s"
    )
    turned: float = threshold(0.5, "correlation, with the other sign, from which it has", Basis.CONVENTION)
    recordings: int = threshold(4, "recordings from which the pace is taken", Basis.EFFORT, "count")


@dataclass(frozen=True)
class Lifting:
    """Thrust against weight."""

    far: float = threshold(
        2.5,
        "factor between weight and thrust from which something else is wrong than a coefficient that is 20 or 50 % off",
        Basis.JUDGED,
    )
    gyration: float = threshold(
        0.45,
        "radius of gyration about x and y in arms; 0.36 to 0.50 of the vehicles whose constants come along",
        Basis.JUDGED,
    )
    near: float = threshold(1.8, "factor between them below which another unit is right", Basis.JUDGED)
    moves: float = threshold(
        0.05, "share of the weight by which the force must vary for inputs to be judged by it", Basis.JUDGED
    )
    calm: float = threshold(0.5, "time over which the force is averaged for that", Basis.JUDGED, "s")
    hidden: float = threshold(
        2.0,
        "times the plain correlation of inputs and force that the one given the climb must be to be believed: noise in "
        "place of rotors has as much of both",
        Basis.JUDGED,
    )
    deaf: float = threshold(0.2, "correlation below which inputs have nothing to do with the force", Basis.JUDGED)
    flat: float = threshold(
        0.25,
        "share of the force's variation below which a map from inputs to rotor speeds hardly moves the thrust",
        Basis.JUDGED,
    )
    fits: float = threshold(0.5, "correlation from which a map is estimated with an offset", Basis.JUDGED)
