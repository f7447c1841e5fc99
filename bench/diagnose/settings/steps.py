"""The thresholds of the steps of a diagnosis, of its verdict and of its sentences."""

from dataclasses import dataclass

from bench.diagnose.settings.threshold import Basis, threshold


@dataclass(frozen=True)
class Comparing:
    """Step 1: free runs beside the noise floor."""

    free_runs: int = threshold(
        500,
        "free runs of a model, about: the mean is then known far better than recordings differ",
        Basis.EFFORT,
        "count",
    )
    horizons: int = threshold(10, "points of a curve of error against horizon", Basis.SHOWN, "count")
    draws: int = threshold(1000, "draws of the bootstrap behind an interval", Basis.EFFORT, "count")


@dataclass(frozen=True)
class Observing:
    """The disturbance observer."""

    fastest: float = threshold(
        0.04,
        "time constant of its fastest filter, as a share of the horizon: what changes faster is forgotten within it",
        Basis.JUDGED,
    )
    ratio: float = threshold(5.0, "from one filter's time constant to the next one's", Basis.JUDGED)
    filters: int = threshold(4, "filters a channel: the slowest remembers five horizons", Basis.JUDGED, "count")
    parts: int = threshold(
        5, "stretches of a horizon over each of which a predicted disturbance is constant", Basis.EFFORT, "count"
    )
    windows: int = threshold(
        250, "free runs of training recordings that tell how far it is trusted, about", Basis.EFFORT, "count"
    )
    points: int = threshold(5, "points of a horizon at which their errors count", Basis.EFFORT, "count")
    nudge: float = threshold(1e-3, "of a disturbance, by which the response to it is told", Basis.ROUNDING)
    halvings: int = threshold(4, "lengths of the step towards that trust that are tried", Basis.EFFORT, "count")


@dataclass(frozen=True)
class Locating:
    """Step 2: where the error is."""

    horizon_share: float = threshold(
        0.4,
        "of the default horizon, over which errors are located: long enough to stand out, short enough to be local",
        Basis.JUDGED,
    )
    free_runs: int = threshold(4000, "free runs whose errors are located, about", Basis.EFFORT, "count")
    overlap: int = threshold(4, "windows that hold the same sample, at most", Basis.EFFORT, "count")
    least_excess: float = threshold(
        0.1, "squared error above the floor, as a share of the floor's, from which it is located", Basis.JUDGED
    )
    least_deviations: float = threshold(
        4.0, "and by how many standard errors of the floor it must exceed the floor", Basis.JUDGED
    )
    least_error: float = threshold(
        1e-4,
        "of a signal's standard deviation: smaller errors are not looked at where there is no noise",
        Basis.ROUNDING,
    )
    least_difference: float = threshold(
        0.1, "difference between a region's share of the error and of the time from which it is one", Basis.JUDGED
    )
    least_ratio: float = threshold(1.25, "ratio of these two shares from which a region is one", Basis.JUDGED)
    interval_handicap: float = threshold(
        1.3, "by what factor an interval must tell more than a single threshold to be said instead", Basis.JUDGED
    )
    least_new: float = threshold(
        0.1, "share of the error that a region must hold and no better region does", Basis.JUDGED
    )
    regions: int = threshold(6, "regions that are said at most", Basis.SHOWN, "count")
    least_windows: int = threshold(
        5, "windows of a recording in a region from which the region is met in it", Basis.JUDGED, "count"
    )
    least_recording: float = threshold(
        0.1,
        "of the mean error in a region, what a recording must have there to count, so that one spike is no region",
        Basis.JUDGED,
    )
    cuts: int = threshold(
        19, "quantiles of a condition, evenly from 5 to 95 %, at which a region may begin or end", Basis.EFFORT, "count"
    )
    worst_windows: int = threshold(3, "windows with the greatest error that are drawn", Basis.SHOWN, "count")


@dataclass(frozen=True)
class Discovering:
    """Step 3: the search for effects, once a set was chosen."""

    exchanges: int = threshold(8, "exchanges of one effect for another at most", Basis.EFFORT, "count")
    faint_trace: float = threshold(
        0.002,
        "share of what noise leaves that a signal must explain on recordings not fitted to be mentioned; noise alone "
        "reaches 0.0001",
        Basis.MEASURED,
    )


@dataclass(frozen=True)
class Extending:
    """Step 4: effects added and fitted."""

    shooting_gain: float = threshold(
        0.9,
        "mean squared error of free runs after shooting, relative to before, below which its numbers are taken for "
        "those of the weak form: on pelican_twin and nanobench it gains 4 %, and numbers that are known otherwise end "
        "2.5 and 20 % off; on nanodrone it gains 46 %",
        Basis.MEASURED,
    )
    given_up: float = threshold(
        0.02,
        "share that learned terms must leave of the squared error above the floor that named effects left, for those "
        "effects to be given up",
        Basis.JUDGED,
    )
    telling: float = threshold(
        1.5, "times the noise floor that named effects leave from which a group of outputs tells of this", Basis.JUDGED
    )
    interval: float = threshold(1.96, "half of a 95 % interval in standard deviations", Basis.CONVENTION)
    neutral: float = threshold(
        1e-3,
        "distance from no effect after shooting, over that of the weak form, below which a number counts as gone",
        Basis.JUDGED,
    )
    determined: float = threshold(
        0.5,
        "width of a constant's interval, relative to that of what was stated, below which the recordings determine it",
        Basis.CONVENTION,
    )


@dataclass(frozen=True)
class Deciding:
    """The verdict."""

    high_excess: float = threshold(
        2.0,
        "squared error over the noise floor's from which something is missing although it follows no signal; below it, "
        "down to `Mattering.near`, only waves are sought",
        Basis.JUDGED,
    )
    least_share: float = threshold(
        1e-6,
        "share of the nominal model's squared error in free runs that an effect must explain, and that must be left "
        "for something to be missing: what is less follows how rates are computed",
        Basis.ROUNDING,
    )
    imitated: float = threshold(
        0.05,
        "error above the noise floor that an effect leaves in an equation, relative to the calibrated model's, from "
        "which it may only imitate what is missing",
        Basis.JUDGED,
    )
    traces_shown: float = threshold(
        0.9, "share of what the traces left explain whose axes and signals are said, largest first", Basis.SHOWN
    )
    hypothesis_term: float = threshold(
        0.1, "gain of a term, relative to the first one's, from which it stands in the hypothesis", Basis.SHOWN
    )


@dataclass(frozen=True)
class Telling:
    """Sentences and the page."""

    little_left: float = threshold(
        0.02,
        "share of the squared error above the floor below which a reader need not know what it follows",
        Basis.SHOWN,
    )
    constant_off: float = threshold(
        2.0, "σ of what was stated beyond which a calibrated constant is marked", Basis.SHOWN, "σ"
    )
    constant_times: float = threshold(
        3.0, "times what was stated from which a constant is told as a multiple of it", Basis.SHOWN
    )
    constant_far: float = threshold(
        2.0, "times what was stated, or one over it, beyond which a constant has a line on the terminal", Basis.SHOWN
    )
    more_than_noise: float = threshold(
        2.0, "times the noise floor beyond which an error is said to be more than noise", Basis.SHOWN
    )
    recalibrated: float = threshold(
        0.5,
        "share of the squared error above the floor that calibration takes, from which constants stand in the headline",
        Basis.SHOWN,
    )
    constant_moved: float = threshold(
        0.1, "σ below which nobody is told that a constant moved, however sure it is", Basis.SHOWN, "σ"
    )
    observer_helps: float = threshold(
        0.95,
        "error with a disturbance observer, relative to that without, from which a reader need not know it",
        Basis.SHOWN,
    )
    alike: float = threshold(
        0.5,
        "share of what a learned term does that an effect of the catalogue would do too, from which it is said to look "
        "like it",
        Basis.SHOWN,
    )
    as_near: float = threshold(
        0.02, "share by which another effect may do less and be said to look like the term as well", Basis.SHOWN
    )
    nearest: int = threshold(3, "effects that a term is said to look like, at most", Basis.SHOWN, "count")
    constants: int = threshold(
        2, "constants, and ratios of them, that a sentence says are off; the page has them all", Basis.SHOWN, "count"
    )
    lines: int = threshold(24, "lines of the summary on a terminal of 100 columns, at most", Basis.SHOWN, "count")
