"""The thresholds of `bench.diagnose.simulate`."""

from dataclasses import dataclass

from bench.diagnose.settings.threshold import Basis, threshold


@dataclass(frozen=True)
class Running:
    """Free runs from measured states."""

    longest: float = threshold(0.5, "default horizon of free runs", Basis.CONVENTION, "s")
    fewest: int = threshold(20, "samples of the default horizon, at least", Basis.JUDGED, "samples")
    short: float = threshold(
        0.2,
        "shorter horizon at which an equation is judged, as a share of the free runs': fast torques show in it, slow "
        "forces in the longer one",
        Basis.JUDGED,
    )
    draws: int = threshold(
        8,
        "draws of the noise for each window of a floor: one alone leaves the floor a few per cent to chance",
        Basis.EFFORT,
        "count",
    )


@dataclass(frozen=True)
class Beginning:
    """Where unmeasured states begin."""

    warm: int = threshold(
        50,
        "samples from whose measurement the beginning is sought, and before which nothing is judged",
        Basis.JUDGED,
        "samples",
    )
    settle: int = threshold(
        100, "samples for which the first input is held to guess the beginning", Basis.JUDGED, "samples"
    )
    steps: int = threshold(12, "Levenberg–Marquardt steps to the beginning", Basis.EFFORT, "count")


@dataclass(frozen=True)
class Shooting:
    """Numbers fitted so that free runs from measured states meet the measurements."""

    windows: int = threshold(160, "windows, about, over all recordings", Basis.EFFORT, "count")
    points: int = threshold(8, "samples of a window whose errors count", Basis.EFFORT, "count")
    steps: int = threshold(6, "Gauss–Newton steps at most", Basis.EFFORT, "count")
    enough: float = threshold(1e-3, "relative fall of the cost below which a fit is finished", Basis.EFFORT)


@dataclass(frozen=True)
class Simulating:
    """Models with unmeasured states, fitted over windows that begin where they are met best."""

    window: int = threshold(128, "longest window, which has a beginning of its own", Basis.JUDGED, "samples")
    windows: int = threshold(
        8, "windows at least, of the recordings together: sets are compared on windows left out", Basis.JUDGED, "count"
    )
    steps: int = threshold(16, "Levenberg–Marquardt steps at most", Basis.EFFORT, "count")
    enough: float = threshold(2e-3, "relative fall of the cost below which a fit is finished", Basis.EFFORT)
    far: float = threshold(
        1e3, "error, in units of what is measured, that stands for a free run that diverged", Basis.CONVENTION
    )


@dataclass(frozen=True)
class Playing:
    """Whole recordings on the page."""

    recordings: int = threshold(6, "recordings that are drawn, at most", Basis.SHOWN, "count")
    points: int = threshold(
        430_000, "points of all lines together: about five bytes each on the page", Basis.SHOWN, "count"
    )
    far: float = threshold(2.0, "how far outside the measured range a line is followed, as a share of it", Basis.SHOWN)
    finest: float = threshold(1 / 400, "share of the same range by which a drawn line may miss a sample", Basis.SHOWN)
