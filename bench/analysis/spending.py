"""Looks at evidence that grows: the level of each at which all of them together err no more often than one may.

Trainings come seed by seed, and whoever stops once an interval is narrow enough stops too early now and then. So every
look spends a part of what may go wrong: Lan and DeMets (1983), with their function that is like Pocock's bounds, which
stops early where it can; a training costs more than an interval that is a little wider.
"""

import math
from functools import lru_cache

import numpy as np
from scipy.special import ndtr, ndtri

from bench.experiment.seeds import MOST_SEEDS

_POINTS, _FAR = 201, 8.0
"""Of the grid on which a density is kept, an odd number; how many standard deviations it reaches to the side that is
not spent on."""
_SIMPSON = np.array([1.0, *([4.0, 2.0] * (_POINTS // 2))[:-1], 1.0]) / 3


def level(alpha: float, first: int, seeds: int) -> float:
    """The α of the intervals at the look with so many seeds a configuration.

    A two-sided interval at α misses on either side with α / 2, and a verdict is wrong on one side only: that of a
    difference in truth goes the other way, or beyond the limit of a band. The first look is at α, and errs with α / 2;
    the later ones spend another α / 2 between them, so that all err with α at most. There is a look at every number of
    seeds from the first to `MOST_SEEDS`; at most one look comes after that, and takes its level.

    Looks are as much alike as the sums of so many independent trainings. Recordings, which all share, make them more
    alike, and less is spent than is counted (Slepian's inequality). Degrees of freedom count in the interval itself
    (the significance-level approach, Jennison and Turnbull 2000, section 3.8).

    Args:
        alpha: of all looks.
        first: seeds at the first look, which was not chosen by what was seen.
        seeds: seeds at this look.
    """
    if seeds <= first or first >= MOST_SEEDS:
        return alpha
    return _levels(alpha, first)[min(seeds, MOST_SEEDS) - first]


@lru_cache(maxsize=1024)
def _levels(alpha: float, first: int) -> tuple[float, ...]:
    """Levels of all looks: bounds of a sum of independent normal variables, on whose upper side alone is spent.

    Armitage, McPherson and Rowe (1969): the density of what has not crossed yet goes from look to look by quadrature.
    """
    bound = -ndtri(alpha / 2) * math.sqrt(first)
    x = np.linspace(-_FAR * math.sqrt(first), bound, _POINTS)
    density = np.exp(-(x**2) / (2 * first)) / math.sqrt(2 * math.pi * first)
    found, before = [alpha], 0.0
    for n in range(first + 1, MOST_SEEDS + 1):
        time = (n - first) / (MOST_SEEDS - first)
        spent = alpha / 2 * math.log(1 + (math.e - 1) * time)
        mass = density * (x[1] - x[0]) * _SIMPSON
        bound = _bound(x, mass, spent - before)
        found.append(float(2 * ndtr(-bound / math.sqrt(n))))
        grid = np.linspace(-_FAR * math.sqrt(n), bound, _POINTS)
        density = np.exp(-((grid[:, None] - x) ** 2) / 2) / math.sqrt(2 * math.pi) @ mass
        x, before = grid, spent
    return tuple(found)


def _bound(x: np.ndarray, mass: np.ndarray, crossing: float) -> float:
    """What one more training carries this mass over."""
    low, high = float(x[0]), float(x[-1]) + 40.0
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if float(mass @ ndtr(x - middle)) > crossing else (low, middle)
    return (low + high) / 2
