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
    most: int = threshold(4, "lines along one axis that are looked at, at most", Basis.EFFORT, "count")
