"""What the spread over seeds and recordings can support: intervals, paired comparisons, equivalence.

The unit of a comparison is the recording: windows of one recording are not independent of each other. Training runs
(seeds) are a second, crossed source of spread: each is judged on every recording.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri, stdtrit

MIN_RECORDINGS = 8
"""Recordings from which on their own distribution is resampled; below, a normal one is assumed and said."""
ALIKE = (0.8, 1.25)
"""A ratio of errors whose interval lies within these is called alike."""
POWER = 0.8
"""Chance with which the smallest difference that could have been seen would have been seen."""
RESAMPLES = 4000
EXACT = 12
"""Gains up to which all signs are tried."""
ACTING = 3
"""Blocks, by their power, from which on what acts in them says something by their number."""


def interval(values: Sequence[float], confidence: float = 0.95) -> tuple[float, float] | None:
    """Student's interval of the mean of independent values (one a seed); None below two of them."""
    x = np.asarray(values, dtype=float)
    if len(x) < 2:
        return None
    half = stdtrit(len(x) - 1, (1 + confidence) / 2) * x.std(ddof=1) / math.sqrt(len(x))
    return float(x.mean() - half), float(x.mean() + half)


def relative_gain(before: np.ndarray, after: np.ndarray, sure: float) -> float:
    """Lower end of the share of an error that blocks (B,) save, each counted alike; of fewer than three minus infinity.

    Errors of blocks go over decades where few of them hold a manoeuvre; their ratios do not, and are compared by their
    logarithms.

    Args:
        before: (B,) squared errors of independent blocks.
        after: (B,) with what is to save them.
        sure: half of the interval, in standard errors.
    """
    if len(before) < 3:
        return -math.inf
    ratios = np.log(np.maximum(before, 1e-300) / np.maximum(after, 1e-300))
    return 1 - math.exp(sure * float(ratios.std(ddof=1)) / len(ratios) ** 0.5 - float(ratios.mean()))


def uneven_gain(gains: np.ndarray, confidence: float = 0.95) -> float:
    """Lower end of the interval of a mean gain, for gains that are as uneven as they are sure.

    Where one block of eight has nearly all of it, Student's interval holds zero although every block gains. Fisher's
    randomization test asks how often random signs of the gains make as large a sum; this is the most that may be taken
    off every gain before that is more often than chance would have it.

    Args:
        gains: (B,) of independent blocks; of fewer than six nothing can be said at 95 %: minus infinity.
        confidence: of the two-sided interval.
    """
    count, level = len(gains), (1 - confidence) / 2
    if 2.0**-count > level:
        return -math.inf
    if count <= EXACT:
        heads = (np.arange(2**count)[:, None] >> np.arange(count)) & 1
    else:
        heads = np.random.default_rng(0).integers(0, 2, (RESAMPLES, count))
    signs = 2.0 * heads - 1

    def chance(less: float) -> float:
        moved = gains - less
        return float((signs @ moved >= moved.sum() - 1e-12 * np.abs(moved).sum()).mean())

    high = float(gains.mean())
    low = 2 * float(gains.min()) - high
    for _ in range(40):
        middle = (low + high) / 2
        low, high = (middle, high) if chance(middle) <= level else (low, middle)
    return low


def rare_gain(before: np.ndarray, after: np.ndarray, recording: np.ndarray, block: np.ndarray, sure: float) -> float:
    """Lower end of the interval of a mean gain, of what acts in so few blocks that these say nothing by their number.

    A manoeuvre that is flown once is one block, and gains of one block are no sample. But what is saved there has a
    course of its own, which errors that have nothing to do with it do not follow: that of a matched filter (G. L.
    Turin, *IRE Trans. Inf. Theory* 6(3), 1960). Errors are as correlated in time as those that are left everywhere,
    or there, whichever is more.

    Args:
        before: (W, c) errors of windows in their order.
        after: (W, c) with what is to save them.
        recording: (W,) that a window is of.
        block: (W,) of windows that are one sample.
        sure: half of the interval, in standard errors.

    Returns:
        The gain of squared error, mean over windows; minus infinity where three blocks or half of them act.
    """
    course = before - after
    power = np.bincount(block, (course**2).sum(1))
    if not power.any() or power.sum() ** 2 >= min(ACTING, len(power) / 2) * (power**2).sum():
        return -math.inf
    series = [(course[own], after[own]) for own in (recording == i for i in np.unique(recording))]
    everywhere, there, longest = 0.0, 0.0, int(np.bincount(block).max())
    for lag in range(longest):
        pairs = [(c[lag:], a[lag:], c[: len(c) - lag], a[: len(a) - lag]) for c, a in series if len(c) > lag]
        weight = (2.0 if lag else 1.0) * (1 - lag / longest)  # Bartlett's
        covariance = sum(late.T @ early for _, late, _, early in pairs) / sum(len(late) for _, late, _, _ in pairs)
        everywhere += weight * sum(float((covariance * (late.T @ early)).sum()) for late, _, early, _ in pairs)
        there += weight * sum(float((c * a).sum(1) @ (d * b).sum(1)) for c, a, d, b in pairs)
    error = 2 * math.sqrt(max(everywhere, there, 0.0))
    return float(((before**2).sum() - (after**2).sum() - sure * error) / len(before))


def curve_interval(
    curves: np.ndarray, statistic: Callable[[np.ndarray], np.ndarray], confidence: float = 0.95, resamples: int = 2000
) -> tuple[float, float]:
    """Percentile interval of a statistic of the mean curve, trainings and recordings both drawn again.

    Args:
        curves: (S, R, T) mean error of every step, of S trainings on R recordings.
        statistic: (D, T) curves → (D,) values, such as their maxima.
        confidence: of the interval.
        resamples: draws.
    """
    rng = np.random.default_rng(0)
    trainings, recordings, _ = curves.shape
    of_trainings = rng.multinomial(trainings, np.full(trainings, 1 / trainings), resamples) / trainings
    of_recordings = rng.multinomial(recordings, np.full(recordings, 1 / recordings), resamples) / recordings
    drawn = statistic(np.einsum("ds,dr,srt->dt", of_trainings, of_recordings, curves, optimize=True))
    low, high = np.quantile(drawn, [(1 - confidence) / 2, (1 + confidence) / 2])
    return float(low), float(high)


def share_interval(count: float, of: float, confidence: float = 0.95) -> tuple[float, float]:
    """Wilson's interval of a share ``count`` / ``of``."""
    z = float(ndtri((1 + confidence) / 2))
    centre, scale = (count + z * z / 2) / (of + z * z), of / (of + z * z)
    half = scale * z * math.sqrt(count * (of - count) / of**3 + (z / (2 * of)) ** 2)
    return centre - half, centre + half


def share_difference(a: tuple[float, float], b: tuple[float, float], confidence: float = 0.95) -> tuple[float, float]:
    """Interval of the difference of two shares (count, of), from their Wilson limits (Newcombe 1998, method 10)."""
    share_a, share_b = a[0] / a[1], b[0] / b[1]
    (low_a, high_a), (low_b, high_b) = share_interval(*a, confidence), share_interval(*b, confidence)
    difference = share_a - share_b
    below = math.hypot(share_a - low_a, high_b - share_b)
    return difference - below, difference + math.hypot(high_a - share_a, share_b - low_b)


@dataclass(frozen=True)
class Comparison:
    """Errors of a as a multiple of those of b."""

    ratio: float
    """Geometric mean over trainings and recordings of error a / error b; NaN where there is no pair."""
    low: float
    """Confidence limits of the ratio; NaN where nothing repeats (one training on one recording)."""
    high: float
    smallest: float
    """Smallest relative reduction of the error (0.2: by 20 %) seen in four of five such experiments; NaN for one."""
    trainings: int
    """Pairs of trained networks."""
    recordings: int
    basis: str
    """What the interval rests on."""

    @property
    def verdict(self) -> str:
        """ "better" (a has the smaller error), "worse" or "cannot tell"; one training cannot speak for the next."""
        if self.trainings < 2:
            return "cannot tell"
        return "better" if self.high < 1 else "worse" if self.low > 1 else "cannot tell"

    @property
    def alike(self) -> bool:
        """Whether the data support that the two differ by no more than `ALIKE`."""
        return self.trainings > 1 and ALIKE[0] <= self.low and self.high <= ALIKE[1]


def compare(a: np.ndarray, b: np.ndarray, confidence: float = 0.95, resamples: int = RESAMPLES) -> Comparison:
    """Compare the errors of two models, paired by training and recording.

    The mean log ratio has the variance σ_r²/R + σ_s²/S + σ_e²/(R S) of two crossed random factors. The part that
    repeats over recordings (first and last term) gets a studentized bootstrap over recordings, or Student's interval
    below `MIN_RECORDINGS` of them; the part of the trainings gets Student's interval; squared half-widths add up
    (variance recovery: Zou and Donner 2008).

    Args:
        a, b: (S, R) positive mean errors of S trainings on R recordings, in one unit.
        confidence: of the interval.
        resamples: draws of the bootstrap; the further out in the tails the limits lie, the more it takes.
    """
    d = np.log(np.asarray(a, dtype=float) / np.asarray(b, dtype=float))
    if d.ndim != 2 or np.shape(a) != np.shape(b):
        raise ValueError(
            f"errors must be two (trainings, recordings) tables of one shape, not {np.shape(a)}, {np.shape(b)}"
        )
    trainings, recordings = d.shape
    if not d.size:
        return Comparison(
            ratio=math.nan,
            low=math.nan,
            high=math.nan,
            smallest=math.nan,
            trainings=trainings,
            recordings=recordings,
            basis="no pair of finished runs",
        )
    mean = float(d.mean())
    below, above = _recording_half_widths(d.mean(0), confidence, resamples)
    of_trainings = _training_half_width(d, confidence)
    basis = _basis(trainings, recordings)
    if recordings == 1 and trainings == 1:
        return Comparison(
            ratio=math.exp(mean),
            low=math.nan,
            high=math.nan,
            smallest=math.nan,
            trainings=trainings,
            recordings=recordings,
            basis=basis,
        )
    below, above = math.hypot(below, of_trainings), math.hypot(above, of_trainings)
    detectable = (below + above) / 2 * (1 + ndtri(POWER) / ndtri((1 + confidence) / 2))
    return Comparison(
        ratio=math.exp(mean),
        low=math.exp(mean - below),
        high=math.exp(mean + above) if mean + above < 700 else math.inf,  # few repetitions at a high confidence
        smallest=1 - math.exp(-detectable) if trainings > 1 else math.nan,
        trainings=trainings,
        recordings=recordings,
        basis=basis,
    )


def _basis(trainings: int, recordings: int) -> str:
    """What an interval over so many trainings and recordings rests on and what it leaves out."""
    if recordings >= MIN_RECORDINGS:
        words = f"paired bootstrap over {recordings} recordings"
    elif recordings > 1:
        words = f"t-interval over only {recordings} recordings"
    else:
        words = "one recording, which says nothing about another"
    return f"{words}; " + (
        f"{trainings} pairs of trained networks" if trainings > 1 else "one training, which says nothing about the next"
    )


def _recording_half_widths(d: np.ndarray, confidence: float, resamples: int) -> tuple[float, float]:
    """Distances of the lower and upper limit from the mean of d (R,), recordings being the repetition."""
    n = len(d)
    if n < 2:
        return 0.0, 0.0
    error = float(d.std(ddof=1)) / math.sqrt(n)
    if n < MIN_RECORDINGS or error == 0:
        half = float(stdtrit(n - 1, (1 + confidence) / 2)) * error
        return half, half
    drawn = d[np.random.default_rng(0).integers(0, n, size=(resamples, n))]
    spread = drawn.std(1, ddof=1) / math.sqrt(n)
    usable = spread > 1e-9 * error  # a draw of one recording n times over has no spread
    t = (drawn.mean(1) - d.mean())[usable] / spread[usable]
    low, high = np.quantile(t, [(1 - confidence) / 2, (1 + confidence) / 2])
    return float(high) * error, float(-low) * error


def _training_half_width(d: np.ndarray, confidence: float) -> float:
    """Half-width that trainings of d (S, R) add beyond what recordings and the interaction account for."""
    trainings, recordings = d.shape
    if trainings < 2:
        return 0.0
    variance = d.mean(1).var(ddof=1)  # of one training's mean: σ_s² + σ_e²/R
    if recordings > 1:
        rest = d - d.mean(0, keepdims=True) - d.mean(1, keepdims=True) + d.mean()
        variance -= (rest**2).sum() / ((trainings - 1) * (recordings - 1)) / recordings
    return float(stdtrit(trainings - 1, (1 + confidence) / 2)) * math.sqrt(max(variance, 0.0) / trainings)
