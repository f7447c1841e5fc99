"""The thresholds of `bench.diagnose.learn`; those of waves are in `unseen`."""

from dataclasses import dataclass

from bench.diagnose.settings.threshold import Basis, threshold


@dataclass(frozen=True)
class Splining:
    """Penalised splines of signals, added one by one while held-out recordings gain."""

    knots: int = threshold(7, "knots of a spline in most signals", Basis.JUDGED, "count")
    knots_of_a_pose: int = threshold(
        15, "knots in a signal that says where the system is: there may be many different places", Basis.JUDGED, "count"
    )
    knots_of_a_wave: int = threshold(
        33,
        "knots in such a signal alone where nothing follows it as coarsely as that: four a period of the shortest wave "
        "that a formula may have",
        Basis.JUDGED,
        "count",
    )
    outer: float = threshold(
        0.002, "share of the samples beyond each of the outer knots, where the spline is a straight line", Basis.JUDGED
    )
    penalties: tuple[float, ...] = threshold(
        (1e-7, 1e-5, 1e-3, 1e-1),
        "weights of the roughness, relative to the mean square of the columns, of which held-out recordings choose",
        Basis.EFFORT,
    )
    first: int = threshold(
        12, "pairs whose penalty is chosen, of all that were tried with the middle one", Basis.EFFORT, "count"
    )
    most: int = threshold(4, "terms that are learned at most", Basis.JUDGED, "count")
    gain: float = threshold(
        0.02,
        "least gain on recordings not fitted, as a share of what noise leaves; noise alone reaches 0.0001",
        Basis.MEASURED,
    )
    relative: float = threshold(
        0.02, "least gain of a further term, relative to that of all terms in its equation", Basis.JUDGED
    )
    agreed: float = threshold(0.75, "share of the recordings that must confirm a term", Basis.CONVENTION)


@dataclass(frozen=True)
class Wording:
    """The formula that says a learned term."""

    worse: float = threshold(
        0.01, "share of what a term saves by which a formula may be worse than the best shape", Basis.JUDGED
    )
    surely: float = threshold(
        2.0, "standard errors over recordings by which it must be worse to be so for sure", Basis.CONVENTION
    )
    widths: tuple[float, float, int] = threshold(
        (0.1, 0.9, 9),
        "of the largest magnitude, or as quantiles, where a shape may bend: from, to, and how many",
        Basis.EFFORT,
    )
    waves: tuple[float, float, float] = threshold(
        (0.4, 8.1, 0.35), "periods of a wave within the span that are tried: from, to below, and step", Basis.EFFORT
    )
    decays: tuple[float, ...] = threshold(
        (-8.0, -4.0, -2.0, -1.0, 1.0, 2.0, 4.0, 8.0),
        "logarithms by which an exponential falls over the span, of those that are tried",
        Basis.EFFORT,
    )
    nudge: float = threshold(1e-4, "relative step of the difference quotient in a bend", Basis.ROUNDING)


@dataclass(frozen=True)
class Learning:
    """Terms sought, weighed and fitted."""

    large: float = threshold(
        0.3,
        "share of what can be explained in an equation that suffices where a term is met in few places, such as a wall",
        Basis.JUDGED,
    )
    few: int = threshold(
        150,
        "products of two signals that are all tried; of more, those with a signal that matters by itself",
        Basis.EFFORT,
        "count",
    )
    few_waves: int = threshold(
        12,
        "axes times signals that say where the system is, with which waves stand beside splines from the first; where "
        "there are more, if nothing else is found",
        Basis.EFFORT,
        "count",
    )
    tries: int = threshold(
        4, "times that terms are sought without what turned out to be a consequence", Basis.EFFORT, "count"
    )
    steps: int = threshold(2, "Gauss–Newton steps to the numbers with which terms are weighed", Basis.EFFORT, "count")
    rounds: int = threshold(
        3, "times that every term's formula is chosen, bent better, beside those of the others", Basis.EFFORT, "count"
    )
    leads: tuple[float, ...] = threshold(
        (0.05, 0.1, 0.2, 0.4),
        "how much later a signal is looked at, to tell whether it is a consequence of what it seems to cause",
        Basis.JUDGED,
        "s",
    )
    better: float = threshold(
        0.02,
        "share of what a term saves by which the later signal must save more for the term to be a consequence",
        Basis.JUDGED,
    )


@dataclass(frozen=True)
class Sketching:
    """The shape of a learned term or wave on the page."""

    points: int = threshold(61, "points of the curve of a term or wave", Basis.SHOWN, "count")
    dots: int = threshold(700, "dots beside the curve, about", Basis.SHOWN, "count")
    inner: float = threshold(0.002, "share of the samples beyond either end of the curve", Basis.SHOWN)
    parts: int = threshold(16, "parts of a wave's period over which a dot is a mean", Basis.SHOWN, "count")
