"""The thresholds of the search for what follows no measured signal."""

from dataclasses import dataclass

from bench.diagnose.settings.threshold import Basis, threshold


@dataclass(frozen=True)
class Unseen:
    """A line in the residual's spectrum, a drift, a constant of each recording."""

    longest: int = threshold(60_000, "samples that are looked at; more would be slower", Basis.EFFORT, "count")
    window: float = threshold(
        0.02,
        "from one short window to the next, a window being twice as long: a line above half of its rate is not seen",
        Basis.CONVENTION,
        "s",
    )
    beside: int = threshold(
        12, "functions of measured signals at most that are fitted beside a line", Basis.JUDGED, "count"
    )
    memory: int = threshold(8, "order of the autoregression that whitens the residual", Basis.JUDGED, "windows")
    bandwidth: float = threshold(
        3.0,
        "time-bandwidth product of the tapers of Thomson's test, of which there are one less than twice as many",
        Basis.CONVENTION,
    )
    shortest: int = threshold(64, "windows of a stretch that is looked at, at least", Basis.JUDGED, "count")
    oversampled: int = threshold(4, "frequencies tried in a stretch's own resolution", Basis.EFFORT, "count")
    least_gain: float = threshold(0.3, "of a sine's amplitude that a window must leave", Basis.CONVENTION)
    false_alarm: float = threshold(
        1e-3,
        "probability that noise alone shows a line at any frequency along any axis; of 150 simulated sets without one "
        "(white noise, gusts, badly sampled inputs) one showed, before held-out recordings had to confirm it; it "
        "did not pass that",
        Basis.MEASURED,
    )
    repeated: float = threshold(
        0.5,
        "share of a line's power in the second half of each recording that its phase and amplitude in the first half "
        "must tell; a narrow resonance that noise drives tells none",
        Basis.JUDGED,
    )
    confirmed: float = threshold(
        0.01,
        "probability that noise alone shows a line at its frequency in the held-out recordings, at most",
        Basis.CONVENTION,
    )
    agreed: float = threshold(0.75, "share of the recordings in which they must tell any", Basis.CONVENTION)
    driven: float = threshold(
        2.0,
        "times a line's amplitude that the inputs may swing at its frequency; a controller answers it about once",
        Basis.JUDGED,
    )
    in_step: float = threshold(
        0.9,
        "mean resultant, over recordings, of twice the angle between two lines from which they are in step; of six "
        "recordings unrelated ones are with a probability of 0.004",
        Basis.JUDGED,
    )
    most: int = threshold(4, "lines along one axis that are looked at, at most", Basis.EFFORT, "count")


@dataclass(frozen=True)
class Hiding:
    """What swings or relaxes out of sight, driven by measured signals."""

    dampings: tuple[float, ...] = threshold(
        (0.02, 0.07, 0.25), "damping ratios from which a mode is sought", Basis.EFFORT
    )
    spacing: float = threshold(
        1.5, "from one frequency that is tried to the next, in damping ratios", Basis.EFFORT, "half-power half-widths"
    )
    windows: tuple[int, ...] = threshold(
        (1, 4, 16),
        "short windows in each of those in which a mode is sought: what is slow shows in long ones",
        Basis.EFFORT,
        "count",
    )
    lags: int = threshold(14, "time constants that are tried of what relaxes", Basis.EFFORT, "count")
    periods: float = threshold(
        3.0, "of a mode that the longest recording must hold, and time constants of what relaxes", Basis.JUDGED, "count"
    )
    lowest: float = threshold(
        1e-3,
        "frequency to which one is bent at least, where it is slower than all recordings",
        Basis.ROUNDING,
        "1 / longest recording",
    )
    highest: float = threshold(
        0.12, "frequency that is tried at most, of that of the windows", Basis.JUDGED, "1 / window step"
    )
    highest_of_inputs: float = threshold(
        0.2, "the same where an input is the driver, which has hardly any noise", Basis.JUDGED, "1 / window step"
    )
    most_damped: float = threshold(0.6, "damping ratio of what is still called a swing", Basis.JUDGED)
    least_damped: float = threshold(1e-3, "damping ratio that is told from none", Basis.JUDGED)
    refined: int = threshold(60, "steps to the best frequency and damping", Basis.EFFORT, "count")
    drivers: int = threshold(4, "signals at most whose modes are looked at closely", Basis.EFFORT, "count")
    rounds: int = threshold(3, "times that the noise's colour is estimated beside the mode", Basis.EFFORT, "count")
    false_alarm: float = threshold(
        1e-3, "probability that noise alone shows a mode of any frequency along any axis", Basis.CONVENTION
    )
    confirmed: float = threshold(
        0.01, "probability that noise alone saves as much in the held-out recordings, at most", Basis.CONVENTION
    )
    agreed: float = threshold(0.75, "share of the recordings in which it must save any", Basis.CONVENTION)
    alike: float = threshold(
        0.05, "relative difference of the frequencies of one mode along two axes, at most", Basis.JUDGED
    )
    equal: float = threshold(
        0.05, "difference of logarithms of squared errors within which modes forecast equally well", Basis.JUDGED
    )
    most: int = threshold(2, "modes that are learned at most", Basis.JUDGED, "count")
