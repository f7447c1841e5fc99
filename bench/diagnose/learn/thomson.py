"""Thomson's harmonic F-test: how surely something swings at one frequency, whatever the colour of the noise.

D. J. Thomson, "Spectrum estimation and harmonic analysis", Proc. IEEE 70 (1982), eqs. 13.5 and 13.10. Orthogonal tapers
see noise of a locally smooth spectrum independently, and a line all with one amplitude. Probabilities of several series
are put together by Fisher's method.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy  # its parts are imported when they are used: scipy.signal takes longer than most of what is here
from scipy.special import gammaincc, gammaln

from bench.diagnose.settings import UNSEEN


@dataclass(frozen=True, eq=False)
class Scan:
    """How surely there is a line at each of some frequencies."""

    frequencies: np.ndarray
    """(F,) [Hz]."""
    evidence: np.ndarray
    """(F,) −log of the probability that noise shows one there; 0 where no series is long enough."""
    background: np.ndarray
    """(F,) power of the noise about it, relative to white noise of unit variance."""


def scan(series: Sequence[np.ndarray], step: float) -> Scan:
    """Look for a line that all ``series`` (J,), sampled every ``step`` [s], have at one frequency."""
    size = 1 << int(np.ceil(np.log2(UNSEEN.oversampled * max(map(len, series)))))
    frequencies = np.fft.rfftfreq(size, step)
    total, degrees = np.zeros(len(frequencies)), np.zeros(len(frequencies))
    level, weight = np.zeros(len(frequencies)), np.zeros(len(frequencies))
    for x in series:
        tapers, sums = _tapers(len(x))
        seen = np.fft.rfft(tapers * (x - x.mean()), size)
        line = sums @ seen / (sums @ sums)
        rest = (np.abs(seen - line * sums[:, None]) ** 2).sum(0)
        more = len(tapers) - 1
        usable = frequencies > _lowest(len(x), step)
        ratio = np.abs(line) ** 2 * (sums @ sums) / np.maximum(rest, 1e-300)
        total += np.where(usable, 2 * more * np.log1p(ratio), 0.0)
        degrees += 2 * usable
        level += np.where(usable, rest / more * len(x), 0.0)
        weight += usable * len(x)
    background = level / np.maximum(weight, 1)
    return Scan(frequencies, -_log_survival(total, degrees), background)


def lines_at(series: Sequence[np.ndarray], step: float, frequency: float) -> tuple[np.ndarray, np.ndarray]:
    """What ``series`` (J, n) of each stretch say of a line at one frequency [Hz].

    Returns:
        −log of the probability (n,) that noise shows one in all stretches, and complex amplitudes (stretches, n) from
        the first sample of each: the real part of amplitude · exp(2πi · frequency · t) is the line.
    """
    total, degrees, amplitudes = np.zeros(series[0].shape[1]), 0, []
    for x in series:
        tapers, sums = _tapers(len(x))
        turning = tapers * np.exp(-2j * np.pi * frequency * step * np.arange(len(x)))
        seen = turning @ (x - x.mean(0))
        line = sums @ seen / (sums @ sums)
        amplitudes.append(2 * line)
        if frequency > _lowest(len(x), step):
            rest = (np.abs(seen - np.outer(sums, line)) ** 2).sum(0)
            total += 2 * (len(tapers) - 1) * np.log1p(np.abs(line) ** 2 * (sums @ sums) / np.maximum(rest, 1e-300))
            degrees += 2
    return -_log_survival(total, np.full(len(total), degrees)), np.array(amplitudes)


def _lowest(count: int, step: float) -> float:
    """The frequency [Hz] above which the mean of a series, which is no noise, does not leak: twice the bandwidth."""
    return 2 * UNSEEN.bandwidth / (count * step)


def _log_survival(x: np.ndarray, degrees: np.ndarray) -> np.ndarray:
    """Log of the probability that chi-squared is beyond x; its leading term where that is below what a float holds."""
    half = np.maximum(degrees, 2) / 2
    tail = gammaincc(half, x / 2)
    far = (half - 1) * np.log(np.maximum(x, 1e-300) / 2) - x / 2 - gammaln(half)
    return np.where(degrees > 0, np.where(tail > 1e-290, np.log(np.maximum(tail, 1e-290)), far), 0.0)


@lru_cache(maxsize=16)
def _tapers(length: int) -> tuple[np.ndarray, np.ndarray]:
    """Slepian tapers (K, length) of unit power, and their sums (K,), zero for the odd ones."""
    count = round(2 * UNSEEN.bandwidth) - 1
    tapers = scipy.signal.windows.dpss(length, UNSEEN.bandwidth, count)
    sums = tapers.sum(1)
    sums[1::2] = 0.0
    return tapers, sums
