"""The thresholds of the checks of signals, in `bench.diagnose.checks`."""

from dataclasses import dataclass

from bench.diagnose.settings.threshold import Basis, threshold


@dataclass(frozen=True)
class Aligning:
    """A signal against the integral of its rate."""

    window: float = threshold(
        0.3, "time over which changes are compared: noise of single samples hardly counts then", Basis.JUDGED, "s"
    )
    apart: int = threshold(
        8,
        "windows, one after the other, from which a sign or a scale is judged: over two of them every slow drift is in "
        "line with every other",
        Basis.JUDGED,
        "count",
    )
    clock_block: float = threshold(4.0, "time over which the clock is judged at once", Basis.JUDGED, "s")
    clock_error: float = threshold(0.025, "relative error of a clock's rate from which it is called one", Basis.JUDGED)
    scale: float = threshold(
        1.25, "factor between a signal and what its rate says from which its scale is called wrong", Basis.JUDGED
    )
    unrelated: float = threshold(
        0.5, "correlation of a signal's change with what its rate says, below which it is no rate of it", Basis.JUDGED
    )
    smooth: float = threshold(
        0.8, "correlation of each with itself an eighth of a window later, from which it is no noise", Basis.JUDGED
    )
    moving: float = threshold(
        0.1,
        "change of a signal along an axis, over the largest along any, from which it tells of its rate",
        Basis.JUDGED,
    )


@dataclass(frozen=True)
class Disagreeing:
    """A signal and its rate that contradict each other for a while."""

    usual: float = threshold(
        100.0,
        "by how much more than is usual between them a rate must contradict a signal, and by more than that changes in "
        "99 of 100 windows; a rate whose filter starts up does by 500 to 700, 112 pairs of real flights that move no "
        "more do by 52 at most",
        Basis.MEASURED,
    )


@dataclass(frozen=True)
class Spiking:
    """Samples far from their neighbours."""

    distance: float = threshold(
        10.0,
        "how far an excursion lies from its neighbours, over the spread of what two signals say of each other",
        Basis.JUDGED,
    )
    tail: float = threshold(4.0, "how far it lies, over the size that one sample in a hundred exceeds", Basis.JUDGED)
    ratio: float = threshold(
        3.0,
        "how many times larger than every lesser excursion of the same signal one must be: real sensors "
        "have long tails",
        Basis.JUDGED,
    )
    lost: float = threshold(
        0.5,
        "how much further a signal goes over a step than its rate says, over what the rate changes about it, from "
        "which samples are missing: no rate that does not turn in between makes more",
        Basis.JUDGED,
    )
    input: float = threshold(0.15, "spike of an input, over its mean size, from which it is one", Basis.JUDGED)
    response: int = threshold(
        12,
        "samples about a spike of an input in which the motion would answer, however it was smoothed",
        Basis.JUDGED,
        "count",
    )
    listed: int = threshold(
        5,
        "spikes of one signal in a recording that are listed one by one, and that a measured input may have",
        Basis.SHOWN,
        "count",
    )
    missed: float = threshold(
        0.3,
        "share of the body rates (rms) that a sample's neighbours do not tell, from which rotations are lost",
        Basis.JUDGED,
    )
    aliased: float = threshold(
        0.9,
        "share of the differences between rotors that neighbours do not tell, from which torques are lost: 1.1 of PX4 "
        "at 50 Hz, .05 to .55 of eleven sets whose torques are understood",
        Basis.SHOWN,
    )


@dataclass(frozen=True)
class Hitting:
    """Impacts of a vehicle."""

    acceleration: float = threshold(
        60.0,
        "change of the velocity beyond the model's, from which the vehicle hits something: no air does it",
        Basis.JUDGED,
        "m/s²",
    )
    turn: float = threshold(500.0, "the same of the body rates", Basis.JUDGED, "rad/s²")
    flown: int = threshold(100, "samples before it that say what is usual of this flight", Basis.JUDGED, "samples")


@dataclass(frozen=True)
class Freezing:
    """Samples that are no measurement."""

    held: float = threshold(
        0.15, "shortest time for which a sensor that repeats its value is taken for frozen", Basis.JUDGED, "s"
    )
    held_samples: int = threshold(10, "least number of samples that such a sensor repeats", Basis.JUDGED, "count")
    rests: float = threshold(0.1, "share of samples at rest from which that is mentioned", Basis.JUDGED)
    rare: float = threshold(
        0.001, "share of repeated values elsewhere below which a signal does not repeat itself by nature", Basis.JUDGED
    )
    pushed: float = threshold(
        0.5,
        "spread of a drive, over that of a usual recording, that would move a machine which stands still all the time",
        Basis.JUDGED,
    )
    unit_length: float = threshold(0.02, "how far the length of a quaternion may be from one", Basis.JUDGED)


@dataclass(frozen=True)
class Inverting:
    """A machine's drive that acts with the other sign."""

    window: float = threshold(
        0.06,
        "time over which motion and drive are compared: noise of single samples hardly counts then",
        Basis.JUDGED,
        "s",
    )
    latest: float = threshold(0.3, "delay with which the drive may act as filed all the same", Basis.JUDGED, "s")
    least: int = threshold(10, "windows for each number that is fitted, at least", Basis.CONVENTION, "count")
    better: float = threshold(
        0.5,
        "squares left with the other sign, relative to the least that no sign or the filed one leaves",
        Basis.JUDGED,
    )
    between: tuple[float, float] = threshold(
        (0.2, 5.0), "factors of what the model makes of it that are still the same drive", Basis.JUDGED
    )


@dataclass(frozen=True)
class Shifting:
    """Inputs and states that are logged at different times."""

    suspect: float = threshold(0.5, "shift of all recordings from which it is mentioned", Basis.JUDGED, "samples")
    certain: float = threshold(
        0.7,
        "by how much recordings, all of them by some, must move before their inputs for a fault of the log",
        Basis.JUDGED,
        "samples",
    )
    different: float = threshold(
        1.5, "shift of one recording against the others from which it is a fault", Basis.JUDGED, "samples"
    )
    apart: float = threshold(5.0, "times as far as the others are from each other that it must be", Basis.JUDGED)
    sure: float = threshold(
        3.0,
        "standard errors by which a lag is told from another one: the likelihood of correlations whose samples are "
        "independent once in a smoothing window",
        Basis.CONVENTION,
    )
    widest: int = threshold(10, "largest lag that is looked at", Basis.EFFORT, "samples")
    blurred: float = threshold(
        0.05,
        "share of the window of a slope, where that stands in for a rate, that a fault is larger than: its noise moved "
        "an arm with nothing shifted by 1.6 samples of 71",
        Basis.MEASURED,
    )
    smoothing: int = threshold(
        13,
        "window of the local quadratic that all go through before they are compared: slopes are noisy",
        Basis.JUDGED,
        "samples",
    )
    slow: int = threshold(
        121,
        "window of a local quadratic whose result is left out: missing physics shifts what is slow",
        Basis.JUDGED,
        "samples",
    )
    least_correlation: float = threshold(
        0.8, "correlation from which a recording may be said to differ from the others", Basis.JUDGED
    )
    clear: float = threshold(
        0.5, "correlation of modelled and measured acceleration at the shift from which it is told", Basis.JUDGED
    )


@dataclass(frozen=True)
class Leaving:
    """Damaged recordings among many."""

    share: float = threshold(
        0.1,
        "share of the recordings that may be damaged and are left out; a fault of more of them stops the analysis",
        Basis.CONVENTION,
    )
