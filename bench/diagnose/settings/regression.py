"""The thresholds of `bench.diagnose.regression`."""

import math
from dataclasses import dataclass

from bench.diagnose.settings.threshold import Basis, threshold


@dataclass(frozen=True)
class Linearising:
    """A model about its numbers, and effects about starting points."""

    unstable: float = threshold(
        1e6,
        "rates, relative to the model's own, that no physical effect adds: a start with more is left out",
        Basis.JUDGED,
    )
    largest: float = threshold(
        0.999,
        "share of the samples of a signal that are no larger than its size, in which effects are measured",
        Basis.JUDGED,
    )
    wide: float = threshold(
        0.2,
        "relative 1σ of a constant from which what an effect does depends on it too much for one linearisation",
        Basis.JUDGED,
    )
    probe: float = threshold(1e-3, "step of a one-sided difference, in scales of the parameter", Basis.ROUNDING)
    remembered: int = threshold(
        400,
        "samples that a delay which is looked for reaches back at most: each one is a state",
        Basis.EFFORT,
        "samples",
    )
    together: int = threshold(
        12,
        "models, at least, whose rates are held in memory at once; those of all starts would take gigabytes",
        Basis.EFFORT,
        "count",
    )
    at_once: int = threshold(
        8_000,
        "samples, times models, whose rates are computed at once: what they need fits a processor's cache",
        Basis.EFFORT,
        "count",
    )
    affine: float = threshold(
        1e-9, "largest difference from an affine map, relative to the map, of a recurrence that is one", Basis.ROUNDING
    )


@dataclass(frozen=True)
class Calibrating:
    """What is known of a model's constants."""

    within: float = threshold(
        3.0,
        "how far a constant is calibrated at most: one further off is a wrong constant, which is an effect",
        Basis.CONVENTION,
        "σ",
    )
    free: float = threshold(
        math.log(10),
        "1σ of the logarithm of a constant that was let go: an order of magnitude, so that it pulls no other one along",
        Basis.JUDGED,
    )


@dataclass(frozen=True)
class Following:
    """What a residual follows."""

    alike: float = threshold(
        1e-3,
        "share of the largest gain by which a column may gain less and still be taken before it, if it stands first: "
        "copies of one signal gain alike to eight digits, and rounding would choose among them",
        Basis.ROUNDING,
    )


@dataclass(frozen=True)
class Folding:
    """Recordings held out in turn, and blocks whose losses are compared."""

    folds: int = threshold(
        3,
        "fewest parts of which each is held out once: recordings, or stretches of them where there are fewer",
        Basis.CONVENTION,
        "count",
    )
    most: int = threshold(
        10,
        "parts of which each is held out at most, the usual number for cross-validation: more recordings make them "
        "together, neighbours by neighbours, else normal equations of each would take memory without bound",
        Basis.CONVENTION,
        "count",
    )
    block: float = threshold(
        4.0,
        "length of the blocks whose losses are compared: longer than what is left in a residual remembers",
        Basis.JUDGED,
        "s",
    )


@dataclass(frozen=True)
class Waving:
    """A wave of known frequency, told from what was recorded before."""

    silent: float = threshold(
        0.5,
        "silence that is taken to have come before a recording: a wave must be heard before it is told",
        Basis.JUDGED,
        "periods",
    )
    heard: float = threshold(1.0, "length of a recording before which no wave is told", Basis.JUDGED, "periods")


@dataclass(frozen=True)
class Mapping:
    """Residuals against conditions, as the page shows them."""

    bins: int = threshold(12, "bins of equally many samples each, whose means are drawn", Basis.SHOWN, "count")
    dots: int = threshold(1500, "samples of a scatter that are kept at most", Basis.SHOWN, "count")
    maps: int = threshold(8, "maps that are shown at most", Basis.SHOWN, "count")
    each: int = threshold(2, "maps of one quantity, and maps against one condition, at most", Basis.SHOWN, "count")
    follows: float = threshold(
        0.05, "share of a residual's variance that its means in bins must hold for a map to be shown", Basis.SHOWN
    )
