"""The thresholds of `bench.diagnose.logs`."""

from dataclasses import dataclass

from bench.diagnose.settings.threshold import Basis, threshold


@dataclass(frozen=True)
class Reading:
    """Recordings as they are read."""

    ends: int = threshold(
        8, "samples at either end of a stretch, where filters have neighbours on one side only", Basis.JUDGED, "samples"
    )
    half_width: int = threshold(
        3,
        "samples on either side of one that say what it should be: spikes of up to as many are seen",
        Basis.JUDGED,
        "samples",
    )
    plain_difference: float = threshold(
        0.5,
        "most that the difference of a sample and the one before leaves of a rate, against the differences about it",
        Basis.JUDGED,
    )
    held_out: float = threshold(1 / 3, "share of the recordings that only test", Basis.CONVENTION)
    whole: int = threshold(
        5,
        "recordings of which whole ones are held out, two of five: of fewer, one alone may show what acts, and each is "
        "cut in parts, which forget what a slow state remembers",
        Basis.JUDGED,
        "count",
    )
    fewest_parts: int = threshold(
        3, "parts of a recording: one tests, and others lie on both sides of it", Basis.JUDGED, "count"
    )
    most_parts: int = threshold(5, "parts of a recording, at most: as of a single one", Basis.CONVENTION, "count")
    part: float = threshold(
        10.0, "shortest part: two blocks of rows, and what a whitening filter remembers twice", Basis.JUDGED, "s"
    )
    part_samples: int = threshold(
        100, "samples of a part, at least: of slow logs ten seconds are few", Basis.JUDGED, "samples"
    )
    part_of_one: int = threshold(
        20, "samples of a part of the only recording; whether a free run fits is asked after", Basis.JUDGED, "samples"
    )
    beginning: int = threshold(
        10, "of a recording at most one part in so many is left out for what was given before it began", Basis.JUDGED
    )
    faded: float = threshold(
        0.01,
        "of a difference in past inputs that is remembered no more: five time constants of a lag",
        Basis.CONVENTION,
    )
    enough: int = threshold(
        180_000,
        "samples that are diagnosed: of more, some recordings are, and all are checked",
        Basis.EFFORT,
        "samples",
    )
    fewest: int = threshold(
        6,
        "recordings to fit, and to test on, that are diagnosed at least: of fewer none is left out for its length",
        Basis.EFFORT,
        "count",
    )
    untold: float = threshold(
        0.01, "share of the samples at which a model may give no finite rate: they are left out", Basis.JUDGED
    )
    stretch: float = threshold(
        5.0,
        "shortest stretch of a recording that is looked at where recordings are not looked at whole: a block of rows "
        "and what a whitening filter remembers",
        Basis.EFFORT,
        "s",
    )


@dataclass(frozen=True)
class Sloping:
    """Rates that were not measured, as slopes of local cubics."""

    shortest: int = threshold(
        5, "window: a cubic through fewer samples leaves nothing out", Basis.CONVENTION, "samples"
    )
    longest: int = threshold(
        401, "window, at most: of any encoder's counts so many are enough", Basis.EFFORT, "samples"
    )
    windows: int = threshold(
        4,
        "windows that the longest stretch of a recording holds, at least: the ends of it are lost",
        Basis.JUDGED,
        "count",
    )
    step: float = threshold(1.15, "from one window that is tried to the next, as a ratio", Basis.EFFORT)
    hopeless: float = threshold(
        10.0, "times the least squared error so far at which no longer window is tried", Basis.EFFORT
    )


@dataclass(frozen=True)
class Hearing:
    """Noise and filter from spectra."""

    segment: int = threshold(
        128, "length of a spectrum; half or a quarter of it where no recording is as long", Basis.JUDGED, "samples"
    )
    stepped: float = threshold(
        0.5, "share of the samples at which an input changes below which it goes in steps", Basis.CONVENTION
    )
    answered: int = threshold(
        64,
        "samples over which what follows a step is told from noise, at most: half a spectrum",
        Basis.JUDGED,
        "samples",
    )
    rows: int = threshold(
        20,
        "samples a number of that answer, at least: it then takes 5 % of the noise for its own",
        Basis.JUDGED,
        "count",
    )
    unlike: float = threshold(
        0.35,
        "mean distance, in natural logarithms, from which no known filter has the spectrum that was found",
        Basis.JUDGED,
    )
    faint: float = threshold(
        0.0001, "of a filter's largest gain: spectra are not believed to fall lower", Basis.ROUNDING
    )
    digits: float = threshold(
        1e-09,
        "of a signal's largest value: files hold nine digits, and no noise is believed to be less",
        Basis.ROUNDING,
    )
    longest_window: int = threshold(2001, "window of a stated filter, at most", Basis.CONVENTION, "samples")
    highest_order: int = threshold(
        20, "order of a stated local polynomial, at most: beyond it its weights are rounding errors", Basis.ROUNDING
    )
