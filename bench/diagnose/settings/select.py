"""The thresholds of `bench.diagnose.select`."""

from dataclasses import dataclass

from bench.diagnose.settings.threshold import Basis, threshold


@dataclass(frozen=True)
class Searching:
    """Rows of the weak form that effects are chosen on."""

    stride: float = threshold(
        0.06,
        "from one test function to the next where the motion is slower; a test function is two hops long",
        Basis.JUDGED,
        "s",
    )
    fine: int = threshold(6, "samples from one test function to the next that are enough", Basis.EFFORT, "samples")
    longest: int = threshold(
        24_000, "samples that are looked at; more would make it slower and no surer", Basis.EFFORT, "samples"
    )
    glance: int = threshold(
        6_000, "samples that tell whether another view of the rows is worth a search of all", Basis.EFFORT, "samples"
    )
    telling: int = threshold(
        12, "columns at most that are fitted before what is left is called noise", Basis.JUDGED, "count"
    )
    buried: float = threshold(
        0.3,
        "share of noise of the inputs in what a column is made of from which the data say nothing about it",
        Basis.JUDGED,
    )
    bent: float = threshold(
        1.0,
        "1σ by which noise of the states must bend a number for what it makes of columns to be taken off",
        Basis.JUDGED,
    )
    noisy_drive: float = threshold(
        0.1,
        "noise of a drive, over its standard deviation, from which it was measured behind the actuator, not commanded",
        Basis.JUDGED,
    )
    memory: int = threshold(8, "order of the autoregression that whitens a residual", Basis.JUDGED, "hops")


@dataclass(frozen=True)
class Releasing:
    """Constants that were let go."""

    slow: float = threshold(
        3.0,
        "density at rest of what is left of an equation, over its mean density, from which it is slow",
        Basis.JUDGED,
    )
    turns: int = threshold(
        6,
        "times that numbers and the noise of an equation are fitted in turns beside a slow disturbance",
        Basis.EFFORT,
        "count",
    )
    flat: float = threshold(
        1e-4,
        "eigenvalue of normal equations of normalised columns, over the largest, below which a direction is flat; "
        "one-sided differences leave up to 2e-5 of an exact one",
        Basis.ROUNDING,
    )
    remembered: int = threshold(4_000, "hops over which an autoregression's answer is summed", Basis.EFFORT, "hops")


@dataclass(frozen=True)
class Inverse:
    """What an input works against, by inverse dynamics."""

    shortest: int = threshold(3, "sampling intervals of a piece of motion, at least", Basis.CONVENTION, "samples")
    piece: float = threshold(
        0.2, "time over which motion and input are averaged, and that a position repeats at rest", Basis.JUDGED, "s"
    )
    surely: float = threshold(3.0, "standard deviations of noise beyond which a speed has a sign", Basis.CONVENTION)
    at_rest: float = threshold(0.99, "quantile of what a speed reads at rest that is nothing", Basis.CONVENTION)
    most: float = threshold(
        0.5, "share of the squared input that the model leaves which friction surely explains", Basis.CONVENTION
    )
    least: int = threshold(4, "pieces for each number that is fitted, at least", Basis.CONVENTION, "count")


@dataclass(frozen=True)
class Commanding:
    """How a measured drive follows the commands that were recorded beside it."""

    latest: int = threshold(
        3, "samples by which a command may act later than it is filed, beside the lag", Basis.CONVENTION, "samples"
    )
    slowest: float = threshold(
        0.999, "largest moving-average part of what is measured: a lag of a thousand samples", Basis.CONVENTION
    )
    settled: float = threshold(
        4.0, "of its own time constants after which a filter has forgotten where it began", Basis.ROUNDING
    )
    shortest: int = threshold(50, "samples of a stretch that is looked at", Basis.JUDGED, "samples")
    enough: int = threshold(
        12_000, "samples of a channel that the fit looks at, of each stretch its share", Basis.JUDGED, "samples"
    )
    rounding: float = threshold(
        1e-12, "of the largest speed, squared: a variance that is no noise of a sensor", Basis.ROUNDING
    )
    least_gained: float = threshold(
        0.5**0.5, "of the sensor's noise that may be left, or the drive stays as it was measured", Basis.CONVENTION
    )


@dataclass(frozen=True)
class Timing:
    """When the inputs act."""

    within_sample: float = threshold(
        0.5,
        "largest shift of a signal that need not act at once: what the path between two samples can make",
        Basis.CONVENTION,
        "samples",
    )
    significant: float = threshold(4.0, "standard errors from zero from which a shift is believed", Basis.JUDGED)
    negligible: float = threshold(
        0.01, "shift below which nothing is gained by reading the input anew", Basis.JUDGED, "samples"
    )
    coarse: float = threshold(
        0.5,
        "shift from which the cross-correlation's estimate is the start; the regression alone finds smaller ones",
        Basis.JUDGED,
        "samples",
    )
    longest: int = threshold(
        9_000, "samples that are looked at; more would make it slower and hardly surer", Basis.EFFORT, "samples"
    )
    steps: int = threshold(3, "Gauss–Newton steps to the shift", Basis.EFFORT, "count")
    linearised: int = threshold(
        2, "times that the model is linearised where its inputs are read", Basis.EFFORT, "count"
    )
    anew: float = threshold(
        0.05,
        "change of the inputs' shift from which it is: a thrust that is a third too small would make that shift seem a "
        "third too large",
        Basis.JUDGED,
        "samples",
    )
    window: float = threshold(
        0.1, "time over which a rate is held against the signal whose derivative it is", Basis.JUDGED, "s"
    )
    within_window: float = threshold(0.25, "largest shift of a rate, as a share of this window", Basis.ROUNDING)
    blocks: int = threshold(
        8, "parts of a recording whose spread tells how well its shift is known", Basis.CONVENTION, "count"
    )
    probe: float = threshold(1e-3, "step of the one-sided difference in the shift", Basis.ROUNDING, "samples")
    prior: float = threshold(3.0, "1σ of the effects that are fitted beside the shift, in typical values", Basis.JUDGED)


@dataclass(frozen=True)
class Choosing:
    """How many effects, and which."""

    largest: int = threshold(3, "effects searched for together; more are added one by one", Basis.EFFORT, "count")
    most: int = threshold(5, "effects that are named at most", Basis.JUDGED, "count")
    significant: float = threshold(
        3.5, "t over blocks of the held-out gain with which an effect is accepted", Basis.JUDGED
    )
    sure: float = threshold(
        2.0, "t over blocks of the held-out gain that suffices where the gain is plain", Basis.CONVENTION
    )
    plain: float = threshold(
        0.012,
        "gain, as a share of what noise leaves, that is plain: it comes from few manoeuvres rather than by chance",
        Basis.JUDGED,
    )
    large: float = threshold(
        0.05,
        "gain, as a share of what noise leaves, that is accepted if every recording not fitted confirms it",
        Basis.JUDGED,
    )
    overcorrected: float = threshold(
        3.0,
        "standard deviations of what noise leaves, and of the noise that was drawn to be taken off, that a fit leaves "
        "less than nothing, from which what was taken for noise of the inputs acts",
        Basis.CONVENTION,
    )
    visible: float = threshold(
        0.01,
        "least gain of an effect, as a share of what noise leaves; less must be sure in every recording that was not "
        "fitted, and is left to held-out forecasts",
        Basis.JUDGED,
    )
    relevant: float = threshold(0.004, "least gain of an effect, as a share of all that effects explain", Basis.JUDGED)
    clearing: float = threshold(
        0.8,
        "share of what is left, where that exceeds the noise, with which an effect is relevant whatever others explain",
        Basis.JUDGED,
    )
    doubted: float = threshold(
        5.0,
        "relief of the constants' prior, beyond the price of parameters, that is evidence in itself",
        Basis.JUDGED,
        "χ²",
    )
    distinct: float = threshold(2.5, "t over blocks with which a rival must lose to count as told apart", Basis.JUDGED)
    surely: float = threshold(
        5.0, "t from which even a small difference in explanation counts against fewer parameters", Basis.JUDGED
    )
    simpler: float = threshold(
        0.3,
        "share of what is left by which a set of fewer parameters may be worse, if the blocks do not agree that it is",
        Basis.JUDGED,
    )


@dataclass(frozen=True)
class Stepping:
    """From a linearised model to the next one."""

    shares: tuple[float, ...] = threshold(
        (1.0, 0.5, 0.25), "of a step of the model's own numbers, of which the best is taken", Basis.EFFORT
    )
    kept: float = threshold(
        0.5, "share of a promised gain that an exchange of effects must keep when it is measured", Basis.JUDGED
    )
    steps: int = threshold(
        6,
        "steps of a model's own numbers at most, from one look at candidates to the next",
        Basis.EFFORT,
        "count",
    )
    strengths: tuple[float, ...] = threshold(
        (1.0, 1.5, 2.2, 3.3, 5.0, 7.5),
        "times what is typical, of dry friction, from the best of which it is fitted",
        Basis.EFFORT,
    )
    comparable: float = threshold(
        10.0,
        "squared error of free runs with a friction, over that without it, up to which both are fitted to free runs",
        Basis.EFFORT,
    )
    scanned: float = threshold(0.002, "share of its strength to which a friction is looked for", Basis.EFFORT)


@dataclass(frozen=True)
class Verifying:
    """Effects once they were chosen: imitations, rivals, what is still unknown."""

    imitation: float = threshold(
        0.02,
        "share of all that is explained by which free terms must do better before an effect counts as their imitation",
        Basis.JUDGED,
    )
    disagree: float = threshold(
        0.01, "probability that recordings which share a number seem to disagree about it", Basis.CONVENTION
    )
    own_share: float = threshold(
        0.3, "share of its gain that an effect must keep beside such terms, or it is their imitation", Basis.JUDGED
    )
    plainly: float = threshold(
        0.1,
        "gain, as a share of what noise leaves, of an effect that is there although none of its parameters is known "
        "alone",
        Basis.JUDGED,
    )
    part: float = threshold(
        0.5,
        "gain, relative to all that is not understood, below which an effect may be a part of that",
        Basis.JUDGED,
    )
    left: float = threshold(
        0.15,
        "what a dictionary of signals may still explain, as a share of what noise leaves, before something is missing",
        Basis.JUDGED,
    )
    spanned: float = threshold(
        1e-6, "square of a column that sums of others leave, relative to its own, up to which it is one", Basis.ROUNDING
    )
    together: float = threshold(
        0.5,
        "uncertainty of a ratio of two constants, relative to that of the better known one, below which it is told too",
        Basis.SHOWN,
    )
    odds: float = threshold(
        6.0, "difference of Bayes's criterion that counts: twice the logarithm of 20 to 1", Basis.CONVENTION
    )
    replaces: float = threshold(
        0.5, "share of an effect's gain that another must have in its place to be its rival", Basis.JUDGED
    )
    acts: float = threshold(0.1, "share of an effect's gain from which a channel is one in which it acts", Basis.JUDGED)
    exact: float = threshold(
        2.0, "times the noise: what leaves less leaves nothing, and its rivals must come near that", Basis.JUDGED
    )
    loud: float = threshold(
        10.0,
        "times the noise: what leaves more is no rival of what leaves nothing, in however few blocks it shows",
        Basis.JUDGED,
    )


@dataclass(frozen=True)
class Mattering:
    """What is worth a term, on recordings that were not fitted."""

    share: float = threshold(
        0.05,
        "squared error that an effect must save to be named, as a share of what can be explained of some equation",
        Basis.JUDGED,
    )
    near: float = threshold(
        1.05, "error, relative to the best that can be reached, up to which nothing is worth a term", Basis.JUDGED
    )
    lost: float = threshold(
        1.5,
        "error with an effect, relative to that without, from which an equation is lost by it; its inverse: from which "
        "one would be lost without it",
        Basis.JUDGED,
    )
    sure: float = threshold(
        2.0, "half of a 95 % interval of a saving, in standard errors of its mean over blocks", Basis.CONVENTION
    )
    block: float = threshold(
        4.0, "length of these blocks at most: longer than what is left in a residual remembers", Basis.JUDGED, "s"
    )
    blocks: int = threshold(
        8, "blocks at least, where the recordings are long enough for that many horizons", Basis.JUDGED, "count"
    )
    terms: int = threshold(
        8, "functions of measured signals at most that are taken one by one to predict errors", Basis.EFFORT, "count"
    )
    shrinkage: tuple[float, ...] = threshold(
        tuple(10.0 ** (k / 2) for k in range(-8, 5)),
        "ridge penalties, relative to the mean eigenvalue, of which one is chosen on recordings left out",
        Basis.EFFORT,
    )
    longest: int = threshold(
        60_000,
        "samples that effects are weighed on, and as many that say what can be explained at all",
        Basis.EFFORT,
        "samples",
    )


@dataclass(frozen=True)
class Differing:
    """Whether recordings differ in a number."""

    most: float = threshold(
        0.5,
        "share of what one number for all recordings leaves where the effect acts, from which they differ in it: most",
        Basis.CONVENTION,
    )
    kept: float = threshold(
        0.75,
        "share of what numbers of each recording save that those of one half must save of its other half: what changes "
        "within recordings as it does between them is no matter of recordings",
        Basis.CONVENTION,
    )
    alike: float = threshold(
        0.9, "share of what the best effect explains with such numbers from which another does as well", Basis.JUDGED
    )
    draws: int = threshold(400, "draws that intervals of derived parameters are taken from", Basis.EFFORT, "count")


@dataclass(frozen=True)
class Forecasting:
    """Effects that only free runs ask for."""

    gain: float = threshold(
        0.9,
        "mean squared error of free runs with an effect, over that without it, below which they ask for it: on "
        "nanodrone and nanobench a rotational damping leaves .85 and .63, the next effect .94 and .91",
        Basis.MEASURED,
    )
    looked_at: int = threshold(400, "samples at which it is seen which states a number moves", Basis.EFFORT, "samples")


@dataclass(frozen=True)
class Growing:
    """Sets of effects that are fitted through the simulator, one effect added at a time."""

    most: int = threshold(3, "effects that are added at most: each set costs a fit", Basis.EFFORT, "count")
    likely: int = threshold(3, "starting points that growing windows lead", Basis.EFFORT, "count")
    first: int = threshold(
        4, "steps after which the worse half of them is dropped, and then after twice as many", Basis.EFFORT, "count"
    )
    lengths: tuple[int, ...] = threshold(
        (16, 64), "lengths of the windows that lead a fit to the whole ones", Basis.JUDGED, "samples"
    )
    sure: float = threshold(2.0, "t over windows of the held-out gain that a larger set needs", Basis.CONVENTION)
    disputed: float = threshold(
        3.0,
        "times the odds that count, up to which a set makes a tie if the windows do not agree that it is worse",
        Basis.JUDGED,
    )
    folds: int = threshold(4, "parts of the windows of which each is held out once", Basis.CONVENTION, "count")
